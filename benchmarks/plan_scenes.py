"""Scenes of one volume that need different things: what ``benchmarks.plans`` compares."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import click

from benchmarks.common import benchmark_scene, shared_data
from isogi_core.model.scene import Scene, load_scene

CONSTANT = {"type": "constant"}
LAMP = {"type": "directional", "irradiance": 2.0, "angle": 2.0}
UFFIZI, GRACE, NOON_GRASS = "uffizi_256x128", "grace_256x128", "noon_grass_1024x512"
COLOURED = [0.8, 0.5, 0.3]

SCENES: Mapping[str, Mapping[str, Any]] = {
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
"""Settings by a scene's name: ``probe`` is the light's file, ``around`` how far isovalues may be from the first."""


def load(names: Iterable[str], target: float) -> Iterator[tuple[str, Scene]]:
    """The scenes of these names, with this target error; those whose probe is not at hand are left out, and told."""
    isovalue = benchmark_scene(None, "constant").isovalue
    for name in names:
        settings = {"albedo": 0.7, "bounces": None, **SCENES[name], "isovalue": isovalue, "target_error": target}
        around, probe = settings.pop("around", None), settings.pop("probe", None)
        if around is not None:
            settings["isovalues"] = [isovalue - around, isovalue + around]
        if probe is not None:
            settings["lights"] = probe_lights(probe)
        if settings["lights"]:
            yield name, benchmark_scene(None, **settings)
        else:
            click.echo(f"{name}: left out, as there are no shared data.", err=True)


def probe_lights(probe: str) -> list[Mapping[str, str]]:
    """The lights of a scene under a ``probe`` alone; none where its file is not at hand."""
    data = shared_data()
    return [] if data is None else [{"type": "probe", "file": str(data / f"probe_{probe}.hdr")}]


def three_scenes(target: str | None, engine: str, head: str) -> Iterator[Scene]:
    """The engine block at 70 and the CT head at 110 under these probes, and the MNI brain at 90 under constant light.

    Demos where the shared data are not at hand; the scene that is told, if any.
    """
    data = shared_data()
    if target is not None or data is None:
        for name in (target,) if target is not None else ("demo:casting", "demo:orbital"):
            yield load_scene(name)
        return
    names = "engine_256x256x128_uint8", "ct_head_208x256x225_uint8", "mni152_t1_197x233x189_uint8"
    lights = probe_lights(engine), probe_lights(head), [CONSTANT]
    for name, isovalue, own in zip(names, (70, 110, 90), lights, strict=True):
        yield load_scene(data / f"{name}.nhdr", isovalue=isovalue, albedo=0.7, lights=own)
