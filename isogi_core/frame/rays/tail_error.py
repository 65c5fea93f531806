"""The tail of a picture's errors: estimate the error that 99 % of its pixels stay below, from its
control pixels.

A control pixel shows an error that is part noise of its own paths. The distribution of the errors
without that noise is the one by which all controls together are most likely (Laird, Journal of the
American Statistical Association 73, 1978, by expectation maximisation). A prior distribution counts
as TRUSTED_CONTROLS controls (Dempster, Laird and Rubin, Journal of the Royal Statistical Society B
39, 1977, section 1): half of it are normal errors, as large as the class of each pixel shows, half
are errors of any size, as some pixels have far larger errors than the rest of their class.

Few controls lie in the tail, each with a weight, so the share of pixels above an error gets a gamma
interval (Fay and Feuer, Statistics in Medicine 16, 1997, with the mean weight of Tiwari, Clegg and
Zou, Statistical Methods in Medical Research 15, 2006). The errors at which the ends of this
interval come down to 1 % are the interval of the percentile (Woodruff, Journal of the American
Statistical Association 47, 1952).
"""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from isogi_core.frame.rays.control_pixels import (
    ControlPixels,
    TotalError,
    classes_of,
    spread_errors,
)

TAIL_SHARE = 0.01
"""Share of a picture's pixels in the tail, which may have larger errors."""


MIN_ERROR = 1e-4
"""Least relative error that is distinguished from none."""


ERRORS = np.geomspace(MIN_ERROR, 1.0, 80)
"""Grid of relative errors on which distributions are kept, by equal factors up to 1."""


BORDERS = np.sqrt(ERRORS[1:] * ERRORS[:-1])
"""Borders between neighbours of the grid."""


ODD = 0.5
"""Share of the prior in which each error of the grid is equally likely."""


TRUSTED_CONTROLS = 512
ROUNDS = 10
"""Number of controls that the prior counts as, and number of rounds of maximisation: more
rounds change the tail by 1 %.
"""


TRUSTED = 4.0
"""Weight of the mean noise of its class in the noise of a control, next to 1 for its two halves
of paths.
"""


INTERVAL_MARGIN = 1.1
"""Factor on either end of an interval, for noise that is not normally distributed."""


TAIL_STANDARD_ERRORS = 1.96
"""Standard errors from the middle to either end of a 95 % interval."""


@dataclass(frozen=True)
class TailError:
    """The error, relative to the mean luminance, that 99 % of a picture's pixels stay below: the
    ``likely`` value and the 95 % interval from ``low`` to ``high``.

    If ``high`` is 1, nothing bounds the error.
    """

    likely: float
    low: float
    high: float

    def within(self, total: TotalError) -> "TailError":
        """Return the tail of a picture with a ``total`` error: its upper end is limited by that of
        the total.

        If the mean squared error is e², no more than a share s of the pixels has a squared error
        above e² / s (Markov's inequality), whatever their distribution. So ten times the upper end
        of the total error bounds 99 % of the pixels even if there are few controls.
        """
        bound = max(total.high / math.sqrt(TAIL_SHARE), self.likely)
        return replace(self, high=min(self.high, bound))


def tail_of(
    controls: ControlPixels, shown: np.ndarray, uncertainty: np.ndarray, mean: float
) -> TailError:
    """Return the tail of a picture that shows the luminance ``shown`` (k,) at its ``controls``; see
    ``measure_tail``.

    The controls were drawn by the ``uncertainty`` (m,) of all points; errors are relative to the
    true ``mean`` luminance.
    """
    # A pixel that was drawn more than once has the same paths each time: it is one control, with
    # the sum of the weights.
    places, first, rows = np.unique(controls.places, return_index=True, return_inverse=True)
    # In the dark any error is as large as can be.
    if not len(places) or mean <= 0.0:
        worst = float(controls.squares(shown).any())
        return TailError(worst, worst, worst)
    wrong = (shown[:, None] - controls.halves)[first] / mean
    classes = classes_of(uncertainty, controls)[places]
    expected = spread_errors(uncertainty, controls, shown) / mean
    weights = np.bincount(rows, controls.weights)
    return measure_tail(wrong, weights, classes, expected)


def measure_tail(
    wrong: np.ndarray, weights: np.ndarray, classes: np.ndarray, expected: np.ndarray
) -> TailError:
    """Return the tail by control pixels, whose luminance differs by ``wrong`` (k, 2) from their two
    halves of paths, relative to the mean.

    ``weights`` (k,) are the shares of all pixels that controls stand for; ``classes`` (k,) from 0
    group controls of about the same noise; ``expected`` (m,) is the error that is expected of each
    pixel.
    """
    counts = weights / weights.sum()
    seen = likelihoods(wrong, noise_of(wrong, classes))
    # Estimate the chance that each control has an error above each of the grid, then the share of
    # all pixels above it, and find the error at which that share, and the ends of its interval,
    # come down to 1 %.
    above = shares_above(seen, counts, shares_of(expected))
    shares = bounds(above, counts)
    low, likely, high = (falls_below(TAIL_SHARE, each, ERRORS) for each in shares)
    return TailError(likely, low / INTERVAL_MARGIN, min(high * INTERVAL_MARGIN, 1.0))


def noise_of(wrong: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """Return the variance of the mean of each control's halves, (k,): the mean of its class,
    weighted by TRUSTED, and its two halves.
    """
    # The mean of two independent halves has a quarter of the variance of their difference.
    single = (wrong[:, 0] - wrong[:, 1]) ** 2 / 4.0
    pooled = np.bincount(classes, single) / np.maximum(np.bincount(classes), 1)
    return np.asarray((TRUSTED * pooled[classes] + single) / (TRUSTED + 1.0))


def likelihoods(wrong: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the likelihood of the measured error of each control, the mean of its two errors
    ``wrong`` (k, 2), if its true error has the same sign and the size of each of ERRORS; (k,
    errors), scaled so that the largest of each control is 1.

    The noise of that mean has the ``variance`` (k,), and is taken to be normal. A true error of the
    other sign is left out: for a measured size s and a true size E it is less likely by the factor
    exp(-2 s E / variance), which is near 1 only if s E is far below the variance. A measured size
    above 1 counts as 1.
    """
    seen = np.minimum(np.abs(wrong.mean(axis=1)), 1.0)[:, None]
    spread = np.maximum(variance, MIN_ERROR**2)[:, None]
    apart = -((seen - ERRORS) ** 2) / (2.0 * spread)
    return np.asarray(np.exp(apart - apart.max(axis=1, keepdims=True)))


def shares_of(expected: np.ndarray) -> np.ndarray:
    """Return the prior: the share of pixels whose error is each of ERRORS, if pixels have
    normal errors of the scales ``expected`` (m,); (errors,).
    """
    scales = np.bincount(np.searchsorted(BORDERS, expected), minlength=len(ERRORS))
    normal = normal_shares() @ (scales / len(expected))
    return np.asarray(ODD / len(ERRORS) + (1.0 - ODD) * normal)


@cache
def normal_shares() -> np.ndarray:
    """Return the share of a normal error that falls next to each of ERRORS, for each of ERRORS
    as its scale; (errors, scales).
    """
    scales = math.sqrt(2.0) * ERRORS
    below = np.array([[math.erf(border / scale) for scale in scales] for border in BORDERS])
    return np.diff(below, axis=0, prepend=0.0, append=1.0)


def shares_above(likely: np.ndarray, counts: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the chance that each control has an error above each of ERRORS; (k, errors).

    ``likely`` (k, errors) are the likelihoods, ``counts`` (k,) the shares of pixels that controls
    stand for, of the sum 1, and ``expected`` (errors,) is the prior.
    """
    shares = expected
    trusted = TRUSTED_CONTROLS / (TRUSTED_CONTROLS + len(counts))
    # Expectation maximisation: distribute each control over the errors by its posterior, take the
    # mean over all controls as the new distribution, and mix it with the prior.
    for _ in range(ROUNDS):
        found = shares * ((counts / (likely @ shares)) @ likely)
        shares = trusted * expected + (1.0 - trusted) * found
    # The posterior of each control under that distribution, summed up from its upper end.
    chances = likely * shares / (likely @ shares)[:, None]
    return np.asarray(chances[:, ::-1].cumsum(axis=1)[:, ::-1] - chances)


def bounds(above: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the share of pixels with an error above each of ERRORS, between the ends of its
    interval: low, likely and high, (errors,) each.
    """
    likely = counts @ above
    # The variance of a weighted count is the sum of the squared weights. A control that is above
    # with a chance p counts as less than one: the variance grows by Σ w²p / Σ w²p².
    squares = counts**2 @ above
    variance = squares**2 / np.maximum(counts**2 @ above**2, 1e-300)
    # The upper end allows for one more control above, of the mean weight.
    mean = 1.0 / len(counts)
    square = float((counts**2).mean())
    low = gamma_quantile(likely, variance, -TAIL_STANDARD_ERRORS)
    high = gamma_quantile(likely + mean, variance + square, TAIL_STANDARD_ERRORS)
    return low, likely, np.asarray(np.maximum(high, likely))


def gamma_quantile(mean: np.ndarray, variance: np.ndarray, deviations: float) -> np.ndarray:
    """Return the quantile of gamma distributions at ``deviations`` standard deviations from the
    middle.

    Source: Wilson and Hilferty, Proceedings of the National Academy of Sciences 17, 1931: the cube
    root is about normal.
    """
    ninth = variance / np.maximum(9.0 * mean**2, 1e-300)
    return np.asarray(mean * np.maximum(1.0 - ninth + deviations * np.sqrt(ninth), 0.0) ** 3)


def falls_below(share: float, shares: np.ndarray, errors: np.ndarray) -> float:
    """Return the error that a ``share`` of the pixels exceeds. ``shares`` (errors,), which fall,
    are the shares of pixels above each of the ascending ``errors``.

    Return 0 if fewer pixels exceed even the least of ``errors``, 1 if more exceed the largest.
    """
    over = np.flatnonzero(shares > share)
    if not len(over):
        return 0.0
    last = int(over[-1])
    if last + 1 == len(errors):
        return 1.0
    # Interpolate the logarithm of the error, as the grid has equal factors.
    part = (shares[last] - share) / (shares[last] - shares[last + 1])
    return float(errors[last] * math.exp(part * math.log(errors[last + 1] / errors[last])))
