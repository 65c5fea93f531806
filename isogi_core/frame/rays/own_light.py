"""Light from the paths of single pixels: which pixels have it, how many paths that takes, and the
filter over it.

Filtering of pixels' own light, and of what it corrects in texels' light: no border shows where one
meets the other. A pixel of few paths takes over what pixels around it on the surface agree on. The
filter is that of texels (``kernels.shading.filtering``) among pixels: two passes over 3 × 3 pixels,
the second at twice the distance (Dammertz and others 2010), and as much of a pixel's own light as
pixels around it differ by more than their noise (Lee 1980).

Pixels' own light differs from the light of texels by their error, which is smooth, and by noise.
The mean difference over pixels around corrects the light of texels, there and beside, where it
fades out. Of own light as much is kept as differs from the corrected light by more than noise.

The error of the mixture is Stein's unbiased estimate of risk (Stein, Annals of Statistics 9, 1981):
besides measured differences it needs how far each value follows its noise, which probes show
(Ramani, Blu and Unser, IEEE Transactions on Image Processing 17, 2008). Probes are contrasts of the
replicas: distributed as the noise of their mean is, and independent of it.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import RATE
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import bounces_of_truth
from isogi_core.frame.rays.pixel_rays import Paths, pooled_variance, variance_of_mean
from isogi_core.frame.rays.point_paths import Estimate
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.shading.lattice import MIN_LIGHT
from isogi_core.kernels.shading.surface_points import SurfacePoints, mean_around
from isogi_core.kernels.transport import streams
from isogi_core.model.environment import LUMINANCE_WEIGHTS

FILTER_PASSES = ((1, 1.0), (2, 1.8))
"""Distances, in pixels, between those that a pass mixes; and how much more variance their mean has
than that of independent ones: those of the second pass took over from the same pixels (1.8 times,
on even light).
"""

FULL_COVERAGE = 0.4
"""The share of pixels around one, by what they count, that corrects it wholly: less than at a
straight border.
"""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Pixels around each point of a ``gbuffer``, as far as they show the same surface; on threads
    of ``tiles``.
    """

    gbuffer: GBuffer
    tiles: Tiles

    @cached_property
    def shown(self) -> tuple[np.ndarray, SurfacePoints]:
        """The number of the point in each pixel, and the points, in the world here. Raises
        Cancelled.
        """
        shown = self.gbuffer.shown(self.tiles)
        spacing = np.array(self.gbuffer.spacing, np.float32)
        return self.gbuffer.rows, shown._replace(points=shown.points * spacing)

    @property
    def voxel(self) -> float:
        """Width of a voxel in the picture, in pixels: the median over pixels beside others that
        show the surface.
        """
        beside = np.flatnonzero(np.diff(self.gbuffer.pixels.astype(np.int64)) == 1)
        if not len(beside):
            return 1.0
        ways = np.diff(self.gbuffer.points.astype(np.float64), axis=0)[beside]
        return 1.0 / max(float(np.median(np.linalg.norm(ways, axis=1))), 1e-3)

    def means(
        self, values: np.ndarray, variance: np.ndarray, step: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """The mean of ``values`` (m, n) over 3 × 3 pixels at a distance of ``step``; and its
        variance, (m,), where that of independent values is ``variance`` (m,). Raises Cancelled.
        """
        shown = self.shown
        means = np.empty_like(values)
        left = np.empty(len(values))

        def _piece(a: int, b: int) -> None:
            mean_around(*shown, step, a, values, variance, means[a:b], left[a:b])

        self.tiles.run(_piece, len(values), self.tiles.even(len(values)))
        return means, left


def filter_pixels(
    light: np.ndarray, variance: np.ndarray, gbuffer: GBuffer, tiles: Tiles
) -> tuple[np.ndarray, np.ndarray]:
    """Linear RGB of the points of a G-buffer, filtered, and the ``variance`` (m,) that its
    luminance has then.

    Further columns of ``light`` (m, 3 or more) are mixed as the colours are. Raises Cancelled.
    """
    around = Surroundings(gbuffer, tiles)
    for step, shared in FILTER_PASSES:
        shown = light[:, :3] @ LUMINANCE_WEIGHTS
        means, taken = around.means(np.column_stack([light, variance, shown**2]), variance, step)
        mean = means[:, :-2]
        noise = means[:, -2]
        square = means[:, -1]
        kept = beyond_noise(square - (mean[:, :3] @ LUMINANCE_WEIGHTS) ** 2, noise)
        light = mean + kept[:, None] * (light - mean)
        variance = np.minimum(kept * noise + (1.0 - kept) ** 2 * shared * taken, variance)
    return light, variance


def beyond_noise(apart: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """The share of values (k,) to be kept that are so far ``apart``, squared, with so much
    ``noise``: Wiener's.
    """
    signal = np.maximum(apart - noise, 0.0)
    return np.asarray(signal / np.maximum(signal + noise, 1e-300))


class NoisyPixels(NamedTuple):
    """Light that pixels have of their own: ``light`` (k, 3) linear RGB, the ``variance`` (k,) of
    its luminance, and ``probes`` (k, n): luminances distributed as its noise is, independent of it.
    """

    light: np.ndarray
    variance: np.ndarray
    probes: np.ndarray


def correct(
    light: np.ndarray,
    expected: np.ndarray,
    places: np.ndarray,
    own: NoisyPixels,
    gbuffer: GBuffer,
    tiles: Tiles,
) -> tuple[np.ndarray, np.ndarray]:
    """The texels' ``light`` (m, 3) of a picture, corrected by the ``own`` light of points in rows
    ``places`` (k,); and the mean squared error of these points' luminance then, (k,).

    A texel's error reaches as far as the texel, so differences are spread a voxel and more: by the
    error that is ``expected`` (m,) of each point, so that little changes where little is expected.
    See ``blended_error`` for the error; where little corrects a pixel it is what is expected of
    texels. Raises Cancelled.
    """
    # Differences from texels' light are spread over a voxel, and with them what the probes add.
    around = Surroundings(gbuffer, tiles)
    scale = np.maximum(expected, 1e-3 * expected.mean() + 1e-30)[:, None]
    found = np.column_stack([own.light - light[places], own.probes]) / scale[places]
    known = np.zeros((len(light), found.shape[1] + 1))
    known[places] = np.column_stack([found, np.ones(len(places))])
    none = np.zeros(len(light))
    for level in range(max(math.ceil(math.log2(around.voxel)), 0) + 1):
        known, _ = around.means(known, none, 1 << level)
    share = np.minimum(known[:, -1:] / FULL_COVERAGE, 1.0)
    ramp = share**2 * (3.0 - 2.0 * share)
    spread = ramp * scale / np.maximum(known[:, -1:], 1e-300)
    light = light + spread * known[:, :3]
    carried = (spread * known[:, 3:-1])[places]

    # What differs from the corrected light by more than noise stays.
    apart = own.light - light[places]
    near = Surroundings(gbuffer.part(places, tiles), tiles)
    kept, square = blended_error(own, apart @ LUMINANCE_WEIGHTS, carried, near)
    light[places] += kept[:, None] * apart
    left = ((1.0 - ramp) * scale)[places, 0]
    return light, np.maximum(square, ((1.0 - kept) * left) ** 2)


def blended_error(
    own: NoisyPixels, apart: np.ndarray, carried: np.ndarray, near: Surroundings
) -> tuple[np.ndarray, np.ndarray]:
    """The share of pixels' ``own`` light that is kept beside light that was corrected by it; and
    the mean squared error of what both make, (k,) each.

    The corrected light is C, own light O with the variance V is ``apart`` (k,) from it by x, and
    the share is κ = 1 - V / M, at least 0, where M is the mean of x² ``near``. The shown light
    C + κ x then errs, in the mean, by

        κ V + 2 (1 - κ) cov(O, C) + 4 V / M² · mean(x n)²   if M > V, and
        M - V + 2 cov(O, C)                                 if it is not.

    The first term is the error that own light leaves where it is kept, or what texels' light errs
    by beyond noise where it is not; the second the noise that C took over from the same paths; the
    third that of κ, which follows the noise, too. Probes show them: each adds p to O and p' to C,
    ``carried`` (k, n), so that cov(O, C) is the mean of p p', and n is p - p'. Of a pixel alone the
    estimate is rough, so it is the mean over pixels near, and at least the noise that is left,
    κ² V + 2 κ (1 - κ) cov(O, C) + (1 - κ)² var(C).

    It is assumed that the noise of paths is normal and independent from pixel to pixel, and of the
    light of texels; noise that the filter, or the correction, has in common between pixels is in
    the probes. Texels' noise is part of x.
    """
    noise = own.probes - carried
    both = (own.probes * carried).mean(axis=1)
    values = [own.variance, both, (carried**2).mean(axis=1), apart[:, None] * noise, apart**2]
    means, _ = near.means(np.column_stack(values), own.variance)
    (variance, common, left), square = means[:, :3].T, means[:, -1]
    kept = beyond_noise(square, variance)
    floor = np.maximum(square, 1e-300)
    followed = (means[:, 3:-1] ** 2).mean(axis=1) / floor * (variance / floor)
    risk = np.where(kept > 0.0, kept * variance + 4.0 * followed, square - variance)
    risk = (risk + 2.0 * (1.0 - kept) * common)[:, None]
    for step, _ in FILTER_PASSES:
        risk, _ = near.means(risk, own.variance, step)
    least = kept**2 * variance + (1.0 - kept) * (
        2.0 * kept * np.maximum(common, 0.0) + (1.0 - kept) * left
    )
    return kept, np.maximum(risk[:, 0], least)


REPLICAS = 4
FIRST_PATHS = 16
"""Independent randomisations of each pixel, and paths of each after the first step."""

CONTRASTS = np.array([[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]])
"""What the replicas count in each probe, over their number: as much as in the mean, with signs that
make probes independent of it and of each other.
"""

MOST_PATHS = 1 << 14
"""Paths of each replica, at most: 65,536 from a pixel."""

FILTERED_VARIANCE_SHARE = 0.7
"""What filtering leaves of the variance of light that pixels have of their own: 0.46 to 0.9, as it
is most at edges.

Where it corrects the light of texels 0.3 to 1 is left of that: all where texels are much noisier,
so that none is counted on.
"""

BLACK_SHARE = 1e-3
"""The share of the brightest colour below which a surface counts as black."""

AIM = 0.85
"""Share of the target error that a picture is brought to: the interval of what is measured has some
width.
"""


@dataclass(frozen=True, eq=False)
class PixelLight:
    """Surface points with light of their own: rows ``places`` (k,), ascending, and the ``estimate``
    by their paths.

    It is of REPLICAS, and all points have as many paths of each. They show ``light`` (k, 3), linear
    RGB, which is filtered, and whose luminance has the ``variance`` (k,); ``probes`` (k, contrasts)
    are distributed as its noise is. Of all points (m,) the luminance of texels' light is
    ``expected`` to be so wrong.
    """

    places: np.ndarray
    estimate: Estimate
    light: np.ndarray
    variance: np.ndarray
    probes: np.ndarray
    expected: np.ndarray

    @classmethod
    def none(cls) -> "PixelLight":
        """No pixel has light of its own."""
        empty = Estimate.none(0, REPLICAS)
        probes = np.empty((0, len(CONTRASTS)))
        return cls(np.empty(0, np.int64), empty, np.empty((0, 3)), np.empty(0), probes, np.empty(0))

    @classmethod
    def of(
        cls, places: np.ndarray, estimate: Estimate, paths: Paths, expected: np.ndarray
    ) -> "PixelLight":
        """The light of points by an ``estimate``, filtered without their colours. Raises
        Cancelled.
        """
        means = estimate.means
        buffer = paths.gbuffer
        tiles = paths.tiles
        tints = tints_of(paths.light, buffer, tiles)
        grey = (tints @ LUMINANCE_WEIGHTS) ** 2
        variance = pooled_variance(variance_of_mean(means), buffer)
        bare = means / tints[:, None]
        probes = bare @ LUMINANCE_WEIGHTS @ CONTRASTS.T / REPLICAS
        found = np.column_stack([bare.mean(axis=1), probes])
        found, variance = filter_pixels(found, variance / grey, buffer, tiles)
        light = found[:, :3] * tints
        probes = found[:, 3:] * np.sqrt(grey)[:, None]
        return cls(places, estimate, light, variance * grey, probes, expected)

    @property
    def count(self) -> int:
        """Paths of each replica from every point."""
        return self.estimate.most

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        held = (
            *(self.places, self.estimate, self.light),
            *(self.variance, self.probes, self.expected),
        )
        return sum(each.nbytes for each in held)

    def grown(
        self,
        choice: "Choice",
        count: int,
        light: RotatedLight,
        gbuffer: GBuffer,
        tiles: Tiles,
        progress: Callable[[int], object] | None = None,
    ) -> "PixelLight":
        """Light of the points of a ``choice``, or after more paths: those known are not traced
        again. Raises Cancelled.

        ``progress`` is called with the number of paths that each piece traced.
        """
        places = choice.places
        expected = choice.errors.copy()
        expected[self.places] = self.expected[self.places]
        paths = Paths(light, gbuffer.part(places, tiles), tiles, bounces_of_truth(light))
        estimate = Estimate.none(len(places), REPLICAS)
        known = np.isin(places, self.places, assume_unique=True)
        kept = np.isin(self.places, places, assume_unique=True)
        estimate.sums[known] = self.estimate.sums[kept]
        estimate.counts[known] = self.estimate.counts[kept]
        for first in np.unique(estimate.counts[estimate.counts < count]).tolist():
            rows = np.flatnonzero(estimate.counts == first)
            some = estimate.sums[rows]
            paths.of(rows).add(some, streams.PIXEL_LIGHT_STREAM, first, count - first, progress)
            estimate.sums[rows] = some
            estimate.counts[rows] = count
        return PixelLight.of(places, estimate, paths, expected)

    def put(
        self, framebuffer: Framebuffer, gbuffer: GBuffer, light: RotatedLight, tiles: Tiles
    ) -> None:
        """Write it into a picture of a G-buffer, as final light, and correct pixels around it.
        Raises Cancelled.
        """
        if not len(self.places):
            return
        pixels = gbuffer.pixels
        own = gbuffer.pixels[self.places]
        tints = tints_of(light, gbuffer, tiles)
        some = tints[self.places]
        grey = (some @ LUMINANCE_WEIGHTS) ** 2
        given = NoisyPixels(
            self.light / some, self.variance / grey, self.probes / np.sqrt(grey)[:, None]
        )
        expected = self.expected / (tints @ LUMINANCE_WEIGHTS)
        texels = framebuffer.radiance[pixels] / tints
        whole, square = correct(texels, expected, self.places, given, gbuffer, tiles)
        framebuffer.radiance[pixels] = np.clip(whole * tints, 0.0, np.finfo(np.float32).max)
        shown = np.maximum(
            framebuffer.radiance[own] @ LUMINANCE_WEIGHTS, MIN_LIGHT * light.spec.unit
        )
        framebuffer.state[own] = FINAL
        framebuffer.error[own] = np.minimum(np.sqrt(square * grey) / shown, 1.0)


def tints_of(light: RotatedLight, gbuffer: GBuffer, tiles: Tiles) -> np.ndarray:
    """What to divide light by, so that colours of the surface do not show in it; (m, 3), never 0.
    Raises Cancelled.
    """
    if not light.coloured:
        return np.ones((len(gbuffer.points), 3), np.float32)
    return np.maximum(light.tints(gbuffer, tiles), BLACK_SHARE)


def times_as_many(found: np.ndarray | float, allowed: np.ndarray | float) -> np.ndarray:
    """How many times as many paths bring a variance that was ``found`` to what is ``allowed``; see
    RATE.
    """
    return np.asarray((found / np.maximum(allowed, 1e-300)) ** (RATE / 2.0))


@dataclass(frozen=True, eq=False)
class Choice:
    """The points at ``places`` (k,), ascending, are to have light of their own whose variances add
    up to ``variance``.

    That is expected to take ``count`` paths of each replica. Texels leave ``errors`` (m,) in the
    luminance of points.
    """

    places: np.ndarray
    variance: float
    count: float
    errors: np.ndarray

    @property
    def paths(self) -> float:
        """Paths of all its points together."""
        return REPLICAS * self.count * len(self.places)


@dataclass(eq=False)
class Growth:
    """The ``light`` that chosen points have so far; ``traced`` counts the paths of what is added to
    it just now.
    """

    choice: Choice
    light: PixelLight
    traced: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.light.nbytes

    @property
    def enough(self) -> bool:
        """Whether the points' noise is as small as it is to be."""
        return bool(self.light.variance.sum() <= self.choice.variance)

    @property
    def has_new(self) -> bool:
        """Whether some of the points have no light of their own yet."""
        return len(self.light.places) < len(self.choice.places)

    @property
    def wanted(self) -> float:
        """Paths of each replica that it will take, by the noise after those that there are."""
        if self.has_new:
            return self.choice.count
        more = float(times_as_many(float(self.light.variance.sum()), self.choice.variance))
        return min(self.light.count * more, MOST_PATHS)

    @property
    def next(self) -> int:
        """Paths of each replica after the next step: twice as many at most, so that little is lost
        with a step.
        """
        before = self.light.count
        if self.has_new:
            return max(before, FIRST_PATHS)
        return min(2 * before, max(math.ceil(self.wanted), before + before // 8))

    @property
    def left(self) -> float:
        """Paths that are left, of all points together."""
        known = len(self.light.places) * self.light.count
        return max(REPLICAS * (self.wanted * len(self.choice.places) - known) - self.traced, 0.0)

    def note(self, paths: int) -> None:
        """Count so many more paths."""
        with self._lock:
            self.traced += paths


def choose_points(
    errors: np.ndarray, variance: np.ndarray, paths: int, own: np.ndarray, allowed: float
) -> Choice:
    """The points that are to have light of their own, so that a picture's mean squared error is
    ``allowed``.

    The points with the largest squared ``errors`` (m,) come first, after those that have their
    ``own``, (k,); so many ``paths`` leave the ``variance`` (m,) of each. What the others err by
    leaves so much to the noise of these: the number of points is that which takes fewest paths.
    """
    rest = np.ones(len(errors), bool)
    rest[own] = False
    others = np.flatnonzero(rest)
    order = np.concatenate([own, others[np.argsort(-errors[others], kind="stable")]])
    left = np.append(errors[order][::-1].cumsum()[::-1], 0.0)[len(own) :]
    room = allowed * len(errors) - left
    noise = (
        FILTERED_VARIANCE_SHARE * np.append(0.0, variance[order].cumsum())[len(own) :] / REPLICAS
    )
    many = np.arange(len(own), len(errors) + 1)
    counts = np.clip(paths * times_as_many(noise, room), FIRST_PATHS, MOST_PATHS)
    costs = np.where(room > 0.0, many * counts, np.inf)
    costs[-1] = many[-1] * counts[-1]  # of all points also where nothing is allowed, as in the dark
    best = int(np.argmin(costs))
    return Choice(
        np.sort(order[: many[best]]), float(room[best]), float(counts[best]), np.sqrt(errors)
    )


SHARES = 64
"""Shares of a picture's points of which the cheapest is foreseen."""


def foreseen_paths(points: int, error: float, target: float, effort: float) -> float:
    """Paths of their own that a picture's ``points`` will take before anything is measured.

    Their errors, whose root mean square is ``error``, are taken to have squares that are
    distributed exponentially: a share x of the points, those that err most, leaves 1 - x + x ln x
    of the sum to the others. To a relative error e a point takes ``effort`` / e^RATE paths.
    """
    share = np.arange(1, SHARES + 1) / SHARES
    variance = (AIM * target) ** 2 - error**2 * (1.0 - share + share * np.log(share))
    taken = share * points * effort * times_as_many(share, variance)
    if error > AIM * target:
        return float(taken[variance > 0.0].min())
    return 0.0
