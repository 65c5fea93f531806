"""Scenes of different volumes, lights and albedos: what ``benchmarks.calibration`` is told of."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import click

from benchmarks.common import shared_data
from benchmarks.plan_scenes import COLOURED, CONSTANT, GRACE, NOON_GRASS, UFFIZI
from isogi_core.model.scene import Scene, load_scene

SKY = {"type": "sky", "sun_azimuth": 20.0, "sun_elevation": 35.0}
LAMP = {"type": "directional", "irradiance": 2.0, "angle": 2.0}
ENGINE, HEAD = "engine_256x256x128_uint8", "ct_head_208x256x225_uint8"
BRAIN, BONSAI = "mni152_t1_197x233x189_uint8", "bonsai_256x256x256_uint8"

SCENES: Mapping[str, Mapping[str, Any]] = {
    "casting, constant": {"lights": [CONSTANT]},
    "casting, constant and a lamp": {"lights": [CONSTANT, LAMP]},
    "orbital, sky, coloured": {"volume": "demo:orbital", "lights": [SKY], "albedo": COLOURED},
    "orbital, fixed sky, coloured": {"volume": "demo:orbital", "lights": [SKY], "albedo": COLOURED, "rotating": False},
    "engine 70, constant": {"volume": ENGINE, "isovalue": 70, "lights": [CONSTANT]},
    "engine 70, constant, albedo 0.95": {"volume": ENGINE, "isovalue": 70, "lights": [CONSTANT], "albedo": 0.95},
    "engine 70, uffizi": {"volume": ENGINE, "isovalue": 70, "probe": UFFIZI},
    "engine 70, grace": {"volume": ENGINE, "isovalue": 70, "probe": GRACE},
    "engine 170, fixed noon_grass": {"volume": ENGINE, "isovalue": 170, "probe": NOON_GRASS, "rotating": False},
    "CT head 110, grace, coloured": {"volume": HEAD, "isovalue": 110, "probe": GRACE, "albedo": COLOURED},
    "CT head 110, constant, coloured": {"volume": HEAD, "isovalue": 110, "lights": [CONSTANT], "albedo": COLOURED},
    "MNI brain 90, uffizi, direct alone": {"volume": BRAIN, "isovalue": 90, "probe": UFFIZI, "bounces": 0},
    "MNI brain 90, fixed grace": {"volume": BRAIN, "isovalue": 90, "probe": GRACE, "rotating": False},
    "bonsai 80, noon_grass": {"volume": BONSAI, "isovalue": 80, "probe": NOON_GRASS},
    "bonsai 80, constant, no bounces": {"volume": BONSAI, "isovalue": 80, "lights": [CONSTANT], "bounces": 0},
}
"""Settings by a scene's name: ``volume`` is the data's file, the casting where none is told; ``probe`` the light's."""


def load(names: Iterable[str]) -> Iterator[tuple[str, Scene]]:
    """The scenes of these names; those whose volume or probe is not at hand are left out, and told."""
    data = shared_data()
    for name in names:
        settings = {"albedo": 0.7, "volume": "demo:casting", **SCENES[name]}
        volume, probe = settings.pop("volume"), settings.pop("probe", None)
        if data is None and (probe is not None or not volume.startswith("demo:")):
            click.echo(f"{name}: left out, as there are no shared data.", err=True)
            continue
        if probe is not None:
            settings["lights"] = [{"type": "probe", "file": f"{data}/probe_{probe}.hdr"}]
        yield name, load_scene(volume if volume.startswith("demo:") else f"{data}/{volume}.nhdr", **settings)
