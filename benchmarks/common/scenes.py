"""The scenes that suites measure: volumes and lights of the shared data, or demos where those are
not at hand.
"""

import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from isogi_core.files.scene_file import SceneSource
from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.scene import Scene

ENGINE = "engine_256x256x128_uint8.nhdr"
GRACE = "probe_grace_256x128.hdr"
CONSTANT = {"type": "constant"}

VOLUMES = {
    "engine": ENGINE,
    "CT head": "ct_head_208x256x225_uint8.nhdr",
    "MNI brain": "mni152_t1_197x233x189_uint8.nhdr",
    "carp": "carp_256x512x256_uint8.nhdr",
    "chest CT": "lidc_chest_256x256x133_uint8.nhdr",
    "bonsai": "bonsai_256x256x256_uint8.nhdr",
    "heptane": "heptane_302x302x302_uint8.nhdr",
}
"""Files of the shared volumes, by what a person calls them."""

LIGHTS: Mapping[str, Mapping[str, str]] = {
    "grace": {"type": "probe", "file": GRACE},
    "uffizi": {"type": "probe", "file": "probe_uffizi_256x128.hdr"},
    "constant light": CONSTANT,
    "noon_grass": {"type": "probe", "file": "probe_noon_grass_1024x512.hdr"},
}
"""Lights by name; files are in the folder of shared data."""


def shared_data() -> Path | None:
    """The folder of real volumes and probes (``$ISOGI_SHARED_DATA``), None where there is none."""
    folder = Path(
        os.environ.get("ISOGI_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data")
    )
    return folder if folder.is_dir() else None


def benchmark_scene(target: str | None, light: str = "probe", **overrides: Any) -> Scene:
    """``target``, or the engine block at 70 under grace (``light`` "probe") or constant light; else
    the casting.
    """
    data = shared_data()
    if target is None and data is not None:
        lights = {"probe": {"type": "probe", "file": str(data / GRACE)}, "constant": CONSTANT}
        engine = {"isovalue": 70, "albedo": 0.7, "bounces": 4, "lights": [lights[light]]}
        return load_scene(data / ENGINE, **{**engine, **overrides})
    return load_scene(target, **overrides)


DOCUMENTED = Path(__file__).parents[2] / "docs" / "scenes"
"""Where the scenes of the documents are, which name shared volumes."""


def documented_scene(name: str, data: Path) -> Scene:
    """A scene of the documents, by the name of its file, whose volume lies anywhere in ``data``."""
    file = DOCUMENTED / f"{name}.toml"
    return load_scene(file, volume=str(next(data.rglob(tomllib.loads(file.read_text())["volume"]))))


def scene_file(folder: Path) -> str:
    """The engine block at 70 under grace as a scene file, or the casting where the data are not at
    hand.
    """
    data = shared_data()
    scene = folder / "first.toml"
    volume = 'volume = "demo:casting"'
    light = ""
    if data is not None:
        volume = f'volume = "{data / ENGINE}"\nisovalue = 70\nbounces = 4'
        light = f'[[lights]]\ntype = "probe"\nfile = "{data / GRACE}"\n'
    scene.write_text(f"{volume}\n{light}", encoding="utf-8")
    return str(scene)


@dataclass(frozen=True)
class Subject:
    """A shared volume at an isovalue under a light, by their names here."""

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
        """The name of a folder of its own."""
        return f"{self.volume}-{self.isovalue:g}-{self.light}".lower().replace(" ", "-")


def scene_of(subject: Subject, **more: Any) -> Scene:
    """The scene of a subject, with ``more`` settings, planned by isogi.

    ClickException where the shared data are not at hand.
    """
    data = shared_data()
    if data is None:
        raise click.ClickException(
            "There are no shared volumes: set ISOGI_SHARED_DATA to a folder that has them."
        )
    light = dict(LIGHTS[subject.light])
    own = {
        "volume": VOLUMES[subject.volume],
        "isovalue": subject.isovalue,
        "albedo": 0.7,
        "lights": [light],
    }
    return build_scene(SceneSource(subject.scene, {**own, **more}, data))


THREE = (
    Subject("engine", 70, "grace"),
    Subject("CT head", 110, "uffizi"),
    Subject("MNI brain", 90, "constant light"),
)

SIX = (
    *(*THREE, Subject("engine", 170, "uffizi"), Subject("carp", 110, "noon_grass")),
    Subject("chest CT", 60, "uffizi"),
)
"""As unlike each other as the shared volumes are: smooth, porous, thin, coarse and anisotropic
ones.
"""


SEVEN = (
    *THREE,
    Subject("bonsai", 40, "noon_grass"),
    Subject("chest CT", 60, "uffizi"),
    Subject("carp", 110, "noon_grass"),
    Subject("heptane", 100, "uffizi"),
)
"""Scenes of one cold view each, next to a path tracer."""


def three_scenes(target: str | None) -> Iterator[Scene]:
    """The scene ``target``; without one the scenes of THREE, or two demos where the shared data are
    not at hand.
    """
    if target is not None or shared_data() is None:
        for name in (target,) if target is not None else ("demo:casting", "demo:orbital"):
            yield load_scene(name)
        return
    yield from map(scene_of, THREE)
