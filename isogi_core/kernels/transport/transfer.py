"""Radiance transfer of texels (S1, eqs. 6 and 8), and their irradiance under a light that stays."""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import Choice, kernel
from isogi_core.kernels.simd.memory import load
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD_RECORD, RAY_OFFSET_VOXELS, normal, to_index, value
from isogi_core.kernels.tracing.plateaus import leave_plateau, point_within
from isogi_core.kernels.tracing.vec import column, is_zero, length, load_columns, put_column
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.ends import blocks, make_ends, trace_ends
from isogi_core.kernels.transport.harmonics import accumulate
from isogi_core.kernels.transport.integrate import add_paths, limits
from isogi_core.kernels.transport.light_paths import SURROUNDINGS_RECORD
from isogi_core.kernels.transport.open_paths import Open
from isogi_core.kernels.transport.paths import (
    NO_PATH,
    PATH_RULES,
    SAMPLE_RANGE,
    TRANSFER_RULES,
    PathStarts,
    PathTree,
    SampleRange,
    TransferRules,
)
from isogi_core.kernels.transport.rng import mix
from isogi_core.kernels.transport.wavefront import WAVE_PATHS, whole

REAL_ARRAY = types.float64[::1]
REAL_ROWS = types.float64[:, ::1]
TEXEL_PLACES = types.int32[:, ::1]


@kernel()
def texel_seed(z, y, x, half):
    """The sequence of a lattice texel and one of its two independent randomisations (half = 0 or 1)."""
    return mix(mix(mix(z, y), x), half)


@kernel(exact=True)
def hemmed(field, p, n, level):
    """Whether it is solid RAY_OFFSET_VOXELS above ``p`` along the normal ``n``: light has no room to arrive there."""
    up = to_index(n, field.spacing)
    return value(field.voxels, point_within(field.voxels.shape, p, up, RAY_OFFSET_VOXELS / length(up))) > level


@kernel(types.void(FIELD_RECORD, REAL_ARRAY, TEXEL_PLACES, REAL_ROWS, REAL_ROWS, REAL_ARRAY, types.boolean[::1]))
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


@Choice
def make_carried(scene, paths):
    """Room (3, n) for what n ``paths`` carry: none where all reflect alike."""


@Choice
def count_ends(ends, carried, rules, c, counts):
    """Fill ``counts`` (n,) with what each path counts in channel ``c`` by the ``rules``.

    Returns which blocks of the ``PathEnds`` count at all, (first, last): the others are left.
    """


@make_carried.case(Open)
def make_nothing(scene, paths):
    """No room: all paths reflect alike."""
    return np.ones((3, 0))


@limits.case(TransferRules)
def limits_of_transfer(rules):
    """Two weights are of no bounces, and of paths that never leave."""
    return rules.weights.shape[1] - 2, rules.branches


@count_ends.case(TransferRules)
def count_by_weights(ends, carried, rules, c, counts):
    """Count each path by the weight of its bounces, and a branch over the number of branches."""
    weights, branches = rules.weights[c], rules.branches
    straight, reflected = weights[:2].any(), weights[0] != 0.0 or weights[2:].any()
    first, last = 0 if straight or branches == 1 else 1, blocks(branches) if reflected else 1
    stride = ends.bounces.shape[0] // blocks(branches)
    for m in range(first * stride, last * stride):
        bounces = ends.bounces[m]
        counts[m] = weights[bounces + 1] if bounces != NO_PATH else 0.0
    counts[stride : last * stride] /= branches
    return first, last


@kernel()
def add_harmonics(ends, counts, order, starts, samples, some, sums):
    """Add harmonics of this ``order`` of the ends of ``trace_ends`` to ``sums`` (i // PATH_WIDTH, n² PATH_WIDTH).

    They are from ``starts`` starts with ``samples`` each, and the blocks that are ``some`` (first, last) of the
    ``PathEnds``. Lane i % PATH_WIDTH is of start i, and takes its samples in their order, and each one's branches in
    theirs: the company of a start changes no bit.
    """
    stride = starts * samples[1]
    for block in range(sums.shape[0]):
        for s in range(samples[0]):
            for j in range(some[0], some[1]):
                m = j * stride + s * starts + block * PATH_WIDTH
                x, y, z = load_columns(ends.directions, m)
                accumulate(order, x, y, z, load(counts, m, PATH_WIDTH), sums[block])


@kernel()
def project_ends(ends, carried, rules, orders, starts, samples, sums):
    """Add the ends of ``trace_ends`` to ``sums`` (channels, …), each by its rule: see ``count_ends``.

    ``samples`` are how many each of the ``starts`` took, and how many there is room for. Source: S1, eq. 8 with cosine
    sampling, τ_i = Σ R^k Y_i(ω) / N.
    """
    counts = np.zeros(ends.bounces.shape[0] + PATH_WIDTH)
    for c in range(sums.shape[0]):
        some = count_ends(ends, carried, rules, c, counts)
        add_harmonics(ends, counts, orders[c], starts, samples, some, sums[c])


@kernel()
def exchange(sums, rows, outside, store):
    """Copy between ``sums`` (see ``project_ends``) and those of ``bake_texels``, ``outside``."""
    for i in range(2 * rows.shape[0]):
        block, lane = i // PATH_WIDTH, i % PATH_WIDTH
        for c in range(sums.shape[0]):
            there, here = outside[rows[i // 2], i % 2, c], sums[c, block, lane::PATH_WIDTH]
            for j in range(here.shape[0]):
                if store:
                    there[j] = here[j]
                else:
                    here[j] = there[j]


@kernel()
def start_halves(place, rows):
    """The ``PathStarts`` of the ``rows`` and each of their two halves."""
    texels, points, normals, isovalues = place
    g = 2 * rows.shape[0]
    here, around = np.empty((3, g)), np.empty((3, g))
    levels, seeds = np.empty(g), np.empty(g, np.uint64)
    for i in range(g):
        r = rows[i // 2]
        put_column(here, i, column(points, r))
        put_column(around, i, column(normals, r))
        levels[i], seeds[i] = isovalues[r], texel_seed(texels[r, 0], texels[r, 1], texels[r, 2], i % 2)
    return PathStarts(here, around, levels, seeds, np.full(g, NO_WALL))


@kernel()
def bake_together(scene, place, rows, samples, rules, orders, out):
    """``bake_rows`` of a few texels whose paths go together."""
    g, last, (bounces, branches) = 2 * rows.shape[0], samples.first + samples.count, limits(rules)
    starts, step, most = start_halves(place, rows), min(max(WAVE_PATHS // g, 1), samples.count), orders.max()
    tree, ends = PathTree(bounces, rules.survival, branches), make_ends(g, step, branches)
    carried = make_carried(scene, ends.bounces.shape[0])
    sums = np.zeros((orders.shape[0], whole(g) // PATH_WIDTH, most * most * PATH_WIDTH))
    exchange(sums, rows, out, False)
    for begin in range(samples.first, last, step):
        some = SampleRange(begin, min(step, last - begin))
        trace_ends(scene, starts, some, tree, ends, carried)
        project_ends(ends, carried, rules, orders, g, (some.count, step), sums)
    exchange(sums, rows, out, True)


@kernel()
def bake_rows(scene, place, rows, samples, rules, orders, sums):
    """Add to ``sums`` what a ``SampleRange`` of paths brings to the ``rows``: see ``bake_texels``."""
    together = max(WAVE_PATHS // (2 * samples.count), PATH_WIDTH)
    for i in range(0, rows.shape[0], together):
        bake_together(scene, place, rows[i : i + together], samples, rules, orders, sums)


PLACE = types.Tuple((TEXEL_PLACES, REAL_ROWS, REAL_ROWS, REAL_ARRAY))
ROW_ARRAY, ORDER_ARRAY = types.int64[::1], types.int64[::1]
TRANSFER_SUMS = types.float64[:, :, :, ::1]


@kernel(
    types.void(FIELD_RECORD, ACTIVE_CELLS, PLACE, ROW_ARRAY, SAMPLE_RANGE, TRANSFER_RULES, ORDER_ARRAY, TRANSFER_SUMS)
)
def bake_texels(field, cells, place, rows, samples, rules, orders, sums):
    """Sums of a ``SampleRange`` for the ``rows`` and each of their two halves.

    ``place`` is what ``locate_texels`` took and wrote: texels, points, normals, isovalues, the latter
    within the range of ``cells``. The weights (channels, bounces + 2) of the ``TransferRules`` are what a path counts
    that left after k bounces, at k + 1, or never, at 0.
    Adds to ``sums`` (m, 2, channels, n²), n the greatest of the channels' ``orders``. Source: S1, section 4.1,
    "for all texels".
    """
    bake_rows(Open(field, cells), place, rows, samples, rules, orders, sums)


@kernel()
def light_together(field, cells, place, rows, samples, rules, light, sums):
    """``bake_irradiance`` for a few texels whose paths go together."""
    some = np.empty((2 * rows.shape[0], 3))
    for i in range(some.shape[0]):
        some[i] = sums[rows[i // 2], i % 2]
    add_paths(Open(field, cells), start_halves(place, rows), samples, rules, light, some)
    for i in range(some.shape[0]):
        sums[rows[i // 2], i % 2] = some[i]


@kernel(
    types.void(
        FIELD_RECORD,
        ACTIVE_CELLS,
        PLACE,
        ROW_ARRAY,
        SAMPLE_RANGE,
        PATH_RULES,
        SURROUNDINGS_RECORD,
        types.float64[:, :, ::1],
    )
)
def bake_irradiance(field, cells, place, rows, samples, rules, light, sums):
    """Sums of a ``SampleRange`` of E/π for the ``rows`` and each of their two halves.

    ``place`` is what ``locate_texels`` took and wrote, as for ``bake_texels``, whose random numbers these
    are; the weights (bounces + 1, 3) of the ``PathRules`` are R^k over the chance to get there (see
    ``russian_roulette``); ``light`` the Surroundings. Adds linear RGB, with all bounces, to ``sums`` (m, 2, 3):
    times the albedo it is the radiance that leaves the surface.
    """
    together = max(WAVE_PATHS // (2 * samples.count), PATH_WIDTH)
    for i in range(0, rows.shape[0], together):
        light_together(field, cells, place, rows[i : i + together], samples, rules, light, sums)
