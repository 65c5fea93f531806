"""References: a view path-traced from each pixel, with what is known of its own noise."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Reference:
    """The mean of ``samples`` paths from each pixel, over independent randomisations.

    ``mean`` (h, w, 3) float32 linear RGB, ``variance`` (h, w) float32 that of the mean's luminance, 0 off the
    surface; ``on`` (h, w) bool is where the surface is; ``seconds`` of the processor were spent.
    """

    mean: np.ndarray
    variance: np.ndarray
    on: np.ndarray
    samples: int
    seconds: float
