"""Radiance transfer of texels on an isosurface that has other albedos from place to place (S1, eqs. 6 and 8)."""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD
from isogi_core.kernels.tracing.vec import column, madd, put_column
from isogi_core.kernels.transport.colours import COLOURS, albedo_at
from isogi_core.kernels.transport.paths import SAMPLE_RANGE, SampleRange
from isogi_core.kernels.transport.transfer import (
    ORDERS,
    PLACE,
    ROWS,
    SUMS,
    exchange,
    make_ends,
    project,
    start_halves,
)
from isogi_core.kernels.transport.wavefront import (
    WAVE,
    Vertices,
    blocks,
    branch_ends,
    columns,
    first_of_wave,
    generate,
    go_on,
    intersect,
    launch_all,
    make_vertices,
    make_wave,
    open_ends,
    partition,
    russian_roulette,
    sample_direction,
    whole,
    write_ends,
)


class ColouredRules(NamedTuple):
    """What a path counts in each of r rows of sums, and how it goes on: see ``PathTree``.

    Rows have harmonics of ``orders`` (r,). One that leaves at once counts ``straight`` (r,), and one after k bounces
    ``reflected`` (r,), times the albedos of what it hit over the chance to get there, as ``mixes`` (r, 3) mix them, or
    the square of that in rows that are ``squared`` (r,).
    """

    orders: Any
    straight: Any
    reflected: Any
    mixes: Any
    squared: Any
    bounces: int
    survival: float
    branches: int


NUMBERS = types.float64[::1]
ROWS_OF_RULES = (ORDERS, NUMBERS, NUMBERS, types.float64[:, ::1], types.boolean[::1])
COLOURED_RULES = record(ColouredRules, *ROWS_OF_RULES, types.int64, types.float64, types.int64)


@kernel()
def carry(wave, vertices, hits, chance, colours, carried):
    """Multiply what paths carry, ``carried`` (3, paths), by the albedo of what they hit over the ``chance`` of that."""
    origins, directions = columns(vertices.points, vertices.count), columns(wave.directions, vertices.count)
    for i in wave.hits[:hits]:
        albedo = albedo_at(colours, madd(column(origins, i), wave.t[i], column(directions, i)))
        for c in range(3):
            carried[c, wave.owners[i]] *= albedo[c] / chance


@kernel()
def carry_along(wave, count, stride, carried):
    """Let the wave's ``count`` branches carry what the paths do that they are of."""
    for owner in wave.owners[:count]:
        put_column(carried, owner, column(carried, owner % stride))


@kernel()
def walk_coloured_wave(field, cells, colours, walk, rules, ends, carried):
    """``walk_wave``, with what its paths carry; ``walk`` is the wave, its vertices, and room for others."""
    wave, vertices, spare = walk
    stride = ends.bounces.shape[0] // blocks(rules.branches)
    for bounce in range(rules.bounces + 1):
        count = vertices.count
        sample_direction(wave, vertices, bounce, field.spacing)
        intersect(field, cells, wave, vertices.points, count)
        hits = partition(wave, count)
        write_ends(wave, count, count - hits, bounce, ends)
        hits = russian_roulette(wave, hits, bounce, rules.survival)
        if hits == 0 or bounce == rules.bounces:
            return
        carry(wave, vertices, hits, rules.survival if bounce > 0 else 1.0, colours, carried)
        branches = rules.branches if bounce == 0 else 1
        vertices, spare = go_on(field, wave, vertices, spare, hits, branches, stride)
        if branches > 1:
            branch_ends(wave, vertices.count, stride, ends)
            carry_along(wave, vertices.count, stride, carried)


@kernel()
def walk_coloured_paths(field, cells, colours, starts, samples, rules, ends, carried):
    """``walk_paths``, to the same ends; writes to ``carried`` (3, paths) the albedos that each path met, multiplied."""
    total = starts.isovalues.shape[0] * samples.count
    open_ends(ends, total)
    carried[:, :total] = 1.0
    origins, first = launch_all(field, starts), first_of_wave(rules.branches)
    n = whole(min(first, total)) * rules.branches
    wave, room, spare = make_wave(n), make_vertices(n), make_vertices(n)
    for begin in range(0, total, first):
        vertices = Vertices(room.points, room.normals, min(first, total - begin))
        generate(wave, vertices, starts, origins, samples.first, begin)
        walk_coloured_wave(field, cells, colours, (wave, vertices, spare), rules, ends, carried)


@kernel()
def count_path(rules, row, bounces, carried, m):
    """What path ``m`` counts in a ``row`` of sums that left after so many ``bounces``; nothing if it never did."""
    if bounces <= 0:
        return rules.straight[row] if bounces == 0 else 0.0
    mix = rules.mixes[row]
    share = mix[0] * carried[0, m] + mix[1] * carried[1, m] + mix[2] * carried[2, m]
    return rules.reflected[row] * (share * share if rules.squared[row] else share)


@kernel()
def project_coloured(ends, carried, rules, starts, samples, sums):
    """``project_ends``, with what each path counts by the albedos that it met."""
    paths = ends.bounces.shape[0]
    counts, stride = np.zeros(paths + PATH_WIDTH), paths // blocks(rules.branches)
    for c in range(sums.shape[0]):
        for m in range(paths):
            counts[m] = count_path(rules, c, ends.bounces[m], carried, m)
        counts[stride:paths] /= rules.branches
        project(ends, counts, rules.orders[c], starts, samples, (0, blocks(rules.branches)), sums[c])


@kernel()
def bake_coloured_together(field, cells, colours, place, rows, samples, rules, out):
    """``bake_coloured_texels`` for a few texels whose paths go together."""
    g, last, starts = 2 * rows.shape[0], samples.first + samples.count, start_halves(place, rows)
    step, most = min(max(WAVE // g, 1), samples.count), rules.orders.max()
    ends = make_ends(g, step, rules.branches)
    carried = np.ones((3, ends.bounces.shape[0]))
    sums = np.zeros((rules.orders.shape[0], whole(g) // PATH_WIDTH, most * most * PATH_WIDTH))
    exchange(sums, rows, out, False)
    for begin in range(samples.first, last, step):
        some = SampleRange(begin, min(step, last - begin))
        walk_coloured_paths(field, cells, colours, starts, some, rules, ends, carried)
        project_coloured(ends, carried, rules, g, (some.count, step), sums)
    exchange(sums, rows, out, True)


@kernel(types.void(FIELD, ACTIVE_CELLS, COLOURS, PLACE, ROWS, SAMPLE_RANGE, COLOURED_RULES, SUMS))
def bake_coloured_texels(field, cells, colours, place, rows, samples, rules, sums):
    """``bake_texels`` of the same paths on a surface with ``colours``, by ColouredRules.

    Adds to ``sums`` (m, 2, r, n²): τ_i = Σ (Π R(x_j)) Y_i(ω) / N over the points x_j that a path hits.
    """
    together = max(WAVE // (2 * samples.count), PATH_WIDTH)
    for i in range(0, rows.shape[0], together):
        bake_coloured_together(field, cells, colours, place, rows[i : i + together], samples, rules, sums)
