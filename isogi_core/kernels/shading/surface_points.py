"""Points on the surfaces of a picture,
and means and noise over neighbouring pixels of one surface.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record


class SurfacePoints(NamedTuple):
    """m points on surfaces, one a row: ``points`` in index space and world unit ``normals``,
    float32 (m, 3).

    ``pixels`` (m,) uint32 are the picture indices of the points, or the numbers of the rays that
    end on them; they also choose random numbers. Waves of paths hold columns in double precision
    instead of rows, as SIMD needs them: see ``PathStarts``.
    """

    points: Any
    normals: Any
    pixels: Any

    def part(self, some: slice | np.ndarray) -> "SurfacePoints":
        """Return the points in ``some`` rows."""
        return SurfacePoints(self.points[some], self.normals[some], self.pixels[some])


POINT_ROWS = types.float32[:, ::1]
PIXEL_ARRAY = types.uint32[::1]
SURFACE_POINTS = record(SurfacePoints, POINT_ROWS, POINT_ROWS, PIXEL_ARRAY)


@kernel()
def point_of(vectors, m):
    """Return row ``m`` of a float32 (n, 3) array as a tuple of float64."""
    return np.float64(vectors[m, 0]), np.float64(vectors[m, 1]), np.float64(vectors[m, 2])


MAX_SLOPE_SINE = 0.4
"""Sine of the angle between a surface and the way to another point
at which that point's weight is halved.
"""


DISTANCE_WEIGHTS = np.exp(np.arange(3) / -2.0)
"""Weight of a pixel by its squared distance, 0 to 2, in steps: a Gaussian with a standard
deviation of one step.
"""

ROW_NUMBERS = types.int32[:, ::1]


@kernel()
def sameness(points, normals, m, n):
    """Return how likely points ``m`` and ``n`` belong to one smooth surface, 0 to 1.

    It is the 16th power of the cosine between their normals (a half at 17°), times
    2^-(s/MAX_SLOPE_SINE)², s being the larger sine between the surface at either point and the way
    to the other.
    """
    like = 0.0
    from_m = 0.0
    from_n = 0.0
    square = 1e-30
    for c in range(3):
        a, b = np.float64(normals[m, c]), np.float64(normals[n, c])
        way = np.float64(points[n, c]) - np.float64(points[m, c])
        # Sum the products of normals, and of each normal with the way, over the axes.
        like = like + a * b
        square = square + way * way
        from_m, from_n = from_m + a * way, from_n + b * way
    # Square the sine of the steeper slope, relative to that of half weight.
    slope = max(from_m * from_m, from_n * from_n) / (MAX_SLOPE_SINE * MAX_SLOPE_SINE * square)
    like = max(like, 0.0) ** 2
    return like**2 * like**2 * (like**2 * like**2) * np.exp2(-slope)


@kernel(inline=True)
def number_at(rows, y, x):
    """Return the number of the point in pixel (x, y);
    -1 if there is none, or outside the picture.
    """
    if 0 <= y < rows.shape[0] and 0 <= x < rows.shape[1]:
        return np.int64(rows[y, x])
    return -1


@kernel()
def find_around(rows, pixel, step, found):
    """Fill ``found`` (9,) with the numbers of the points in the 3 × 3 pixels about a ``pixel``,
    a ``step`` apart; -1 if there is none.
    """
    y, x = divmod(np.int64(pixel), rows.shape[1])
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            found[3 * dy + dx + 4] = number_at(rows, y + dy * step, x + dx * step)


@kernel()
def are_void(values, found):
    """Return True if the last value of all points ``found`` is zero."""
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
    """Fill ``means`` (k, n) with the weighted mean of the ``values`` (m, n) around each point from
    number ``first`` on.

    The mean is over 3 × 3 pixels, a ``step`` apart, weighted by nearness and ``sameness``. Values
    have the independent ``variance`` (m,); that of the mean goes to ``left`` (k,). If the last
    value of a point is 0, all of its values must be 0. ``rows`` (h, w) number the ``SurfacePoints``
    in each pixel, -1 if there is none; unlike elsewhere, these points are in world space.
    """
    found = np.empty(9, np.int64)
    for i in range(means.shape[0]):
        m = np.uint64(first + i)
        find_around(rows, points.pixels[m], step, found)
        total = 1.0
        noise = variance[m]
        for c in range(means.shape[1]):
            means[i, c] = values[m, c]
        # Skip points without any values around them; the mean is zero.
        if are_void(values, found):
            left[i] = 0.0
            continue
        # Add the weighted neighbours; entry 4 is the point, with weight 1.
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
"""Pixels on either side of a pixel over which its noise is estimated."""

BINOMIAL_WEIGHTS = (1.0, 4.0, 6.0, 4.0, 1.0)
"""Weights of neighbours along an axis."""


@kernel()
def spread_between(values, m, n):
    """Return an estimate of the variance at point ``m`` by its neighbour ``n``.

    With two ``values`` per point, by independent halves, it is that of their mean at ``n``; with
    one, that of a value, from the difference between both points.
    """
    if values.shape[1] == 1:
        return 0.5 * (values[m, 0] - values[n, 0]) ** 2
    return 0.25 * (values[n, 0] - values[n, 1]) ** 2


@kernel(types.void(types.int32[:, ::1], types.uint32[::1], types.int64, REAL_ROWS, REAL_ARRAY))
def pool_noise(rows, pixels, first, values, variance):
    """Fill ``variance`` (k,) of the points from number ``first`` on with the mean of the estimates
    around each.

    ``rows`` (h, w) number the points in the pixels of a picture, -1 if there is none; ``pixels``
    (m,) are the points' pixels; ``values`` (m, 1 or 2) are the estimates of each point by as many
    independent halves. The mean is over 5 × 5 pixels with binomial weights.
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
                # With one value per point, only differences to other points show noise.
                if n >= 0 and (n != m or values.shape[1] > 1):
                    weight = BINOMIAL_WEIGHTS[dy + RADIUS] * BINOMIAL_WEIGHTS[dx + RADIUS]
                    total = total + weight * spread_between(values, m, n)
                    weights = weights + weight
        variance[i] = total / max(weights, 1.0)
