"""How light is carried from texels to pixels: the ways of ``report.moved`` on real volumes, as docs tell them.

``python -m benchmarks.interpolation [--size 80] [-o FOLDER]``; references are kept in FOLDER, and grown from there.
Needs the shared data.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import click

from benchmarks.reports import Subject, scene_of
from isogi_core.report import moved
from isogi_core.report.bench import Bench
from isogi_core.report.sections import Section
from server.measure import view_of
from server.report.command import STAND

ENGINES = tuple(Subject("engine", isovalue, "constant light") for isovalue in (70, 170, 180))
HEAD, BRAIN = (Subject(*each, "constant light") for each in (("CT head", 110), ("MNI brain", 90)))
PROBES = (
    *(Subject("engine", isovalue, light) for isovalue, light in ((70, "grace"), (170, "uffizi"))),
    Subject("CT head", 110, "uffizi"),
    Subject("MNI brain", 90, "grace"),
)
SUBJECTS = (*ENGINES, HEAD, BRAIN, *PROBES)


@click.command()
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), help="Where references are kept.")
@click.option("--size", type=click.IntRange(8, 1024), default=80, show_default=True, help="Pixels along each side.")
@click.option("--only", multiple=True, help="Part of a subject's name, such as 'engine under grace'; repeatable.")
def main(output: Path | None, size: int, only: tuple[str, ...]) -> None:
    """Print a table in Markdown for each subject."""
    tell(SUBJECTS, moved.study, table_of, output, size, only)


def tell(
    subjects: Sequence[Subject],
    study: Callable[[Bench], Section],
    told: Callable[[str, Section], str],
    output: Path | None,
    size: int,
    only: Sequence[str],
) -> None:
    """Print what a ``study`` finds of the subjects whose names have any part of ``only``, as it is ``told``."""
    with tempfile.TemporaryDirectory() as passing:
        for subject in subjects:
            if not only or any(part in subject.name for part in only):
                begun = time.monotonic()
                click.echo(told(subject.name, study(bench_of(subject, size, output or Path(passing)))))
                click.echo(f"{subject.name}: {time.monotonic() - begun:.0f} s", err=True)


def bench_of(subject: Subject, size: int, folder: Path) -> Bench:
    """The bench of a subject's view, as reports have it, but with no lobes beside: all light is carried by texels."""
    scene = scene_of(subject, **({} if subject.light == "constant light" else {"lobes": 0}))
    return Bench(scene, view_of(scene, size, camera=scene.camera(**STAND, fov=30.0)), folder / subject.folder)


def table_of(name: str, section: Section) -> str:
    """A section's table as Markdown, shares in per cent."""
    table = section.tables[0]
    head = "| " + " | ".join([name, *(f"{column.name}, %" for column in table.columns[1:])]) + " |"
    rule = "| --- |" + " ---: |" * (len(table.columns) - 1)
    rows = [
        f"| {row[0]} | " + " | ".join(f"{100.0 * float(cell or 0.0):.2f}" for cell in row[1:]) + " |"
        for row in table.rows
    ]
    return "\n".join([head, rule, *rows, ""])


if __name__ == "__main__":
    main()
