"""The tail of the errors of a picture: the error that 99 % of its pixels stay below."""

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
