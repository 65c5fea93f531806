"""Light of pixels' own: choose the pixels that get light from paths of their own, trace it, and
write it into the picture.

The pixels whose texels have the largest errors get it. Their number is the one at which the
picture's error comes to its target with the fewest paths; if few others are left, all get it.
Traced light is filtered; see ``pixel_filter``.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from isogi_core.bake.noise import RATE
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import paths_of_truth
from isogi_core.frame.rays.pixel_filter import (
    NoisyPixels,
    Surroundings,
    correct,
    filter_pixels,
)
from isogi_core.frame.rays.pixel_rays import Paths, pooled_variance, variance_of_mean
from isogi_core.frame.rays.point_paths import Estimate
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.shading.lattice import MIN_LIGHT
from isogi_core.kernels.transport import streams
from isogi_core.model.environment import LUMINANCE_WEIGHTS

REPLICAS = 2
FIRST_PATHS = 32
"""Number of independent randomisations of each pixel, and paths of each after the first step.

Fewer are longer sequences, with less noise: at 256 paths of a pixel, two have 0.91 to 0.96 times
the filtered error of four (engine under grace, CT head and heptane under uffizi, carp under
noon_grass), and neighbours show their noise as well.
"""


FIRST_SHOWN_PATHS = 8
SHOWN_FACTOR = 4
"""Paths of each replica after the first step of a picture that paths alone light, and the factor on
them in each further step.
"""


CONTRASTS = np.array([[1.0, -1.0]])
"""Weights of the replicas in each probe, times their number: of the same size as in the mean,
with signs that make the probe independent of it.
"""


MOST_PATHS = 1 << 15
"""Paths of each replica, at most: 65,536 from a pixel."""


FILTERED_VARIANCE_SHARE = 0.7
"""Share of the variance of traced light that filtering leaves: 0.46 to 0.9, as there is most of it
at edges.

Correcting the light of texels leaves 0.3 to 1 of that: all of it if texels are much noisier, so
that no gain is counted on.
"""


MOST_AHEAD = 4.0
LEAST_MORE = 1.25
"""Largest ratio of the paths of points that began without light to those of points with light of
other views, before these take more paths, too; and the least factor on the paths of these, once
they take more.
"""


BLACK_SHARE = 1e-3
"""Share of the brightest albedo below which a surface counts as black."""


RIM = (2.0 / 3.0, 1.0 / 3.0)
"""Shares of traced light that are shown in the pixels next to those that were chosen, and in the
pixels beyond: it fades out to the light of texels, and no border shows.
"""


FEW_LEFT = 1.0 / 6.0
"""Share of a picture's points below which those that neither were chosen nor are in a rim are
chosen, too: at most a fifth more paths, and no border is left.
"""


SAME_SURFACE = 0.01
"""Least weight of the pixels around one at which it counts as next to them on one surface."""


AIM = 0.85
"""Share of the target error that is aimed at, as the interval of the measured error has some
width.
"""


AIM_OF_PATHS = 0.75
"""Share of the target error that the noise of a picture by paths alone may have. The filter of
pixels adds 0.5 to 0.7 of the noise as a bias.
"""


PATHS_RATE = (RATE + 2.0) / 2.0
"""Exponent of paths over error, as predicted for pixels from a few controls: between RATE, as of
points in strata, and 2, as of light that few paths find.
"""


@dataclass(frozen=True, eq=False)
class PixelLight:
    """Light of k surface points that was traced for them.

    - ``places`` (k,): rows of the points, ascending.
    - ``estimate``: sums of REPLICAS replicas of paths. Points have different numbers of paths if
      some began with light: see ``Growth``.
    - ``light`` (k, 3): linear RGB that they show, filtered.
    - ``variance`` (k,): variance of its luminance.
    - ``probes`` (k, contrasts): luminances with the distribution of its noise.
    - ``expected`` (m,): expected error of the texels' luminance at all points of the picture.
    - ``shares`` (k,): shares of the light that are shown, or one number for all points.
    """

    places: np.ndarray
    estimate: Estimate
    light: np.ndarray
    variance: np.ndarray
    probes: np.ndarray
    expected: np.ndarray
    shares: np.ndarray | float = 1.0

    @classmethod
    def none(cls) -> "PixelLight":
        """Return light of no points."""
        empty = Estimate.none(0, REPLICAS)
        probes = np.empty((0, len(CONTRASTS)))
        return cls(np.empty(0, np.int64), empty, np.empty((0, 3)), np.empty(0), probes, np.empty(0))

    @classmethod
    def of(
        cls,
        places: np.ndarray,
        estimate: Estimate,
        paths: Paths,
        expected: np.ndarray,
        shares: np.ndarray | float = 1.0,
    ) -> "PixelLight":
        """Return the light of the points of ``paths`` by an ``estimate``, filtered, of which
        ``shares`` are shown. Raises Cancelled.
        """
        means = estimate.means
        gbuffer = paths.gbuffer
        tiles = paths.tiles
        # Divide by the colours of the surface, which the filter must not blur.
        tints = tints_of(paths.light, gbuffer, tiles)
        grey = (tints @ LUMINANCE_WEIGHTS) ** 2
        variance = pooled_variance(variance_of_mean(means), gbuffer)
        bare = means / tints[:, None]
        # Filter the probes along with the light, so that they keep the distribution of its noise.
        probes = bare @ LUMINANCE_WEIGHTS @ CONTRASTS.T / REPLICAS
        found = np.column_stack([bare.mean(axis=1), probes])
        found, variance = filter_pixels(found, variance / grey, gbuffer, tiles)
        light = found[:, :3] * tints
        probes = found[:, 3:] * np.sqrt(grey)[:, None]
        return cls(places, estimate, light, variance * grey, probes, expected, shares)

    @property
    def count(self) -> int:
        """The largest number of paths of each replica from any point."""
        return self.estimate.most

    @property
    def paths(self) -> int:
        """The number of paths of all points together."""
        return REPLICAS * int(self.estimate.counts.sum())

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        arrays = (self.places, self.light, self.variance, self.probes, self.expected)
        return self.estimate.nbytes + sum(each.nbytes for each in arrays)

    def grown(
        self,
        choice: "Choice",
        wanted: np.ndarray,
        light: RotatedLight,
        gbuffer: GBuffer,
        tiles: Tiles,
        progress: Callable[[int], object] | None = None,
    ) -> "PixelLight":
        """Return the light of the points of a ``choice`` once each replica has the ``wanted`` (k,)
        numbers of paths; paths that were traced before are kept. Raises Cancelled.

        ``progress`` is called with the number of paths that each piece traced.
        """
        places = choice.places
        # Expected errors of known points are those from before they had light of their own.
        expected = choice.errors.copy()
        expected[self.places] = self.expected[self.places]
        paths = paths_of_truth(light, gbuffer, places, tiles)
        estimate = Estimate.none(len(places), REPLICAS)
        known = np.isin(places, self.places, assume_unique=True)
        kept = np.isin(self.places, places, assume_unique=True)
        estimate.sums[known] = self.estimate.sums[kept]
        estimate.counts[known] = self.estimate.counts[kept]
        # Points that join have no paths yet: trace together those that have the same number of
        # paths, and are to have the same number.
        spans = estimate.counts * (MOST_PATHS + 1) + wanted
        for span in np.unique(spans[wanted > estimate.counts]).tolist():
            first, last = divmod(span, MOST_PATHS + 1)
            rows = np.flatnonzero(spans == span)
            some = estimate.sums[rows]
            paths.of(rows).add(some, streams.PIXEL_LIGHT_STREAM, first, last - first, progress)
            estimate.sums[rows] = some
            estimate.counts[rows] = last
        return PixelLight.of(places, estimate, paths, expected, choice.shares)

    def without(
        self, rows: np.ndarray, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles
    ) -> "PixelLight":
        """Return this light without the points in some ``rows`` of a G-buffer; the others keep
        their paths. It is filtered anew, as the filter had mixed in light of the points that are
        gone. Raises Cancelled.
        """
        kept = ~np.isin(self.places, rows, assume_unique=True)
        if not kept.any():
            return PixelLight.none()
        places = self.places[kept]
        paths = paths_of_truth(light, gbuffer, places, tiles)
        shares = np.broadcast_to(self.shares, self.places.shape)[kept]
        return PixelLight.of(places, self.estimate.part(kept), paths, self.expected, shares)

    def put(
        self, framebuffer: Framebuffer, gbuffer: GBuffer, light: RotatedLight, tiles: Tiles
    ) -> None:
        """Write the light into a picture of a G-buffer that shows the light of texels, and correct
        the pixels around it by the difference of the two.

        Pixels with traced light become final; the others keep their states and errors. Raises
        Cancelled.
        """
        if not len(self.places):
            return
        pixels = gbuffer.pixels
        traced = gbuffer.pixels[self.places]
        # Divide all light by the colours of the surface, correct it, and multiply again: neighbours
        # share corrections, which must not carry colours along. Variances of luminance are divided
        # by the squared luminance of the colour, as if the light were grey.
        tints = tints_of(light, gbuffer, tiles)
        some = tints[self.places]
        grey = (some @ LUMINANCE_WEIGHTS) ** 2
        light_of_pixels = NoisyPixels(
            self.light / some, self.variance / grey, self.probes / np.sqrt(grey)[:, None]
        )
        expected = self.expected / (tints @ LUMINANCE_WEIGHTS)
        texels = framebuffer.radiance[pixels] / tints
        corrected, square = correct(
            texels, expected, self.places, light_of_pixels, gbuffer, tiles, self.shares
        )
        framebuffer.radiance[pixels] = np.clip(corrected * tints, 0.0, np.finfo(np.float32).max)
        # Pixels with traced light are final, with the error of the mixture.
        settle(framebuffer, traced, square * grey, light)

    def show(self, framebuffer: Framebuffer, gbuffer: GBuffer, light: RotatedLight) -> None:
        """Write the light into a picture of a G-buffer as it is, without any light of texels. Its
        pixels become final.
        """
        traced = gbuffer.pixels[self.places]
        framebuffer.radiance[traced] = np.clip(self.light, 0.0, np.finfo(np.float32).max)
        settle(framebuffer, traced, self.variance, light)


def settle(
    framebuffer: Framebuffer, pixels: np.ndarray, square: np.ndarray, light: RotatedLight
) -> None:
    """Make ``pixels`` (k,) of a picture final, whose luminance has the mean squared errors
    ``square`` (k,).
    """
    shown = np.maximum(
        framebuffer.radiance[pixels] @ LUMINANCE_WEIGHTS, MIN_LIGHT * light.spec.unit
    )
    framebuffer.state[pixels] = FINAL
    framebuffer.error[pixels] = np.minimum(np.sqrt(square) / shown, 1.0)


def tints_of(light: RotatedLight, gbuffer: GBuffer, tiles: Tiles) -> np.ndarray:
    """Return the factors (m, 3), never 0, by which light is divided so that colours of the
    surface do not show in it. Raises Cancelled.
    """
    if not light.coloured:
        return np.ones((len(gbuffer.points), 3), np.float32)
    return np.maximum(light.tints(gbuffer, tiles), BLACK_SHARE)


def times_as_many(found: np.ndarray | float, allowed: np.ndarray | float) -> np.ndarray:
    """Return the factor on the number of paths that brings a variance from ``found`` to
    ``allowed``: paths grow with 1 / error^RATE.
    """
    return np.asarray((found / np.maximum(allowed, 1e-300)) ** (RATE / 2.0))


@dataclass(frozen=True, eq=False)
class Choice:
    """The points at ``places`` (k,), ascending, that are to have light of their own.

    - ``variance``: sum of their variances that is to be reached, unless ``noise`` is given.
    - ``count``: paths of each replica which that is expected to take.
    - ``errors`` (m,): expected error of the texels' luminance at all points.
    - ``shares`` (k,): shares of their light that are to be shown, or one number for all.
    - ``noise``: root mean square of their noise that is to be reached, relative to their mean
      luminance; None if that is the ``variance``.
    """

    places: np.ndarray
    variance: float
    count: float
    errors: np.ndarray
    shares: np.ndarray | float = 1.0
    noise: float | None = None

    def allowed(self, light: "PixelLight") -> float:
        """Return the sum of variances that the ``light`` of its points is to reach."""
        if self.noise is None:
            return self.variance
        # The light itself tells the mean luminance of the picture better than a few controls.
        mean = float((light.light @ LUMINANCE_WEIGHTS).mean())
        return len(light.places) * (self.noise * mean) ** 2

    @property
    def paths(self) -> float:
        """The number of paths of all its points together."""
        return REPLICAS * self.count * len(self.places)

    def with_rim(self, gbuffer: GBuffer, tiles: Tiles) -> "Choice":
        """Return the choice with the pixels of a G-buffer around the chosen ones, in which traced
        light fades out; with all pixels, if that leaves few. Raises Cancelled.
        """
        around = Surroundings(gbuffer, tiles)
        none = np.zeros(len(self.errors))
        shares = none.copy()
        shares[self.places] = 1.0
        # Add the neighbours of all pixels that have a share so far, ring after ring.
        for share in RIM:
            near, _ = around.means((shares > 0.0)[:, None].astype(float), none)
            shares[(shares == 0.0) & (near[:, 0] > SAME_SURFACE)] = share
        # A few pixels that are left out would be islands. Errors of dark ones hardly count in the
        # error of the picture, and are seen beside their neighbours.
        if np.count_nonzero(shares == 0.0) < FEW_LEFT * len(shares):
            shares[:] = 1.0
        # A pixel that shows the share s of traced light keeps the share 1 - s of its texels' error,
        # and (1 - s)² of the square. The squared error that is gone from those that were not chosen
        # leaves as much room for noise.
        removed = self.errors**2 * shares * (2.0 - shares)
        removed[self.places] = 0.0
        room = self.variance + float(removed.sum())
        places = np.flatnonzero(shares)
        return replace(self, places=places, variance=room, shares=shares[places])


@dataclass(eq=False)
class Growth:
    """The ``light`` that the points of a ``choice`` have so far.

    - ``earlier`` (j,): rows of the points with light of other views, or of an earlier growth: they
      take more paths only if the others cannot make up for their noise.
    - ``shown``: True if the picture shows the light of each step. It has no other light then, so
      that the first step is a short one; and there are few steps, as each costs a picture.
    - ``traced``: number of paths of the step that is under way.
    """

    choice: Choice
    light: PixelLight
    shown: bool = False
    earlier: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    traced: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.light.nbytes

    @property
    def enough(self) -> bool:
        """True if the noise of the points is as small as the choice asks."""
        return bool(self.light.variance.sum() <= self.choice.allowed(self.light))

    @property
    def has_new(self) -> bool:
        """True if some of the points have no light yet."""
        return len(self.light.places) < len(self.choice.places)

    @property
    def _began_with_light(self) -> np.ndarray:
        """Marks (k,) of the ``earlier`` points."""
        return np.isin(self.light.places, self.earlier, assume_unique=True)

    @property
    def _wanted(self) -> np.ndarray:
        """Paths of each replica of each point with light that are needed in all, predicted from the
        noise of those traced so far; (k,).

        If there are ``earlier`` points, all others alone grow: light from other views came by other
        random numbers, so that a few paths more hardly reduce its noise. All points grow if the
        others would take more than MOST_AHEAD times as many paths.
        """
        counts = self.light.estimate.counts
        variance = self.light.variance
        began = self._began_with_light
        allowed = self.choice.allowed(self.light)
        if began.any() and not began.all():
            # Earlier points leave ``room`` for the noise of the new ones. These must not need too
            # many paths to fit; with MOST_PATHS they cannot grow at all.
            room = allowed - float(variance[began].sum())
            most = min(MOST_AHEAD * float(counts[began].mean()), MOST_PATHS - 1)
            if room > 0.0:
                new = float(counts[~began].mean())
                wanted = new * float(times_as_many(float(variance[~began].sum()), room))
                if wanted <= most:
                    return np.where(began, counts, wanted)
        more = float(times_as_many(float(variance.sum()), allowed))
        if began.any():
            more = max(more, LEAST_MORE)
        return np.minimum(counts * more, MOST_PATHS)

    @property
    def next(self) -> np.ndarray:
        """Paths of each replica of each point of the choice after the next step; (k,) int64.

        Points without light come first: they get as many paths as the others have, in several
        steps if each is shown. Then paths grow to the number that is wanted, but at most to twice
        as many, so that a cancelled step loses little, and at least by an eighth, so that few steps
        are needed. If each step is shown, they grow faster. No point gets more than MOST_PATHS.
        """
        counts = self.light.estimate.counts
        if self.has_new:
            return self._with_first_paths
        factor = SHOWN_FACTOR if self.shown else 2
        began = self._began_with_light
        # New points catch up with the earlier ones.
        if began.any() and not began.all():
            new = int(counts[~began].min())
            others = int(counts[began].mean())
            if new < others:
                return np.where(began, counts, np.maximum(counts, min(factor * new, others)))
        # Points that want no more paths keep those they have, unless that is so of all.
        wanted = np.ceil(self._wanted).astype(np.int64)
        growing = wanted > counts
        if not growing.any():
            growing[:] = True
        least = counts + np.maximum(counts // 8, 1)
        after = np.minimum(np.maximum(wanted, least), np.minimum(factor * counts, MOST_PATHS))
        return np.where(growing, after, counts)

    @property
    def _with_first_paths(self) -> np.ndarray:
        """Paths of each replica of each point of the choice once those without light have some;
        (k,) int64. Points with light keep the paths that they have.
        """
        if self.shown:
            first = FIRST_SHOWN_PATHS
        else:
            counts = self.light.estimate.counts
            first = max(int(counts.mean()) if len(counts) else 0, FIRST_PATHS)
        after = np.full(len(self.choice.places), first, np.int64)
        known = np.isin(self.choice.places, self.light.places, assume_unique=True)
        kept = np.isin(self.light.places, self.choice.places, assume_unique=True)
        after[known] = self.light.estimate.counts[kept]
        return after

    @property
    def exhausted(self) -> bool:
        """True if all points have as many paths as they may."""
        return not self.has_new and self.light.estimate.fewest >= MOST_PATHS

    @property
    def left(self) -> float:
        """Paths that remain to be traced, of all points together."""
        counts = self.light.estimate.counts
        if self.has_new:
            new = len(self.choice.places) - len(self.light.places)
            others = counts[~self._began_with_light]
            paths = self.choice.count * new + float((self.choice.count - others).clip(0.0).sum())
        else:
            paths = float((self._wanted - counts).clip(0.0).sum())
        return max(REPLICAS * paths - self.traced, 0.0)

    def note(self, paths: int) -> None:
        """Count more ``paths`` as traced. Called from several threads."""
        with self._lock:
            self.traced += paths


def choose_points(
    errors: np.ndarray, variance: np.ndarray, paths: int, own: np.ndarray, allowed: float
) -> Choice:
    """Choose the points that are to have light of their own, so that the mean squared error of a
    picture becomes ``allowed`` with the fewest paths.

    - ``errors`` (m,): squared error of each point by its texels.
    - ``variance`` (m,): variance of each point's luminance after ``paths`` paths.
    - ``own`` (k,): rows of the points that have such light already; they keep it.
    """
    # Points with the largest errors come first, after those that have light already.
    is_other = np.ones(len(errors), bool)
    is_other[own] = False
    others = np.flatnonzero(is_other)
    order = np.concatenate([own, others[np.argsort(-errors[others], kind="stable")]])
    # For each number of points, the errors of all others leave ``room`` for the noise of the chosen
    # ones. The more points are chosen, the fewer paths each needs.
    left = np.append(errors[order][::-1].cumsum()[::-1], 0.0)[len(own) :]
    room = allowed * len(errors) - left
    variances = np.append(0.0, variance[order].cumsum())[len(own) :]
    noise = FILTERED_VARIANCE_SHARE * variances / REPLICAS
    many = np.arange(len(own), len(errors) + 1)
    counts = np.clip(paths * times_as_many(noise, room), FIRST_PATHS, MOST_PATHS)
    # Take the number of points with the smallest product of points and paths.
    costs = np.where(room > 0.0, many * counts, np.inf)
    # All points are a choice even if no error is allowed, as in the dark.
    costs[-1] = many[-1] * counts[-1]
    best = int(np.argmin(costs))
    places = np.sort(order[: many[best]])
    return Choice(places, float(room[best]), float(counts[best]), np.sqrt(errors))


def all_points(points: int, error: float, target: float, mean: float, effort: float) -> Choice:
    """Choose all ``points`` of a picture, to bring its noise to AIM_OF_PATHS times the ``target``
    by paths alone.

    ``mean`` is the luminance of the picture, ``error`` the relative error that is expected of its
    texels. A point takes ``effort`` / e^PATHS_RATE paths to a relative error e.
    """
    variance = points * (AIM_OF_PATHS * target * mean) ** 2
    count = max(paths_alone(1, effort, target) / REPLICAS, 1.0)
    errors = np.full(points, error * mean)
    return Choice(np.arange(points), variance, count, errors, noise=AIM_OF_PATHS * target)


def paths_alone(points: int, effort: float, target: float) -> float:
    """Return the number of paths that bring the noise of ``points`` points of a picture to
    AIM_OF_PATHS times the ``target``. A point takes ``effort`` / e^PATHS_RATE paths to a relative
    error e.
    """
    return points * effort / (AIM_OF_PATHS * target) ** PATHS_RATE


SHARES = 64
"""Number of shares of a picture's points that are tried to foresee the cheapest."""


def foreseen_paths(points: int, error: float, target: float, effort: float) -> float:
    """Predict the paths that pixels of a picture with ``points`` points will need for light of
    their own, before anything is measured.

    The squares of their errors, whose root mean square is ``error``, are taken to be exponentially
    distributed: the share x of the points with the largest errors leaves 1 - x + x ln x of the sum
    to the others. A point takes ``effort`` / e^RATE paths to a relative error e, and at least the
    first ones.
    """
    # The target leaves some variance to the chosen points of each share, none if it is too small.
    share = np.arange(1, SHARES + 1) / SHARES
    variance = (AIM * target) ** 2 - error**2 * (1.0 - share + share * np.log(share))
    each = np.maximum(effort * times_as_many(share, variance), REPLICAS * FIRST_PATHS)
    taken = share * points * each
    if error > AIM * target:
        return float(taken[variance > 0.0].min())
    return 0.0
