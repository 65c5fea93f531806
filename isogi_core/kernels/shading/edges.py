"""Edges of a picture: the contrast of neighbouring pixels, and the light of samples between the
middles of pixels.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record

NEAR_CENTRE = np.float32(0.1**2)
"""Squared distance, in pixels, within which a sample counts as lying at the middle of a pixel."""

ELSEWHERE = np.float32(1e-6)
"""Weight of a pixel that shows another wall than a sample: it counts if no other does."""

HALF_F32 = np.float32(0.5)
ZERO_F32 = np.float32(0.0)


@kernel(types.void(types.uint8[:, :, ::1], types.uint8[:, ::1], types.uint8[:, ::1]))
def find_contrasts(picture, state, contrast):
    """Fill ``contrast`` (h, w) uint8 with the largest difference of each pixel of ``picture`` (h,
    w, 3) from one of its eight neighbours.

    It is 255 next to a silhouette, which is between pixels of which only one shows the surface by
    ``state`` (h, w), and 0 between two that show none.
    """
    height, width = state.shape
    contrast[:] = 0
    for y in range(height):
        for x in range(width):
            # Visit each pair of neighbours once, and raise the contrast of both.
            for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
                v, u = y + down, x + right
                if v < height and 0 <= u < width:
                    change = difference(picture, state, (y, x), (v, u))
                    contrast[y, x], contrast[v, u] = (
                        max(contrast[y, x], change),
                        max(contrast[v, u], change),
                    )


@kernel()
def difference(picture, state, one, other):
    """Return the largest difference of two pixels, ``one`` and ``other`` (y, x), over the
    channels, in 255 steps.
    """
    if (state[one] > 0) != (state[other] > 0):
        return np.uint8(255)
    most = 0
    if state[one]:
        for c in range(3):
            here = np.int64(picture[one[0], one[1], c])
            there = np.int64(picture[other[0], other[1], c])
            most = max(most, abs(here - there))
    return np.uint8(most)


class Shown(NamedTuple):
    """A picture whose light is read between its pixels.

    - ``rows`` (h, w) int32: number of the surface point that a pixel shows, -1 if none.
    - ``points`` (m, 3): these points in index space.
    - ``numbers`` (m,) int8: the walls that these are on, NO_WALL for the surface, or WINDOW_FACE.
    - ``radiance`` (h · w, 3): linear RGB.
    - ``spacing``: world units per voxel along x, y, z.
    - ``eye``: in index space.
    - ``fine``: inverse square of a pixel's side at distance 1.

    All others are float32.
    """

    rows: Any
    points: Any
    numbers: Any
    radiance: Any
    spacing: Any
    eye: Any
    fine: Any


SHOWN_RECORD = record(
    Shown,
    types.int32[:, ::1],
    types.float32[:, ::1],
    types.int8[::1],
    types.float32[:, ::1],
    types.UniTuple(types.float32, 3),
    types.UniTuple(types.float32, 3),
    types.float32,
)


@kernel()
def squared_distance(spacing, points, m, place):
    """Return the squared world distance of row ``m`` of ``points`` from ``place``,
    both in index space.
    """
    x = spacing[0] * (points[m, 0] - place[0])
    y = spacing[1] * (points[m, 1] - place[1])
    z = spacing[2] * (points[m, 2] - place[2])
    return x * x + y * y + z * z


@kernel()
def add_pixel(shown, x, y, sample, unit, total):
    """Return ``total`` = (r, g, b, weight) plus the weighted light of pixel (x, y), if that shows
    the surface.

    ``sample`` is (points, m, number): row m of the points is the one whose light is sought, and
    lies on the wall of this number. ``unit`` is the inverse square of a pixel's side at its
    distance. The weight is the inverse fourth power of the distance between the pixel's point and
    the sample's, in pixels, times ELSEWHERE if these are on two walls: where walls meet, points of
    both are near, so that distance alone does not tell them apart.
    """
    height, width = shown.rows.shape
    if x < 0 or y < 0 or x >= width or y >= height or shown.rows[y, x] < 0:
        return total
    points, m, number = sample
    row = shown.rows[y, x]
    pixel = y * width + x
    there = shown.points[row, 0], shown.points[row, 1], shown.points[row, 2]
    # Weigh the pixel by the distance of its point; NEAR_CENTRE keeps the weight finite.
    near = squared_distance(shown.spacing, points, m, there) * unit + NEAR_CENTRE
    weight = np.float32(1.0) / (near * near)
    if shown.numbers[row] != number:
        weight = weight * ELSEWHERE
    r, g, b, w = total
    light = shown.radiance
    return (
        r + weight * light[pixel, 0],
        g + weight * light[pixel, 1],
        b + weight * light[pixel, 2],
        w + weight,
    )


@kernel(
    types.void(
        SHOWN_RECORD,
        types.float32[:, ::1],
        types.uint32[::1],
        types.float32[:, ::1],
        types.int8[::1],
        types.float32[:, ::1],
    )
)
def borrow_light(shown, places, found, points, numbers, light):
    """Fill rows ``found`` (k,) of ``light`` (n, 3) with the light of ``points`` (k, 3) on the walls
    with these ``numbers`` (k,), or on the surface, seen at ``places`` (n, 2; x, y), from the pixels
    around.

    It is the weighted mean of the four pixels around the place, or, if none of them shows the
    surface, of the ring of twelve around these. Rows stay as they are if neither does.
    """
    for m in range(found.shape[0]):
        i = found[m]
        # Measure distances in pixels at the depth of the point.
        unit = shown.fine / max(
            squared_distance(shown.spacing, points, m, shown.eye), np.float32(1e-30)
        )
        x, y = int(np.floor(places[i, 0] - HALF_F32)), int(np.floor(places[i, 1] - HALF_F32))
        total = ZERO_F32, ZERO_F32, ZERO_F32, ZERO_F32
        for ring in range(2):
            if total[3] == ZERO_F32:
                for v in range(y - ring, y + 2 + ring):
                    for u in range(x - ring, x + 2 + ring):
                        total = add_pixel(shown, u, v, (points, m, numbers[m]), unit, total)
        if total[3] > ZERO_F32:
            for c in range(3):
                light[i, c] = total[c] / total[3]
