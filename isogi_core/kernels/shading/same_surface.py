"""Means over the pixels around one, of a picture in which some show the same surface."""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.shading.picture_noise import REAL_ARRAY, REAL_ROWS

MAX_SLOPE_SINE = 0.4
"""Sine of the angle, between a pixel's surface and the way to another point, at which that one counts a half less."""


class ShownPoints(NamedTuple):
    """Surface points of a picture: ``rows`` (h, w) int32 number those in each pixel, -1 where none is; the ``pixels``
    (m,) uint32 in which they show, ``points`` (m, 3) float32 in the world, and unit ``normals`` (m, 3) float32.
    """

    rows: Any
    pixels: Any
    points: Any
    normals: Any


DISTANCE_WEIGHTS = np.exp(np.arange(3) / -2.0)
"""What a pixel counts by its squared distance, 0 to 2, in steps."""

SINGLE_ROWS = types.float32[:, ::1]
SHOWN_POINTS = record(ShownPoints, types.int32[:, ::1], types.uint32[::1], SINGLE_ROWS, SINGLE_ROWS)


@kernel()
def sameness(points, normals, m, n):
    """How much points ``m`` and ``n`` are of one smooth surface, 0 to 1.

    By the 16th power of the cosine between their normals (a half at 17°), and by the slope of the way between them.
    """
    like, from_m, from_n, square = 0.0, 0.0, 0.0, 1e-30
    for c in range(3):
        a, b = np.float64(normals[m, c]), np.float64(normals[n, c])
        way = np.float64(points[n, c]) - np.float64(points[m, c])
        like, square = like + a * b, square + way * way
        from_m, from_n = from_m + a * way, from_n + b * way
    slope = max(from_m * from_m, from_n * from_n) / (MAX_SLOPE_SINE * MAX_SLOPE_SINE * square)
    like = max(like, 0.0) ** 2
    return like**2 * like**2 * (like**2 * like**2) * np.exp2(-slope)


@kernel(inline=True)
def number_at(rows, y, x):
    """The number of the point in a pixel; -1 where none is, and outside the picture."""
    return np.int64(rows[y, x]) if 0 <= y < rows.shape[0] and 0 <= x < rows.shape[1] else -1


@kernel()
def find_around(shown, m, step, found):
    """Fill ``found`` (9,) with the numbers of the points in the 3 × 3 pixels about ``m``, -1 where none is."""
    y, x = divmod(np.int64(shown.pixels[m]), shown.rows.shape[1])
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            found[3 * dy + dx + 4] = number_at(shown.rows, y + dy * step, x + dx * step)


@kernel()
def are_void(values, found):
    """Whether the last value of all points ``found`` is zero."""
    for n in found:
        if n >= 0 and values[n, values.shape[1] - 1] != 0.0:
            return False
    return True


@kernel(types.void(SHOWN_POINTS, types.int64, types.int64, REAL_ROWS, REAL_ARRAY, REAL_ROWS, REAL_ARRAY))
def mean_around(shown, step, first, values, variance, means, left):
    """Fill ``means`` (k, n) of points from number ``first`` on with the mean of ``values`` (m, n) about each.

    Over the 3 × 3 pixels at a distance of ``step``, itself among them, by nearness and ``sameness``. Values with the
    independent ``variance`` (m,) have a mean whose variance goes to ``left`` (k,). Values of points whose last one is 0
    are taken to be 0 all.
    """
    found = np.empty(9, np.int64)
    for i in range(means.shape[0]):
        m = np.uint64(first + i)
        find_around(shown, m, step, found)
        total, noise = 1.0, variance[m]
        for c in range(means.shape[1]):
            means[i, c] = values[m, c]
        if are_void(values, found):
            left[i] = 0.0
            continue
        for k in range(9):
            if k != 4 and found[k] >= 0:
                n = np.uint64(found[k])
                same, square = sameness(shown.points, shown.normals, m, n), (k // 3 - 1) ** 2 + (k % 3 - 1) ** 2
                weight = DISTANCE_WEIGHTS[square] * same
                total, noise = total + weight, noise + weight * weight * variance[n]
                for c in range(means.shape[1]):
                    means[i, c] += weight * values[n, c]
        for c in range(means.shape[1]):
            means[i, c] /= total
        left[i] = noise / (total * total)
