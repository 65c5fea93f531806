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
from isogi_core.kernels.scouts import CLEAR, FIELDS, prepare, scout
from isogi_core.kernels.vec import column

BATCH = 4096
"""Rays that are prepared and scouted together: their records stay in the second-level cache."""

LANES = WIDTH is not None

MOST_VOXELS = 2**30
"""Volumes with more voxels are too large for the scouts' words of 32 bits."""

ORIGINS = types.float64[:, ::1]
SIDES = types.int8[::1]
VECTOR = types.float64[::1]


@kernel()
def settle_lanes(flat, shape, rays, first, columns, found, entries, spans, t, came):
    """Settle COUNT rays, ``columns`` of the batch that begins with ray ``first``.

    Returns, as bits, those for which ``cast`` must be asked.
    """
    isovalues, origins, directions, _ = rays
    nz, ny, nx = shape
    word = gather(found, columns)
    known = word >= 0
    span = gather(spans[0], columns), gather(spans[1], columns)
    m = columns + first
    o = gather(origins[0], m), gather(origins[1], m), gather(origins[2], m)
    d = gather(directions[0], m), gather(directions[1], m), gather(directions[2], m)
    solid = (word & 1) != 0
    place = select(known, word >> 1, 0)
    hit, near, sure = cross_cells(flat, shape, o, d, place, span, gather(isovalues, m), solid)
    late = (near - span[0]) * longest_of(d) - doubles(gather(entries, columns))
    sure = sure & known & (late <= 0.5 * POSITION_ERROR * max(nx, ny, nz))
    scatter(t, m, hit, sure)
    scatter(came, m, select(solid, ints(SOLID), OUTSIDE), sure)
    return bits(~sure)


@kernel()
def settle(field, flat, rays, first, queue, count, found, entries, spans, t, came):
    """Write the hits of a batch's rays, of which scouts said ``found``, to ``t`` and ``came``: as ``cast`` gives them.

    ``queue`` (count,) are the columns that were scouted; it is overwritten.
    """
    isovalues, origins, directions, sides = rays
    hits = 0
    for i in range(count):
        column_ = queue[i]
        queue[hits] = column_
        hits += found[column_] != CLEAR
    padded = -(-hits // COUNT) * COUNT
    queue[hits:padded] = queue[0]
    for i in range(0, padded, COUNT):
        asked = settle_lanes(flat, field.voxels.shape, rays, first, load(queue, i), found, entries, spans, t, came)
        lane = i
        while asked != 0 and lane < hits:
            if asked & 1:
                m = first + queue[lane]
                t[m], came[m] = cast(field, isovalues[m], column(origins, m), column(directions, m), int(sides[m]))
            asked >>= 1
            lane += 1


@kernel()
def cast_by_lanes(field, bricks, isovalues, origins, directions, sides, t, came):
    """``cast_batch`` by scouts in lanes; at least COUNT rays."""
    records, spans = np.empty((FIELDS, BATCH), np.float32), np.empty((2, BATCH))
    queue, found = np.empty(BATCH, np.int32), np.empty(BATCH, np.int32)
    entries = np.empty(BATCH, np.float32)
    flat, shape = field.voxels.reshape(field.voxels.size), field.voxels.shape
    t[:] = math.inf
    came[:] = UNKNOWN
    for begin in range(0, t.shape[0], BATCH):
        last = min(begin + BATCH, t.shape[0])
        first = min(begin, last - COUNT)
        count = prepare(shape, bricks.shape, isovalues, origins, directions, sides, first, last, records, spans, queue)
        found[:] = CLEAR
        scout(flat, shape, bricks, records, queue, count, found, entries)
        rays = isovalues, origins, directions, sides
        settle(field, flat, rays, first, queue, count, found, entries, spans, t, came)


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
    if LANES and field.voxels.size < MOST_VOXELS and t.shape[0] >= COUNT:
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
