"""What an eye sees in final pictures: steps at borders between pixels with and without light of
their own, and the noise of flat areas of surfaces and walls, in L*.

    python -m benchmarks.accuracy looks [--size 160] [--paths 1024] [--target-error 0.02]
        [--only TEXT …] [--json]

Steps are differences between neighbouring pixels. The noise is the part of L* that a mean over
5 × 5 pixels takes away, in areas where that mean changes by less than 0.5 from pixel to pixel. Both
are those beyond a path-traced picture, whose pixels have DEEPER times as many paths at borders, and
whose noise is subtracted elsewhere; with ``--paths 0``, all steps are left out, and the noise is
that of the picture, with what the scene shows. Both leave out outlines.

Of glass, rays bring all light, and of several surfaces each side has borders of its own: in their
pictures any two neighbours count as a border, and a step is the part of their difference that
SIGMAS standard deviations of the path-traced picture do not explain. The scenes are the hydrogen, a
smoothed brain and the engine under grace, and scenes of docs/; those of docs/scenes have a target
error of at least LOOSER.
"""

import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.accuracy.benches import wanted
from benchmarks.accuracy.room import PATIENCE, edges
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import LIGHTS, documented_scene, shared_data
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.frame import Frame
from isogi_core.frame.rays.pixel_rays import Paths, split_into_replicas
from isogi_core.frame.renderer import Renderer
from isogi_core.kernels.transport import streams
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
    "smoothed brain": {
        "volume": "mni152_t1_197x233x189_uint8.nhdr",
        "isovalue": 90,
        "smooth": 1,
        "environment": "studio",
    },
}
"""Scenes on shared volumes."""

DRAWN = ("cornell", "glow", "lamp", "colours", "surfaces")
"""Scenes of docs/."""

DOCUMENTED = {"glass": "nuclear", "microscopy": "microscopy"}
"""Scenes of docs/scenes, whose volumes are shared ones."""

LOOSER = 0.05
"""The error of their pictures in docs/scenes.md: at 2 % they take ten minutes and more."""

BINOMIAL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
FLAT = 0.5
"""Weights of the mean, and change of L* a pixel below which an area counts as flat."""

TAKEN = 1.0 - 2.0 * BINOMIAL[2] ** 2 + float(BINOMIAL @ BINOMIAL) ** 2
"""Share of the variance of independent noise that the mean over 5 × 5 pixels takes away."""

DEEPER = 16
"""Factor on the paths of a path-traced picture at borders: in dark parts, 1,024 paths leave a noise
of 0.8 L*, and the largest of a hundred differences would be one of noise.
"""

NEIGHBOURS = (
    (np.s_[:, :-1], np.s_[:, 1:]),
    (np.s_[:-1], np.s_[1:]),
)
"""Pixels of a picture and the next ones along a row, and along a column."""

SIGMAS = 4.0
"""Standard deviations of its noise by which a path-traced picture may be wrong: of 50,000
differences, 3 are beyond them by chance.
"""

HEAD = (
    "scene",
    "target error",
    "final",
    "with own light",
    "borders",
    "steps beyond, RMS",
    "at most",
    "noise of surfaces beyond",
    "of walls",
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
        target = target_error
        if name in DOCUMENTED:
            target = max(target_error, LOOSER)
        frame, shown, truth = pictures(scene, size, paths, Goal.checked(target))
        found = {"target": target, "final": float(frame.final), **measure(frame, shown, truth)}
        figures |= {f"{name}: {key}": value for key, value in found.items()}
        rows.append((name, *(in_words(value) for value in found.values())))
        click.echo(" | ".join(rows[-1]), err=True)
    return Measurement(f"Final pictures to the eye, {size} × {size}", figures, markdown(HEAD, rows))


def in_words(value: float) -> str:
    """A figure of a table: three digits, of large counts all."""
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.3g}"


def scenes(only: tuple[str, ...]) -> Iterator[tuple[str, Scene]]:
    """The scenes with these words in their names."""
    data = shared_data()
    for name, document in REAL.items():
        if data is not None and wanted(name, only):
            yield name, build_scene(SceneSource(name, document, data))
    for name in DRAWN:
        if wanted(name, only):
            yield name, load_scene(str(DOCS / f"{name}.toml"))
    for name, file in DOCUMENTED.items():
        if data is not None and wanted(name, only):
            yield name, documented_scene(file, data)


@dataclass(frozen=True, eq=False)
class Truth:
    """A path-traced picture: ``lightness`` (h, w) in L*, the ``noise`` (h, w) of it, a standard
    deviation, and the lightness ``at_borders`` (h, w), which has less noise there.
    """

    lightness: np.ndarray
    noise: np.ndarray
    at_borders: np.ndarray


def pictures(
    scene: Scene, size: int, paths: int, goal: Goal
) -> tuple[Frame, np.ndarray, Truth | None]:
    """The final picture, its L* (h, w), and the path-traced one if ``paths`` are asked for."""
    view = replace(view_of(scene, size), smooth=False)
    exposure = scene.default_exposure
    with (
        tempfile.TemporaryDirectory() as store,
        closing(RenderEngine([scene], store, workers=2)) as engine,
    ):
        engine.start()
        frame = awaited(engine, scene.id, view, goal, PATIENCE)
        shown = lightness(frame.radiance, exposure)
        if not paths:
            return frame, shown, None
        path_traced = replace(view, shading="path_traced", samples=paths)
        traced = engine.survey(scene.id, path_traced, goal)
        deep = deepened(traced, borders_of(frame), engine.renderer(scene.id))
    light = np.clip(exposure * traced.radiance, 0.0, 1.0) @ LUMINANCE_WEIGHTS
    noise = traced.error * light * slope_of_lightness(light)
    truth = Truth(lightness(traced.radiance, exposure), noise, lightness(deep, exposure))
    return frame, shown, truth


def deepened(traced: Frame, borders: np.ndarray, renderer: Renderer) -> np.ndarray:
    """The radiance (h, w, 3) of a path-traced picture whose pixels at ``borders`` (h, w) take
    DEEPER times as many paths.
    """
    rows = np.flatnonzero(borders.flat[traced.gbuffer.pixels])
    gbuffer = traced.gbuffer.part(rows, renderer.tiles)
    replicas, each = split_into_replicas(traced.view.samples)
    paths = Paths(renderer.surface.light(traced.view), gbuffer, renderer.tiles)
    # Trace the paths of the picture again, then those that follow them. The difference between both
    # means is added to the picture, which may show more than the light of its surface.
    few = np.zeros((len(rows), replicas, 3))
    paths.add(few, streams.PICTURE_STREAM, 0, each)
    many = few.copy()
    paths.add(many, streams.PICTURE_STREAM, each, (DEEPER - 1) * each)
    found = traced.radiance.astype(np.float64)
    change = many.mean(axis=1) / (DEEPER * each) - few.mean(axis=1) / each
    found.reshape(-1, 3)[gbuffer.pixels] += change
    return found


def own_pixels(frame: Frame) -> np.ndarray:
    """Marks of the pixels with light of their own; (h, w) bool."""
    own = np.zeros(frame.state.shape, bool)
    if frame.quality.known is not None:
        own.flat[frame.gbuffer.pixels[frame.quality.known.own.places]] = True
    return own


def inner_pixels(frame: Frame) -> np.ndarray:
    """Marks of the pixels that show a surface or a wall, without outlines; (h, w) bool."""
    return (frame.state > 0) & ~edges(frame)


def borders_of(frame: Frame) -> np.ndarray:
    """Marks of the pixels on either side of a border of light of pixels' own; (h, w) bool."""
    own = own_pixels(frame)
    inner = inner_pixels(frame)
    found = np.zeros(own.shape, bool)
    for a, b in NEIGHBOURS:
        border = (own[a] != own[b]) & inner[a] & inner[b]
        found[a] |= border
        found[b] |= border
    return found


def measure(frame: Frame, shown: np.ndarray, truth: Truth | None) -> dict[str, float]:
    """Steps at borders, and noise, of a final picture that has the L* ``shown`` (h, w)."""
    inner = inner_pixels(frame)
    own = own_pixels(frame)
    walls = np.zeros(shown.shape, bool)
    walls.flat[frame.gbuffer.walls.pixels] = True
    steps = np.empty(0)
    if truth is not None and frame.quality.known is None:
        parts = (inner & walls, inner & ~walls)
        steps = np.concatenate([steps_anywhere(shown, truth, part) for part in parts])
    elif truth is not None:
        steps = steps_beyond(shown, truth.at_borders, own, inner)
    return {
        "own": float(own.sum()),
        "borders": float(len(steps)),
        "RMS": float(np.sqrt((steps**2).mean())) if len(steps) else 0.0,
        "most": float(np.abs(steps).max(initial=0.0)),
        "surfaces": noise_of(shown, inner & ~walls, truth),
        "walls": noise_of(shown, inner & walls, truth),
    }


def lightness(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """CIE L* of the ``radiance`` (h, w, 3) as a screen shows it; (h, w)."""
    shown = np.clip(exposure * radiance, 0.0, 1.0) @ LUMINANCE_WEIGHTS
    return np.where(shown > 216 / 24389, 116.0 * np.cbrt(shown) - 16.0, 24389 / 27 * shown)


def slope_of_lightness(light: np.ndarray) -> np.ndarray:
    """The derivative of L* by ``light`` of 0 to 1; 0 at 1, as more light is not shown."""
    found = 116.0 / 3.0 * np.maximum(light, 216 / 24389) ** (-2.0 / 3.0)
    return np.where(light < 1.0, found, 0.0)


def steps_beyond(
    shown: np.ndarray, truth: np.ndarray, own: np.ndarray, inner: np.ndarray
) -> np.ndarray:
    """Differences between ``inner`` neighbours of which one is ``own``, less the true ones."""
    found = []
    wrong = shown - truth
    for a, b in NEIGHBOURS:
        border = (own[a] != own[b]) & inner[a] & inner[b]
        found.append((wrong[b] - wrong[a])[border])
    return np.concatenate(found)


def steps_anywhere(shown: np.ndarray, truth: Truth, part: np.ndarray) -> np.ndarray:
    """Differences between neighbours in a ``part`` (h, w) of the picture, less the true ones, as
    far as they are beyond the noise of the ``truth``.
    """
    found = []
    wrong = shown - truth.lightness
    for a, b in NEIGHBOURS:
        both = part[a] & part[b]
        step = (wrong[b] - wrong[a])[both]
        noise = np.hypot(truth.noise[a], truth.noise[b])[both]
        found.append(np.sign(step) * np.maximum(np.abs(step) - SIGMAS * noise, 0.0))
    return np.concatenate(found)


def noise_of(shown: np.ndarray, part: np.ndarray, truth: Truth | None) -> float:
    """The RMS of what a mean over 5 × 5 pixels takes away beyond the ``truth``, where it is flat
    and all of these belong to the ``part``; 0 if there is no such place.
    """
    # Pixels at the edge of the picture have no mean around them.
    whole = mean_around(np.pad(part[1:-1, 1:-1], 1).astype(float)) > 0.999
    slope = np.hypot(*np.gradient(mean_around(shown)))
    flat = whole & (slope < FLAT)
    if not flat.any():
        return 0.0
    # Subtract what the scene shows, and the noise that the path-traced picture brings.
    known = 0.0
    if truth is not None:
        shown = shown - truth.lightness
        known = TAKEN * float((truth.noise[flat] ** 2).mean())
    square = float(((shown - mean_around(shown))[flat] ** 2).mean())
    return max(square - known, 0.0) ** 0.5


def mean_around(values: np.ndarray) -> np.ndarray:
    """The binomial mean over 5 × 5 pixels; (h, w)."""
    for axis in (0, 1):
        padded = np.pad(values, [(2 * int(a == axis),) * 2 for a in range(2)], "edge")
        values = np.lib.stride_tricks.sliding_window_view(padded, len(BINOMIAL), axis) @ BINOMIAL
    return values
