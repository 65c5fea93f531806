"""Control pixels: whole paths from a few pixels measure the error of a picture, and the tail of its
errors.

A control pixel has two independent halves of paths, a and b, beside the light s that the picture
shows. As both halves are right on the average and independent of each other, (s - a)(s - b) is
right on the average for the squared error of s, whatever its causes: noise, interpolation,
harmonics, light that leaks, bounces that are cut off. Before there are controls the total is a
prediction.

The tail of a picture's errors: the error that 99 % of its pixels stay below, by control pixels. A
control shows an error that is part noise of its own paths. The distribution of the errors without
that noise is what makes all controls together most likely (Laird, Journal of the American
Statistical Association 73, 1978, by expectation maximisation), where what is expected counts as
some controls do (Dempster, Laird and Rubin, Journal of the Royal Statistical Society B 39, 1977,
section 1): pixels err normally, as the controls of their class do, or by anything, for some err far
more than their class. Few controls lie in the tail, each with a weight: the share of pixels above
an error has a gamma interval (Fay and Feuer, Statistics in Medicine 16, 1997, with the mean weight
of Tiwari, Clegg and Zou, Statistical Methods in Medical Research 15, 2006). The errors at which the
ends of that interval come down to 1 % are the interval of the percentile (Woodruff, Journal of the
American Statistical Association 47, 1952).
"""

import math
from dataclasses import dataclass, replace
from functools import cache

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
"""Share of the light that bounces beyond those of control paths may bring, where the plan chose the
bounces.
"""

FIRST_CONTROLS = 256
CONTROLS_IF_MISSED = 1024
MAX_CONTROLS = 4096
"""Pixels of the first round of controls; of all rounds of a picture that seems to miss its target,
and of one that seems to reach it, whose interval costs less to narrow than better light. Each
further round doubles what there is.
"""

EVENLY_DRAWN = 0.5
"""Share of the controls that is drawn evenly from the picture; the others where it is uncertain."""

FEWEST_PATHS = 16
MOST_PATHS = 512
LAST_PATHS = 1 << 14
"""Paths of each half, at least and at most, when controls are drawn; and at most once as many
controls as there may be show a picture at its target, and their noise alone leaves that open.
"""


@dataclass(frozen=True, eq=False)
class ControlPixels:
    """Points of a view that were drawn at random, and what paths from each brought.

    ``places`` (k,) int64 are rows of the G-buffer's points, ``weights`` (k,) over k what each
    counts in a mean over all points, and ``halves`` (k, 2) float64 the luminance by either half.
    """

    places: np.ndarray
    weights: np.ndarray
    halves: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that they take."""
        return self.places.nbytes + self.weights.nbytes + self.halves.nbytes

    @classmethod
    def none(cls) -> "ControlPixels":
        """No controls."""
        return cls(np.empty(0, np.int64), np.empty(0), np.empty((0, 2)))

    def joined(self, other: "ControlPixels") -> "ControlPixels":
        """The controls and ``other`` ones of the same picture."""
        places = np.append(self.places, other.places)
        weights = np.append(self.weights, other.weights)
        return ControlPixels(places, weights, np.concatenate([self.halves, other.halves]))

    def mean(self, shown: np.ndarray, mean: float) -> float:
        """The true mean luminance of all points, at least 0: the picture's ``mean`` less what
        controls find too much.

        The picture shows the luminance ``shown`` (k,) at the controls.
        """
        return max(mean - float((self.weights * (shown - self.halves.mean(axis=1))).mean()), 0.0)

    @property
    def noise(self) -> float:
        """The mean variance of the luminance by a half of the paths."""
        return float((self.weights * (self.halves[:, 0] - self.halves[:, 1]) ** 2).mean()) / 2.0

    def deepened(self, halves: np.ndarray) -> "ControlPixels":
        """Controls of the same points by twice as many paths, of which those added brought the
        luminance ``halves`` (k, 2).
        """
        return ControlPixels(self.places, self.weights, (self.halves + halves) / 2.0)

    def squares(self, shown: np.ndarray) -> np.ndarray:
        """The squared error of each control's luminance, ``shown`` (k,), right on the average;
        (k,).
        """
        wrong = shown[:, None] - self.halves
        return np.asarray(wrong[:, 0] * wrong[:, 1])


BINS = 8
"""Classes of points by how uncertain they are; what each errs by is measured by its controls."""


def classes_of(uncertainty: np.ndarray, controls: ControlPixels) -> np.ndarray:
    """The class of each point (m,) by its ``uncertainty``, least first, with as many ``controls``
    in each; (m,).
    """
    edges = np.quantile(uncertainty[controls.places], np.arange(1, BINS) / BINS)
    return np.searchsorted(edges, uncertainty)


def means_of(classes: np.ndarray, controls: ControlPixels, values: np.ndarray) -> np.ndarray:
    """The mean of each class of points by the ``values`` (k,) at its controls; (BINS,)."""
    known = classes[controls.places]
    sums = np.bincount(known, controls.weights * values, BINS)
    return np.asarray(sums / np.maximum(np.bincount(known, controls.weights, BINS), 1e-9))


def squares_of(classes: np.ndarray, controls: ControlPixels, shown: np.ndarray) -> np.ndarray:
    """The mean squared error of each class by its controls, whose luminance is ``shown`` (k,);
    (BINS,), at least 0.
    """
    return np.maximum(means_of(classes, controls, controls.squares(shown)), 0.0)


def variance_of_halves(uncertainty: np.ndarray, controls: ControlPixels) -> np.ndarray:
    """The variance of each point's luminance by a half of its paths, as the controls of its class
    show it; (m,).
    """
    classes = classes_of(uncertainty, controls)
    apart = controls.halves[:, 0] - controls.halves[:, 1]
    return np.asarray(means_of(classes, controls, apart**2 / 2.0)[classes])


def spread_errors(
    uncertainty: np.ndarray, controls: ControlPixels, shown: np.ndarray
) -> np.ndarray:
    """The error of each point's luminance: what its class errs by, shared out by the
    ``uncertainty`` (m,); (m,).
    """
    classes = classes_of(uncertainty, controls)
    means = np.bincount(classes, uncertainty**2, BINS) / np.maximum(
        np.bincount(classes, minlength=BINS), 1
    )
    shares = uncertainty / np.sqrt(np.maximum(means, 1e-300))[classes]
    return np.asarray(
        np.where(means[classes] > 0.0, shares, 1.0)
        * np.sqrt(squares_of(classes, controls, shown))[classes]
    )


def draw_places(
    gbuffer: GBuffer, uncertainty: np.ndarray, key: tuple[int, int], count: int
) -> np.ndarray:
    """Rows of ``count`` points, drawn in strata along a curve that fills the picture, more where it
    is uncertain.

    Half of them are drawn evenly, the others by the ``uncertainty`` (m,) of each point; random
    numbers follow from the ``key``. Returns rows (count,) int64.
    """
    order = np.argsort(
        interleaved(gbuffer.pixels % gbuffer.shape[1], gbuffer.pixels // gbuffer.shape[1])
    )
    reached = np.cumsum(chances(uncertainty)[order])
    strata = (
        np.arange(count) + np.random.default_rng((streams.CONTROLS_STREAM, *key)).random(count)
    ) / count
    return np.asarray(
        order[np.minimum(np.searchsorted(reached, strata * reached[-1]), len(order) - 1)]
    )


def chances(uncertainty: np.ndarray) -> np.ndarray:
    """The chance of each point (m,) to be drawn."""
    total = float(uncertainty.sum())
    if total > 0.0:
        uneven = uncertainty / total
    else:
        uneven = np.full(len(uncertainty), 1.0 / len(uncertainty))
    return np.asarray(EVENLY_DRAWN / len(uncertainty) + (1.0 - EVENLY_DRAWN) * uneven)


def interleaved(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Numbers along Morton's curve of pixels (m,) uint32; (m,) uint64."""
    spread = [spread_bits(each.astype(np.uint64)) for each in (x, y)]
    return np.asarray(spread[0] | spread[1] << np.uint64(1))


def spread_bits(words: np.ndarray) -> np.ndarray:
    """The low 16 bits of words with a zero after each."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        words = (words | words << np.uint64(shift)) & np.uint64(mask)
    return words


def paths_for(target: float) -> int:
    """Paths of each half for pictures of about a ``target`` error: a power of two, whose noise is
    about as large.
    """
    return int(np.clip(2 ** math.ceil(math.log2(8.0 / target)), FEWEST_PATHS, MOST_PATHS))


def trace_controls(
    light: RotatedLight,
    gbuffer: GBuffer,
    places: np.ndarray,
    some: tuple[int, int],
    stream: int,
    tiles: Tiles,
) -> np.ndarray:
    """The luminance of points at ``places`` (k,) by two halves of ``some`` paths each, after how
    many and how many; (k, 2). Raises Cancelled.

    Halves of another ``stream`` draw random numbers of their own.
    """
    (first, paths) = some
    distinct, each = np.unique(places, return_inverse=True)
    sums = np.zeros((len(distinct), 2, 3))
    paths_from = Paths(light, gbuffer.part(distinct, tiles), tiles, bounces_of_truth(light))
    paths_from.add(sums, streams.CONTROLS_STREAM + 2 * stream, first, paths)
    return np.asarray((sums @ LUMINANCE_WEIGHTS / paths)[each])


def bounces_of_truth(light: RotatedLight) -> int:
    """Bounces of paths that nothing of worth is cut off from; the scene's own where somebody gave
    them.
    """
    plan = light.spec.prepared.scene.plan
    chosen = "bounces" in dict(plan.errors)
    if chosen:
        return max(bounces_for(light.reflecting, CUT / BOUNCES_SHARE), plan.bounces)
    return plan.bounces


CONTROL_STANDARD_ERRORS = 2.2
"""Standard errors to either side: with 1.96 of them 256 controls of seven views held 86 to 95 %,
not 95 %.
"""

NOISE_FACTOR = 1.3
"""What the true noise is over its estimate at most, in 95 % of frames: it is 0.7 to 1.4 times that
in 99 %, and its logarithm is about normal.
"""

FARTHEST = 20.0
"""The logarithm that an interval's half is cut off at."""


@dataclass(frozen=True)
class TotalError:
    """Relative RMSE of a picture's luminance over its surface, ``likely``, and the 95 % interval
    ``low`` to ``high``.

    So many ``controls`` measured it; of none it is a prediction.
    """

    likely: float
    low: float
    high: float
    controls: int = 0

    def at_least(self, noise: float) -> "TotalError":
        """The error of a picture whose ``noise`` alone is this large: controls of few pixels may
        find less.

        The noise is an estimate, too: the upper end is as far above it as that of the controls is
        above their middle, or NOISE_FACTOR where this is less.
        """
        if noise <= self.likely:
            return self
        if self.likely > 0.0:
            factor = min(self.high / self.likely, NOISE_FACTOR)
        else:
            factor = NOISE_FACTOR
        return replace(self, likely=noise, high=max(self.high, min(factor * noise, 1.0)))

    @property
    def predicted(self) -> bool:
        """Whether no pixel was measured."""
        return self.controls == 0


def measure_total(squares: np.ndarray, mean: float) -> TotalError:
    """The total error by the weighted squared errors (k,) of control pixels, relative to the true
    ``mean`` luminance.

    The interval is that of the logarithm of their mean, for a few large ones make most of it; it
    never leaves 0 to 1.
    """
    count = len(squares)
    square = float(squares.mean())
    spread = float(squares.std()) / math.sqrt(count)
    if mean <= 0.0:
        worst = float(squares.any())
        return TotalError(worst, worst, worst, count)
    if square > 0.0:
        factor = math.exp(min(CONTROL_STANDARD_ERRORS * spread / square, FARTHEST))
    else:
        factor = 1.0
    if square > 0.0:
        above = square * factor
    else:
        above = CONTROL_STANDARD_ERRORS * spread
    low, likely, high = (
        min(math.sqrt(max(each, 0.0)) / mean, 1.0) for each in (square / factor, square, above)
    )
    return TotalError(likely, low, high, count)


def expected_error(scene: Scene, isovalue: Isovalue) -> float:
    """The error that the plan and the survey of the volume let expect beside noise; relative."""
    surveyed = scene.projection
    return math.hypot(
        min(surveyed.error(isovalue), surveyed.allowed), *(error for _, error in scene.plan.errors)
    )


def predict_total(noise: float, expected: float) -> TotalError:
    """The total error of a frame with so much ``noise``, and an ``expected`` error beside."""
    return TotalError(min(math.hypot(noise, expected), 1.0), noise, 1.0)


TAIL_SHARE = 0.01
"""Share of a picture's pixels that may err by more."""

MIN_ERROR = 1e-4
"""The least relative error that is told from none."""

ERRORS = np.geomspace(MIN_ERROR, 1.0, 80)
"""Relative errors, from the least one to 1, by equal factors."""

BORDERS = np.sqrt(ERRORS[1:] * ERRORS[:-1])
"""The borders between these."""

ODD = 0.5
"""The share of pixels of which nothing is expected: each of the errors is as likely."""

TRUSTED_CONTROLS = 512
ROUNDS = 10
"""Controls that what is expected counts as much as, and rounds of maximisation: more of them change
the tail by 1 %.
"""

TRUSTED = 4.0
"""What the noise of a control's class counts in its noise, beside the two halves of its paths."""

INTERVAL_MARGIN = 1.1
"""Factor on either end of an interval, for noise that is not distributed normally."""

TAIL_STANDARD_ERRORS = 1.96
"""Standard errors to either side of the logarithm of an interval of 95 %."""


@dataclass(frozen=True)
class TailError:
    """The error relative to the mean luminance that 99 % of a picture's pixels stay below, and its
    95 % interval.

    An interval up to 1 says that nothing bounds it.
    """

    likely: float
    low: float
    high: float

    def within(self, total: TotalError) -> "TailError":
        """The tail of a picture with a ``total`` error: what the upper end of that allows, at most.

        Where the mean of squared errors is e², no more than a share s of them is above e² / s
        (Markov's inequality), whatever their distribution. So ten times the upper end of the total
        bounds 99 % of the pixels where controls are too few for a bound of their own.
        """
        bound = max(total.high / math.sqrt(TAIL_SHARE), self.likely)
        return replace(self, high=min(self.high, bound))


def tail_of(
    controls: ControlPixels, shown: np.ndarray, uncertainty: np.ndarray, mean: float
) -> TailError:
    """The tail of a picture that shows the luminance ``shown`` (k,) at its ``controls``; see
    ``measure_tail``.

    They were drawn by the ``uncertainty`` (m,) of its points, whose true ``mean`` luminance errors
    are relative to. A pixel that was drawn again and again is one control.
    """
    places, first, each = np.unique(controls.places, return_index=True, return_inverse=True)
    if not len(places) or mean <= 0.0:
        worst = float(controls.squares(shown).any())
        return TailError(worst, worst, worst)
    wrong = (shown[:, None] - controls.halves)[first] / mean
    classes = classes_of(uncertainty, controls)[places]
    expected = spread_errors(uncertainty, controls, shown) / mean
    return measure_tail(wrong, np.bincount(each, controls.weights), classes, expected)


def measure_tail(
    wrong: np.ndarray, weights: np.ndarray, classes: np.ndarray, expected: np.ndarray
) -> TailError:
    """The tail by control pixels: by their two halves of paths they err by ``wrong`` (k, 2),
    relative to the mean.

    ``weights`` (k,) say what each counts among all pixels, and ``classes`` (k,) from 0 which
    controls have about as much noise. All pixels (m,) are ``expected`` to err by so much.
    """
    counts = weights / weights.sum()
    seen = likelihoods(wrong, noise_of(wrong, classes))
    above = shares_above(seen, counts, shares_of(expected))
    low, likely, high = (falls_below(TAIL_SHARE, each, ERRORS) for each in bounds(above, counts))
    return TailError(likely, low / INTERVAL_MARGIN, min(high * INTERVAL_MARGIN, 1.0))


def noise_of(wrong: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """The variance of the mean of each control's halves (k,): of its class, corrected a little by
    the two.
    """
    each = (wrong[:, 0] - wrong[:, 1]) ** 2 / 4.0
    pooled = np.bincount(classes, each) / np.maximum(np.bincount(classes), 1)
    return np.asarray((TRUSTED * pooled[classes] + each) / (TRUSTED + 1.0))


def likelihoods(wrong: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """How likely what each control shows is if it errs by each of the ERRORS, either way; (k,
    errors), at most 1.
    """
    seen = np.minimum(np.abs(wrong.mean(axis=1)), 1.0)[:, None]
    spread = np.maximum(variance, MIN_ERROR**2)[:, None]
    apart = -((seen - ERRORS) ** 2) / (2.0 * spread)
    return np.asarray(np.exp(apart - apart.max(axis=1, keepdims=True)))


def shares_of(expected: np.ndarray) -> np.ndarray:
    """The share of pixels that err by each of the ERRORS, where they are ``expected`` (m,) to err;
    (errors,).
    """
    of_scale = np.bincount(np.searchsorted(BORDERS, expected), minlength=len(ERRORS)) / len(
        expected
    )
    return np.asarray(ODD / len(ERRORS) + (1.0 - ODD) * (normal_shares() @ of_scale))


@cache
def normal_shares() -> np.ndarray:
    """How much of a normal error, whose scale is each of the ERRORS, is about each of them;
    (errors, scales).
    """
    scales = math.sqrt(2.0) * ERRORS
    below = np.array([[math.erf(border / scale) for scale in scales] for border in BORDERS])
    return np.diff(below, axis=0, prepend=0.0, append=1.0)


def shares_above(likely: np.ndarray, counts: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """The chance that each control errs by more than each of the errors, whose shares are
    ``expected``; (k, errors).
    """
    shares = expected
    trusted = TRUSTED_CONTROLS / (TRUSTED_CONTROLS + len(counts))
    for _ in range(ROUNDS):
        found = shares * ((counts / (likely @ shares)) @ likely)
        shares = trusted * expected + (1.0 - trusted) * found
    chances = likely * shares / (likely @ shares)[:, None]
    return np.asarray(chances[:, ::-1].cumsum(axis=1)[:, ::-1] - chances)


def bounds(above: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The share of pixels that err by more than each of the errors, with the ends of its interval;
    (errors,) each.
    """
    likely = counts @ above
    known = counts**2 @ above
    variance = known**2 / np.maximum(counts**2 @ above**2, 1e-300)
    one = 1.0 / len(counts)
    square = float((counts**2).mean())
    low = gamma_quantile(likely, variance, -TAIL_STANDARD_ERRORS)
    high = gamma_quantile(likely + one, variance + square, TAIL_STANDARD_ERRORS)
    return low, likely, np.asarray(np.maximum(high, likely))


def gamma_quantile(mean: np.ndarray, variance: np.ndarray, deviations: float) -> np.ndarray:
    """The quantile, so many standard ``deviations`` from the middle, of a gamma distribution.

    Source: Wilson and Hilferty, Proceedings of the National Academy of Sciences 17, 1931: its cube
    root is normal.
    """
    ninth = variance / np.maximum(9.0 * mean**2, 1e-300)
    return np.asarray(mean * np.maximum(1.0 - ninth + deviations * np.sqrt(ninth), 0.0) ** 3)


def falls_below(share: float, shares: np.ndarray, errors: np.ndarray) -> float:
    """The error at which falling ``shares`` (errors,) of pixels above an error come down to one; 0
    to 1.
    """
    over = np.flatnonzero(shares > share)
    if not len(over):
        return 0.0
    last = int(over[-1])
    if last + 1 == len(errors):
        return 1.0
    part = (shares[last] - share) / (shares[last] - shares[last + 1])
    return float(errors[last] * math.exp(part * math.log(errors[last + 1] / errors[last])))
