"""Origins of shadow rays from the points of a picture, and the order in which the points cast them.

Pixels cast rays in turns, from a coarse grid to a fine one. A point may adopt the answer of the
neighbours of earlier turns if all of them lie on one smooth surface with it, which saves its ray.
All of this depends on the view alone, and not on the light.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.shading.surface_points import (
    PIXEL_ARRAY,
    SURFACE_POINTS,
    number_at,
    point_of,
)
from isogi_core.kernels.tracing.cast import SURFACE
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, launch
from isogi_core.kernels.tracing.vec import add, length, scale, sub

MAX_BEND = 0.25
"""Largest distance of a point from the middle of two neighbours, relative to the neighbours'
distance, at which the three count as lying on one smooth surface.
"""

MAX_NEIGHBOUR_VOXELS = 4.0
"""Largest distance in voxels between two neighbours whose answer a point between them may
adopt: surfaces cast no shadow smaller than that.
"""

FIRST_TURN_STRIDE = 4
"""Distance along x and y between the pixels of the first turn."""

SAMPLING_TURNS = 5
"""Number of turns; each pixel of a later turn lies between four pixels of turns before."""

ANY_TURN = -1
"""Stands for all turns."""

PART = types.UniTuple(types.int64, 2)
ORDER_ARRAY = types.int32[::1]


class ShadowPoints(NamedTuple):
    """All surface points of a picture, as the origins of shadow rays to any light.

    - ``points``: ``SurfacePoints``.
    - ``rows`` (h, w) int32: number of the point in each pixel, -1 if there is none.
    - ``starts`` (m, 3) float64: ray origins in index space.
    - ``around`` (m, 4) int32: numbers of the neighbours of earlier turns whose answer a point may
      adopt; the first is -1 if it may not.
    - ``edgy`` (m,): True if half-shadows are looked for even if all neighbours agree.
    - ``order`` (m,) int32: the points turn by turn, ascending within each.
    """

    points: Any
    rows: Any
    starts: Any
    around: Any
    edgy: Any
    order: Any


SHADOW_POINTS = record(
    ShadowPoints,
    SURFACE_POINTS,
    types.int32[:, ::1],
    types.float64[:, ::1],
    types.int32[:, ::1],
    types.boolean[::1],
    ORDER_ARRAY,
)


@kernel()
def turn_of(x, y):
    """Return the turn of pixel (x, y), 0 to 4.

    Turn 0 has the pixels whose x and y are multiples of 4. Turns 1 and 2 halve that grid; turns 3
    and 4 fill in the other pixels, between neighbours at distance 1.
    """
    if (x | y) & 1:
        return 3 if x & y & 1 else 4
    return 2 if (x + y) & 2 else (x & 2) // 2


@kernel()
def step_of(turn):
    """Return the distance along x and y between the pixels of a ``turn`` and all turns before;
    1 for ANY_TURN.
    """
    if turn == 0:
        return FIRST_TURN_STRIDE
    if 0 < turn < 3:
        return 2
    return 1


@kernel()
def is_midway(points, m, a, b):
    """Return True if point ``m`` lies about halfway between its neighbours ``a`` and ``b``, as
    on one smooth surface; False if one of them is -1.
    """
    if a < 0 or b < 0:
        return False
    p, q = point_of(points, a), point_of(points, b)
    bend = sub(scale(add(p, q), 0.5), point_of(points, m))
    return length(bend) <= MAX_BEND * length(sub(p, q))


@kernel()
def apart(points, a, b):
    """Return the distance between points ``a`` and ``b``, in index space."""
    return length(sub(point_of(points, a), point_of(points, b)))


@kernel()
def are_near(points, a, b):
    """Return True if points ``a`` and ``b`` are at most MAX_NEIGHBOUR_VOXELS apart."""
    return apart(points, a, b) <= MAX_NEIGHBOUR_VOXELS


@kernel()
def near_between(points, m, a, b):
    """Return True if point ``m`` lies about halfway between ``a`` and ``b``,
    and these are near each other.
    """
    return is_midway(points, m, a, b) and are_near(points, a, b)


@kernel()
def has_close_neighbours(points, m, four):
    """Return True if point ``m`` has all ``four`` neighbours, and the nearest is at most half
    of MAX_NEIGHBOUR_VOXELS away.

    At a silhouette in front of matter the point's surface then goes on to at least one side. The
    edge has a row of such points on either side, two pixels wide, of which every other is enough.
    """
    nearest = math.inf
    for n in four:
        if n < 0:
            return False
        nearest = min(nearest, apart(points, m, n))
    return nearest <= 0.5 * MAX_NEIGHBOUR_VOXELS


@kernel()
def neighbours(rows, y, x, aside, step):
    """Return the numbers of four points around pixel (x, y): along the axes at a distance of
    ``step`` if ``aside`` is 0, diagonal if it equals ``step``.
    """
    a = number_at(rows, y - aside, x - step)
    b = number_at(rows, y + aside, x + step)
    return a, b, number_at(rows, y - step, x + aside), number_at(rows, y + step, x - aside)


@kernel()
def on_one_surface(points, m, four):
    """Return True if point ``m`` lies about halfway between each of the two opposite pairs of
    its ``four`` neighbours, as on one smooth surface.
    """
    return is_midway(points, m, four[0], four[1]) and is_midway(points, m, four[2], four[3])


@kernel(types.void(SURFACE, SHADOW_POINTS, PART))
def prepare_points(surface, picture, part):
    """Fill ``starts``, ``around`` and ``edgy`` of the points of a ``part``, a range (begin, end).

    Neighbours are diagonal in odd turns, and next to the point along the axes in even ones. Points
    are ``edgy`` at silhouettes and creases, behind which half-shadows may begin. If one surface
    hides another there, only every other point is: such edges are two pixels wide, and half-shadows
    that are found spread to their neighbours.
    """
    rows = picture.rows
    points = picture.points.points
    around = picture.around
    width = picture.rows.shape[1]
    for m in range(part[0], part[1]):
        p = point_of(points, m)
        n = point_of(picture.points.normals, m)
        # Offset the origin of shadow rays from the surface.
        start = launch(surface.field, surface.isovalue, p, n, OUTSIDE_SIGN)
        picture.starts[m, 0], picture.starts[m, 1], picture.starts[m, 2] = start
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
        # A point adopts answers only between neighbours on one smooth surface; neighbours two or
        # more pixels apart must also be near each other.
        turn = turn_of(x, y)
        step = step_of(turn)
        four = neighbours(rows, y, x, step * (turn & 1), step)
        smooth = turn > 0 and on_one_surface(points, m, four)
        if smooth and step > 1:
            smooth = are_near(points, four[0], four[1]) and are_near(points, four[2], four[3])
        around[m, 0] = four[0] if smooth else -1
        around[m, 1] = four[1]
        around[m, 2] = four[2]
        around[m, 3] = four[3]
        # Look for half-shadows if the surface breaks off between this pixel and the next. Skip
        # every other pixel of an edge that is two pixels wide.
        adjacent = neighbours(rows, y, x, 0, 1)
        skipped = (x + y) & 1 and has_close_neighbours(points, m, adjacent)
        picture.edgy[m] = not skipped and not on_one_surface(points, m, adjacent)


@kernel(types.void(PIXEL_ARRAY, types.int64, ORDER_ARRAY, types.int64[::1]))
def sort_by_turn(pixels, width, order, ends):
    """Fill the ``order`` (m,) with the numbers of the points at ``pixels`` (y · ``width`` + x),
    turn by turn and ascending within each, by a counting sort.

    ``ends`` (SAMPLING_TURNS + 1,) is filled, too: turn t has ``order[ends[t] : ends[t + 1]]``, and
    ``ends[0]`` is 0.
    """
    # Count the points of each turn, and sum the counts: a turn begins where the one before ends.
    ends[:] = 0
    for m in range(pixels.shape[0]):
        y, x = divmod(np.int64(pixels[m]), width)
        ends[turn_of(x, y) + 1] += 1
    for turn in range(SAMPLING_TURNS):
        ends[turn + 1] += ends[turn]
    # Put each point at the next free place of its turn.
    places = ends.copy()
    for m in range(pixels.shape[0]):
        y, x = divmod(np.int64(pixels[m]), width)
        turn = turn_of(x, y)
        order[places[turn]] = m
        places[turn] += 1
