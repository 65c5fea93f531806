"""Control pixels: measure the total error of a picture by whole paths from a few of its pixels.

From each control pixel two independent halves of paths are traced, whose mean luminances are a and
b; the picture shows the luminance s there. Both halves are unbiased and independent of each other,
so (s - a)(s - b) is an unbiased estimate of the squared error of s, whatever its causes: noise,
interpolation, truncated harmonics, light that leaks, bounces that are cut off. Before a picture has
control pixels, its total error is a prediction.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.pixel_rays import Paths
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.transport import streams
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.volume import Isovalue
from isogi_core.plan.budget import BOUNCES_SHARE, bounces_for
from isogi_core.plan.scene import Scene

CUT = 0.001
"""Share of the light that bounces beyond those of control paths may bring, if the plan chose
the bounces of the scene.
"""


FIRST_CONTROLS = 256
CONTROLS_IF_MISSED = 1024
MAX_CONTROLS = 4096
"""Numbers of controls: of the first round; of all rounds at most if the picture seems to miss its
target; and of all rounds at most if it seems to reach it. More of them are worth their paths then,
as narrowing the interval costs less than better light. Each further round at least doubles them.
"""


EVENLY_DRAWN = 0.5
"""Share of the controls that is drawn evenly from the points of a picture; the others are drawn in
proportion to the uncertainty. Even draws keep each weight below 1 / EVENLY_DRAWN, also if the
uncertainty misses an error.
"""


FEWEST_PATHS = 16
MOST_PATHS = 512
LAST_PATHS = 1 << 14
"""Number of paths of each half: at least and at most when controls are drawn, and the most later.
More than MOST_PATHS are traced if a picture seems to be at its target and the noise of its controls
alone leaves that open.
"""


@dataclass(frozen=True, eq=False)
class ControlPixels:
    """Points of a picture that were drawn at random, and the light of paths from each.

    - ``places`` (k,) int64: rows of the G-buffer's points; a point may be drawn more than once.
    - ``weights`` (k,): importance weights. The mean over the controls of weight · value estimates
      the mean of the value over all points.
    - ``halves`` (k, 2) float64: luminance by each half of the paths.
    """

    places: np.ndarray
    weights: np.ndarray
    halves: np.ndarray

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.places.nbytes + self.weights.nbytes + self.halves.nbytes

    @classmethod
    def none(cls) -> "ControlPixels":
        """Return no controls."""
        return cls(np.empty(0, np.int64), np.empty(0), np.empty((0, 2)))

    def joined(self, other: "ControlPixels") -> "ControlPixels":
        """Concatenate these controls and ``other`` ones of the same picture. The weights stay, as
        each control counts for all points by its chance in the draw that it is from.
        """
        places = np.append(self.places, other.places)
        weights = np.append(self.weights, other.weights)
        return ControlPixels(places, weights, np.concatenate([self.halves, other.halves]))

    def mean(self, shown: np.ndarray, mean: float) -> float:
        """Estimate the true mean luminance of all points, at least 0, from the ``mean`` that the
        picture shows and from the luminance ``shown`` (k,) that it shows at the controls.

        The mean difference between picture and paths at the controls is subtracted: a control
        variate, with less noise than the mean of the paths.
        """
        return max(mean - float((self.weights * (shown - self.halves.mean(axis=1))).mean()), 0.0)

    @property
    def noise(self) -> float:
        """The mean variance of the luminance that one half of the paths gives."""
        return float((self.weights * (self.halves[:, 0] - self.halves[:, 1]) ** 2).mean()) / 2.0

    def deepened(self, halves: np.ndarray) -> "ControlPixels":
        """Return these controls with twice as many paths: the added ones gave the luminance
        ``halves`` (k, 2).
        """
        return ControlPixels(self.places, self.weights, (self.halves + halves) / 2.0)

    def squares(self, shown: np.ndarray) -> np.ndarray:
        """Return an unbiased estimate of the squared error of the luminance ``shown`` (k,) at
        each control; (k,).
        """
        wrong = shown[:, None] - self.halves
        return np.asarray(wrong[:, 0] * wrong[:, 1])


BINS = 8
"""Number of classes of points by their uncertainty; the controls of a class measure its error."""


def classes_of(uncertainty: np.ndarray, controls: ControlPixels) -> np.ndarray:
    """Return the class of each point (m,), from 0, by its ``uncertainty`` (m,), least first.
    Every class has about as many ``controls``.
    """
    edges = np.quantile(uncertainty[controls.places], np.arange(1, BINS) / BINS)
    return np.searchsorted(edges, uncertainty)


def means_of(classes: np.ndarray, controls: ControlPixels, values: np.ndarray) -> np.ndarray:
    """Return the weighted mean of the ``values`` (k,) of the controls in each class; (BINS,)."""
    known = classes[controls.places]
    sums = np.bincount(known, controls.weights * values, BINS)
    return np.asarray(sums / np.maximum(np.bincount(known, controls.weights, BINS), 1e-9))


def squares_of(classes: np.ndarray, controls: ControlPixels, shown: np.ndarray) -> np.ndarray:
    """Return the mean squared error of each class by its controls, at which the picture shows
    the luminance ``shown`` (k,); (BINS,), at least 0.
    """
    return np.maximum(means_of(classes, controls, controls.squares(shown)), 0.0)


def variance_of_halves(uncertainty: np.ndarray, controls: ControlPixels) -> np.ndarray:
    """Estimate the variance of each point's luminance by one half of its paths, from the
    controls of its class; (m,).
    """
    classes = classes_of(uncertainty, controls)
    # The difference of two independent halves has twice the variance of one.
    apart = controls.halves[:, 0] - controls.halves[:, 1]
    return np.asarray(means_of(classes, controls, apart**2 / 2.0)[classes])


def spread_errors(
    uncertainty: np.ndarray, controls: ControlPixels, shown: np.ndarray
) -> np.ndarray:
    """Estimate the error of each point's luminance: the RMS error that controls measure for its
    class, distributed over the points of the class in proportion to their ``uncertainty`` (m,);
    (m,).
    """
    classes = classes_of(uncertainty, controls)
    # Scale the uncertainty so that its mean square in each class is 1.
    counts = np.maximum(np.bincount(classes, minlength=BINS), 1)
    means = np.bincount(classes, uncertainty**2, BINS) / counts
    shares = uncertainty / np.sqrt(np.maximum(means, 1e-300))[classes]
    shares = np.where(means[classes] > 0.0, shares, 1.0)
    return np.asarray(shares * np.sqrt(squares_of(classes, controls, shown))[classes])


def draw_places(
    gbuffer: GBuffer, uncertainty: np.ndarray, key: tuple[int, int], count: int
) -> np.ndarray:
    """Draw ``count`` points of a G-buffer at random, more of them where the picture is uncertain;
    return their rows, (count,) int64.

    Half of them are drawn evenly, the others in proportion to the ``uncertainty`` (m,) of each
    point, a luminance. A control is weighted by 1 / (m · chance), which makes up for its uneven
    ``chances``. The ``key`` seeds the random numbers: a picture gets the same controls again.
    """
    # Sort the points along Morton's curve, so that points near on the curve are near in the
    # picture.
    width = gbuffer.shape[1]
    order = np.argsort(interleaved(gbuffer.pixels % width, gbuffer.pixels // width))
    reached = np.cumsum(chances(uncertainty)[order])
    # Draw one point from each of ``count`` strata of equal chance: the controls cover the whole
    # picture.
    random = np.random.default_rng((streams.CONTROLS_STREAM, *key)).random(count)
    strata = (np.arange(count) + random) / count
    drawn = np.searchsorted(reached, strata * reached[-1])
    return np.asarray(order[np.minimum(drawn, len(order) - 1)])


def chances(uncertainty: np.ndarray) -> np.ndarray:
    """Return the chance of each point to be drawn, by its ``uncertainty``; (m,), of the sum 1."""
    total = float(uncertainty.sum())
    count = len(uncertainty)
    if total > 0.0:
        uneven = uncertainty / total
    else:
        uneven = np.full(count, 1.0 / count)
    return np.asarray(EVENLY_DRAWN / count + (1.0 - EVENLY_DRAWN) * uneven)


def interleaved(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return places along Morton's curve of pixels at ``x`` and ``y``, (m,) uint32 each; (m,)
    uint64.
    """
    spread = [spread_bits(each.astype(np.uint64)) for each in (x, y)]
    return np.asarray(spread[0] | spread[1] << np.uint64(1))


def spread_bits(words: np.ndarray) -> np.ndarray:
    """Insert a zero after each of the low 16 bits of ``words``."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        words = (words | words << np.uint64(shift)) & np.uint64(mask)
    return words


def paths_for(target: float) -> int:
    """Return the number of paths of each half of a control, for a picture with an error of
    about ``target``: a power of two, at which the noise of a control is of about that size,
    too.
    """
    return int(np.clip(2 ** math.ceil(math.log2(8.0 / target)), FEWEST_PATHS, MOST_PATHS))


def first_controls(target: float) -> float:
    """Return the number of paths of the first controls, both halves together, of a picture with
    an error of about ``target``.
    """
    return 2.0 * paths_for(target) * FIRST_CONTROLS


def trace_controls(
    light: RotatedLight,
    gbuffer: GBuffer,
    places: np.ndarray,
    span: tuple[int, int],
    stream: int,
    tiles: Tiles,
) -> np.ndarray:
    """Trace two halves of paths from the points in rows ``places`` (k,); return their luminance,
    (k, 2). ``span`` is the number of paths of each half that were traced before, and the number
    to trace.

    The halves take the random sequences 2 · ``stream`` and 2 · ``stream`` + 1 of controls, so they
    are independent of each other and of the light that the picture shows. Raises Cancelled.
    """
    first, paths = span
    # A point that was drawn more than once is traced once: it would draw the same random numbers.
    distinct, rows = np.unique(places, return_inverse=True)
    sums = np.zeros((len(distinct), 2, 3))
    paths_of_truth(light, gbuffer, distinct, tiles).add(
        sums, streams.CONTROLS_STREAM + 2 * stream, first, paths
    )
    return np.asarray((sums @ LUMINANCE_WEIGHTS / paths)[rows])


def paths_of_truth(
    light: RotatedLight, gbuffer: GBuffer, places: np.ndarray, tiles: Tiles
) -> Paths:
    """Return the paths from the points of a G-buffer in rows ``places``, with as many bounces as
    matter. Raises Cancelled.
    """
    return Paths(light, gbuffer.part(places, tiles), tiles, bounces_of_truth(light))


def bounces_of_truth(light: RotatedLight) -> int:
    """Return the number of bounces of control paths: those cut off would bring at most the
    share CUT of the light. If the scene gives the number of bounces itself, return that.
    """
    plan = light.spec.prepared.scene.plan
    # A plan that chose the bounces lists the error of those cut off. ``bounces_for`` keeps within
    # BOUNCES_SHARE of the error that it is given; dividing by it leaves CUT.
    if "bounces" in dict(plan.errors):
        return max(bounces_for(light.reflecting, CUT / BOUNCES_SHARE), plan.bounces)
    return plan.bounces


CONTROL_STANDARD_ERRORS = 2.2
"""Standard errors from the middle to either end of a 95 % interval, more than the 1.96 of a normal
distribution: with these, intervals of 256 controls of seven views held the truth in 86 to 95 % of
the cases.
"""


NOISE_FACTOR = 1.3
"""Largest ratio of the true noise to its estimate, in 95 % of the frames: it is 0.7 to 1.4 in
99 %, and its logarithm is about normal.
"""


FARTHEST = 20.0
"""Limit of the logarithm of an interval's half width."""


@dataclass(frozen=True)
class TotalError:
    """The relative RMSE of a picture's luminance over its surface: the ``likely`` value, and the 95
    % interval from ``low`` to ``high``.

    ``controls`` is the number of control pixels that measured it; 0 for a prediction.
    """

    likely: float
    low: float
    high: float
    controls: int = 0

    def at_least(self, noise: float) -> "TotalError":
        """Return this error, raised to the ``noise`` of the picture if it is smaller: the noise is
        a part of the total error, but few control pixels may miss it by chance.
        """
        if noise <= self.likely:
            return self
        # The noise is an estimate, too. Its upper end is as far above it as that of the controls is
        # above their middle, in proportion, but no farther than NOISE_FACTOR.
        if self.likely > 0.0:
            factor = min(self.high / self.likely, NOISE_FACTOR)
        else:
            factor = NOISE_FACTOR
        return replace(self, likely=noise, high=max(self.high, min(factor * noise, 1.0)))

    @property
    def predicted(self) -> bool:
        """True if no control pixel measured it."""
        return self.controls == 0


def measure_total(squares: np.ndarray, mean: float) -> TotalError:
    """Return the total error by the weighted squared errors ``squares`` (k,) of control pixels,
    relative to the true ``mean`` luminance; all of it is between 0 and 1.
    """
    count = len(squares)
    square = float(squares.mean())
    spread = float(squares.std()) / math.sqrt(count)
    # In the dark any error is as large as can be.
    if mean <= 0.0:
        worst = float(squares.any())
        return TotalError(worst, worst, worst, count)
    # A few large errors make most of the mean, so the interval is symmetric about its logarithm.
    # Estimates of squares may be negative; if their mean is, only its standard error is known.
    if square > 0.0:
        factor = math.exp(min(CONTROL_STANDARD_ERRORS * spread / square, FARTHEST))
        ends = (square / factor, square, square * factor)
    else:
        ends = (square, square, CONTROL_STANDARD_ERRORS * spread)
    low, likely, high = (min(math.sqrt(max(each, 0.0)) / mean, 1.0) for each in ends)
    return TotalError(likely, low, high, count)


def planned_error(scene: Scene) -> float:
    """Return the relative error besides noise that the plan of a ``scene`` expects."""
    return math.hypot(*(error for _, error in scene.plan.errors))


def expected_error(scene: Scene, isovalue: Isovalue) -> float:
    """Return the relative error besides noise that is expected at an ``isovalue``: by the plan
    of the ``scene``, and by the survey of its volume.
    """
    surveyed = scene.projection
    return math.hypot(min(surveyed.error(isovalue), surveyed.allowed), planned_error(scene))


def predict_total(noise: float, expected: float) -> TotalError:
    """Return the total error of a frame with this ``noise`` and an ``expected`` error besides."""
    return TotalError(min(math.hypot(noise, expected), 1.0), noise, 1.0)
