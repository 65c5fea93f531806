"""How light is carried from texels to pixels: the ways of ``report.moved`` on real volumes, as docs tell them.

``python -m benchmarks.interpolation [--size 80] [-o FOLDER]``; references are kept in FOLDER, and grown from there.
Needs the shared data.
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

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
    for subject, bench in benches(SUBJECTS, without_lobes, output, size, only):
        click.echo(table_of(subject.name, moved.study(bench)))


def benches(
    subjects: Sequence[Subject],
    settings: Callable[[Subject], Mapping[str, Any]],
    output: Path | None,
    size: int,
    only: Sequence[str],
) -> Iterator[tuple[Subject, Bench]]:
    """Benches of the subjects whose names have any part of ``only``, as reports have them, with ``settings`` besides.

    Says how long each was of use.
    """
    with tempfile.TemporaryDirectory() as passing:
        for subject in subjects:
            if not only or any(part in subject.name for part in only):
                begun, scene = time.monotonic(), scene_of(subject, **settings(subject))
                view = view_of(scene, size, camera=scene.camera(**STAND, fov=30.0))
                yield subject, Bench(scene, view, (output or Path(passing)) / subject.folder)
                click.echo(f"{subject.name}: {time.monotonic() - begun:.0f} s", err=True)


def without_lobes(subject: Subject) -> dict[str, int]:
    """What scenes say so that all light is carried by texels."""
    return {} if subject.light == "constant light" else {"lobes": 0}


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
