"""Casting many rays: the float32 traversal finds candidate cells,
the float64 intersection decides.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, kernel, record
from isogi_core.kernels.simd.maths import bits, f64, where
from isogi_core.kernels.simd.memory import gather, load, scatter
from isogi_core.kernels.simd.types import RAY_WIDTH, REGISTER_LANES
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS, POSITION_ERROR
from isogi_core.kernels.tracing.field import FIELD_RECORD
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, SOLID_SIGN, UNKNOWN_SIDE, cast
from isogi_core.kernels.tracing.ray_stream import Rays, fill_stream, make_stream
from isogi_core.kernels.tracing.simd_intersect import cross_cells
from isogi_core.kernels.tracing.slabs import longest
from isogi_core.kernels.tracing.traversal import MISS, UNSURE, cell_of, traverse
from isogi_core.kernels.tracing.vec import column

BATCH_RAYS = 4096
"""Rays that are traversed together; their stream fits the second-level cache."""

SIMD = REGISTER_LANES is not None

MOST_VOXELS = 2**31
LONGEST_SIDE = 2**18
"""Volumes with as many voxels, or as long a side, overflow the traversal's 32-bit words, or the
margins of its float32 tests.
"""

ORIGINS = types.float64[:, ::1]
SIDE_ARRAY = types.int8[::1]
RAYS_RECORD = record(Rays, REAL_ARRAY, ORIGINS, ORIGINS, SIDE_ARRAY)


class TracedSurface(NamedTuple):
    """An isosurface: the ``field``, the ``cells`` that may hold it (``ActiveCells``),
    and the normalised isovalue.
    """

    field: Any
    cells: Any
    isovalue: float


SURFACE = record(TracedSurface, FIELD_RECORD, ACTIVE_CELLS, types.float64)


@kernel()
def settle_vector(volume, rays, columns, stream, found, entries, hits):
    """Intersect RAY_WIDTH rays, at ``columns`` of a stream, with their candidate cells.

    Writes certain hits, and returns the other rays as bits: they need ``cast``. ``volume`` and
    ``found`` are those of ``traverse``.
    """
    (flat, shape), (isovalues, origins, directions, _), (_, spans, owners), (t, came) = (
        volume,
        rays,
        stream,
        hits,
    )
    # Gather the candidate cells, and the rays in float64.
    word = gather(found, columns)
    m = gather(owners, columns)
    known = (word != MISS) & (word != UNSURE)
    span = gather(spans[0], columns), gather(spans[1], columns)
    o = gather(origins[0], m), gather(origins[1], m), gather(origins[2], m)
    d = gather(directions[0], m), gather(directions[1], m), gather(directions[2], m)
    solid = (word & 1) != 0
    place = where(known, cell_of(word), 0)
    # Intersect in float64. The traversal tested the way up to its float32 entry into the cell. If
    # the true entry comes later, by more than the margins of those tests allow for, a part of the
    # way in front of it was not tested, and a hit is not sure.
    hit, near, sure = cross_cells(flat, shape, o, d, place, span, gather(isovalues, m), solid)
    late = (near - span[0]) * longest(d) - f64(gather(entries, columns))
    sure = sure & known & (late <= 0.5 * POSITION_ERROR * max(shape))
    scatter(t, m, hit, sure)
    scatter(came, m, where(solid, SOLID_SIGN, OUTSIDE_SIGN), sure)
    return bits(~sure)


@kernel()
def settle(field, volume, rays, count, stream, found, entries, hits):
    """Write the ``hits`` (t, came) of the ``count`` rays of a stream that were traversed, with
    the results of ``cast``.
    """
    isovalues, origins, directions, sides = rays
    t, came = hits
    # List the rays with a candidate cell.
    met = np.empty(count + RAY_WIDTH, np.int32)
    last = 0
    for i in range(count):
        met[last] = i
        last += found[i] != MISS
    met[last : last + RAY_WIDTH] = met[0]
    # Intersect them vector by vector; cast those that are not sure one by one.
    for i in range(0, last, RAY_WIDTH):
        asked = settle_vector(volume, rays, load(met, i, RAY_WIDTH), stream, found, entries, hits)
        lane = i
        while asked != 0 and lane < last:
            if asked & 1:
                m = stream.owners[met[lane]]
                t[m], came[m] = cast(
                    field, isovalues[m], column(origins, m), column(directions, m), int(sides[m])
                )
            asked >>= 1
            lane += 1


@kernel()
def cast_simd(field, cells, rays, t, came):
    """Cast rays as ``cast_batch`` does, by SIMD traversal; there are at least RAY_WIDTH rays."""
    room = min(BATCH_RAYS, t.shape[0]) + RAY_WIDTH
    stream = make_stream(room)
    entries = np.empty(room, np.float32)
    found = np.empty(room, np.int32)
    shape = field.voxels.shape
    volume = (field.voxels.reshape(field.voxels.size), shape)
    hits = (t, came)
    t[:] = math.inf
    came[:] = UNKNOWN_SIDE
    # Traverse and intersect one batch of rays after the other.
    for first in range(0, t.shape[0], BATCH_RAYS):
        count = fill_stream(
            shape, cells.shape, rays, first, min(first + BATCH_RAYS, t.shape[0]), stream
        )
        found[:count] = MISS
        traverse(volume, cells, stream.records, count, found, entries)
        settle(field, volume, rays, count, stream, found, entries, hits)


@kernel()
def cast_scalar(field, rays, t, came):
    """Cast rays as ``cast_batch`` does, one at a time."""
    for m in range(t.shape[0]):
        o, d = column(rays.origins, m), column(rays.directions, m)
        t[m], came[m] = cast(field, rays.isovalues[m], o, d, int(rays.sides[m]))


CAST = types.void(FIELD_RECORD, ACTIVE_CELLS, RAYS_RECORD, REAL_ARRAY, SIDE_ARRAY)


@kernel(CAST)
def cast_batch(field, cells, rays, t, came):
    """Find the first intersections of n ``Rays``, with the bits of ``intersect.cast``.

    Isovalues lie within the range of ``cells``. Writes ``t`` (n,), infinite for misses, and
    ``came`` (n,), the side that the ray arrives on. Rays need no order; coherent neighbours are
    faster.
    """
    fits = field.voxels.size < MOST_VOXELS and max(field.voxels.shape) < LONGEST_SIDE
    if SIMD and fits and t.shape[0] >= RAY_WIDTH:
        cast_simd(field, cells, rays, t, came)
    else:
        cast_scalar(field, rays, t, came)


@kernel(CAST)
def cast_one_by_one(field, cells, rays, t, came):
    """Cast rays by the scalar kernel: the reference, and the method without SIMD."""
    cast_scalar(field, rays, t, came)
