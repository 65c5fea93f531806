"""Low-discrepancy points against plain random ones, at equal time: the ratio of errors.

    python -m benchmarks.speed points [TARGET] [--size 64] [--samples 1024] [--json]

The engine block at 70 under grace, the CT head at 110 under uffizi and the MNI brain at 90 under
constant light, or demos where the shared data are not at hand; as they are lit by their plans.
Texels of a view are baked, and its pixels traced, with 16, 64, 256 … samples each, in the same
kernels: of few sequences many points, as isogi does, or of as many sequences as samples the first
point alone, which is uniform and independent of all others. Errors are relative RMSE of the
luminance against many more samples, whose own noise is taken off. Seconds are of the processor, all
threads, from one run after compiling; the error of random points is interpolated to the time of the
others. As many sequences have as many sums, which a sampler made for random points would not keep
apart: where that takes time, with many harmonics, the ratio at equal samples is the fair one.
"""

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import click
import numpy as np
from tqdm import tqdm

from benchmarks.common.measurement import Measurement, markdown
from benchmarks.common.scenes import three_scenes
from benchmarks.common.suite import part
from benchmarks.speed.paths import view_texels
from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.refine import Place, locate, sample_irradiance, sample_transfer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.pixel_rays import Paths, split_into_replicas
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.transport import streams
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_report.speed import make_renderer, view_of

MANY = 16
"""The reference takes so many times the most samples."""

TOGETHER = 64
"""Sequences of plain random points that are drawn from together."""

TEXELS = 1024
PIECE = 128
"""Texels that are baked, and those of a piece of work."""

HEAD = ("samples", "error", "s", "error, random", "s, random", "ratio", "ratio at equal time")


class Surfels(Protocol):
    """Places that are lit: texels or pixels."""

    def light(self, stream: int, sequences: int, points: int) -> np.ndarray:
        """Luminance (m, sequences) by so many points of each sequence, numbered from ``stream``
        on.
        """


@dataclass(frozen=True, eq=False)
class Pixels:
    """The surface pixels of a view."""

    paths: Paths

    def light(self, stream: int, sequences: int, points: int) -> np.ndarray:
        """See ``Surfels``."""
        sums = np.zeros((len(self.paths.gbuffer.points), sequences, 3))
        self.paths.add(sums, stream, 0, points)
        return np.asarray(sums @ LUMINANCE_WEIGHTS / points)


@dataclass(frozen=True, eq=False)
class Texels:
    """Some texels (m, 3; z, y, x) of a scene."""

    prepared: PreparedScene
    texels: np.ndarray
    tiles: Tiles

    def light(self, stream: int, sequences: int, points: int) -> np.ndarray:
        """See ``Surfels``: a texel has two sequences, and as many under each name of a texel far
        away.
        """
        found = np.empty((len(self.texels), sequences))

        def bake(a: int, b: int) -> None:
            (_, p, n, isovalues), void = locate(self.texels[a:b], self.prepared)
            names = np.arange(stream // 2, (stream + sequences) // 2) * self.prepared.shape[0]
            far = self.texels[a:b, None] + names[:, None] * np.array([1, 0, 0])
            copies = (len(names),) * (b - a)
            place = (
                far.reshape(-1, 3).astype(np.int32),
                *(np.repeat(v, copies, axis=-1) for v in (p, n, isovalues)),
            )
            found[a:b] = self._halves(place, np.repeat(void, copies), points).reshape(
                b - a, sequences
            )

        self.tiles.run(bake, len(self.texels), PIECE)
        return found

    def _halves(self, place: Place, void: np.ndarray, points: int) -> np.ndarray:
        spec = spec_for(self.prepared, "gi")
        layers = spec.plan.layers
        light = np.zeros((len(void), 2))
        if layers[0].kind == "irradiance":
            sample = sample_irradiance
        else:
            sample = sample_transfer
        for layer, (sums, _) in zip(
            layers, sample(layers, place, void, spec, 0, 2 * points), strict=True
        ):
            weights = spec.luminance_light[:, : layer.order**2]
            if layer.channels != len(weights):
                weights = weights.sum(axis=0, keepdims=True)
            light += np.einsum("mhcn,cn->mh", sums[..., : weights.shape[1]], weights) / points
        return light


@dataclass(frozen=True)
class Point:
    """What so many ``samples`` give: relative errors of both kinds of points, and the processor's
    seconds.
    """

    samples: int
    error: float
    seconds: float
    random_error: float
    random_seconds: float


def surfels(renderer: Renderer, size: int) -> dict[str, Surfels]:
    """Texels and pixels of the view."""
    prepared = renderer.prepared
    view = view_of(renderer.prepared.scene, size)
    texels = np.concatenate(view_texels(prepared.scene, size))
    chosen = np.random.default_rng(1).choice(texels, min(TEXELS, len(texels)), replace=False)
    (*_, isovalues), void = locate(chosen, prepared)
    chosen = chosen[~void][isovalues[~void].argsort()]
    paths = Paths(
        RotatedLight(renderer.caches.spec("gi"), view), renderer.gbuffer(view), renderer.tiles
    )
    return {"texels": Texels(prepared, chosen, renderer.tiles), "pixels": Pixels(paths)}


def measure(what: Surfels, most: int) -> list[Point]:
    """Both kinds of points, 16, 64 … up to the ``most`` samples."""
    what.light(0, 2, 1)
    rungs = [4**k for k in range(2, int(math.log(most, 4)) + 1)]
    true = what.light(streams.REFERENCE_STREAM, 8, MANY * most // 8)
    return [both(what, samples, true) for samples in tqdm(rungs, leave=False)]


def both(what: Surfels, samples: int, true: np.ndarray) -> Point:
    """Errors and seconds of both kinds of points."""
    if isinstance(what, Pixels):
        replicas, each = split_into_replicas(samples)
    else:
        replicas, each = 2, samples // 2
    light, seconds = timed(lambda: what.light(0, replicas, each).mean(axis=1))
    other, random_seconds = timed(lambda: random(what, samples))
    return Point(samples, error(light, true), seconds, error(other, true), random_seconds)


def random(what: Surfels, samples: int) -> np.ndarray:
    """The mean over the first points of as many sequences."""
    blocks = range(
        2 * streams.REFERENCE_STREAM, 2 * streams.REFERENCE_STREAM + samples, min(TOGETHER, samples)
    )
    return np.asarray(
        np.mean([what.light(b, min(TOGETHER, samples), 1).mean(axis=1) for b in blocks], axis=0)
    )


def timed(work: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    """What some work gives, and the processor's seconds for it."""
    begun = time.process_time()
    found = work()
    return found, time.process_time() - begun


def error(light: np.ndarray, true: np.ndarray) -> float:
    """Relative RMSE of luminances (m,) against the mean of ``true`` (m, sequences), whose noise is
    taken off.
    """
    noise = true.var(axis=1, ddof=1).mean() / true.shape[1]
    wrong = ((light - true.mean(axis=1)) ** 2).mean() - noise
    return float(np.sqrt(max(wrong, 0.0)) / true.mean())


def ratios(found: Sequence[Point]) -> list[float]:
    """Random errors at the time of the others, over theirs; beyond what was measured random errors
    go as t^-1/2.
    """
    times, errors = (
        np.array([getattr(p, name) for p in found]) for name in ("random_seconds", "random_error")
    )
    wanted = np.array([p.seconds for p in found])
    inside = np.clip(wanted, times[0], times[-1])
    log = np.interp(np.log(inside), np.log(times), np.log(errors))
    return [float(r) for r in np.exp(log) * np.sqrt(inside / wanted) / [p.error for p in found]]


@part(size=64)
@click.argument("target", required=False)
@click.option(
    "--samples",
    type=click.IntRange(16),
    default=1024,
    show_default=True,
    help="The most, for each place.",
)
def points(target: str | None, size: int, samples: int) -> Iterator[Measurement]:
    """Errors of low-discrepancy points beside those of random ones, at equal samples and at equal
    time.
    """
    for scene in three_scenes(target):
        with tempfile.TemporaryDirectory() as store:
            for name, what in surfels(make_renderer(scene, store), size).items():
                yield told(
                    (
                        f"{scene.name} at {scene.isovalue:g}, {scene.lighting.environment.name}, "
                        f"{name}"
                    ),
                    measure(what, samples),
                )


def told(title: str, found: Sequence[Point]) -> Measurement:
    """A curve as figures and as a table."""
    figures: dict[str, float] = {}
    rows = []
    for point, ratio in zip(found, ratios(found), strict=True):
        equal = point.random_error / point.error
        figures |= {
            f"{point.samples} samples: error": point.error,
            f"{point.samples} samples: random error": point.random_error,
            f"{point.samples} samples: random / low-discrepancy": equal,
            f"{point.samples} samples: random / low-discrepancy at equal time": ratio,
        }
        errors = (
            f"{point.error:.4f}",
            f"{point.seconds:.3f}",
            f"{point.random_error:.4f}",
            f"{point.random_seconds:.3f}",
        )
        rows.append((str(point.samples), *errors, f"{equal:.2f}", f"{ratio:.2f}"))
    return Measurement(title, figures, markdown(HEAD, rows, left=0))
