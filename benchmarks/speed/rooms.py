"""Frames among walls and of a surface that shines, beside frames without; and what baking S3's
scenes takes.

    python -m benchmarks.speed rooms [--size 512] [--repeats 9] [--levels 3] [--json]

Cameras are a hundredth of a degree apart, so that each frame casts its primary rays; the light of
texels and walls is there. Then the four scenes of docs/scenes, which are S3's kinds, are baked in a
view of 256² at ``levels`` isovalues, evenly spaced through their ranges: the seconds of processors
until the picture tells an error of ERRORS, where it does in time, are beside S3's own for a level
(table 1; two Xeons of 3 GHz), whose error is not told. Glass keeps no texels: there the walls are
all that is baked.
"""

import tempfile
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import psutil

from benchmarks.common.measurement import Measurement
from benchmarks.common.scenes import documented_scene, shared_data
from benchmarks.common.suite import part
from benchmarks.common.timing import milliseconds
from isogi_core.bake.noise import Goal
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.picture_plan import PRESENT
from isogi_core.frame.renderer import Renderer
from isogi_core.model.scene_plan import MIN_SAMPLES
from isogi_core.model.view import View
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_report.speed import (
    LOOSEST_GOAL,
    Candidate,
    bake_view,
    make_renderer,
    medians,
    seconds,
    view_of,
)
from isogi_server.cli.render import awaited
from isogi_server.render.engine import RenderEngine

S3: Mapping[str, tuple[int, float]] = {
    "medical": (52, 1626.0),
    "molecular": (20, 393.0),
    "microscopy": (45, 772.0),
    "nuclear": (17, 480.0),
}
"""The levels that S3 used for each kind of scene, and its seconds for each (table 1)."""

CAMERAS = {"room": (90.0, 5.0, 3.5), "": (40.0, 30.0, 3.0)}
"""Azimuth, elevation and distance, by what a scene has."""

BRAIN = {"volume": "mni152_t1_197x233x189_uint8.nhdr", "isovalue": 90}
PAIRS: Mapping[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "room": ({"room": "cornell"}, {"lights": [{"type": "constant"}], "rotating": False}),
    "shine": ({"shine": {"kind": "plastic"}}, {}),
}
"""What a scene of the brain has, and what it has without."""

PATIENCE = 200.0
"""Seconds that a bake may take."""

ERRORS = (0.1, 0.05, 0.02)
"""Told relative errors that bakes are timed to."""

SIZE = 256
"""Pixels a side of the views that are baked."""


@part(size=512, repeats=9)
@click.option(
    "--levels",
    default=3,
    type=click.IntRange(1),
    help="Isovalues of each scene.",
    show_default=True,
)
def rooms(size: int, repeats: int, levels: int) -> Measurement:
    """Frames in a room and of a surface that shines, over those without; processor time of S3's
    scenes.
    """
    data = shared_data()
    if data is None:
        raise click.ClickException("This needs the shared volumes: set ISOGI_SHARED_DATA.")
    figures = dict[str, float]()
    for name, pair in PAIRS.items():
        scenes = [build_scene(SceneSource("brain", {**BRAIN, **own}, data)) for own in pair]
        figures |= compare(name, scenes, size, repeats)
    for name, (count, taken) in S3.items():
        for error, each in baked(name, data, levels).items():
            figures[f"{name}, core-seconds a level to {100 * error:g} %"] = each
            figures[f"{name}, S3's / ours to {100 * error:g} %, {count} levels"] = taken / each
    return Measurement(f"Rooms, {size} × {size}", figures)


def compare(name: str, scenes: list[Scene], size: int, repeats: int) -> dict[str, float]:
    """Frames of a scene with what has this ``name``, and without."""
    names = (f"gi, {name}", f"gi, no {name}")
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        some = {
            each: moved(lit(scene, store, size), scene, size)
            for each, scene, store in zip(names, scenes, (one, other), strict=True)
        }
        median = medians(some, repeats)
    return {**milliseconds(median), f"{name} / without": median[names[0]] / median[names[1]]}


def lit(scene: Scene, store: str, size: int) -> Renderer:
    """A renderer of a scene, with the light that its view reads."""
    renderer = make_renderer(scene, store)
    view = camera_of(scene, size)
    bake_view(renderer, view, MIN_SAMPLES)
    frame = renderer.render(view, LOOSEST_GOAL)
    while frame.quality.waiting and renderer.surface.refine_frame(
        frame, LOOSEST_GOAL, renderer.tiles, PRESENT
    ):
        frame = renderer.render(view, LOOSEST_GOAL)
    return renderer


def camera_of(scene: Scene, size: int, turn: int = 0) -> View:
    """The view of a scene from a camera that stands a little aside in each turn."""
    azimuth, elevation, distance = CAMERAS["room" if scene.lighting.room.any else ""]
    return view_of(
        scene, size, camera=scene.camera(azimuth + 0.01 * turn, elevation, distance, 30.0)
    )


def moved(renderer: Renderer, scene: Scene, size: int) -> Candidate:
    """A frame from another camera in each round."""
    return lambda turn: seconds(lambda: renderer.render(camera_of(scene, size, turn), LOOSEST_GOAL))


def baked(name: str, data: Path, levels: int) -> dict[float, float]:
    """Seconds of processors that a level of one of S3's scenes takes to ERRORS, the mean of some
    levels; of those errors that all of them come to.
    """
    scene = documented_scene(name, data)
    low, high = scene.isovalues
    view = camera_of(scene, SIZE)
    spent = dict[float, list[float]]()
    with (
        tempfile.TemporaryDirectory() as store,
        closing(RenderEngine([scene], store, workers=2)) as engine,
    ):
        engine.start()
        for share in (np.arange(levels) + 0.5) / levels:
            before = processor_seconds()
            shown = replace(view, isovalue=float(low + share * (high - low)))
            reached = dict[float, float]()

            def note(
                frame: Frame, before: float = before, reached: dict[float, float] = reached
            ) -> None:
                for error in ERRORS:
                    if frame.total.likely <= error:
                        reached.setdefault(error, processor_seconds() - before)

            awaited(engine, scene.id, shown, Goal.checked(scene.target_error), PATIENCE, note)
            for error, seconds_of in reached.items():
                spent.setdefault(error, []).append(seconds_of)
    return {error: float(np.mean(each)) for error, each in spent.items() if len(each) == levels}


def processor_seconds() -> float:
    """Seconds that this process and those that it started have worked."""
    own = psutil.Process()
    return float(sum(sum(each.cpu_times()[:2]) for each in (own, *own.children(recursive=True))))
