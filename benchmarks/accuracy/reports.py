"""Error against run time, by cause: ``isogi report`` of real volumes under several lights, summed up.

    python -m benchmarks.accuracy reports -o DIR [--size 112] [--deadline 4m] [--write]

Goes on where it was stopped. Needs the shared data.
"""

import time
from pathlib import Path
from typing import Any

import click

from benchmarks.accuracy.summary import summary_of
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import Subject, scene_of
from benchmarks.common.suite import part
from server.cli.arguments import duration
from server.cli.bench import view_of
from server.report.command import STAND, Wishes, report_of, sentence

LIGHTS = ("grace", "uffizi", "constant light")
ENGINES = tuple(Subject("engine", isovalue, light) for isovalue in (70, 170) for light in LIGHTS)
OTHERS = (Subject("CT head", 110, "uffizi"), Subject("MNI brain", 90, "grace"))
SUBJECTS = (*ENGINES, *OTHERS)

PICTURED = (ENGINES[0], *OTHERS)
"""Subjects whose pictures are shown."""

CURVED = ENGINES[: len(LIGHTS)]
"""Subjects whose curves of error against run time are shown."""


@part(size=112)
@click.option("-o", "--output", default="reports", type=click.Path(path_type=Path, file_okay=False), show_default=True)
@click.option("--deadline", callback=duration, help="Of each report, such as 4m.")
def reports(output: Path, size: int, deadline: float | None) -> Measurement:
    """How wrong isogi's light is, by cause, and what it costs: reports of real volumes, summed up."""
    for subject in SUBJECTS:
        click.echo(subject.name, err=True)
        facts = make(subject, output / subject.folder, size, deadline)
        click.echo(sentence(facts), err=True)
        if facts["stopped"]:
            raise click.Abort
    folders = {each.name: output / each.folder for each in SUBJECTS}
    return summary_of(folders, [each.name for each in PICTURED], [each.name for each in CURVED])


def make(subject: Subject, folder: Path, size: int, deadline: float | None) -> dict[str, Any]:
    """The report of a subject: what the command would tell of it."""
    scene = scene_of(subject)
    view = view_of(scene, size, camera=scene.camera(**STAND, fov=30.0))
    return report_of(scene, view, scene.default_exposure, Wishes(folder, deadline), time.monotonic())
