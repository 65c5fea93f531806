"""Depth peels: all isosurfaces that rays of a camera meet, front to back, until what is behind
hardly counts.

Walls let nothing through: the first that a ray meets is the last that it shows.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.camera import SIGHT, WINDOW_FACE, is_solid, look_through, put_point
from isogi_core.kernels.tracing.cast import TracedSurface, cast_batch
from isogi_core.kernels.tracing.field import FIELD_RECORD, clamp_cell
from isogi_core.kernels.tracing.intersect import SOLID_SIGN, UNKNOWN_SIDE, cross_cell
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.slabs import clip_box, cut_cell, reciprocals
from isogi_core.kernels.tracing.vec import column, madd, put_column
from isogi_core.kernels.tracing.walls import NO_WALL, nearest_wall

MAX_SURFACES = 4
"""Isosurfaces of a scene at most: the one that slides, and the pinned ones."""

MAX_PEELED_LAYERS = 64
"""Surfaces that a ray shows behind each other, at most. Where each lets nine tenths pass, what is
left of a ray's light is below LEAST before. The last of them is the first opaque one that is left.
"""

MIN_RAY_SHARE = 1.0 / 512.0
"""Share of a ray's light below which what lies behind is left out."""

NO_SIDE = -3
"""The side that a ray meets where it meets nothing; WINDOW_FACE is that of a window, and others are
from 0 on.
"""

FIRST_WALL_SIDE = 2 * MAX_SURFACES
"""The side that a ray meets on the first wall; one more on the next."""


class Shells(NamedTuple):
    """s isosurfaces of a ``field``: ``cells`` that may hold each (MOST of them: the others say
    nothing), normalised ``isovalues`` (s,), and the shares of rays that pass straight through,
    ``clears`` (s,). What all pass is not seen.
    """

    field: Any
    cells: Any
    isovalues: Any
    clears: Any


class Peeled(NamedTuple):
    """What rays meet, ray by ray and front to back, (m,) each.

    ``rays`` uint32 are their numbers, and ``points`` (m, 3) float32 in index space. ``sides`` int8
    are 2 k on the outer side of surface k, one more on its inner one, FIRST_WALL_SIDE + k on wall
    k, or WINDOW_FACE. ``ranks`` int8 tell how many of that side the ray has met before, and
    ``weights`` float32 the share of its light that comes from there.
    """

    rays: Any
    points: Any
    sides: Any
    ranks: Any
    weights: Any


class Crossings(NamedTuple):
    """The last crossings found of n rays with s surfaces: ways ``t`` from the eye, inf where there
    is none, and the sides that they ``came`` from, (s, n). Nothing is seen of them beyond ``far``
    (n,). ``walls`` (n,) are the numbers of those that end rays, ``ends`` (n,) from the eye.
    """

    t: Any
    came: Any
    far: Any
    walls: Any
    ends: Any


class Layers(NamedTuple):
    """What n rays show, layer behind layer: ``sides``, as of ``Peeled``, ways ``t`` and
    ``weights``, (MAX_PEELED_LAYERS + 1, n).

    The last of them has walls alone.
    """

    sides: Any
    t: Any
    weights: Any


BYTE_ARRAY = types.int8[::1]
SHELLS = record(
    Shells, FIELD_RECORD, types.UniTuple(ACTIVE_CELLS, MAX_SURFACES), REAL_ARRAY, REAL_ARRAY
)
PEELED = record(
    Peeled, types.uint32[::1], types.float32[:, ::1], BYTE_ARRAY, BYTE_ARRAY, types.float32[::1]
)


@kernel()
def rest_of_cell(field, isovalue, o, d, side):
    """What a ray meets that starts on its ``side`` of a surface within a cell: (way, side it came
    from).

    Where it meets nothing there, (inf, its side where it leaves the cell); and in any case the way
    to that place.
    """
    (nz, ny, nx) = field.voxels.shape
    inv = reciprocals(d)
    cell = (clamp_cell(o[0], nx), clamp_cell(o[1], ny), clamp_cell(o[2], nz))
    box = clip_box(field.voxels.shape, o, d)
    t, side = cross_cell((field.voxels, isovalue), (o, d, inv), cell, box, side)
    return t, side, cut_cell(o, inv, cell, box[0], box[1])[1]


@kernel()
def put_crossing(crossings, k, i, way, came):
    """Move the crossing of ray ``i`` with surface ``k`` on by a ``way``; whether that is still
    seen.
    """
    t = crossings.t[k, i] + way
    crossings.t[k, i] = t if t <= crossings.far[i] else math.inf
    crossings.came[k, i] = came
    return crossings.t[k, i] < math.inf


@kernel()
def leave_cells(shells, crossings, k, eye, directions, some):
    """Move ``some`` rays (m,) on to their next crossings with surface ``k`` where these are in the
    same cells.

    The others are moved to where they leave those cells: how many, and they are the first of
    ``some`` then. From a point on the surface vectors of rays would be of no use: each would ask
    ``cast``.
    """
    count = 0
    for j in range(some.shape[0]):
        i = some[j]
        o = madd(eye, crossings.t[k, i], column(directions, i))
        came = int(crossings.came[k, i])
        t, side, leave = rest_of_cell(
            shells.field, shells.isovalues[k], o, column(directions, i), -came
        )
        crosses = t < math.inf
        seen = put_crossing(crossings, k, i, t if crosses else leave, side if crosses else -side)
        some[count] = i
        count += seen and not crosses
    return count


@kernel()
def cast_to_next(shells, crossings, k, eye, directions, some):
    """Replace the crossings with surface ``k`` of ``some`` rays (m,), by their numbers, by the next
    ones.
    """
    n = some.shape[0]
    rays = Rays(
        np.full(n, shells.isovalues[k]), np.empty((3, n)), np.empty((3, n)), np.empty(n, np.int8)
    )
    t = np.empty(n)
    came = np.empty(n, np.int8)
    for j in range(n):
        i = some[j]
        d = column(directions, i)
        put_column(rays.origins, j, madd(eye, crossings.t[k, i], d))
        put_column(rays.directions, j, d)
        rays.sides[j] = -crossings.came[k, i]
    cast_batch(shells.field, shells.cells[k], rays, t, came)
    for j in range(n):
        put_crossing(crossings, k, some[j], t[j], came[j])


@kernel()
def opens(shells, p):
    """Whether a point is within an opaque surface; surfaces that let rays pass are looked into."""
    for k in range(shells.clears.shape[0]):
        if shells.clears[k] <= 0.0 and is_solid(
            TracedSurface(shells.field, shells.cells[k], shells.isovalues[k]), p
        ):
            return True
    return False


@kernel()
def first_crossings(shells, sight, eye, directions, layers, left):
    """The first crossings of rays from the ``eye`` behind a window, whose faces end rays as their
    first layer.
    """
    s = shells.clears.shape[0]
    n = directions.shape[1]
    ways = np.empty((3, n))
    every = np.arange(n)
    crossings = Crossings(
        np.empty((s, n)), np.full((s, n), UNKNOWN_SIDE, np.int8), ways[0], ways[1], ways[2]
    )
    for i in range(n):
        d = column(directions, i)
        near, far = look_through(sight.window, eye, d)
        crossings.ends[i], crossings.walls[i] = nearest_wall(sight.walls, eye, d, NO_WALL, math.inf)
        crossings.far[i] = min(far, crossings.ends[i])
        crossings.t[:, i] = near
        if 0.0 < near <= crossings.ends[i] and opens(shells, madd(eye, near, d)):
            layers.sides[0, i] = WINDOW_FACE
            layers.t[0, i] = near
            layers.weights[0, i] = 1.0
            left[i] = 0.0
    for k in range(s):
        if shells.clears[k] < 1.0:
            cast_to_next(shells, crossings, k, eye, directions, every)
        else:
            crossings.t[k] = math.inf
    return crossings


@kernel()
def next_surface(shells, crossings, i, opaque):
    """The surface whose crossing is next on ray ``i``, of those that are ``opaque`` alone where
    asked; -1 for none.
    """
    best = -1
    way = math.inf
    for k in range(shells.clears.shape[0]):
        if crossings.t[k, i] < way and (shells.clears[k] <= 0.0 or not opaque):
            best = k
            way = crossings.t[k, i]
    return best


@kernel()
def take_layer(shells, crossings, layers, number, left):
    """Make the next crossing of each ray its layer of this ``number``; of the share ``left`` (n,)
    some passes.

    Returns whether any ray goes on behind it.
    """
    some = False
    for i in range(left.shape[0]):
        if left[i] > 0.0:
            k = next_surface(shells, crossings, i, number == MAX_PEELED_LAYERS - 1)
        else:
            k = -1
        if k >= 0:
            clear = shells.clears[k]
            layers.sides[number, i] = 2 * k + (crossings.came[k, i] == SOLID_SIGN)
            layers.t[number, i] = crossings.t[k, i]
            layers.weights[number, i] = left[i] * (1.0 - clear)
            if left[i] * clear >= MIN_RAY_SHARE:
                left[i] = left[i] * clear
            else:
                left[i] = 0.0
            some = some or left[i] > 0.0
    return some


@kernel()
def take_walls(crossings, layers, left):
    """Make the wall that ends each ray the last of its layers, with all that is ``left`` (n,)."""
    for i in range(left.shape[0]):
        if left[i] > 0.0 and crossings.walls[i] != NO_WALL:
            last = 0
            while layers.sides[last, i] != NO_SIDE:
                last += 1
            layers.sides[last, i] = FIRST_WALL_SIDE + int(crossings.walls[i])
            layers.t[last, i] = crossings.ends[i]
            layers.weights[last, i] = left[i]
            left[i] = 0.0


@kernel()
def find_passing(layers, number, k, left, some):
    """Write the numbers of rays that go on past surface ``k`` in a layer to ``some`` (n,); returns
    how many.
    """
    count = 0
    for i in range(left.shape[0]):
        some[count] = i
        count += layers.sides[number, i] >> 1 == k and left[i] > 0.0
    return count


@kernel()
def write_layers(eye, directions, layers, peeled):
    """Write what rays show ray by ray; returns how much that is."""
    count = 0
    for i in range(directions.shape[1]):
        first = count
        for layer in range(MAX_PEELED_LAYERS + 1):
            side = layers.sides[layer, i]
            if side == NO_SIDE:
                break
            put_point(peeled.points, count, madd(eye, layers.t[layer, i], column(directions, i)))
            peeled.rays[count] = i
            peeled.sides[count] = side
            peeled.weights[count] = layers.weights[layer, i]
            peeled.ranks[count] = rank_of(peeled, first, count)
            count += 1
    return count


@kernel()
def rank_of(peeled, first, row):
    """How many of the rows from the ``first`` to a ``row`` are of the same side as that."""
    found = 0
    for other in range(first, row):
        found += peeled.sides[other] == peeled.sides[row]
    return found


@kernel(types.int64(SHELLS, SIGHT, types.UniTuple(types.float64, 3), REAL_ROWS, PEELED, REAL_ARRAY))
def peel_rays(shells, sight, eye, directions, peeled, left):
    """All that rays from the ``eye`` in ``directions`` (3, n) meet, in index space: how much that
    is.

    It is written to ``peeled``, which has room for (MAX_PEELED_LAYERS + 1) · n, and ``left`` (n,)
    is filled with the share of each ray's light that comes from behind all of it. The window of a
    ``sight`` has faces in what is opaque, and takes no walls away.
    """
    n = directions.shape[1]
    ways = np.empty((2, MAX_PEELED_LAYERS + 1, n))
    layers = Layers(np.full((MAX_PEELED_LAYERS + 1, n), NO_SIDE, np.int8), ways[0], ways[1])
    left[:] = 1.0
    crossings = first_crossings(shells, sight, eye, directions, layers, left)
    some = np.empty(n, np.int64)
    number = 0
    while take_layer(shells, crossings, layers, number, left) and number < MAX_PEELED_LAYERS - 1:
        for k in range(shells.clears.shape[0]):
            count = find_passing(layers, number, k, left, some)
            count = leave_cells(shells, crossings, k, eye, directions, some[:count])
            if count > 0:
                cast_to_next(shells, crossings, k, eye, directions, some[:count])
        number += 1
    take_walls(crossings, layers, left)
    return write_layers(eye, directions, layers, peeled)
