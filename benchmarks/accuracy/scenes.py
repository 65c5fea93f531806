"""Scenes that need different things: of one volume, for the plans, and of many, for the
calibration.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import click

from benchmarks.common.scenes import CONSTANT, LIGHTS, VOLUMES, benchmark_scene, shared_data
from isogi_core.plan.assembly import load_scene
from isogi_core.plan.scene import Scene

LAMP = {"type": "directional", "irradiance": 2.0, "angle": 2.0}
SKY = {"type": "sky", "sun_azimuth": 20.0, "sun_elevation": 35.0}
UFFIZI = "uffizi"
GRACE = "grace"
NOON_GRASS = "noon_grass"
COLOURED = [0.8, 0.5, 0.3]
ENGINE = VOLUMES["engine"]
HEAD = VOLUMES["CT head"]
BRAIN = VOLUMES["MNI brain"]
BONSAI = "bonsai_256x256x256_uint8.nhdr"

PLANNED: Mapping[str, Mapping[str, Any]] = {
    "constant light, no bounces": {"lights": [CONSTANT], "bounces": 0},
    "constant light": {"lights": [CONSTANT]},
    "constant light, one isovalue": {"lights": [CONSTANT], "around": 0.0},
    "constant light, a range of isovalues": {"lights": [CONSTANT], "around": 10.0},
    "constant light and a lamp": {"lights": [CONSTANT, LAMP]},
    "fixed uffizi": {"probe": UFFIZI, "rotating": False},
    "fixed uffizi, coloured albedo": {"probe": UFFIZI, "rotating": False, "albedo": COLOURED},
    "rotating uffizi": {"probe": UFFIZI},
    "rotating grace": {"probe": GRACE},
    "rotating noon_grass": {"probe": NOON_GRASS},
    "rotating uffizi, coloured albedo": {"probe": UFFIZI, "albedo": COLOURED},
    "rotating uffizi, albedo 0": {"probe": UFFIZI, "albedo": 0.0},
}
"""Settings by a scene's name: ``probe`` is the light's file, ``around`` how far isovalues may be
from the first.
"""

CALIBRATED: Mapping[str, Mapping[str, Any]] = {
    "casting, constant": {"lights": [CONSTANT]},
    "casting, constant and a lamp": {"lights": [CONSTANT, LAMP]},
    "orbital, sky, coloured": {"volume": "demo:orbital", "lights": [SKY], "albedo": COLOURED},
    "orbital, fixed sky, coloured": {
        "volume": "demo:orbital",
        "lights": [SKY],
        "albedo": COLOURED,
        "rotating": False,
    },
    "engine 70, constant": {"volume": ENGINE, "isovalue": 70, "lights": [CONSTANT]},
    "engine 70, constant, albedo 0.95": {
        "volume": ENGINE,
        "isovalue": 70,
        "lights": [CONSTANT],
        "albedo": 0.95,
    },
    "engine 70, uffizi": {"volume": ENGINE, "isovalue": 70, "probe": UFFIZI},
    "engine 70, grace": {"volume": ENGINE, "isovalue": 70, "probe": GRACE},
    "engine 170, fixed noon_grass": {
        "volume": ENGINE,
        "isovalue": 170,
        "probe": NOON_GRASS,
        "rotating": False,
    },
    "CT head 110, grace, coloured": {
        "volume": HEAD,
        "isovalue": 110,
        "probe": GRACE,
        "albedo": COLOURED,
    },
    "CT head 110, constant, coloured": {
        "volume": HEAD,
        "isovalue": 110,
        "lights": [CONSTANT],
        "albedo": COLOURED,
    },
    "MNI brain 90, uffizi, direct alone": {
        "volume": BRAIN,
        "isovalue": 90,
        "probe": UFFIZI,
        "bounces": 0,
    },
    "MNI brain 90, fixed grace": {
        "volume": BRAIN,
        "isovalue": 90,
        "probe": GRACE,
        "rotating": False,
    },
    "bonsai 80, noon_grass": {"volume": BONSAI, "isovalue": 80, "probe": NOON_GRASS},
    "bonsai 80, constant, no bounces": {
        "volume": BONSAI,
        "isovalue": 80,
        "lights": [CONSTANT],
        "bounces": 0,
    },
}
"""Settings by a scene's name: ``volume`` is the data's file, the casting where none is told;
``probe`` the light's.
"""


def load_planned(names: Iterable[str], target: float) -> Iterator[tuple[str, Scene]]:
    """Scenes of PLANNED with this target error; those whose probe is not at hand are left out, and
    told.
    """
    isovalue = benchmark_scene(None, "constant").isovalue
    for name in names:
        settings = {
            "albedo": 0.7,
            "bounces": None,
            **PLANNED[name],
            "isovalue": isovalue,
            "target_error": target,
        }
        around = settings.pop("around", None)
        if around is not None:
            settings["isovalues"] = [isovalue - around, isovalue + around]
        if lit(name, settings):
            yield name, benchmark_scene(None, **settings)


def load_calibrated(names: Iterable[str]) -> Iterator[tuple[str, Scene]]:
    """Scenes of CALIBRATED; those whose volume or probe is not at hand are left out, and told."""
    data = shared_data()
    for name in names:
        settings = {"albedo": 0.7, "volume": "demo:casting", **CALIBRATED[name]}
        volume = settings.pop("volume")
        if data is None and not volume.startswith("demo:"):
            leave_out(name)
        elif lit(name, settings):
            yield (
                name,
                load_scene(volume if volume.startswith("demo:") else data / volume, **settings),
            )


def lit(name: str, settings: dict[str, Any]) -> bool:
    """Put the light in place of a ``probe``'s name, in ``settings``; False, and told, where its
    file is not at hand.
    """
    probe = settings.pop("probe", None)
    data = shared_data()
    if probe is None:
        return True
    if data is None:
        leave_out(name)
        return False
    settings["lights"] = [{"type": "probe", "file": str(data / LIGHTS[probe]["file"])}]
    return True


def leave_out(name: str) -> None:
    """Say that a scene is left out."""
    click.echo(f"{name}: left out, as there are no shared data.", err=True)
