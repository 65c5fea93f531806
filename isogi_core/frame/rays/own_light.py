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

import numpy as np

from isogi_core.bake.noise import RATE
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import bounces_of_truth
from isogi_core.frame.rays.pixel_filter import NoisyPixels, correct, filter_pixels
from isogi_core.frame.rays.pixel_rays import Paths, pooled_variance, variance_of_mean
from isogi_core.frame.rays.point_paths import Estimate
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.shading.lattice import MIN_LIGHT
from isogi_core.kernels.transport import streams
from isogi_core.model.environment import LUMINANCE_WEIGHTS

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
