"""What an eye sees in final pictures: steps at borders between pixels with and without light of
their own, and the noise of flat areas of surfaces and walls, in L*.

    python -m benchmarks.accuracy looks [--size 160] [--paths 1024] [--target-error 0.02]
        [--only TEXT …] [--json]

Steps are differences between neighbouring pixels, less those of a path-traced picture, which
``--paths 0`` leaves out. The noise is the part of L* that a mean over 5 × 5 pixels takes away, in
areas where that mean changes by less than 0.5 from pixel to pixel. Both leave out outlines. The
scenes are the hydrogen and the engine under grace, and scenes of docs/.
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
from benchmarks.accuracy.room import PATIENCE, edges
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import LIGHTS, shared_data
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.frame import Frame
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.scene import Scene
from isogi_report.speed import view_of
from isogi_server.cli.render import awaited
from isogi_server.render.engine import RenderEngine

DOCS = Path(__file__).parents[2] / "docs"

REAL: dict[str, dict[str, Any]] = {
    "hydrogen": {"volume": "hydrogen3d_64x64x64_float32.nhdr", "environment": "studio"},
    "engine": {
        "volume": "engine_256x256x128_uint8.nhdr",
        "isovalue": 70,
        "lights": [dict(LIGHTS["grace"])],
    },
}
"""Scenes on shared volumes."""

DRAWN = ("cornell", "glow", "lamp", "colours", "surfaces")
"""Scenes of docs/."""

BINOMIAL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
FLAT = 0.5
"""Weights of the mean, and change of L* a pixel below which an area counts as flat."""

HEAD = (
    "scene",
    "with own light",
    "borders",
    "steps beyond, RMS",
    "at most",
    "noise of surfaces",
    "noise of walls",
)


@part(size=160)
@click.option(
    "--paths", default=1024, type=click.IntRange(0), help="Paths a pixel.", show_default=True
)
@click.option("--target-error", default=0.02, show_default=True, help="Of the final pictures.")
@click.option("--only", multiple=True, help="Part of a scene's name; repeatable.")
def looks(size: int, paths: int, target_error: float, only: tuple[str, ...]) -> Measurement:
    """Steps and noise, to the eye, of final pictures."""
    figures = dict[str, float]()
    rows = list[tuple[str, ...]]()
    for name, scene in scenes(only):
        frame, traced = pictures(scene, size, paths, Goal.checked(target_error))
        found = measure(frame, traced, scene.default_exposure)
        figures |= {f"{name}: {key}": value for key, value in found.items()}
        rows.append((name, *(f"{value:.3g}" for value in found.values())))
        click.echo(" | ".join(rows[-1]), err=True)
    return Measurement(f"Final pictures to the eye, {size} × {size}", figures, markdown(HEAD, rows))


def scenes(only: tuple[str, ...]) -> Iterator[tuple[str, Scene]]:
    """The scenes with these words in their names."""
    data = shared_data()
    for name, document in REAL.items():
        if data is not None and wanted(name, only):
            yield name, build_scene(SceneSource(name, document, data))
    for name in DRAWN:
        if wanted(name, only):
            yield name, load_scene(str(DOCS / f"{name}.toml"))


def pictures(scene: Scene, size: int, paths: int, goal: Goal) -> tuple[Frame, Frame | None]:
    """The final picture, and the path-traced one if ``paths`` are asked for."""
    view = replace(view_of(scene, size), smooth=False)
    with (
        tempfile.TemporaryDirectory() as store,
        closing(RenderEngine([scene], store, workers=2)) as engine,
    ):
        engine.start()
        frame = awaited(engine, scene.id, view, goal, PATIENCE)
        if not paths:
            return frame, None
        traced = replace(view, shading="path_traced", samples=paths)
        return frame, engine.survey(scene.id, traced, goal)


def measure(frame: Frame, traced: Frame | None, exposure: float) -> dict[str, float]:
    """Steps at borders, and noise, of a final picture."""
    shown = lightness(frame, exposure)
    inner = (frame.state > 0) & ~edges(frame)
    own = np.zeros(shown.shape, bool)
    if frame.quality.known is not None:
        own.flat[frame.gbuffer.pixels[frame.quality.known.own.places]] = True
    steps = np.empty(0)
    if traced is not None:
        steps = steps_beyond(shown, lightness(traced, exposure), own, inner)
    walls = np.zeros(shown.shape, bool)
    walls.flat[frame.gbuffer.walls.pixels] = True
    return {
        "own": float(own.sum()),
        "borders": float(len(steps)),
        "RMS": float(np.sqrt((steps**2).mean())) if len(steps) else 0.0,
        "most": float(np.abs(steps).max(initial=0.0)),
        "surfaces": noise_of(shown, inner & ~walls),
        "walls": noise_of(shown, inner & walls),
    }


def lightness(frame: Frame, exposure: float) -> np.ndarray:
    """CIE L* of the pixels as a screen shows them; (h, w)."""
    shown = np.clip(exposure * frame.radiance, 0.0, 1.0) @ LUMINANCE_WEIGHTS
    return np.where(shown > 216 / 24389, 116.0 * np.cbrt(shown) - 16.0, 24389 / 27 * shown)


def steps_beyond(
    shown: np.ndarray, truth: np.ndarray, own: np.ndarray, inner: np.ndarray
) -> np.ndarray:
    """Differences between ``inner`` neighbours of which one is ``own``, less the true ones."""
    found = []
    wrong = shown - truth
    for a, b in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1], np.s_[1:]),
    ):
        border = (own[a] != own[b]) & inner[a] & inner[b]
        found.append((wrong[b] - wrong[a])[border])
    return np.concatenate(found)


def noise_of(shown: np.ndarray, part: np.ndarray) -> float:
    """The RMS of what a mean over 5 × 5 pixels takes away, where it is flat and all of these belong
    to the ``part``; 0 if there is no such place.
    """
    # Pixels at the edge of the picture have no mean around them.
    whole = mean_around(np.pad(part[1:-1, 1:-1], 1).astype(float)) > 0.999
    mean = mean_around(shown)
    slope = np.hypot(*np.gradient(mean))
    flat = whole & (slope < FLAT)
    if not flat.any():
        return 0.0
    return float(np.sqrt(((shown - mean)[flat] ** 2).mean()))


def mean_around(values: np.ndarray) -> np.ndarray:
    """The binomial mean over 5 × 5 pixels; (h, w)."""
    for axis in (0, 1):
        padded = np.pad(values, [(2 * int(a == axis),) * 2 for a in range(2)], "edge")
        values = np.lib.stride_tricks.sliding_window_view(padded, len(BINOMIAL), axis) @ BINOMIAL
    return values
