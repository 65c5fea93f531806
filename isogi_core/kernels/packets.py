"""Many rays against an isosurface: scouts go ahead in float32, the scalar kernel has the last word.

A scout walks the bricks of ``bricks`` and stops at the first cell in which the field's sign, along the
ray and anywhere a float32 ray may be wrong about, is not certain to stay. Everything before that cell
is certain, so that the scalar ``cross_cell`` of that one cell gives the very hit that ``intersect.cast``
finds, when the ray enters it no later than the scout did; where it finds none (a grazed surface, noise
about the isovalue) or where a scout cannot tell, ``cast`` itself is asked. So both agree in every bit.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.bricks import BRICKS, POSITION_ERROR
from isogi_core.kernels.crossings import cross_cells, longest_of
from isogi_core.kernels.field import FIELD
from isogi_core.kernels.intersect import OUTSIDE, SOLID, UNKNOWN, cast
from isogi_core.kernels.lane_memory import gather, load, scatter
from isogi_core.kernels.lanes import COUNT, WIDTH, bits, doubles, ints, select
from isogi_core.kernels.records import FIELDS, prepare
from isogi_core.kernels.scouts import ASK, CLEAR, cell_of, scout
from isogi_core.kernels.vec import column

BATCH = 4096
"""Rays that are prepared and scouted together: their records stay in the second-level cache."""

LANES = WIDTH is not None

MOST_VOXELS, LONGEST_SIDE = 2**31, 2**18
"""Volumes of so many are too large for the scouts' words of 32 bits, or for what they prove in float32."""

ORIGINS = types.float64[:, ::1]
SIDES = types.int8[::1]
VECTOR = types.float64[::1]


@kernel()
def settle_lanes(flat, shape, rays, columns, owners, found, entries, spans, t, came):
    """Settle COUNT scouted rays, which stand in ``columns``; returns, as bits, those that ``cast`` must be asked."""
    isovalues, origins, directions, _ = rays
    nz, ny, nx = shape
    word, m = gather(found, columns), gather(owners, columns)
    known = (word != CLEAR) & (word != ASK)
    span = gather(spans[0], columns), gather(spans[1], columns)
    o = gather(origins[0], m), gather(origins[1], m), gather(origins[2], m)
    d = gather(directions[0], m), gather(directions[1], m), gather(directions[2], m)
    solid = (word & 1) != 0
    place = select(known, cell_of(word), 0)
    hit, near, sure = cross_cells(flat, shape, o, d, place, span, gather(isovalues, m), solid)
    late = (near - span[0]) * longest_of(d) - doubles(gather(entries, columns))
    sure = sure & known & (late <= 0.5 * POSITION_ERROR * max(nx, ny, nz))
    scatter(t, m, hit, sure)
    scatter(came, m, select(solid, ints(SOLID), OUTSIDE), sure)
    return bits(~sure)


@kernel()
def settle(field, flat, rays, count, owners, found, entries, spans, t, came):
    """Write the hits of ``count`` scouted rays to ``t`` and ``came`` at their ``owners``: as ``cast`` gives them."""
    isovalues, origins, directions, sides = rays
    met, hits = np.empty(count + COUNT, np.int32), 0
    for i in range(count):
        met[hits] = i
        hits += found[i] != CLEAR
    met[hits : hits + COUNT] = met[0]
    for i in range(0, hits, COUNT):
        asked = settle_lanes(flat, field.voxels.shape, rays, load(met, i), owners, found, entries, spans, t, came)
        lane = i
        while asked != 0 and lane < hits:
            if asked & 1:
                m = owners[met[lane]]
                t[m], came[m] = cast(field, isovalues[m], column(origins, m), column(directions, m), int(sides[m]))
            asked >>= 1
            lane += 1


@kernel()
def cast_by_lanes(field, bricks, isovalues, origins, directions, sides, t, came):
    """``cast_batch`` by scouts in lanes; at least COUNT rays."""
    room = min(BATCH, t.shape[0]) + COUNT
    records, spans, entries = np.empty((FIELDS, room), np.float32), np.empty((2, room)), np.empty(room, np.float32)
    owners, found = np.empty(room, np.int32), np.empty(room, np.int32)
    flat, shape = field.voxels.reshape(field.voxels.size), field.voxels.shape
    rays = isovalues, origins, directions, sides
    t[:] = math.inf
    came[:] = UNKNOWN
    for first in range(0, t.shape[0], BATCH):
        last = min(first + BATCH, t.shape[0])
        count = prepare(shape, bricks.shape, isovalues, origins, directions, sides, first, last, records, spans, owners)
        found[:count] = CLEAR
        scout(flat, shape, bricks, records, count, found, entries)
        settle(field, flat, rays, count, owners, found, entries, spans, t, came)


@kernel()
def cast_one_by_one(field, bricks, isovalues, origins, directions, sides, t, came):
    """``cast_batch`` where there are no lanes."""
    for m in range(t.shape[0]):
        t[m], came[m] = cast(field, isovalues[m], column(origins, m), column(directions, m), int(sides[m]))


@kernel()
def cast_batch(field, bricks, isovalues, origins, directions, sides, t, came):
    """First crossings of rays ``origins`` + t · ``directions`` (3, n), as ``intersect.cast`` gives them, to the bit.

    ``isovalues`` (n,) within the range of ``bricks``; ``sides`` (n,) OUTSIDE, SOLID or UNKNOWN; writes
    ``t`` (n,), inf where there is none, and ``came`` (n,). Rays need no order; neighbours side by side are faster.
    """
    fits = field.voxels.size < MOST_VOXELS and max(field.voxels.shape) < LONGEST_SIDE
    if LANES and fits and t.shape[0] >= COUNT:
        cast_by_lanes(field, bricks, isovalues, origins, directions, sides, t, came)
    else:
        cast_one_by_one(field, bricks, isovalues, origins, directions, sides, t, came)


RAYS = types.void(FIELD, BRICKS, VECTOR, ORIGINS, ORIGINS, SIDES, VECTOR, SIDES)


@kernel(RAYS)
def cast_rays(field, bricks, isovalues, origins, directions, sides, t, came):
    """``cast_batch`` for callers outside compiled code."""
    cast_batch(field, bricks, isovalues, origins, directions, sides, t, came)


@kernel(RAYS)
def cast_rays_one_by_one(field, bricks, isovalues, origins, directions, sides, t, came):
    """``cast_rays`` by the scalar kernel: the reference, and what there is without lanes."""
    cast_one_by_one(field, bricks, isovalues, origins, directions, sides, t, came)
