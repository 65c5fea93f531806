"""The pinhole camera, and primary rays: the surface, wall or window face behind each pixel."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ROWS, REAL_TRIPLE, kernel, record
from isogi_core.kernels.simd.maths import where
from isogi_core.kernels.simd.memory import load, store
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.cast import SURFACE, cast_batch
from isogi_core.kernels.tracing.field import VOXEL_ARRAY, value
from isogi_core.kernels.tracing.intersect import UNKNOWN_SIDE
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.vec import column, load_columns, madd, put_column
from isogi_core.kernels.tracing.walls import NO_WALL, WALLS_RECORD, Walls, inner, nearest_wall


class Pinhole(NamedTuple):
    """A camera in index space; the ray through picture point (x, y) is corner + x·right + y·down
    from ``eye``.

    Rays are scaled so that their parameter is the world distance along the view axis (the depth).
    """

    eye: tuple[float, float, float]
    corner: tuple[float, float, float]
    right: tuple[float, float, float]
    down: tuple[float, float, float]


PINHOLE = record(Pinhole, REAL_TRIPLE, REAL_TRIPLE, REAL_TRIPLE, REAL_TRIPLE)


@kernel()
def pixel_ray(camera, x, y):
    """Return the index-space direction, per unit of depth, through picture point (x, y); pixel
    centres are at half-integers.
    """
    return madd(madd(camera.corner, x, camera.right), y, camera.down)


@kernel()
def write_hits(eye, directions, t, first, found, points):
    """Write the numbers of rays that hit something, counted from ``first``, and their hit
    points; return how many there are.
    """
    hits = 0
    for i in range(t.shape[0]):
        if t[i] < math.inf:
            found[hits] = first + i
            put_point(points, hits, madd(eye, t[i], column(directions, i)))
            hits += 1
    return hits


@kernel()
def put_point(points, row, p):
    """Write a vector to a row of ``points`` (n, 3)."""
    points[row, 0], points[row, 1], points[row, 2] = p


WINDOW_FACE = -2.0
"""Stands for a face of the window instead of a wall's number."""


class Sight(NamedTuple):
    """The ``walls``, and the planes of a ``window`` (k, 4) in index space: points with n · p +
    w ≥ 0 are visible.
    """

    walls: Any
    window: Any


SIGHT = record(Sight, WALLS_RECORD, REAL_ROWS)

NO_WALLS = Walls(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2, 3)), np.empty(0))
"""A scene without walls."""

PIXEL_ROWS = types.uint32[:, ::1]
POINT_ROWS = types.float32[:, :, ::1]


@kernel()
def look_through(window, eye, d):
    """Return the part (near, far) of the ray eye + t·d, t ≥ 0, that a ``window`` leaves
    visible; (0, -inf) if none.
    """
    near = 0.0
    far = math.inf
    # Each plane cuts off the part of the ray that is behind it.
    for k in range(window.shape[0]):
        height = inner(window, k, eye) + window[k, 3]
        slope = inner(window, k, d)
        if slope > 0.0:
            near = max(near, -height / slope)
        elif slope < 0.0:
            far = min(far, -height / slope)
        elif height < 0.0:
            far = -math.inf
    if near <= far:
        return (near, far)
    return (0.0, -math.inf)


@kernel()
def is_solid(surface, p):
    """Return True if the index-space point ``p`` is in the volume's box and above the isovalue;
    False next to a hole.
    """
    nz, ny, nx = surface.field.voxels.shape
    x, y, z = p
    within = 0.0 <= x <= nx - 1.0 and 0.0 <= y <= ny - 1.0 and 0.0 <= z <= nz - 1.0
    return within and value(surface.field.voxels, p) > surface.isovalue


@kernel()
def cast_through(surface, window, eye, directions, t, met):
    """Cast rays in ``directions`` (3, n) from the ``eye`` through a ``window``; fill distances
    ``t`` (n,), infinite for misses.

    ``met`` (n,) is WINDOW_FACE for hits on a face of the window, and NO_WALL for hits on the
    isosurface and for misses.
    """
    count = t.shape[0]
    origins = np.empty((3, count))
    came = np.empty(count, np.int8)
    near = np.empty(count)
    far = np.empty(count)
    # Start each ray at the point at which the window lets it in.
    for i in range(count):
        d = column(directions, i)
        near[i], far[i] = look_through(window, eye, d)
        put_column(origins, i, madd(eye, near[i], d))
    rays = Rays(
        np.full(count, surface.isovalue), origins, directions, np.full(count, UNKNOWN_SIDE, np.int8)
    )
    cast_batch(surface.field, surface.cells, rays, t, came)
    # A ray that starts inside of the solid shows the window's face; hits beyond the window are not
    # seen.
    for i in range(count):
        opened = near[i] > 0.0 and is_solid(surface, column(origins, i))
        t[i] = near[i] if opened else near[i] + t[i]
        seen = t[i] <= far[i]
        t[i] = t[i] if seen else math.inf
        if opened and seen:
            met[i] = WINDOW_FACE
        else:
            met[i] = NO_WALL


@kernel()
def cast_sight(surface, sight, eye, directions, t, met):
    """Cast rays in ``directions`` (3, n) from the ``eye``; fill distances ``t`` (n,), infinite for
    misses.

    ``met`` (n,) is the number of the wall that a ray hits first, WINDOW_FACE for a face of the
    window, and NO_WALL for the isosurface and for misses. Windows do not cut walls.
    """
    # Find the surface, then walls before it: a vector of rays at a time, and the rest one by one.
    cast_through(surface, sight.window, eye, directions, t, met)
    whole = t.shape[0] // PATH_WIDTH * PATH_WIDTH
    for i in range(0, whole, PATH_WIDTH):
        d = load_columns(directions, i)
        reach = load(t, i, PATH_WIDTH)
        reach, wall = nearest_wall(sight.walls, eye, d, d[0] * 0.0 + NO_WALL, reach)
        store(t, i, reach)
        store(met, i, where(wall > NO_WALL, wall, load(met, i, PATH_WIDTH)))
    for i in range(whole, t.shape[0]):
        t[i], wall = nearest_wall(sight.walls, eye, column(directions, i), NO_WALL, t[i])
        met[i] = met[i] if wall == NO_WALL else wall


SEEN_COUNTS = types.UniTuple(types.int64, 2)


@kernel(
    SEEN_COUNTS(
        SURFACE, SIGHT, PINHOLE, types.int64, types.int64, PIXEL_ROWS, POINT_ROWS, types.int8[::1]
    )
)
def trace_pixels(surface, sight, camera, first, width, pixels, points, numbers):
    """Cast the rays of n pixels of a picture, ``first`` to ``first`` + n - 1, counted row by row;
    the length of the outputs gives n.

    Returns the number of pixels that show the isosurface, and that of pixels that show walls or
    faces of the window. Pixel numbers go to ``pixels`` (2, n), ascending, and index-space points to
    ``points`` (2, n, 3): those of the isosurface to the first row, those of walls and faces to the
    second one, with the wall's number or WINDOW_FACE in ``numbers`` (n,). Pixels that show nothing
    are left out.
    """
    count = pixels.shape[1]
    directions = np.empty((3, count))
    t = np.empty(count)
    met = np.empty(count)
    # Generate the rays through pixel centres, and cast them.
    for i in range(count):
        y, x = divmod(first + i, width)
        put_column(directions, i, pixel_ray(camera, x + 0.5, y + 0.5))
    cast_sight(surface, sight, camera.eye, directions, t, met)
    hits = others = 0
    # Sort the hits into those on the isosurface and those on walls and faces. NO_WALL stands for
    # misses, too, whose distance is infinite.
    for i in range(count):
        if met[i] == NO_WALL:
            kind = 0
            place = hits
        else:
            kind = 1
            place = others
        if t[i] < math.inf:
            pixels[kind, place] = first + i
            put_point(points[kind], place, madd(camera.eye, t[i], column(directions, i)))
            if kind:
                numbers[place] = np.int8(met[i])
            hits = hits + 1 - kind
            others = others + kind
    return hits, others


@kernel(
    types.int64(
        SURFACE,
        SIGHT,
        PINHOLE,
        types.float32[:, ::1],
        types.uint32[::1],
        types.float32[:, ::1],
        types.int8[::1],
    )
)
def trace_places(surface, sight, camera, places, found, points, numbers):
    """Cast the rays through the ``places`` (n, 2; x, y) of a picture; return how many hit anything.

    Their rows go to ``found`` (n,), ascending, their hit points in index space to ``points`` (n,
    3), and the wall's number, WINDOW_FACE or NO_WALL to ``numbers`` (n,).
    """
    count = places.shape[0]
    directions = np.empty((3, count))
    t = np.empty(count)
    met = np.empty(count)
    for i in range(count):
        put_column(directions, i, pixel_ray(camera, places[i, 0], places[i, 1]))
    cast_sight(surface, sight, camera.eye, directions, t, met)
    hits = write_hits(camera.eye, directions, t, 0, found, points)
    for i in range(hits):
        numbers[i] = np.int8(met[found[i]])
    return hits


@kernel(types.void(VOXEL_ARRAY, types.float32[:, ::1], types.float32[::1]))
def read_values(voxels, points, values):
    """Fill ``values`` (n,) with the trilinear values at ``points`` (n, 3) in index space,
    inside of the box.
    """
    for i in range(values.shape[0]):
        values[i] = value(voxels, (float(points[i, 0]), float(points[i, 1]), float(points[i, 2])))
