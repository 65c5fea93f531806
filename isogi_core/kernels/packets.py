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
from isogi_core.kernels.field import FIELD, clamp_cell
from isogi_core.kernels.intersect import OUTSIDE, SOLID, UNKNOWN, cast, cross_cell, cut_cell, reciprocal
from isogi_core.kernels.lanes import WIDTH
from isogi_core.kernels.scouts import CLEAR, FIELDS, prepare, scout
from isogi_core.kernels.vec import column, madd

BATCH = 4096
"""Rays that are prepared and scouted together: their records stay in the second-level cache."""

LANES = WIDTH is not None

MOST_VOXELS = 2**30
"""Volumes with more voxels are too large for the scouts' words of 32 bits."""

ORIGINS = types.float64[:, ::1]
SIDES = types.int8[::1]
VECTOR = types.float64[::1]


@kernel()
def settle_ray(field, iso, ray, span, word, entry):
    """The hit of a ``ray`` (o, d, side) of which a scout said ``word``: (t, side), exactly as ``cast`` says."""
    nz, ny, nx = field.voxels.shape
    if word == CLEAR:
        return math.inf, UNKNOWN
    o, d, side = ray
    if word >= 0:
        place = word >> 1
        cell = place % nx, place // nx % ny, place // (nx * ny)
        inv = reciprocal(d[0]), reciprocal(d[1]), reciprocal(d[2])
        near, far = cut_cell(o, inv, cell, span[0], span[1])
        longest = max(abs(d[0]), abs(d[1]), abs(d[2]))
        late = (near - span[0]) * longest - entry
        middle = madd(o, 0.5 * (near + far), d)
        home = clamp_cell(middle[0], nx) == cell[0] and clamp_cell(middle[1], ny) == cell[1]
        home &= clamp_cell(middle[2], nz) == cell[2]
        if home and late <= 0.5 * POSITION_ERROR * max(nx, ny, nz):
            from_side = SOLID if word & 1 else OUTSIDE
            t, came = cross_cell(field.voxels, iso, o, d, inv, cell, span[0], span[1], from_side)
            if t < math.inf:
                return t, came
    return cast(field, iso, o, d, side)


@kernel()
def cast_by_lanes(field, bricks, isovalues, origins, directions, sides, t, came):
    """``cast_batch`` by scouts in lanes."""
    rays, owners = np.empty((FIELDS, BATCH), np.float32), np.empty(BATCH, np.int64)
    spans, found = np.empty((BATCH, 2)), np.empty(BATCH, np.int32)
    entries = np.empty(BATCH, np.float32)
    flat = field.voxels.reshape(field.voxels.size)
    for first in range(0, t.shape[0], BATCH):
        last = min(first + BATCH, t.shape[0])
        t[first:last] = math.inf
        came[first:last] = UNKNOWN
        count = prepare(field, bricks.shape, isovalues, origins, directions, sides, first, last, rays, owners, spans)
        found[:count] = CLEAR
        scout(flat, field.voxels.shape, bricks, rays, count, found, entries)
        for i in range(count):
            m = owners[i]
            ray = column(origins, m), column(directions, m), int(sides[m])
            t[m], came[m] = settle_ray(field, isovalues[m], ray, (spans[i, 0], spans[i, 1]), found[i], entries[i])


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
    if LANES and field.voxels.size < MOST_VOXELS:
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
