"""Errors of pictures, and the power laws by which they fall."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from isogi_core.model.environment import LUMINANCE_WEIGHTS


def relative_rmse(picture: np.ndarray, best: np.ndarray, on: np.ndarray) -> float:
    """RMSE of the luminance over the pixels ``on`` (h, w), over its mean in the ``best``; both (h,
    w, 3 or more).
    """
    light = best[on][:, :3].astype(np.float64) @ LUMINANCE_WEIGHTS
    wrong = picture[on][:, :3].astype(np.float64) @ LUMINANCE_WEIGHTS - light
    return math.sqrt((wrong**2).mean()) / float(light.mean())


def rms(values: Sequence[float]) -> float:
    """Root mean square."""
    return math.sqrt(statistics.fmean(value**2 for value in values))


def without(error: float, noise: float) -> float:
    """An error that was measured against a reference, without the reference's own independent
    ``noise``.
    """
    return math.sqrt(max(error**2 - noise**2, 0.0))


@dataclass(frozen=True)
class PowerLaw:
    """An error that falls as ``scale`` · n^-``power`` with the samples n."""

    scale: float
    power: float

    @staticmethod
    def fit(counts: Sequence[float], errors: Sequence[float]) -> "PowerLaw":
        """The line of least squares through the logarithms of errors after so many samples."""
        slope, height = np.polyfit(np.log(counts), np.log(errors), 1)
        return PowerLaw(math.exp(height), -float(slope))

    def count_for(self, error: float) -> int:
        """Samples that reach an error, at least 1."""
        return max(round((self.scale / error) ** (1.0 / self.power)), 1)

    def through(self, count: int, error: float) -> "PowerLaw":
        """The law of the same power that goes through a point."""
        return PowerLaw(error * count**self.power, self.power)
