"""Ray streams: rays as the traversal takes them, mirrored to ascending directions, in float32,
in structure-of-arrays layout.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import bits, f32, lane_numbers, where
from isogi_core.kernels.simd.memory import load, store
from isogi_core.kernels.simd.types import RAY_WIDTH
from isogi_core.kernels.tracing.active_cells import BRICK_CELLS
from isogi_core.kernels.tracing.intersect import UNKNOWN_SIDE
from isogi_core.kernels.tracing.slabs import clip_box, longest

FIELDS = 10
"""Numbers of a ray in a stream: origin and direction (x, y, z, mirrored), distance to the exit,
isovalue, sign, mirror.
"""

EVERY = (1 << RAY_WIDTH) - 1
"""Bits of all lanes."""

STRAY_BIT = 8
"""Bit of a mirror that marks a ray which only ``cast`` can follow."""


class Rays(NamedTuple):
    """n rays ``origins`` + t · ``directions`` (3, n), float64, in index space; each may meet
    another isosurface.

    ``isovalues`` (n,) float64; ``sides`` (n,) int8: OUTSIDE_SIGN, SOLID_SIGN or UNKNOWN_SIDE, on
    which rays start.
    """

    isovalues: Any
    origins: Any
    directions: Any
    sides: Any


class RayStream(NamedTuple):
    """The rays of a batch that meet the volume's box, in the first columns of arrays (…, n).

    ``records`` float32 (FIELDS, n); ``spans`` float64 (2, n): part of each ray in the box;
    ``owners`` int32 (n,): number of the ray.
    """

    records: Any
    spans: Any
    owners: Any


@kernel()
def make_stream(n):
    """Allocate a stream of ``n`` rays."""
    return RayStream(np.empty((FIELDS, n), np.float32), np.empty((2, n)), np.empty(n, np.int32))


@kernel()
def mirrored_axis(d, here, size):
    """Mirror a direction's component and a coordinate along an axis of ``size`` if the ray
    descends it; return (component, coordinate, mask of the mirrored rays).
    """
    descends = d < 0.0
    return f32(abs(d)), f32(where(descends, size - here, here)), descends


@kernel()
def put_rays(shape, bricks, rays, m, stream, r):
    """Write RAY_WIDTH rays from ray ``m`` on to the columns from ``r`` on; return those that meet
    the box, as bits.

    ``shape`` are the voxels and ``bricks`` the bricks along z, y, x.
    """
    records, spans, _ = stream
    isovalues, origins, directions, sides = rays
    o = (
        load(origins[0], m, RAY_WIDTH),
        load(origins[1], m, RAY_WIDTH),
        load(origins[2], m, RAY_WIDTH),
    )
    d = (
        load(directions[0], m, RAY_WIDTH),
        load(directions[1], m, RAY_WIDTH),
        load(directions[2], m, RAY_WIDTH),
    )
    # Clip the rays to the box, and scale directions by their largest component. Rays without a
    # finite direction are marked for ``cast``, with numbers that do no harm here.
    near, far = clip_box(shape, o, d)
    most = longest(d)
    shrink = 1.0 / most
    sound = (shrink < math.inf) & (far < math.inf)
    mirror = where(sound, 0, STRAY_BIT)
    # Mirror each axis that a ray descends.
    for a in range(3):
        step = where(sound, d[a] * shrink, 1.0)
        here = where(sound, o[a] + near * d[a], 0.0)
        step, here, descends = mirrored_axis(step, here, float(BRICK_CELLS * bricks[2 - a]))
        mirror = mirror + where(descends, 1 << a, 0)
        store(records[a], r, here)
        store(records[3 + a], r, step)
    # Write the side of rays that start in the box as the sign of the field less the isovalue, which
    # is positive on the solid side: minus the sign of the side.
    side = f32(load(sides, m, RAY_WIDTH))
    store(records[6], r, f32((far - near) * most))
    store(records[7], r, f32(load(isovalues, m, RAY_WIDTH)))
    store(records[8], r, where(near == 0.0, -side, float(UNKNOWN_SIDE)))
    store(records[9], r, f32(mirror))
    store(spans[0], r, near)
    store(spans[1], r, far)
    return bits(near < far)


@kernel()
def compact_rays(stream, r, met):
    """Keep those of the RAY_WIDTH columns from ``r`` on whose bit is set in ``met``: move them
    together, in order, to begin at ``r``. Return the column behind the last kept one.
    """
    records, spans, owners = stream
    end = r
    for column in range(r, r + RAY_WIDTH):
        if met & 1:
            for field in range(FIELDS):
                records[field, end] = records[field, column]
            spans[0, end], spans[1, end] = spans[0, column], spans[1, column]
            owners[end] = owners[column]
            end += 1
        met >>= 1
    return end


@kernel()
def fill_stream(shape, bricks, rays, first, last, stream):
    """Write the ``rays`` from ``first`` to ``last`` that meet the box to a ``stream``; return their
    number.

    ``shape`` are the voxels and ``bricks`` the bricks along z, y, x. At least RAY_WIDTH rays exist,
    and the stream has room for RAY_WIDTH more.
    """
    count = 0
    for i in range(first, last, RAY_WIDTH):
        # The last vector is moved back to end at the last ray; rays that it repeats are masked out.
        m = max(min(i, last - RAY_WIDTH), 0)
        met = put_rays(shape, bricks, rays, m, stream, count)
        store(stream.owners, count, lane_numbers() + m)
        met &= EVERY << (i - m)
        if met == EVERY:
            count = count + RAY_WIDTH
        else:
            count = compact_rays(stream, count, met)
    return count
