"""Depth peeling: all surfaces that camera rays meet, front to back, until hardly any light is left
for those behind. Walls are opaque: the first wall on a ray is the last layer.
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
"""Largest number of isosurfaces of a scene: the one that slides, and the pinned ones."""

MAX_PEELED_LAYERS = 64
"""Largest number of layers on a ray; the last of them is the next opaque surface.

If each layer lets nine tenths pass, the rest of a ray's light is below MIN_RAY_SHARE before that.
"""

MIN_RAY_SHARE = 1.0 / 512.0
"""Least share of a ray's light: surfaces behind are left out once less than this passes."""

NO_SIDE = -3
"""Side of a ray that meets nothing; WINDOW_FACE is that of a window, other sides are ≥ 0."""

FIRST_WALL_SIDE = 2 * MAX_SURFACES
"""Side of a ray that meets the first wall; the next wall has the next number."""


class Shells(NamedTuple):
    """s isosurfaces of a ``field``.

    ``cells`` may hold each of them (MAX_SURFACES records, of which only s are read); ``isovalues``
    (s,) are normalised; ``clears`` (s,) are the shares of rays that pass straight through. A
    surface that all rays pass is not seen.
    """

    field: Any
    cells: Any
    isovalues: Any
    clears: Any


class Peeled(NamedTuple):
    """Hits of rays, ray by ray and front to back, (m,) each.

    - ``rays`` uint32: number of the ray; ``points`` (m, 3) float32: in index space.
    - ``sides`` int8: 2 k on the outer side of surface k, 2 k + 1 on its inner side, FIRST_WALL_SIDE
      + k on wall k, or WINDOW_FACE.
    - ``ranks`` int8: hits of the same side earlier on the ray.
    - ``weights`` float32: share of the ray's light that comes from here.
    """

    rays: Any
    points: Any
    sides: Any
    ranks: Any
    weights: Any


class Crossings(NamedTuple):
    """The latest crossings of n rays with s surfaces.

    - ``t`` (s, n): distance from the eye, infinite if there is none; ``came`` (s, n): side that the
      ray arrives on.
    - ``far`` (n,): distance up to which anything is seen.
    - ``walls``, ``ends`` (n,): number and distance of the wall that ends the ray.
    """

    t: Any
    came: Any
    far: Any
    walls: Any
    ends: Any


class Layers(NamedTuple):
    """Layers of n rays: ``sides`` as in ``Peeled``, distances ``t`` and
    ``weights``, (MAX_PEELED_LAYERS + 1, n). The last layer holds only walls.
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
    """Intersect a ray that starts on its ``side`` of a surface with the surface in the rest of its
    cell.

    Returns (t, side it came from) of the hit, or (inf, side at the exit), followed by the distance
    of the exit.
    """
    (nz, ny, nx) = field.voxels.shape
    inv = reciprocals(d)
    cell = (clamp_cell(o[0], nx), clamp_cell(o[1], ny), clamp_cell(o[2], nz))
    box = clip_box(field.voxels.shape, o, d)
    t, side = cross_cell((field.voxels, isovalue), (o, d, inv), cell, box, side)
    return t, side, cut_cell(o, inv, cell, box[0], box[1])[1]


@kernel()
def put_crossing(crossings, k, i, way, came):
    """Move the crossing of ray ``i`` with surface ``k`` on by the distance ``way``; return True
    if it can still be seen.
    """
    t = crossings.t[k, i] + way
    crossings.t[k, i] = t if t <= crossings.far[i] else math.inf
    crossings.came[k, i] = came
    return crossings.t[k, i] < math.inf


@kernel()
def leave_cells(shells, crossings, k, eye, directions, some):
    """Move ``some`` rays (m,) to their next crossings with surface ``k`` if these lie in the same
    cells.

    The other rays are moved to the exits of their cells and listed first in ``some``; returns their
    number. From a point on the surface, SIMD traversal would leave each ray to ``cast``.
    """
    count = 0
    for j in range(some.shape[0]):
        i = some[j]
        # Start from the crossing, on the surface's other side.
        o = madd(eye, crossings.t[k, i], column(directions, i))
        came = int(crossings.came[k, i])
        t, side, leave = rest_of_cell(
            shells.field, shells.isovalues[k], o, column(directions, i), -came
        )
        # Go to a second crossing in the cell, or to its exit. There ``came`` becomes the opposite
        # of the side at the exit, as ``cast_to_next`` starts on the opposite of ``came``.
        crosses = t < math.inf
        seen = put_crossing(crossings, k, i, t if crosses else leave, side if crosses else -side)
        some[count] = i
        count += seen and not crosses
    return count


@kernel()
def cast_to_next(shells, crossings, k, eye, directions, some):
    """Move ``some`` rays (m,) on to their next crossings with surface ``k``, from the points at
    which their ``crossings`` are.

    Such a point is a crossing, the exit of a cell (see ``leave_cells``), or the first visible point
    of the ray. The ray leaves it on the side opposite of ``came``; UNKNOWN_SIDE is its own
    opposite.
    """
    n = some.shape[0]
    rays = Rays(
        np.full(n, shells.isovalues[k]), np.empty((3, n)), np.empty((3, n)), np.empty(n, np.int8)
    )
    t = np.empty(n)
    came = np.empty(n, np.int8)
    # Start each ray at its point, on the known side: it does not find the crossing there again.
    for j in range(n):
        i = some[j]
        d = column(directions, i)
        put_column(rays.origins, j, madd(eye, crossings.t[k, i], d))
        put_column(rays.directions, j, d)
        rays.sides[j] = -crossings.came[k, i]
    # Add the distances from there to those from the eye.
    cast_batch(shells.field, shells.cells[k], rays, t, came)
    for j in range(n):
        put_crossing(crossings, k, some[j], t[j], came[j])


@kernel()
def opens(shells, p):
    """Return True if the point ``p`` lies inside of an opaque surface,
    which a window's face then cuts open.
    """
    for k in range(shells.clears.shape[0]):
        if shells.clears[k] <= 0.0 and is_solid(
            TracedSurface(shells.field, shells.cells[k], shells.isovalues[k]), p
        ):
            return True
    return False


@kernel()
def first_crossings(shells, sight, eye, directions, layers, left):
    """Find the first crossing of each ray from the ``eye`` with each surface, in the part of the
    ray that the window leaves visible.

    If a ray enters that part inside of an opaque surface, the window cuts matter open there: the
    face of the window is the ray's first and only layer, and its share ``left`` becomes 0.
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
        # Clip the ray by the window and the first wall.
        near, far = look_through(sight.window, eye, d)
        crossings.ends[i], crossings.walls[i] = nearest_wall(sight.walls, eye, d, NO_WALL, math.inf)
        crossings.far[i] = min(far, crossings.ends[i])
        crossings.t[:, i] = near
        # Show the cut face if the ray begins at a plane of the window, and no wall hides it.
        if 0.0 < near <= crossings.ends[i] and opens(shells, madd(eye, near, d)):
            layers.sides[0, i] = WINDOW_FACE
            layers.t[0, i] = near
            layers.weights[0, i] = 1.0
            left[i] = 0.0
    # Cast the rays at each surface that can be seen, from the window on. They start on no surface,
    # so their sides are UNKNOWN_SIDE.
    for k in range(s):
        if shells.clears[k] < 1.0:
            cast_to_next(shells, crossings, k, eye, directions, every)
        else:
            crossings.t[k] = math.inf
    return crossings


@kernel()
def next_surface(shells, crossings, i, opaque):
    """Return the surface with the next crossing on ray ``i``, or -1;
    only opaque surfaces if ``opaque``.
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
    """Make the next crossing of each ray its layer ``number``, and reduce the share ``left``
    (n,) that passes; return True if any ray goes on.
    """
    some = False
    for i in range(left.shape[0]):
        # The last layer, walls aside, is the next opaque surface: clear ones are skipped.
        if left[i] > 0.0:
            k = next_surface(shells, crossings, i, number == MAX_PEELED_LAYERS - 1)
        else:
            k = -1
        if k >= 0:
            # The surface keeps 1 - clear of the light that is left; a small rest is dropped.
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
    """Make the wall that ends each ray its last layer, with the share ``left`` (n,)."""
    for i in range(left.shape[0]):
        if left[i] > 0.0 and crossings.walls[i] != NO_WALL:
            # Find the first free layer of the ray.
            last = 0
            while layers.sides[last, i] != NO_SIDE:
                last += 1
            layers.sides[last, i] = FIRST_WALL_SIDE + int(crossings.walls[i])
            layers.t[last, i] = crossings.ends[i]
            layers.weights[last, i] = left[i]
            left[i] = 0.0


@kernel()
def find_passing(layers, number, k, left, some):
    """List in ``some`` (n,) the rays whose layer ``number`` is surface ``k``, and that have light
    left for layers behind; return their number.
    """
    count = 0
    for i in range(left.shape[0]):
        some[count] = i
        count += layers.sides[number, i] >> 1 == k and left[i] > 0.0
    return count


@kernel()
def write_layers(eye, directions, layers, peeled):
    """Write the layers of all rays to ``peeled``, ray by ray; return their number."""
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
    """Return the number of rows from ``first`` up to ``row`` that have the same side as ``row``."""
    found = 0
    for other in range(first, row):
        found += peeled.sides[other] == peeled.sides[row]
    return found


@kernel(types.int64(SHELLS, SIGHT, types.UniTuple(types.float64, 3), REAL_ROWS, PEELED, REAL_ARRAY))
def peel_rays(shells, sight, eye, directions, peeled, left):
    """Find all surfaces and walls that rays from the ``eye`` in ``directions`` (3, n) meet, in
    index space; return the number of rows in ``peeled``.

    ``peeled`` has room for (MAX_PEELED_LAYERS + 1) · n rows. ``left`` (n,) is filled with the share
    of each ray's light that comes from behind all of it. The window of a ``sight`` has faces in
    opaque matter, and does not cut walls.
    """
    n = directions.shape[1]
    ways = np.empty((2, MAX_PEELED_LAYERS + 1, n))
    layers = Layers(np.full((MAX_PEELED_LAYERS + 1, n), NO_SIDE, np.int8), ways[0], ways[1])
    left[:] = 1.0
    # Find the first crossing of each ray with each surface.
    crossings = first_crossings(shells, sight, eye, directions, layers, left)
    some = np.empty(n, np.int64)
    number = 0
    # Take the nearest crossing of each ray as its next layer, and move rays that pass to their next
    # crossing.
    while take_layer(shells, crossings, layers, number, left) and number < MAX_PEELED_LAYERS - 1:
        for k in range(shells.clears.shape[0]):
            count = find_passing(layers, number, k, left, some)
            count = leave_cells(shells, crossings, k, eye, directions, some[:count])
            if count > 0:
                cast_to_next(shells, crossings, k, eye, directions, some[:count])
        number += 1
    take_walls(crossings, layers, left)
    return write_layers(eye, directions, layers, peeled)
