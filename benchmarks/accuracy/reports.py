"""Error against run time, by cause: ``isogi report`` of six scenes of real volumes, summed up.

    python -m benchmarks.accuracy reports -o DIR [--size 112] [--deadline 4m] [--write]

Goes on where it was stopped. Needs the shared data.
"""

import time
from pathlib import Path
from typing import Any

import click

from benchmarks.accuracy.benches import report_view
from benchmarks.accuracy.summary import summary_of
from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import SIX, Subject, scene_of
from benchmarks.common.suite import part
from isogi_report.command import ReportRequest, report_of, sentence
from isogi_server.cli.arguments import duration


@part(size=112)
@click.option(
    "-o",
    "--output",
    default="reports",
    type=click.Path(path_type=Path, file_okay=False),
    show_default=True,
)
@click.option("--deadline", callback=duration, help="Of each report, such as 4m.")
def reports(output: Path, size: int, deadline: float | None) -> Measurement:
    """How wrong isogi's light is, by cause, and what it costs: reports of real volumes, summed
    up.
    """
    for subject in SIX:
        click.echo(subject.name, err=True)
        facts = make(subject, output / subject.folder, size, deadline)
        click.echo(sentence(facts), err=True)
        if facts["stopped"]:
            raise click.Abort
    return summary_of({each.name: output / each.folder for each in SIX})


def make(subject: Subject, folder: Path, size: int, deadline: float | None) -> dict[str, Any]:
    """The report of a subject: what the command would tell of it."""
    scene = scene_of(subject)
    view = report_view(scene, size)
    return report_of(
        scene, view, scene.default_exposure, ReportRequest(folder, deadline), time.monotonic()
    )
