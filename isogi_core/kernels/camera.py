"""The pinhole camera and the G-buffer: where the surface is behind each pixel."""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.bricks import BRICKS
from isogi_core.kernels.field import FIELD
from isogi_core.kernels.intersect import UNKNOWN
from isogi_core.kernels.packets import cast_batch
from isogi_core.kernels.vec import madd


class Pinhole(NamedTuple):
    """A camera in index space: ``eye``; the ray through pixel (x, y) is corner + x·right + y·down.

    Rays are scaled so that their parameter is the world distance along the view axis (the depth).
    """

    eye: tuple[float, float, float]
    corner: tuple[float, float, float]
    right: tuple[float, float, float]
    down: tuple[float, float, float]


VECTOR = types.UniTuple(types.float64, 3)
PINHOLE = record(Pinhole, VECTOR, VECTOR, VECTOR, VECTOR)


@kernel()
def pixel_ray(camera, x, y):
    """Direction, in index space per unit of depth, through picture point (x, y); pixel centres at half-integers."""
    return madd(madd(camera.corner, x, camera.right), y, camera.down)


@kernel(types.void(FIELD, BRICKS, types.float64, PINHOLE, types.int64, types.float32[:, ::1], types.float32[:, :, ::1]))
def trace_rows(field, bricks, iso, camera, first, depth, position):
    """Fill rows first … of the G-buffer: ``depth`` (rows, w), inf off the surface; ``position`` (rows, w, 3).

    Positions are in index space. ``depth`` and ``position`` are the tile's own rows; ``bricks`` hold ``iso``.
    """
    rows, width = depth.shape
    count = rows * width
    origins, directions = np.empty((count, 3)), np.empty((count, 3))
    for m in range(count):
        d = pixel_ray(camera, m % width + 0.5, first + m // width + 0.5)
        for a in range(3):
            origins[m, a], directions[m, a] = camera.eye[a], d[a]
    isovalues, sides = np.full(count, iso), np.full(count, UNKNOWN, np.int8)
    t, came = np.empty(count), np.empty(count, np.int8)
    cast_batch(field, bricks, isovalues, origins, directions, sides, t, came)
    for m in range(count):
        depth[m // width, m % width] = t[m]
        if t[m] < math.inf:
            for a in range(3):
                position[m // width, m % width, a] = origins[m, a] + t[m] * directions[m, a]
