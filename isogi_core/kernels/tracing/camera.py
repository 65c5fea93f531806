"""The pinhole camera and the G-buffer: where the surface is behind each pixel."""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.cast import SURFACE, cast_batch
from isogi_core.kernels.tracing.intersect import UNKNOWN_SIDE
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.vec import column, madd, put_column


class Pinhole(NamedTuple):
    """A camera in index space: ``eye``; the ray through pixel (x, y) is corner + x·right + y·down.

    Rays are scaled so that their parameter is the world distance along the view axis (the depth).
    """

    eye: tuple[float, float, float]
    corner: tuple[float, float, float]
    right: tuple[float, float, float]
    down: tuple[float, float, float]


REAL_TRIPLE = types.UniTuple(types.float64, 3)
PINHOLE = record(Pinhole, REAL_TRIPLE, REAL_TRIPLE, REAL_TRIPLE, REAL_TRIPLE)


@kernel()
def pixel_ray(camera, x, y):
    """Direction, in index space per unit of depth, through picture point (x, y); pixel centres at half-integers."""
    return madd(madd(camera.corner, x, camera.right), y, camera.down)


@kernel(types.int64(SURFACE, PINHOLE, types.int64, types.int64, types.uint32[::1], types.float32[:, ::1]))
def trace_pixels(surface, camera, first, width, pixels, points):
    """Cast the rays of the picture's pixels ``first`` … first + n, row by row; returns how many show the surface.

    Their picture indices are written to ``pixels`` (n,), ascending, and where the surface is there, in
    index space, to ``points`` (n, 3).
    """
    count = pixels.shape[0]
    directions = np.empty((3, count))
    for i in range(count):
        y, x = divmod(first + i, width)
        put_column(directions, i, pixel_ray(camera, x + 0.5, y + 0.5))
    return meet_surface(surface, camera, directions, first, pixels, points)


@kernel(types.int64(SURFACE, PINHOLE, types.float32[:, ::1], types.uint32[::1], types.float32[:, ::1]))
def trace_places(surface, camera, places, found, points):
    """Cast the rays through the ``places`` (n, 2; x, y) of a picture; returns how many show the surface.

    Their rows are written to ``found`` (n,), ascending, and where the surface is there to ``points``, as above.
    """
    count = places.shape[0]
    directions = np.empty((3, count))
    for i in range(count):
        put_column(directions, i, pixel_ray(camera, places[i, 0], places[i, 1]))
    return meet_surface(surface, camera, directions, 0, found, points)


@kernel()
def meet_surface(surface, camera, directions, first, found, points):
    """Cast rays from the eye; write the numbers, from ``first``, of those that meet the surface, and where."""
    t = np.empty(directions.shape[1])
    cast_from_eye(surface, camera.eye, directions, t)
    return write_hits(camera.eye, directions, t, first, found, points)


@kernel()
def cast_from_eye(surface, eye, directions, t):
    """Cast rays in ``directions`` (3, n) from the ``eye``: fill ``t`` (n,) with their ways to the surface, or inf."""
    count = t.shape[0]
    origins, came = np.empty((3, count)), np.empty(count, np.int8)
    for i in range(count):
        put_column(origins, i, eye)
    rays = Rays(np.full(count, surface.isovalue), origins, directions, np.full(count, UNKNOWN_SIDE, np.int8))
    cast_batch(surface.field, surface.cells, rays, t, came)


@kernel()
def write_hits(eye, directions, t, first, found, points):
    """Write the numbers, from ``first``, of rays from the ``eye`` whose ways ``t`` end, and where; returns how many."""
    hits = 0
    for i in range(t.shape[0]):
        if t[i] < math.inf:
            found[hits] = first + i
            put_point(points, hits, madd(eye, t[i], column(directions, i)))
            hits += 1
    return hits


@kernel()
def put_point(points, row, p):
    """Write a vector into a row of ``points`` (n, 3)."""
    points[row, 0], points[row, 1], points[row, 2] = p
