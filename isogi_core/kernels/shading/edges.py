"""Edges of a picture: where neighbours differ, and the light of samples between the middles of
pixels.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record

NEAR_CENTRE = np.float32(0.1**2)
"""Squared distance, in pixels, within which a sample is as good as at a pixel's middle."""

HALF_F32 = np.float32(0.5)
ZERO_F32 = np.float32(0.0)


@kernel(types.void(types.uint8[:, :, ::1], types.uint8[:, ::1], types.uint8[:, ::1]))
def find_contrasts(picture, state, contrast):
    """Fill ``contrast`` (h, w) uint8 with how much a pixel of ``picture`` (h, w, 3) differs from
    one of its neighbours.

    It is 255 where the surface is seen in one of two alone, by ``state`` (h, w); 0 between two that
    are off it.
    """
    height, width = state.shape
    contrast[:] = 0
    for y in range(height):
        for x in range(width):
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
    """How much two pixels differ, of 255 steps."""
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
    """A picture: ``rows`` (h, w) int32 of the surface points that pixels show, -1 off it, those
    ``points`` (m, 3), in index space, and linear ``radiance`` (h · w, 3), all float32 else.
    ``spacing`` makes index space the world's; the ``eye`` is in index space, and ``fine`` is the
    inverse square of a pixel's side at distance 1.
    """

    rows: Any
    points: Any
    radiance: Any
    spacing: Any
    eye: Any
    fine: Any


SHOWN_RECORD = record(
    Shown,
    types.int32[:, ::1],
    types.float32[:, ::1],
    types.float32[:, ::1],
    types.UniTuple(types.float32, 3),
    types.UniTuple(types.float32, 3),
    types.float32,
)


@kernel()
def squared_distance(spacing, points, m, place):
    """The squared distance of row ``m`` of ``points`` from ``place`` in the world."""
    x = spacing[0] * (points[m, 0] - place[0])
    y = spacing[1] * (points[m, 1] - place[1])
    z = spacing[2] * (points[m, 2] - place[2])
    return x * x + y * y + z * z


@kernel()
def add_pixel(shown, x, y, sample, unit, total):
    """Add the light of pixel (x, y), if it shows the surface, to a ``total`` of r, g, b and weight.

    ``sample`` is its points and its row there, ``unit`` the inverse squared side of a pixel at its
    distance. Weights fall as the fourth power of the distance between the two points.
    """
    height, width = shown.rows.shape
    if x < 0 or y < 0 or x >= width or y >= height or shown.rows[y, x] < 0:
        return total
    points, m = sample
    row = shown.rows[y, x]
    pixel = y * width + x
    own = shown.points[row, 0], shown.points[row, 1], shown.points[row, 2]
    near = squared_distance(shown.spacing, points, m, own) * unit + NEAR_CENTRE
    weight = np.float32(1.0) / (near * near)
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
        types.float32[:, ::1],
    )
)
def borrow_light(shown, places, found, points, light):
    """Fill rows ``found`` (k,) of ``light`` (n, 3) with that of surface ``points``, seen at
    ``places`` (n, 2; x, y).

    It is that of the four pixels around, of those most that show the surface near the point; where
    none of them shows it, of the ring around them.
    """
    for m in range(found.shape[0]):
        i = found[m]
        unit = shown.fine / max(
            squared_distance(shown.spacing, points, m, shown.eye), np.float32(1e-30)
        )
        x, y = int(np.floor(places[i, 0] - HALF_F32)), int(np.floor(places[i, 1] - HALF_F32))
        total = ZERO_F32, ZERO_F32, ZERO_F32, ZERO_F32
        for ring in range(2):
            if total[3] == ZERO_F32:
                for v in range(y - ring, y + 2 + ring):
                    for u in range(x - ring, x + 2 + ring):
                        total = add_pixel(shown, u, v, (points, m), unit, total)
        if total[3] > ZERO_F32:
            for c in range(3):
                light[i, c] = total[c] / total[3]
