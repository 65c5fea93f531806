"""Radiance transfer of texels: the ends of their paths, projected onto spherical harmonics (S1, eqs. 6 and 8)."""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.bricks import BRICKS
from isogi_core.kernels.field import FIELD, OFFSET, normal, to_index, value
from isogi_core.kernels.harmonics import accumulate
from isogi_core.kernels.plateaus import along, leave_plateau
from isogi_core.kernels.reals import ABREAST, read
from isogi_core.kernels.rng import mix
from isogi_core.kernels.vec import column, is_zero, length, put_column
from isogi_core.kernels.waves import WAVE, walk_paths, whole

VECTOR = types.float64[::1]
COLUMNS = types.float64[:, ::1]
TEXELS = types.int32[:, ::1]


@kernel()
def texel_seed(z, y, x, half):
    """The sequence of a lattice texel and one of its two independent randomisations (half = 0 or 1)."""
    return mix(mix(mix(z, y), x), half)


@kernel(exact=True)
def hemmed(field, p, n, level):
    """Whether it is solid an OFFSET above ``p`` along the normal ``n``: light has no room to arrive there."""
    up = to_index(n, field.spacing)
    return value(field.voxels, along(field.voxels.shape, p, up, OFFSET / length(up))) > level


@kernel(types.void(FIELD, VECTOR, TEXELS, COLUMNS, COLUMNS, VECTOR, types.boolean[::1]))
def locate_texels(field, step, texels, points, normals, isovalues, void):
    """Where ``texels`` (m, 3; z, y, x) are, ``points`` (3, m), and the surface through each of them.

    ``step`` (3,) voxels per texel along x, y, z. Writes ``normals`` (3, m), the voxel-space isovalue each
    texel is lit on, a float32, and whether it is void: no gradient there, no number, no side of its own, or hemmed in.
    Those at the edge of a plateau leave their place: see ``leave_plateau``.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        n, v = normal(field, p), np.float32(value(field.voxels, p))
        if not (math.isnan(v) or is_zero(n)):
            p, n, v = leave_plateau(field, p, n)
        void[m] = math.isnan(v) or is_zero(n) or hemmed(field, p, n, v)
        put_column(points, m, p)
        put_column(normals, m, n)
        isovalues[m] = v


@kernel()
def gather_light(left, ways, shares, orders, starts, count, sums):
    """Add the ends of ``walk_paths`` from ``starts`` starts, ``count`` samples each, to sums of their own.

    Lane i % ABREAST of ``sums`` (channels, i // ABREAST, n² ABREAST) is of start i, and takes its samples
    in their order: the company of a start changes no bit. ``shares`` are those of ``bake_texels``.
    Source: S1, eq. 8 with cosine sampling, τ_i = Σ R^k Y_i(ω) / N.
    """
    weights = np.zeros(starts * count + ABREAST)
    for c in range(sums.shape[0]):
        for m in range(starts * count):
            weights[m] = shares[c, left[m] + 1]
        for block in range(sums.shape[1]):
            for s in range(count):
                m = s * starts + block * ABREAST
                x, y, z = read(ways[0], m), read(ways[1], m), read(ways[2], m)
                accumulate(orders[c], x, y, z, read(weights, m), sums[c, block])


@kernel()
def exchange(sums, rows, outside, store):
    """Copy between ``sums`` (see ``gather_light``) and those of ``bake_texels``, ``outside``."""
    for i in range(2 * rows.shape[0]):
        block, lane = i // ABREAST, i % ABREAST
        for c in range(sums.shape[0]):
            there, here = outside[rows[i // 2], i % 2, c], sums[c, block, lane::ABREAST]
            if store:
                there[:] = here
            else:
                here[:] = there


@kernel()
def start_halves(place, rows):
    """Starts of the ``rows`` and each of their halves: isovalues, points, normals and seeds; see ``walk_paths``."""
    texels, points, normals, isovalues = place
    starts = 2 * rows.shape[0]
    here, facing = np.empty((3, starts)), np.empty((3, starts))
    levels, seeds = np.empty(starts), np.empty(starts, np.uint64)
    for i in range(starts):
        r = rows[i // 2]
        put_column(here, i, column(points, r))
        put_column(facing, i, column(normals, r))
        levels[i], seeds[i] = isovalues[r], texel_seed(texels[r, 0], texels[r, 1], texels[r, 2], i % 2)
    return levels, here, facing, seeds


@kernel()
def bake_together(field, bricks, place, rows, first, count, shares, survival, orders, out):
    """``bake_texels`` for a few texels whose paths go together."""
    starts, bounces = 2 * rows.shape[0], shares.shape[1] - 2
    levels, here, facing, seeds = start_halves(place, rows)
    step, most = max(WAVE // starts, 1), orders.max()
    left, ways = np.zeros(starts * step, np.int64), np.zeros((3, starts * step + ABREAST))
    sums = np.zeros((shares.shape[0], whole(starts) // ABREAST, most * most * ABREAST))
    exchange(sums, rows, out, False)
    for begin in range(first, first + count, step):
        samples = min(step, first + count - begin)
        walk_paths(field, bricks, levels, here, facing, seeds, begin, samples, bounces, survival, left, ways)
        gather_light(left, ways, shares, orders, starts, samples, sums)
    exchange(sums, rows, out, True)


@kernel(
    types.void(
        FIELD,
        BRICKS,
        types.Tuple((TEXELS, COLUMNS, COLUMNS, VECTOR)),
        types.int64[::1],
        types.int64,
        types.int64,
        types.float64[:, ::1],
        types.float64,
        types.int64[::1],
        types.float64[:, :, :, ::1],
    )
)
def bake_texels(field, bricks, place, rows, first, count, shares, survival, orders, sums):
    """Sums of ``count`` samples, from sample ``first`` on, for the ``rows`` and each of their two halves.

    ``place`` is what ``locate_texels`` took and wrote: texels, points, normals, isovalues, the latter
    within the range of ``bricks``. ``shares`` (channels, bounces + 2) are what a path counts that left after
    k bounces, at k + 1, or never, at 0; of those that hit twice a share ``survival`` goes on: see ``spin``.
    Adds to ``sums`` (m, 2, channels, n²), n the greatest of the channels' ``orders``. Source: S1, section 4.1,
    "for all texels".
    """
    together = max(WAVE // (2 * count), ABREAST)
    for i in range(0, rows.shape[0], together):
        bake_together(field, bricks, place, rows[i : i + together], first, count, shares, survival, orders, sums)
