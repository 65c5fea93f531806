"""The reports that docs/error.md sums up: ``isogi report`` of real volumes under several lights.

``python -m benchmarks.reports -o DIR [--deadline 4m]``; goes on where it was stopped. Needs the shared data.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from benchmarks.common import shared_data
from benchmarks.error_summary import write_summary
from isogi_core.model.scene import Scene, build_scene
from isogi_core.model.source import SceneSource
from server.cli import duration
from server.measure import view_of
from server.report.command import STAND, Wishes, report_of, sentence

DOCS = Path(__file__).parents[1] / "docs"

VOLUMES = {
    "engine": "engine_256x256x128_uint8.nhdr",
    "CT head": "ct_head_208x256x225_uint8.nhdr",
    "MNI brain": "mni152_t1_197x233x189_uint8.nhdr",
    "carp": "carp_256x512x256_uint8.nhdr",
}
LIGHTS: Mapping[str, Mapping[str, str]] = {
    "grace": {"type": "probe", "file": "probe_grace_256x128.hdr"},
    "uffizi": {"type": "probe", "file": "probe_uffizi_256x128.hdr"},
    "constant light": {"type": "constant"},
    "noon_grass": {"type": "probe", "file": "probe_noon_grass_1024x512.hdr"},
}
REPORTED = ("grace", "uffizi", "constant light")


@dataclass(frozen=True)
class Subject:
    """A volume at an isovalue under a light, by their names here."""

    volume: str
    isovalue: float
    light: str

    @property
    def scene(self) -> str:
        """What a person calls its scene."""
        return f"{self.volume} under {self.light}"

    @property
    def name(self) -> str:
        """What a person calls it."""
        return f"{self.scene} at {self.isovalue:g}"

    @property
    def folder(self) -> str:
        """The name of its report's folder."""
        return f"{self.volume}-{self.isovalue:g}-{self.light}".lower().replace(" ", "-")


ENGINES = tuple(Subject("engine", isovalue, light) for isovalue in (70, 170) for light in REPORTED)
OTHERS = (Subject("CT head", 110, "uffizi"), Subject("MNI brain", 90, "grace"))
SUBJECTS = (*ENGINES, *OTHERS)

PICTURED = (ENGINES[0], *OTHERS)
"""Subjects that docs/error.md shows pictures of."""

CURVED = ENGINES[: len(REPORTED)]
"""Subjects that docs/error.md shows the curves of error against run time of."""


@click.command()
@click.option("-o", "--output", default="reports", type=click.Path(path_type=Path, file_okay=False), show_default=True)
@click.option("--size", type=click.IntRange(8, 1024), default=112, show_default=True, help="Pixels along each side.")
@click.option("--deadline", callback=duration, help="Of each report, such as 4m.")
def main(output: Path, size: int, deadline: float | None) -> None:
    """Make every report, in folders of OUTPUT, and write docs/error.md from them."""
    for subject in SUBJECTS:
        click.echo(subject.name, err=True)
        facts = make(subject, output / subject.folder, size, deadline)
        click.echo(sentence(facts), err=True)
        if facts["stopped"]:
            raise click.Abort
    folders = {each.name: output / each.folder for each in SUBJECTS}
    write_summary(DOCS, folders, [each.name for each in PICTURED], [each.name for each in CURVED])


def make(subject: Subject, folder: Path, size: int, deadline: float | None) -> dict[str, Any]:
    """The report of a subject: what the command would tell of it."""
    scene = scene_of(subject)
    view = view_of(scene, size, camera=scene.camera(**STAND, fov=30.0))
    return report_of(scene, view, scene.default_exposure, Wishes(folder, deadline), time.monotonic())


def scene_of(subject: Subject, **more: Any) -> Scene:
    """The scene of a subject, with ``more`` settings, planned by isogi.

    ClickException where the shared data are not at hand.
    """
    data = shared_data()
    if data is None:
        raise click.ClickException("There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them.")
    light = dict(LIGHTS[subject.light])
    own = {"volume": VOLUMES[subject.volume], "isovalue": subject.isovalue, "albedo": 0.7, "lights": [light]}
    return build_scene(SceneSource(subject.scene, {**own, **more}, data))


if __name__ == "__main__":
    main()
