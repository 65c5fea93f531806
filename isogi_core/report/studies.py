"""The studies of a report, the most important first."""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

from isogi_core.report import (
    convergence,
    interpolation,
    lattices,
    models,
    moved,
    normals,
    sequences,
    split,
    summary,
    tracing,
    vicinity,
)
from isogi_core.report.bench import Bench
from isogi_core.report.sections import Section


@dataclass(frozen=True)
class Study:
    """One question: ``run`` answers it. ``weight`` is its rough share of the whole work; the ``key`` is stable."""

    key: str
    title: str
    run: Callable[[Bench], Section]
    weight: float


def study_of(module: ModuleType, weight: float) -> Study:
    """The study of a module, which has a KEY, a TITLE and a ``study``; it begins unhurried."""

    def run(bench: Bench) -> Section:
        bench.hurry.clear()
        section: Section = module.study(bench)
        return section

    return Study(module.KEY, module.TITLE, run, weight)


STUDIES = (
    study_of(summary, 0.15),
    study_of(split, 0.15),
    study_of(convergence, 0.30),
    study_of(tracing, 0.01),
    study_of(lattices, 0.17),
    study_of(interpolation, 0.13),
    study_of(moved, 0.10),
    study_of(normals, 0.03),
    study_of(sequences, 0.06),
    study_of(vicinity, 0.01),
    study_of(models, 0.05),
)
"""All of them. What a study makes for itself, such as the reference, the next ones find on the bench."""
