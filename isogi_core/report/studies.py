"""The studies of a report, the most important first."""

from collections.abc import Callable
from dataclasses import dataclass

from isogi_core.report import (
    convergence,
    interpolation,
    lattices,
    models,
    normals,
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


STUDIES = (
    Study("summary", "Summary", summary.study, 0.15),
    Study("split", "Where the error comes from", split.study, 0.2),
    Study("convergence", "Error against run time", convergence.study, 0.25),
    Study("tracing", "The frame and path tracing", tracing.study, 0.01),
    Study("lattices", "Density of the lattice", lattices.study, 0.1),
    Study("interpolation", "Interpolation", interpolation.study, 0.12),
    Study("normals", "Normals and offset", normals.study, 0.07),
    Study("vicinity", "Vicinity shading", vicinity.study, 0.02),
    Study("models", "Frame times and memory", models.study, 0.08),
)
"""All of them. What a study makes for itself, such as the reference, the next ones find on the bench."""
