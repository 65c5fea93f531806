"""Points on the surfaces of a picture, and means and noise over neighbouring pixels of the same
surface.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record


class SurfacePoints(NamedTuple):
    """m points on surfaces: ``points`` in index space and world unit ``normals``, float32 (m, 3),
    one a row.

    ``pixels`` (m,) uint32 are the picture indices that show them, or other numbers of rays: random
    numbers follow from these. Waves of paths have columns in double precision in place of rows, as
    SIMD takes them: see ``PathStarts``.
    """

    points: Any
    normals: Any
    pixels: Any

    def part(self, some: slice | np.ndarray) -> "SurfacePoints":
        """The points in ``some`` rows."""
        return SurfacePoints(self.points[some], self.normals[some], self.pixels[some])


POINT_ROWS = types.float32[:, ::1]
PIXEL_ARRAY = types.uint32[::1]
SURFACE_POINTS = record(SurfacePoints, POINT_ROWS, POINT_ROWS, PIXEL_ARRAY)


@kernel()
def point_of(vectors, m):
    """Row ``m`` of a float32 (n, 3) array as a tuple of float64."""
    return np.float64(vectors[m, 0]), np.float64(vectors[m, 1]), np.float64(vectors[m, 2])


MAX_SLOPE_SINE = 0.4
"""Sine of the angle, between a pixel's surface and the way to another point, at which that one
counts a half less.
"""


DISTANCE_WEIGHTS = np.exp(np.arange(3) / -2.0)
"""What a pixel counts by its squared distance, 0 to 2, in steps."""

ROW_NUMBERS = types.int32[:, ::1]


@kernel()
def sameness(points, normals, m, n):
    """How much points ``m`` and ``n`` are of one smooth surface, 0 to 1.

    By the 16th power of the cosine between their normals (a half at 17°), and by the slope of the
    way between them.
    """
    like = 0.0
    from_m = 0.0
    from_n = 0.0
    square = 1e-30
    for c in range(3):
        a, b = np.float64(normals[m, c]), np.float64(normals[n, c])
        way = np.float64(points[n, c]) - np.float64(points[m, c])
        like = like + a * b
        square = square + way * way
        from_m, from_n = from_m + a * way, from_n + b * way
    slope = max(from_m * from_m, from_n * from_n) / (MAX_SLOPE_SINE * MAX_SLOPE_SINE * square)
    like = max(like, 0.0) ** 2
    return like**2 * like**2 * (like**2 * like**2) * np.exp2(-slope)


@kernel(inline=True)
def number_at(rows, y, x):
    """The number of the point in a pixel; -1 where none is, and outside the picture."""
    if 0 <= y < rows.shape[0] and 0 <= x < rows.shape[1]:
        return np.int64(rows[y, x])
    return -1


@kernel()
def find_around(rows, pixel, step, found):
    """Fill ``found`` (9,) with the numbers of the points in the 3 × 3 pixels about a ``pixel``, -1
    where none is.
    """
    y, x = divmod(np.int64(pixel), rows.shape[1])
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            found[3 * dy + dx + 4] = number_at(rows, y + dy * step, x + dx * step)


@kernel()
def are_void(values, found):
    """Whether the last value of all points ``found`` is zero."""
    for n in found:
        if n >= 0 and values[n, values.shape[1] - 1] != 0.0:
            return False
    return True


@kernel(
    types.void(
        ROW_NUMBERS,
        SURFACE_POINTS,
        types.int64,
        types.int64,
        REAL_ROWS,
        REAL_ARRAY,
        REAL_ROWS,
        REAL_ARRAY,
    )
)
def mean_around(rows, points, step, first, values, variance, means, left):
    """Fill ``means`` (k, n) of points from number ``first`` on with the mean of ``values`` (m, n)
    about each.

    Over the 3 × 3 pixels at a distance of ``step``, itself among them, by nearness and
    ``sameness``. Values with the independent ``variance`` (m,) have a mean whose variance goes to
    ``left`` (k,). Values of points whose last one is 0 are taken to be 0 all. ``rows`` (h, w)
    number the ``SurfacePoints`` in each pixel, -1 where none is; these are in the world here.
    """
    found = np.empty(9, np.int64)
    for i in range(means.shape[0]):
        m = np.uint64(first + i)
        find_around(rows, points.pixels[m], step, found)
        total = 1.0
        noise = variance[m]
        for c in range(means.shape[1]):
            means[i, c] = values[m, c]
        if are_void(values, found):
            left[i] = 0.0
            continue
        for k in range(9):
            if k != 4 and found[k] >= 0:
                n = np.uint64(found[k])
                same = sameness(points.points, points.normals, m, n)
                square = (k // 3 - 1) ** 2 + (k % 3 - 1) ** 2
                weight = DISTANCE_WEIGHTS[square] * same
                total = total + weight
                noise = noise + weight * weight * variance[n]
                for c in range(means.shape[1]):
                    means[i, c] += weight * values[n, c]
        for c in range(means.shape[1]):
            means[i, c] /= total
        left[i] = noise / (total * total)


RADIUS = 2
"""Pixels to either side of a pixel that its noise is estimated by."""

BINOMIAL_WEIGHTS = (1.0, 4.0, 6.0, 4.0, 1.0)
"""What neighbours count along an axis."""


@kernel()
def spread_between(values, m, n):
    """Variance estimated by point ``n`` near ``m``: of the mean of its two ``values``, or of one
    from both points.
    """
    if values.shape[1] == 1:
        return 0.5 * (values[m, 0] - values[n, 0]) ** 2
    return 0.25 * (values[n, 0] - values[n, 1]) ** 2


@kernel(types.void(types.int32[:, ::1], types.uint32[::1], types.int64, REAL_ROWS, REAL_ARRAY))
def pool_noise(rows, pixels, first, values, variance):
    """Fill ``variance`` (k,) of points from number ``first`` on: a mean of estimates by points near
    them.

    ``rows`` (h, w) are the numbers of the points in a picture, -1 where none is, ``pixels`` (m,)
    where they show, and ``values`` (m, 1 or 2) of each, by as many independent halves. Nearer
    points count more: binomially.
    """
    for i in range(variance.shape[0]):
        m = first + i
        y, x = divmod(np.int64(pixels[m]), rows.shape[1])
        total = 0.0
        weights = 0.0
        for dy in range(-RADIUS, RADIUS + 1):
            for dx in range(-RADIUS, RADIUS + 1):
                inside = 0 <= y + dy < rows.shape[0] and 0 <= x + dx < rows.shape[1]
                if inside:
                    n = np.int64(rows[y + dy, x + dx])
                else:
                    n = -1
                if n >= 0 and (n != m or values.shape[1] > 1):
                    weight = BINOMIAL_WEIGHTS[dy + RADIUS] * BINOMIAL_WEIGHTS[dx + RADIUS]
                    total = total + weight * spread_between(values, m, n)
                    weights = weights + weight
        variance[i] = total / max(weights, 1.0)
