"""The total error of a picture, whatever its causes: measured by control pixels, or predicted before there are any."""

import math
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.model.volume import Isovalue
from isogi_core.plan.scene import Scene

QUANTILE = 2.2
"""Standard errors to either side: with 1.96 of them 256 controls of seven views held 86 to 95 %, not 95 %."""

MOST = 20.0
"""The logarithm that an interval's half is cut off at."""


@dataclass(frozen=True)
class TotalError:
    """Relative RMSE of a picture's luminance over its surface, ``likely``, and the 95 % interval ``low`` to ``high``.

    So many ``controls`` measured it; of none it is a prediction.
    """

    likely: float
    low: float
    high: float
    controls: int = 0

    def at_least(self, noise: float) -> "TotalError":
        """The same of a picture whose noise alone is so large: controls of few pixels may find less."""
        return replace(self, likely=max(self.likely, noise), high=max(self.high, noise))

    @property
    def predicted(self) -> bool:
        """Whether no pixel was measured."""
        return self.controls == 0


def measure_total(squares: np.ndarray, mean: float) -> TotalError:
    """The total error by the weighted squared errors (k,) of control pixels, relative to the true ``mean`` luminance.

    The interval is that of the logarithm of their mean, for a few large ones make most of it; it never leaves 0 to 1.
    """
    count, square = len(squares), float(squares.mean())
    spread = float(squares.std()) / math.sqrt(count)
    if mean <= 0.0:
        worst = float(squares.any())
        return TotalError(worst, worst, worst, count)
    factor = math.exp(min(QUANTILE * spread / square, MOST)) if square > 0.0 else 1.0
    above = square * factor if square > 0.0 else QUANTILE * spread
    low, likely, high = (min(math.sqrt(max(each, 0.0)) / mean, 1.0) for each in (square / factor, square, above))
    return TotalError(likely, low, high, count)


def expected_error(scene: Scene, isovalue: Isovalue) -> float:
    """The error that the plan and the survey of the volume let expect beside noise; relative."""
    surveyed = scene.projection
    return math.hypot(min(surveyed.error(isovalue), surveyed.allowed), *(error for _, error in scene.plan.errors))


def predict_total(noise: float, expected: float) -> TotalError:
    """The total error of a frame with so much ``noise``, and an ``expected`` error beside."""
    return TotalError(min(math.hypot(noise, expected), 1.0), noise, 1.0)
