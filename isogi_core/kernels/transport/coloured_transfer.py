"""Radiance transfer of texels on an isosurface that has other albedos from place to place (S1, eqs. 6 and 8)."""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD_RECORD
from isogi_core.kernels.tracing.vec import column, madd, put_column
from isogi_core.kernels.transport.colours import COLOURS_RECORD, albedo_at
from isogi_core.kernels.transport.ends import begin_branches, blocks, branch_ends
from isogi_core.kernels.transport.integrate import advance, limits
from isogi_core.kernels.transport.open_paths import advance_in_the_open
from isogi_core.kernels.transport.paths import SAMPLE_RANGE, PathEnds
from isogi_core.kernels.transport.transfer import (
    ORDER_ARRAY,
    PLACE,
    ROW_ARRAY,
    TRANSFER_SUMS,
    bake_rows,
    count_ends,
    make_carried,
)
from isogi_core.kernels.transport.wavefront import columns


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


REAL_ARRAY = types.float64[::1]
ROWS_OF_RULES = (ORDER_ARRAY, REAL_ARRAY, REAL_ARRAY, types.float64[:, ::1], types.boolean[::1])
COLOURED_RULES = record(ColouredRules, *ROWS_OF_RULES, types.int64, types.float64, types.int64)


class Coloured(NamedTuple):
    """One isosurface of a ``field``, within its active ``cells``, whose albedo the ``colours`` say at each place."""

    field: Any
    cells: Any
    colours: Any


@limits.case(ColouredRules)
def limits_of_colours(rules):
    """Say how far paths go by ColouredRules."""
    return rules.bounces, rules.branches


@make_carried.case(Coloured)
def make_albedos(scene, paths):
    """Room for the albedos that each path has met, multiplied."""
    return np.ones((3, paths))


@advance.case(Coloured)
def advance_on_colours(scene, state, vertices, following, bounce, rules):
    """Move the paths that hit the surface there, to carry its albedo over the ``chance`` that they go on."""
    rays, carried, chance = state.wave.rays, state.wave.carried, rules.survival if bounce > 0 else 1.0
    origins, directions = columns(vertices.points, vertices.count), columns(rays.directions, vertices.count)
    for i in rays.hits[: following.count]:
        albedo = albedo_at(scene.colours, madd(column(origins, i), rays.t[i], column(directions, i)))
        for c in range(3):
            carried[c, rays.owners[i]] *= albedo[c] / chance
    advance_in_the_open(scene, state, vertices, following, bounce, rules)


@begin_branches.case(Coloured, PathEnds)
def carry_along(scene, wave, count, ends):
    """Say of the wave's branches that they have not left, and carry what the paths do that they are of."""
    branch_ends(wave, count, ends)
    for owner in wave.rays.owners[:count]:
        put_column(wave.carried, owner, column(wave.carried, owner % wave.starting))


@kernel()
def count_path(rules, row, bounces, carried, m):
    """What path ``m`` counts in a ``row`` of sums that left after its ``bounces``; nothing if it never did."""
    if bounces <= 0:
        return rules.straight[row] if bounces == 0 else 0.0
    mix = rules.mixes[row]
    share = mix[0] * carried[0, m] + mix[1] * carried[1, m] + mix[2] * carried[2, m]
    return rules.reflected[row] * (share * share if rules.squared[row] else share)


@count_ends.case(ColouredRules)
def count_by_albedos(ends, carried, rules, c, counts):
    """Count each path by the albedos that it met, and a branch over the number of branches."""
    paths = ends.bounces.shape[0]
    for m in range(paths):
        counts[m] = count_path(rules, c, ends.bounces[m], carried, m)
    counts[paths // blocks(rules.branches) : paths] /= rules.branches
    return 0, blocks(rules.branches)


@kernel(
    types.void(
        FIELD_RECORD, ACTIVE_CELLS, COLOURS_RECORD, PLACE, ROW_ARRAY, SAMPLE_RANGE, COLOURED_RULES, TRANSFER_SUMS
    )
)
def bake_coloured_texels(field, cells, colours, place, rows, samples, rules, sums):
    """``bake_texels`` of the same paths on a surface with ``colours``, by ColouredRules.

    Adds to ``sums`` (m, 2, r, n²): τ_i = Σ (Π R(x_j)) Y_i(ω) / N over the points x_j that a path hits.
    """
    bake_rows(Coloured(field, cells, colours), place, rows, samples, rules, rules.orders, sums)
