"""Glass: what its pictures tell of their error beside the truth, at once and at rest, and what that
takes.

    python -m benchmarks.accuracy glass [SCENE] [--size 64] [--trees 64] [--paths 64] [--only TEXT
    …]

All real volumes, of glass under a probe, each in one view; without shared data, the casting. The
truth of a pixel is what two halves of trees of rays bring, of other random numbers than the
picture's; the picture's squared error is the product of what it differs by from either, so that
their noise is no part of it. Beside it stands by how much paths, which part nowhere and know all
interfaces, bring more or less in the mean of all pixels, with their own noise.
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import click
import numpy as np

from benchmarks.accuracy.benches import wanted
from benchmarks.accuracy.totals import PLACES
from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import LIGHTS, shared_data
from benchmarks.common.suite import part
from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.files.scene_file import SceneSource
from isogi_core.frame.frame import Frame
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import ControlPixels
from isogi_core.frame.rays.point_paths import HALVES
from isogi_core.frame.rays.through_matter import BREADTH, SeenThrough, Trees, dark_row
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.shot import Shot
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import View
from isogi_core.plan.assembly import build_scene, load_scene
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_report.metrics import luminance_of
from isogi_report.speed import view_of

MEMORY = 1 << 28
"""Bytes of light that frames may hold."""

OTHERS = 64
"""The first of the truth's replicas, after those of pictures."""

TOGETHER = 8
"""Trees of each half that are kept together."""

HEAD = (
    *(
        "glass",
        "pixels",
        "told at once, %",
        "true, %",
        "told at rest, %",
        "true at rest, %",
        "told / true at rest",
    ),
    *("at rest after, s", "paths' mean beside the truth's, %", "their noise, %"),
)


@dataclass(frozen=True)
class Found:
    """What was found of a view, relative to its true mean luminance; seconds until it is at
    rest.
    """

    pixels: int
    told: float
    true: float
    told_at_rest: float
    true_at_rest: float
    seconds: float
    paths: float
    noise: float

    @property
    def ratio(self) -> float:
        """What is told at rest over what is true."""
        return self.told_at_rest / max(self.true_at_rest, 1e-9)

    def row(self, name: str) -> tuple[str, ...]:
        """Its row under HEAD."""
        shares = (self.told, self.true, self.told_at_rest, self.true_at_rest)
        percents = [f"{100 * share:.2f}" for share in shares]
        rest = (
            f"{self.ratio:.2f}",
            f"{self.seconds:.2f}",
            f"{100 * self.paths:+.2f}",
            f"{100 * self.noise:.2f}",
        )
        return (name, f"{self.pixels}", *percents, *rest)


@part(size=64)
@click.argument("target", required=False)
@click.option(
    "--trees",
    default=64,
    type=click.IntRange(TOGETHER),
    show_default=True,
    help="Of each half of the truth.",
)
@click.option(
    "--paths",
    default=64,
    type=click.IntRange(2),
    show_default=True,
    help="Paths a pixel, for their mean.",
)
@click.option("--only", multiple=True, help="Part of a volume's name; repeatable.")
def glass(
    target: str | None, trees: int, paths: int, size: int, only: tuple[str, ...]
) -> Measurement:
    """What pictures of glass tell of their error beside the truth."""
    found = dict[str, Found]()
    for scene in scenes(target, only):
        found[scene.name] = measure(scene, size, trees, paths)
        click.echo(" | ".join(found[scene.name].row(scene.name)), err=True)
    figures = {
        "told / true at rest, median": median(each.ratio for each in found.values()),
        "true at rest, worst": max(each.true_at_rest for each in found.values()),
        "told / true at once, least": min(
            each.told / max(each.true, 1e-9) for each in found.values()
        ),
        "seconds until at rest, median": median(each.seconds for each in found.values()),
    }
    rows = [each.row(name) for name, each in found.items()]
    return Measurement(f"Glass, {size} × {size}", figures, markdown(HEAD, rows))


def scenes(target: str | None, only: Sequence[str]) -> Iterator[Scene]:
    """The scene ``target`` of glass, or all real volumes with these words in their names; the
    casting without those.
    """
    data = shared_data()
    if target is not None or data is None:
        yield load_scene(target, material="glass")
        return
    for stem, isovalue in PLACES:
        if wanted(name := f"{stem.partition('_')[0]} at {isovalue:g}", only):
            own = {"volume": f"{stem}.nhdr", "isovalue": isovalue, "material": "glass"}
            yield build_scene(SceneSource(name, own | {"lights": [dict(LIGHTS["uffizi"])]}, data))


def measure(scene: Scene, size: int, trees: int, paths: int) -> Found:
    """One view of a scene, at once and at rest."""
    with tempfile.TemporaryDirectory() as folder:
        renderer = Renderer(Caches(PreparedScene(scene), Path(folder), MEMORY), Tiles())
        view = replace(view_of(scene, size), smooth=False)
        first = renderer.render(view)
        begun = time.perf_counter()
        while renderer.refine(view):
            pass
        seconds = time.perf_counter() - begun
        last = renderer.render(view)
        halves = true_halves(renderer, view, trees)
        mean = float(halves.mean())
        traced = renderer.render(replace(view, shading="path_traced", samples=paths))
    light = seen(traced)
    noise = traced.error.ravel()[traced.gbuffer.pixels]
    spread = float(np.sqrt(((noise * light) ** 2).sum())) / len(light)
    return Found(
        *(
            len(light),
            first.noise,
            error_of(first, halves),
            last.noise,
            error_of(last, halves),
            seconds,
        ),
        *(float(light.mean()) / mean - 1.0, spread / mean),
    )


def seen(frame: Frame) -> np.ndarray:
    """The luminance of each surface point."""
    return luminance_of(frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels])


def true_halves(renderer: Renderer, view: View, trees: int) -> np.ndarray:
    """The luminance of each surface point by two halves of so many trees each; (m, HALVES)."""
    light = RotatedLight(renderer.caches.spec("gi"), view)
    gbuffer = renderer.gbuffer(view)
    shot = Shot(gbuffer, light, Goal(0.0), renderer.tiles)
    sums = np.zeros((len(gbuffer.pixels), HALVES))
    for first in range(0, trees, TOGETHER):
        some = Trees(
            BREADTH, range(OTHERS, OTHERS + HALVES), range(first, min(first + TOGETHER, trees))
        )
        found, _ = SeenThrough.of(shot, some).gather(dark_row(0))
        sums += luminance_of(found).reshape(len(sums), HALVES, -1).sum(axis=2)
    return np.asarray(sums / trees)


def error_of(frame: Frame, halves: np.ndarray) -> float:
    """The relative RMSE of a frame's luminance, without the noise of the truth's ``halves``."""
    every = ControlPixels(np.arange(len(halves)), np.ones(len(halves)), halves)
    return float(np.sqrt(max(every.squares(seen(frame)).mean(), 0.0)) / halves.mean())
