"""The noise of pixels, estimated by the difference from pixels next to them."""

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel

RADIUS = 2
"""Pixels to either side of a pixel that its noise is estimated by."""

BINOMIAL_WEIGHTS = (1.0, 4.0, 6.0, 4.0, 1.0)
"""What neighbours count along an axis."""

REAL_ROWS, REAL_ARRAY = types.float64[:, ::1], types.float64[::1]


@kernel()
def spread_between(values, m, n):
    """Variance estimated by point ``n`` near ``m``: of the mean of its two ``values``, or of one from both points."""
    if values.shape[1] == 1:
        return 0.5 * (values[m, 0] - values[n, 0]) ** 2
    return 0.25 * (values[n, 0] - values[n, 1]) ** 2


@kernel(types.void(types.int32[:, ::1], types.uint32[::1], types.int64, REAL_ROWS, REAL_ARRAY))
def pool_noise(rows, pixels, first, values, variance):
    """Fill ``variance`` (k,) of points from number ``first`` on: a mean of estimates by points near them.

    ``rows`` (h, w) are the numbers of the points in a picture, -1 where none is, ``pixels`` (m,) where they show, and
    ``values`` (m, 1 or 2) of each, by as many independent halves. Nearer points count more: binomially.
    """
    for i in range(variance.shape[0]):
        m = first + i
        y, x = divmod(np.int64(pixels[m]), rows.shape[1])
        total, weights = 0.0, 0.0
        for dy in range(-RADIUS, RADIUS + 1):
            for dx in range(-RADIUS, RADIUS + 1):
                inside = 0 <= y + dy < rows.shape[0] and 0 <= x + dx < rows.shape[1]
                n = np.int64(rows[y + dy, x + dx]) if inside else -1
                if n >= 0 and (n != m or values.shape[1] > 1):
                    weight = BINOMIAL_WEIGHTS[dy + RADIUS] * BINOMIAL_WEIGHTS[dx + RADIUS]
                    total, weights = total + weight * spread_between(values, m, n), weights + weight
        variance[i] = total / max(weights, 1.0)
