"""Low-discrepancy points against plain random ones, at equal time: the ratio of errors.

    python -m benchmarks.points [--size 64] [--samples 1024] [--json]

The engine block at 70 under grace, the CT head at 110 under uffizi and the MNI brain at 90 under constant light, or
demos where the shared data are not at hand; as they are lit by their plans. Texels of a view are baked, and its pixels
traced, with 16, 64, 256 … samples each, in the same kernels: of few sequences many points, as isogi does, or of as
many sequences as samples the first point alone, which is uniform and independent of all others. Errors are relative
RMSE of the luminance against many more samples, whose own noise is taken off. Seconds are of the processor, all
threads, from one run after compiling; the error of random points is interpolated to the time of the others. As many
sequences have as many sums, which a sampler made for random points would not keep apart: where that takes time, with
many harmonics, the ratio at equal samples is the fair one.
"""

import json
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Protocol

import click
import numpy as np
from tqdm import tqdm

from benchmarks.paths import view_texels
from benchmarks.plan_scenes import GRACE, UFFIZI, three_scenes
from isogi_core.bake.look import look_for
from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import Place, locate, sample_irradiance, sample_transfer
from isogi_core.frame.paths import Paths, replicas_for
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.surroundings import Turned
from isogi_core.frame.tiles import Tiles
from isogi_core.model.sky import LUMINANCE
from isogi_core.report.reference import STREAM
from server.measure import make_renderer, view_of

MANY = 16
"""The reference takes so many times the most samples."""

TOGETHER = 64
"""Sequences of plain random points that are drawn from together."""

TEXELS, PIECE = 1024, 128
"""Texels that are baked, and those of a piece of work."""

HEAD = f"{'samples':>9}{'error':>9}{'seconds':>9}{'random':>9}{'seconds':>9}{'ratio':>9}{'at equal time':>15}"
LINE = (
    "{samples:9}{error:9.4f}{seconds:9.3f}{random_error:9.4f}{random_seconds:9.3f}{at_equal_samples:9.2f}"
    "{at_equal_time:15.2f}"
)


class Surfels(Protocol):
    """Places that are lit: texels or pixels."""

    def light(self, stream: int, sequences: int, points: int) -> np.ndarray:
        """Luminance (m, sequences) by so many points of each sequence, numbered from ``stream`` on."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """The surface pixels of a view."""

    paths: Paths

    def light(self, stream: int, sequences: int, points: int) -> np.ndarray:
        """See ``Surfels``."""
        sums = np.zeros((len(self.paths.gbuffer.points), sequences, 3))
        self.paths.add(sums, stream, 0, points)
        return np.asarray(sums @ LUMINANCE / points)


@dataclass(frozen=True, eq=False)
class Texels:
    """Some texels (m, 3; z, y, x) of a scene."""

    recipe: Recipe
    texels: np.ndarray
    tiles: Tiles

    def light(self, stream: int, sequences: int, points: int) -> np.ndarray:
        """See ``Surfels``: a texel has two sequences, and as many under each name of a texel far away."""
        found = np.empty((len(self.texels), sequences))

        def bake(a: int, b: int) -> None:
            (_, p, n, isovalues), void = locate(self.texels[a:b], self.recipe)
            names = np.arange(stream // 2, (stream + sequences) // 2) * self.recipe.shape[0]
            far = self.texels[a:b, None] + names[:, None] * np.array([1, 0, 0])
            copies = (len(names),) * (b - a)
            place = (far.reshape(-1, 3).astype(np.int32), *(np.repeat(v, copies, axis=-1) for v in (p, n, isovalues)))
            found[a:b] = self._halves(place, np.repeat(void, copies), points).reshape(b - a, sequences)

        self.tiles.run(bake, len(self.texels), PIECE)
        return found

    def _halves(self, place: Place, void: np.ndarray, points: int) -> np.ndarray:
        look = look_for(self.recipe, "gi")
        layers, light = look.plan.layers, np.zeros((len(void), 2))
        sample = sample_irradiance if layers[0].kind == "irradiance" else sample_transfer
        for layer, (sums, _) in zip(layers, sample(layers, place, void, look, 0, 2 * points), strict=True):
            weights = look.luminance_light[:, : layer.order**2]
            weights = weights if layer.channels == len(weights) else weights.sum(axis=0, keepdims=True)
            light += np.einsum("mhcn,cn->mh", sums[..., : weights.shape[1]], weights) / points
        return light


@dataclass(frozen=True)
class Point:
    """What so many ``samples`` give: relative errors of both kinds of points, and the processor's seconds."""

    samples: int
    error: float
    seconds: float
    random_error: float
    random_seconds: float


def surfels(renderer: Renderer, size: int) -> dict[str, Surfels]:
    """Texels and pixels of the view."""
    recipe, view = renderer.recipe, view_of(renderer.recipe.scene, size)
    texels = np.concatenate(view_texels(recipe.scene, size))
    chosen = np.random.default_rng(1).choice(texels, min(TEXELS, len(texels)), replace=False)
    (*_, isovalues), void = locate(chosen, recipe)
    chosen = chosen[~void][isovalues[~void].argsort()]
    paths = Paths(Turned(renderer.caches.look("gi"), view), renderer.gbuffer(view), renderer.tiles)
    return {"texels": Texels(recipe, chosen, renderer.tiles), "pixels": Pixels(paths)}


def measure(what: Surfels, most: int) -> list[Point]:
    """Both kinds of points, 16, 64 … up to the ``most`` samples."""
    what.light(0, 2, 1)
    rungs = [4**k for k in range(2, int(math.log(most, 4)) + 1)]
    true = what.light(STREAM, 8, MANY * most // 8)
    return [both(what, samples, true) for samples in tqdm(rungs, leave=False)]


def both(what: Surfels, samples: int, true: np.ndarray) -> Point:
    """Errors and seconds of both kinds of points."""
    replicas = replicas_for(samples) if isinstance(what, Pixels) else 2
    light, seconds = timed(lambda: what.light(0, replicas, samples // replicas).mean(axis=1))
    other, random_seconds = timed(lambda: random(what, samples))
    return Point(samples, error(light, true), seconds, error(other, true), random_seconds)


def random(what: Surfels, samples: int) -> np.ndarray:
    """The mean over the first points of as many sequences."""
    blocks = range(2 * STREAM, 2 * STREAM + samples, min(TOGETHER, samples))
    return np.asarray(np.mean([what.light(b, min(TOGETHER, samples), 1).mean(axis=1) for b in blocks], axis=0))


def timed(work: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    """What some work gives, and the processor's seconds for it."""
    begun = time.process_time()
    found = work()
    return found, time.process_time() - begun


def error(light: np.ndarray, true: np.ndarray) -> float:
    """Relative RMSE of luminances (m,) against the mean of ``true`` (m, sequences), whose noise is taken off."""
    noise = true.var(axis=1, ddof=1).mean() / true.shape[1]
    wrong = ((light - true.mean(axis=1)) ** 2).mean() - noise
    return float(np.sqrt(max(wrong, 0.0)) / true.mean())


def ratios(points: Sequence[Point]) -> list[float]:
    """Random errors at the time of the others, over theirs; beyond what was measured random errors go as t^-1/2."""
    times, errors = (np.array([getattr(p, name) for p in points]) for name in ("random_seconds", "random_error"))
    wanted = np.array([p.seconds for p in points])
    inside = np.clip(wanted, times[0], times[-1])
    log = np.interp(np.log(inside), np.log(times), np.log(errors))
    return [float(r) for r in np.exp(log) * np.sqrt(inside / wanted) / [p.error for p in points]]


@click.command()
@click.argument("target", required=False)
@click.option("--size", type=click.IntRange(8), default=64, show_default=True, help="Pixels a side of the view.")
@click.option("--samples", type=click.IntRange(16), default=1024, show_default=True, help="The most, for each place.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(target: str | None, size: int, samples: int, as_json: bool) -> None:
    """Measure both kinds of points and print the ratios of their errors."""
    for scene in three_scenes(target, GRACE, UFFIZI):
        with tempfile.TemporaryDirectory() as store:
            for name, what in surfels(make_renderer(scene, store), size).items():
                points = measure(what, samples)
                show(f"{scene.name} at {scene.isovalue:g}, {scene.environment.name}: {name}", points, as_json)


def show(title: str, points: Sequence[Point], as_json: bool) -> None:
    """Print a curve: as JSON on one line, or as a table."""
    rows = [
        {**asdict(point), "at_equal_samples": point.random_error / point.error, "at_equal_time": ratio}
        for point, ratio in zip(points, ratios(points), strict=True)
    ]
    if as_json:
        click.echo(json.dumps({"what": title, "points": rows}, allow_nan=False))
        return
    click.echo(f"\n{title}\n{HEAD}")
    for row in rows:
        click.echo(LINE.format(**row))


if __name__ == "__main__":
    main()
