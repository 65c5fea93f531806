"""Rooms, glass, clear surfaces and shine beside Mitsuba's pictures of the same scene, pixel by
pixel.

    python -m benchmarks.accuracy room [--size 64] [--paths 4096] [--only TEXT …]

isogi's pictures are baked to 2 % and checked by an engine with two workers. Mitsuba traces paths on
a mesh of the cells with the normals of the field, or on a ball, through all of a pixel; isogi's
pictures are four times as wide, and of theirs 16 pixels are one. Compared are pixels that show no
outline. Beside the RMSE of isogi's picture stands that of its own path-traced one: what they have
in common is the mesh's.
"""

import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.accuracy.benches import wanted
from benchmarks.accuracy.mitsuba_race import INSIDE, Converged, converge
from benchmarks.accuracy.mitsuba_scene import Ball, SceneTracer
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.mitsuba import installed
from benchmarks.common.scenes import LIGHTS, shared_data
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.frame import Frame
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from isogi_core.plan.assembly import build_scene
from isogi_core.plan.scene import Scene
from isogi_report.speed import view_of
from isogi_server.cli.render import awaited
from isogi_server.render.engine import RenderEngine

PATIENCE = 300.0
"""Seconds that a picture may take."""

ACROSS = 4
"""isogi's pixels along a side of one of Mitsuba's."""

SIDE = 32
RADIUS = 10.0
"""Voxels along the side of the volume with a ball, and the ball's radius."""

BALL = Ball(((SIDE - 1) / 2,) * 3, RADIUS)
LAMP = {
    "corner": [8.0, 8.0, 60.0],
    "edges": [[0.0, 15.0, 0.0], [15.0, 0.0, 0.0]],
    "radiance": 20.0,
    "sides": 1,
}
FLOOR = {"corner": [-20.0, -20.0, 0.0], "edges": [[71.0, 0.0, 0.0], [0.0, 71.0, 0.0]]}

SCENES: dict[str, dict[str, Any]] = {
    "brain at 90 in a Cornell room": {
        "volume": "mni152_t1_197x233x189_uint8.nhdr",
        "isovalue": 90,
        "room": "cornell",
    },
    "nucleon at 140 in a Cornell room": {
        "volume": "nucleon_41x41x41_uint8.nhdr",
        "isovalue": 140,
        "room": "cornell",
    },
    "nucleon at 140 in a Cornell room, half clear": {
        "volume": "nucleon_41x41x41_uint8.nhdr",
        "isovalue": 140,
        "room": "cornell",
        "clear": 0.5,
    },
    "bucky at 120, half clear": {
        "volume": "bucky_32x32x32_uint8.nhdr",
        "isovalue": 120,
        "clear": 0.5,
    },
    "glass ball and its caustic": {"material": "glass", "walls": [FLOOR, LAMP]},
    **{
        f"metal ball, roughness {rough:g}": {"shine": {"kind": "metal", "roughness": rough}}
        for rough in (0.1, 0.3, 0.6)
    },
}
"""Scenes by name; those without a volume are of a ball."""

VIEWS = {"room": (90.0, 5.0, 3.5), "walls": (50.0, 35.0, 4.0), "": (40.0, 30.0, 3.0)}
"""Azimuth, elevation and distance, by what a scene has."""

HEAD = (
    "scene",
    "pixels",
    "RMSE, %",
    "99th percentile, %",
    "mean, %",
    "told, %",
    "path-traced, %",
    "Mitsuba's noise, %",
)


@part(size=64)
@click.option(
    "--paths", default=4096, type=click.IntRange(8), help="Paths a pixel.", show_default=True
)
@click.option("--only", multiple=True, help="Part of a scene's name; repeatable.")
def room(size: int, paths: int, only: tuple[str, ...]) -> Measurement:
    """How far pictures of rooms, glass, clear surfaces and shine are from Mitsuba's."""
    data = shared_data()
    if not installed() or data is None:
        raise click.ClickException(
            "This needs Mitsuba and the shared volumes: install it, set ISOGI_SHARED_DATA."
        )
    figures = dict[str, float]()
    rows = list[tuple[str, ...]]()
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in scenes(Path(folder), data, only):
            found = measure(scene, size, paths)
            figures |= {f"{name}: {key}": value for key, value in found.items()}
            pixels, *shares = found.values()
            rows.append((name, f"{pixels:.0f}", *(f"{100 * share:.2f}" for share in shares)))
            click.echo(" | ".join(rows[-1]), err=True)
    return Measurement(f"Beside Mitsuba, {size} × {size}", figures, markdown(HEAD, rows))


def scenes(folder: Path, data: Path, only: tuple[str, ...]) -> Iterator[tuple[str, Scene]]:
    """The scenes with these words in their names; a ball's volume is written into a ``folder``."""
    grid = np.mgrid[:SIDE, :SIDE, :SIDE] - (SIDE - 1) / 2
    np.save(folder / "ball.npy", (RADIUS - np.sqrt((grid**2).sum(axis=0))).astype(np.float32))
    for name, document in SCENES.items():
        if wanted(name, only):
            own = {"volume": str(folder / "ball.npy"), "isovalue": 0.0} | document
            if "room" not in own and "walls" not in own:
                own |= {"lights": [dict(LIGHTS["uffizi"])]}
            yield name, build_scene(SceneSource(name, own, data))


def measure(scene: Scene, size: int, paths: int) -> dict[str, float]:
    """Pictures of a scene, isogi's and Mitsuba's."""
    azimuth, elevation, distance = next(
        at for key, at in VIEWS.items() if key in (*scene.source.document, "")
    )
    camera = scene.camera(azimuth, elevation, distance, 30.0)
    view = replace(view_of(scene, ACROSS * size, camera=camera), smooth=False)
    frame, traced = pictures(scene, view, paths // ACROSS**2)
    if "ball" in scene.source.name:
        ball = BALL
    else:
        ball = None
    tracer = SceneTracer(scene, replace(view, width=size, height=size), ball)
    best = converge(tracer, paths, joined((frame.state > 0) & ~edges(frame)) > INSIDE)
    wrong = apart(joined(frame.radiance), best)
    return {
        "pixels": float(best.on.sum()),
        "RMSE": best.error(joined(frame.radiance)),
        "99th percentile": float(np.quantile(np.abs(wrong), 0.99)),
        "mean": float(wrong.mean()),
        "told": frame.total.likely,
        "path-traced": best.error(joined(traced.radiance)),
        "noise": best.noise,
    }


def apart(picture: np.ndarray, best: Converged) -> np.ndarray:
    """Differences of luminance over the mean; (pixels,)."""
    found, light = (
        each[best.on][:, :3].astype(np.float64) @ LUMINANCE_WEIGHTS
        for each in (picture, best.picture)
    )
    return np.asarray((found - light) / light.mean())


def pictures(scene: Scene, view: View, paths: int) -> tuple[Frame, Frame]:
    """The picture out of the cache, and the path-traced one."""
    with (
        tempfile.TemporaryDirectory() as store,
        closing(RenderEngine([scene], store, workers=2)) as engine,
    ):
        engine.start()
        goal = Goal.checked(scene.target_error)
        frame = awaited(engine, scene.id, view, goal, PATIENCE)
        traced = replace(view, shading="path_traced", samples=paths)
        return frame, engine.survey(scene.id, traced, goal)


def joined(picture: np.ndarray) -> np.ndarray:
    """The means of ACROSS × ACROSS pixels of a picture (h, w, …)."""
    height, width = (each // ACROSS for each in picture.shape[:2])
    return np.asarray(
        picture.reshape(height, ACROSS, width, ACROSS, *picture.shape[2:]).mean(axis=(1, 3))
    )


def edges(frame: Frame) -> np.ndarray:
    """Pixels beside which the surface's place jumps by more than its slope explains: outlines; (h,
    w) bool.
    """
    near = frame.position
    found = np.zeros(frame.state.shape, bool)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(near, axis=axis), axis=-1)
        jump = step > 4.0 * np.median(step[step > 0.0])
        first = [slice(None)] * 2
        last = [slice(None)] * 2
        first[axis] = slice(None, -1)
        last[axis] = slice(1, None)
        found[tuple(first)] |= jump
        found[tuple(last)] |= jump
    return found
