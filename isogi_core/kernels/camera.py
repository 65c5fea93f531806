"""The pinhole camera and the G-buffer: where the surface is behind each pixel."""

import math
from typing import NamedTuple

from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.field import FIELD
from isogi_core.kernels.intersect import UNKNOWN, cast
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


@kernel(types.void(FIELD, types.float64, PINHOLE, types.int64, types.float32[:, ::1], types.float32[:, :, ::1]))
def trace_rows(field, iso, camera, first, depth, position):
    """Fill rows first … of the G-buffer: ``depth`` (rows, w), inf off the surface; ``position`` (rows, w, 3).

    Positions are in index space. ``depth`` and ``position`` are the tile's own rows.
    """
    rows, width = depth.shape
    for y in range(rows):
        for x in range(width):
            d = pixel_ray(camera, x + 0.5, first + y + 0.5)
            t, _ = cast(field, iso, camera.eye, d, UNKNOWN)
            depth[y, x] = t
            if t < math.inf:
                p = madd(camera.eye, t, d)
                position[y, x, 0], position[y, x, 1], position[y, x, 2] = p
