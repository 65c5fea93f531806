"""Radiance transfer of texels on an isosurface that has other albedos from place to place (S1, eqs. 6 and 8)."""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.simd.memory import load
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD
from isogi_core.kernels.tracing.vec import column, load_columns, madd
from isogi_core.kernels.transport.colours import COLOURS, albedo_at
from isogi_core.kernels.transport.harmonics import accumulate
from isogi_core.kernels.transport.paths import SAMPLE_RANGE, PathEnds, SampleRange
from isogi_core.kernels.transport.transfer import ORDERS, PLACE, ROWS, SUMS, exchange, start_halves
from isogi_core.kernels.transport.wavefront import (
    WAVE,
    Vertices,
    columns,
    compact,
    generate,
    intersect,
    launch_all,
    make_vertices,
    make_wave,
    next_vertex,
    partition,
    russian_roulette,
    sample_direction,
    whole,
    write_ends,
)


class ColouredRules(NamedTuple):
    """What a path counts in each of r rows of sums, and how long it is: at most ``bounces``, and by its ``survival``.

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


NUMBERS = types.float64[::1]
ROWS_OF_RULES = (ORDERS, NUMBERS, NUMBERS, types.float64[:, ::1], types.boolean[::1])
COLOURED_RULES = record(ColouredRules, *ROWS_OF_RULES, types.int64, types.float64)


@kernel()
def carry(wave, vertices, hits, chance, colours, carried):
    """Multiply what paths carry, ``carried`` (3, paths), by the albedo of what they hit over the ``chance`` of that."""
    origins, directions = columns(vertices.points, vertices.count), columns(wave.directions, vertices.count)
    for i in wave.hits[:hits]:
        albedo = albedo_at(colours, madd(column(origins, i), wave.t[i], column(directions, i)))
        for c in range(3):
            carried[c, wave.owners[i]] *= albedo[c] / chance


@kernel()
def walk_coloured_wave(field, cells, colours, walk, rules, ends, carried):
    """``walk_wave``, with what its paths carry; ``walk`` is the wave, its vertices, and room for others."""
    wave, vertices, spare = walk
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
        following = Vertices(spare.points, spare.normals, hits)
        compact(wave, vertices, following)
        next_vertex(field, wave, count, following)
        vertices, spare = following, vertices


@kernel()
def walk_coloured_paths(field, cells, colours, starts, samples, rules, ends, carried):
    """``walk_paths``, to the same ends; writes to ``carried`` (3, paths) the albedos that each path met, multiplied."""
    total = starts.isovalues.shape[0] * samples.count
    ends.bounces[:total] = -1
    ends.directions[:, :total] = 0.0
    carried[:, :total] = 1.0
    origins = launch_all(field, starts)
    n = whole(min(WAVE, total))
    wave, room, spare = make_wave(n), make_vertices(n), make_vertices(n)
    for begin in range(0, total, WAVE):
        vertices = Vertices(room.points, room.normals, min(WAVE, total - begin))
        generate(wave, vertices, starts, origins, samples.first, begin)
        walk_coloured_wave(field, cells, colours, (wave, vertices, spare), rules, ends, carried)


@kernel()
def count_path(rules, row, bounces, carried, m):
    """What path ``m`` counts in a ``row`` of sums that left after so many ``bounces``, -1 of one that never did."""
    if bounces <= 0:
        return rules.straight[row] if bounces == 0 else 0.0
    mix = rules.mixes[row]
    share = mix[0] * carried[0, m] + mix[1] * carried[1, m] + mix[2] * carried[2, m]
    return rules.reflected[row] * (share * share if rules.squared[row] else share)


@kernel()
def project_coloured(ends, carried, rules, starts, count, sums):
    """``project_ends``, with what each path counts by the albedos that it met."""
    counts, ways = np.zeros(starts * count + PATH_WIDTH), ends.directions
    for c in range(sums.shape[0]):
        for m in range(starts * count):
            counts[m] = count_path(rules, c, ends.bounces[m], carried, m)
        for block in range(sums.shape[1]):
            for s in range(count):
                m = s * starts + block * PATH_WIDTH
                x, y, z = load_columns(ways, m)
                accumulate(rules.orders[c], x, y, z, load(counts, m, PATH_WIDTH), sums[c, block])


@kernel()
def bake_coloured_together(field, cells, colours, place, rows, samples, rules, out):
    """``bake_coloured_texels`` for a few texels whose paths go together."""
    g, last, starts = 2 * rows.shape[0], samples.first + samples.count, start_halves(place, rows)
    step, most = max(WAVE // g, 1), rules.orders.max()
    ends = PathEnds(np.zeros(g * step, np.int64), np.zeros((3, g * step + PATH_WIDTH)))
    carried = np.ones((3, g * step))
    sums = np.zeros((rules.orders.shape[0], whole(g) // PATH_WIDTH, most * most * PATH_WIDTH))
    exchange(sums, rows, out, False)
    for begin in range(samples.first, last, step):
        some = SampleRange(begin, min(step, last - begin))
        walk_coloured_paths(field, cells, colours, starts, some, rules, ends, carried)
        project_coloured(ends, carried, rules, g, some.count, sums)
    exchange(sums, rows, out, True)


@kernel(types.void(FIELD, ACTIVE_CELLS, COLOURS, PLACE, ROWS, SAMPLE_RANGE, COLOURED_RULES, SUMS))
def bake_coloured_texels(field, cells, colours, place, rows, samples, rules, sums):
    """``bake_texels`` of the same paths on a surface with ``colours``, by ColouredRules.

    Adds to ``sums`` (m, 2, r, n²): τ_i = Σ (Π R(x_j)) Y_i(ω) / N over the points x_j that a path hits.
    """
    together = max(WAVE // (2 * samples.count), PATH_WIDTH)
    for i in range(0, rows.shape[0], together):
        bake_coloured_together(field, cells, colours, place, rows[i : i + together], samples, rules, sums)
