"""Shadow rays from a picture's points, whatever the light: where they start, and which point asks
in which turn.

Pixels are asked in turns, so that a point may believe those around it that were asked before, where
these are of one smooth surface with it.
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
"""How far a point may be from the middle of two neighbours, over their distance, for what these see
to hold for it.
"""

MAX_NEIGHBOUR_VOXELS = 4.0
"""Voxels between two neighbours, at most, of which a point amid them believes something: surfaces
hide nothing smaller.
"""

FIRST_TURN_STRIDE = 4
"""Pixels asked in the first turn are so far apart along x and y."""

SAMPLING_TURNS = 5
"""Turns in which pixels are asked, each of them amid four of the turns before."""

ANY_TURN = -1
"""In place of a turn: all of them."""

PART = types.UniTuple(types.int64, 2)
ORDER_ARRAY = types.int32[::1]


class ShadowPoints(NamedTuple):
    """All surface points of a picture, as shadow rays to any light start from them.

    ``points`` are ``SurfacePoints``, ``rows`` (h, w) their numbers, -1 where none; ``starts`` (m,
    3) float64 in index space; ``around`` (m, 4) the neighbours that are asked before a point, first
    -1 where they say nothing of it; ``edgy`` (m,) whether half-shadows are looked for there even
    where all neighbours agree; ``order`` (m,) the points turn by turn, those of one turn ascending.
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
    """When a pixel is asked: 0 where 4 divides x and y; the last two turns amid next neighbours,
    others two apart.
    """
    if (x | y) & 1:
        return 3 if x & y & 1 else 4
    return 2 if (x + y) & 2 else (x & 2) // 2


@kernel()
def step_of(turn):
    """How far apart the pixels of a turn and of those before it are, along x and y; 1 of
    ANY_TURN.
    """
    if turn == 0:
        return FIRST_TURN_STRIDE
    if 0 < turn < 3:
        return 2
    return 1


@kernel()
def is_midway(points, m, a, b):
    """Whether point ``m`` is in the middle of its neighbours ``a`` and ``b``, as on one smooth
    surface.
    """
    if a < 0 or b < 0:
        return False
    p, q = point_of(points, a), point_of(points, b)
    bend = sub(scale(add(p, q), 0.5), point_of(points, m))
    return length(bend) <= MAX_BEND * length(sub(p, q))


@kernel()
def apart(points, a, b):
    """How far points ``a`` and ``b`` are from each other, in index space."""
    return length(sub(point_of(points, a), point_of(points, b)))


@kernel()
def are_near(points, a, b):
    """Whether a point amid points ``a`` and ``b`` may believe what they see."""
    return apart(points, a, b) <= MAX_NEIGHBOUR_VOXELS


@kernel()
def near_between(points, m, a, b):
    """Whether point ``m`` is in the middle of ``a`` and ``b``, as on one smooth surface, and these
    are near.
    """
    return is_midway(points, m, a, b) and are_near(points, a, b)


@kernel()
def amid_near(points, m, four):
    """Whether point ``m`` has all ``four`` neighbours, and the nearest is no farther than that of
    two that are near.
    """
    nearest = math.inf
    for n in four:
        if n < 0:
            return False
        nearest = min(nearest, apart(points, m, n))
    return nearest <= 0.5 * MAX_NEIGHBOUR_VOXELS


@kernel()
def neighbours(rows, y, x, aside, step):
    """Numbers of the four points at a distance of ``step`` about a pixel: diagonal where ``aside``
    is that, too.
    """
    a = number_at(rows, y - aside, x - step)
    b = number_at(rows, y + aside, x + step)
    return a, b, number_at(rows, y - step, x + aside), number_at(rows, y + step, x - aside)


@kernel()
def on_one_surface(points, m, four):
    """Whether point ``m`` is amid ``four`` neighbours, two and two of them opposite, as on one
    smooth surface.
    """
    return is_midway(points, m, four[0], four[1]) and is_midway(points, m, four[2], four[3])


@kernel(types.void(SURFACE, SHADOW_POINTS, PART))
def prepare_points(surface, picture, part):
    """Fill ``starts``, ``around`` and ``edgy`` of the points of a ``part``.

    Neighbours ``around`` are the diagonal ones of a point of an odd turn, and those beside, above
    and below it of an even one. Points are ``edgy`` at edges of the surface, behind which
    half-shadows may begin; where one surface hides another every other one, as such edges are two
    pixels wide, and those found have their neighbours asked.
    """
    rows = picture.rows
    points = picture.points.points
    around = picture.around
    width = picture.rows.shape[1]
    for m in range(part[0], part[1]):
        p = point_of(points, m)
        n = point_of(picture.points.normals, m)
        start = launch(surface.field, surface.isovalue, p, n, OUTSIDE_SIGN)
        picture.starts[m, 0], picture.starts[m, 1], picture.starts[m, 2] = start
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
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
        beside = neighbours(rows, y, x, 0, 1)
        left_out = (x + y) & 1 and amid_near(points, m, beside)
        picture.edgy[m] = not left_out and not on_one_surface(points, m, beside)


@kernel(types.void(PIXEL_ARRAY, types.int64, ORDER_ARRAY, types.int64[::1]))
def sort_by_turn(pixels, width, order, ends):
    """Fill the ``order`` (m,) of points at ``pixels`` of a picture so wide, and the ``ends``
    (SAMPLING_TURNS + 1,) of turns.

    Points of turn t are those from ``ends[t]`` to ``ends[t + 1]``.
    """
    ends[:] = 0
    for m in range(pixels.shape[0]):
        y, x = divmod(np.int64(pixels[m]), width)
        ends[turn_of(x, y) + 1] += 1
    for turn in range(SAMPLING_TURNS):
        ends[turn + 1] += ends[turn]
    places = ends.copy()
    for m in range(pixels.shape[0]):
        y, x = divmod(np.int64(pixels[m]), width)
        turn = turn_of(x, y)
        order[places[turn]] = m
        places[turn] += 1
