"""Radiance transfer of texels (S1, eqs. 6 and 8): their points, their paths, strays, and irradiance
of fixed light.

Strays: starts of paths of which one meets a surface outside of a box. What lies outside may be
taken away, and the paths of all others stay as they are, to the bit: no ray of theirs met anything
there, and where there is less matter nothing new is in their way.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, Choice, kernel, record
from isogi_core.kernels.simd.memory import load
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import (
    FIELD_RECORD,
    RAY_OFFSET_VOXELS,
    normal,
    smooth_gradient,
    to_index,
    value,
)
from isogi_core.kernels.tracing.stiffness import (
    HALVINGS,
    STEP_VOXELS,
    crossing,
    downhill,
    leave_plateau,
    point_within,
)
from isogi_core.kernels.tracing.vec import (
    column,
    dot,
    is_zero,
    length,
    load_columns,
    madd,
    put_column,
)
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.colours import COLOURS_RECORD, albedo_at
from isogi_core.kernels.transport.harmonics import accumulate
from isogi_core.kernels.transport.integrator import (
    WAVE_PATHS,
    EndWave,
    add_paths,
    advance,
    begin_branches,
    blocks,
    branch_ends,
    columns,
    gather_met,
    limits,
    make_ends,
    make_wave,
    partition,
    places_for,
    trace_ends,
    trace_paths,
    whole,
)
from isogi_core.kernels.transport.light_paths import SURROUNDINGS_RECORD, Open, advance_in_the_open
from isogi_core.kernels.transport.paths import (
    NO_PATH,
    PATH_RULES,
    SAMPLE_RANGE,
    TRANSFER_RULES,
    PathEnds,
    PathStarts,
    PathTree,
    SampleRange,
    TransferRules,
)
from isogi_core.kernels.transport.rng import mix

TEXEL_PLACES = types.int32[:, ::1]


@kernel()
def texel_seed(z, y, x, half):
    """The sequence of a lattice texel and one of its two independent randomisations (half = 0 or
    1).
    """
    return mix(mix(mix(z, y), x), half)


@kernel(exact=True)
def hemmed(field, p, n, level):
    """Whether it is solid RAY_OFFSET_VOXELS above ``p`` along the normal ``n``: light has no room
    to arrive there.
    """
    up = to_index(n, field.spacing)
    return (
        value(field.voxels, point_within(field.voxels.shape, p, up, RAY_OFFSET_VOXELS / length(up)))
        > level
    )


@kernel(
    types.void(
        FIELD_RECORD, REAL_ARRAY, TEXEL_PLACES, REAL_ROWS, REAL_ROWS, REAL_ARRAY, types.boolean[::1]
    )
)
def locate_texels(field, step, texels, points, normals, isovalues, void):
    """Where ``texels`` (m, 3; z, y, x) are, ``points`` (3, m), and the surface through each of
    them.

    ``step`` (3,) voxels per texel along x, y, z. Writes ``normals`` (3, m), the voxel-space
    isovalue each texel is lit on, a float32, and whether it is void: no gradient there, no number,
    no side of its own, or hemmed in. Those at the edge of a plateau leave their place: see
    ``leave_plateau``.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        n = normal(field, p)
        v = np.float32(value(field.voxels, p))
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
    weights = rules.weights[c]
    branches = rules.branches
    straight = weights[:2].any()
    reflected = weights[0] != 0.0 or weights[2:].any()
    first = 0 if straight or branches == 1 else 1
    last = blocks(branches) if reflected else 1
    stride = ends.bounces.shape[0] // blocks(branches)
    for m in range(first * stride, last * stride):
        bounces = ends.bounces[m]
        if bounces != NO_PATH:
            counts[m] = weights[bounces + 1]
        else:
            counts[m] = 0.0
    counts[stride : last * stride] /= branches
    return first, last


@kernel()
def add_harmonics(ends, counts, order, starts, samples, some, sums):
    """Add harmonics of this ``order`` of the ends of ``trace_ends`` to ``sums`` (i // PATH_WIDTH,
    n² PATH_WIDTH).

    They are from ``starts`` starts with ``samples`` each, and the blocks that are ``some`` (first,
    last) of the ``PathEnds``. Lane i % PATH_WIDTH is of start i, and takes its samples in their
    order, and each one's branches in theirs: the company of a start changes no bit.
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
    """Add the ends of ``trace_ends`` to ``sums`` (channels, …), each by its rule: see
    ``count_ends``.

    ``samples`` are how many each of the ``starts`` took, and how many there is room for. Source:
    S1, eq. 8 with cosine sampling, τ_i = Σ R^k Y_i(ω) / N.
    """
    counts = np.zeros(ends.bounces.shape[0] + PATH_WIDTH)
    for c in range(sums.shape[0]):
        some = count_ends(ends, carried, rules, c, counts)
        add_harmonics(ends, counts, orders[c], starts, samples, some, sums[c])


@kernel()
def exchange(sums, rows, outside, store):
    """Copy between ``sums`` (see ``project_ends``) and those of ``bake_texels``, ``outside``."""
    for i in range(2 * rows.shape[0]):
        block = i // PATH_WIDTH
        lane = i % PATH_WIDTH
        for c in range(sums.shape[0]):
            there = outside[rows[i // 2], i % 2, c]
            here = sums[c, block, lane::PATH_WIDTH]
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
    here = np.empty((3, g))
    around = np.empty((3, g))
    levels = np.empty(g)
    seeds = np.empty(g, np.uint64)
    for i in range(g):
        r = rows[i // 2]
        put_column(here, i, column(points, r))
        put_column(around, i, column(normals, r))
        levels[i] = isovalues[r]
        seeds[i] = texel_seed(texels[r, 0], texels[r, 1], texels[r, 2], i % 2)
    return PathStarts(here, around, levels, seeds, np.full(g, NO_WALL))


@kernel()
def bake_together(scene, place, rows, samples, rules, orders, out):
    """``bake_rows`` of a few texels whose paths go together."""
    g = 2 * rows.shape[0]
    last = samples.first + samples.count
    (bounces, branches) = limits(rules)
    starts = start_halves(place, rows)
    step = min(max(WAVE_PATHS // g, 1), samples.count)
    most = orders.max()
    tree = PathTree(bounces, rules.survival, branches)
    ends = make_ends(g, step, branches)
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
    """Add to ``sums`` what a ``SampleRange`` of paths brings to the ``rows``: see
    ``bake_texels``.
    """
    together = max(WAVE_PATHS // (2 * samples.count), PATH_WIDTH)
    for i in range(0, rows.shape[0], together):
        bake_together(scene, place, rows[i : i + together], samples, rules, orders, sums)


PLACE = types.Tuple((TEXEL_PLACES, REAL_ROWS, REAL_ROWS, REAL_ARRAY))
ROW_ARRAY = types.int64[::1]
ORDER_ARRAY = types.int64[::1]
TRANSFER_SUMS = types.float64[:, :, :, ::1]


@kernel(
    types.void(
        FIELD_RECORD,
        ACTIVE_CELLS,
        PLACE,
        ROW_ARRAY,
        SAMPLE_RANGE,
        TRANSFER_RULES,
        ORDER_ARRAY,
        TRANSFER_SUMS,
    )
)
def bake_texels(field, cells, place, rows, samples, rules, orders, sums):
    """Sums of a ``SampleRange`` for the ``rows`` and each of their two halves.

    ``place`` is what ``locate_texels`` took and wrote: texels, points, normals, isovalues, the
    latter within the range of ``cells``. The weights (channels, bounces + 2) of the
    ``TransferRules`` are what a path counts that left after k bounces, at k + 1, or never, at 0.
    Adds to ``sums`` (m, 2, channels, n²), n the greatest of the channels' ``orders``. Source: S1,
    section 4.1, "for all texels".
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

    ``place`` is what ``locate_texels`` took and wrote, as for ``bake_texels``, whose random numbers
    these are; the weights (bounces + 1, 3) of the ``PathRules`` are R^k over the chance to get
    there (see ``russian_roulette``); ``light`` the Surroundings. Adds linear RGB, with all bounces,
    to ``sums`` (m, 2, 3): times the albedo it is the radiance that leaves the surface.
    """
    together = max(WAVE_PATHS // (2 * samples.count), PATH_WIDTH)
    for i in range(0, rows.shape[0], together):
        light_together(field, cells, place, rows[i : i + together], samples, rules, light, sums)


class Confines(NamedTuple):
    """Where paths may meet surfaces: a ``box`` (2, 3) of index space, its least and its greatest
    corner.

    Paths go on as a ``PathTree`` says: by its ``bounces``, ``survival`` and ``branches``.
    """

    bounces: int
    survival: float
    branches: int
    box: Any


class Strays(NamedTuple):
    """Which of g starts have a path that met something outside of a ``box``, ``marks`` (g,): it
    ends there.
    """

    box: Any
    marks: Any


CONFINES_RECORD = record(Confines, types.int64, types.float64, types.int64, REAL_ROWS)


@kernel()
def is_within(p, box):
    """Whether the point ``p`` lies in a ``box``."""
    return (
        box[0, 0] <= p[0] <= box[1, 0]
        and box[0, 1] <= p[1] <= box[1, 1]
        and box[0, 2] <= p[2] <= box[1, 2]
    )


@gather_met.case(Strays)
def mark_strays(scene, state, vertices, bounce, strays):
    """Mark the starts whose rays hit something outside of the box; returns how many go on, of all
    others.
    """
    rays = state.wave.rays
    count = vertices.count
    staying = 0
    origins = columns(vertices.points, count)
    directions = columns(rays.directions, count)
    for h in range(partition(rays, count)):
        i = rays.hits[h]
        start = rays.owners[i] % strays.marks.shape[0]
        if not is_within(madd(column(origins, i), rays.t[i], column(directions, i)), strays.box):
            strays.marks[start] = True
        rays.hits[staying] = i
        staying += not strays.marks[start]
    return staying


@kernel()
def trace_strays(scene, starts, samples, confines, marks):
    """Mark which of g ``PathStarts`` stray, ``marks`` (g,), by a ``SampleRange`` of the paths of
    ``trace_ends``.
    """
    tree = PathTree(confines.bounces, confines.survival, confines.branches)
    total = starts.isovalues.shape[0] * samples.count
    wave = EndWave(make_wave(places_for(total, tree.branches)), total, np.ones((3, 0)))
    trace_paths(scene, starts, samples, tree, Strays(confines.box, marks), wave)


@kernel(
    types.void(
        FIELD_RECORD,
        ACTIVE_CELLS,
        PLACE,
        ROW_ARRAY,
        SAMPLE_RANGE,
        CONFINES_RECORD,
        types.boolean[::1],
    )
)
def find_strays(field, cells, place, rows, samples, confines, strays):
    """Mark which of the ``rows`` are ``strays`` (m,), by a ``SampleRange`` of each of their two
    halves.

    ``place`` is what ``locate_texels`` took and wrote, and the paths are those of ``bake_texels``.
    """
    together = max(WAVE_PATHS // (2 * samples.count), 1)
    for i in range(0, rows.shape[0], together):
        some = rows[i : i + together]
        marks = np.zeros(2 * some.shape[0], np.bool_)
        trace_strays(Open(field, cells), start_halves(place, some), samples, confines, marks)
        for k in range(some.shape[0]):
            strays[some[k]] |= marks[2 * k] | marks[2 * k + 1]


class ColouredRules(NamedTuple):
    """What a path counts in each of r rows of sums, and how it goes on: see ``PathTree``.

    Rows have harmonics of ``orders`` (r,). One that leaves at once counts ``straight`` (r,), and
    one after k bounces ``reflected`` (r,), times the albedos of what it hit over the chance to get
    there, as ``mixes`` (r, 3) mix them, or the square of that in rows that are ``squared`` (r,).
    """

    orders: Any
    straight: Any
    reflected: Any
    mixes: Any
    squared: Any
    bounces: int
    survival: float
    branches: int


ROWS_OF_RULES = (ORDER_ARRAY, REAL_ARRAY, REAL_ARRAY, types.float64[:, ::1], types.boolean[::1])
COLOURED_RULES = record(ColouredRules, *ROWS_OF_RULES, types.int64, types.float64, types.int64)


class Coloured(NamedTuple):
    """One isosurface of a ``field``, within its active ``cells``, whose albedo the ``colours`` say
    at each place.
    """

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
    """Move the paths that hit the surface there, to carry its albedo over the ``chance`` that they
    go on.
    """
    rays = state.wave.rays
    carried = state.wave.carried
    chance = rules.survival if bounce > 0 else 1.0
    origins = columns(vertices.points, vertices.count)
    directions = columns(rays.directions, vertices.count)
    for i in rays.hits[: following.count]:
        albedo = albedo_at(
            scene.colours, madd(column(origins, i), rays.t[i], column(directions, i))
        )
        for c in range(3):
            carried[c, rays.owners[i]] *= albedo[c] / chance
    advance_in_the_open(scene, state, vertices, following, bounce, rules)


@begin_branches.case(Coloured, PathEnds)
def carry_along(scene, wave, count, ends):
    """Say of the wave's branches that they have not left, and carry what the paths do that they are
    of.
    """
    branch_ends(wave, count, ends)
    for owner in wave.rays.owners[:count]:
        put_column(wave.carried, owner, column(wave.carried, owner % wave.starting))


@kernel()
def count_path(rules, row, bounces, carried, m):
    """What path ``m`` counts in a ``row`` of sums that left after its ``bounces``; nothing if it
    never did.
    """
    if bounces <= 0:
        if bounces == 0:
            return rules.straight[row]
        return 0.0
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
        FIELD_RECORD,
        ACTIVE_CELLS,
        COLOURS_RECORD,
        PLACE,
        ROW_ARRAY,
        SAMPLE_RANGE,
        COLOURED_RULES,
        TRANSFER_SUMS,
    )
)
def bake_coloured_texels(field, cells, colours, place, rows, samples, rules, sums):
    """``bake_texels`` of the same paths on a surface with ``colours``, by ColouredRules.

    Adds to ``sums`` (m, 2, r, n²): τ_i = Σ (Π R(x_j)) Y_i(ω) / N over the points x_j that a path
    hits.
    """
    bake_rows(Coloured(field, cells, colours), place, rows, samples, rules, rules.orders, sums)


TEXEL_PROJECTED, TOO_FAR, OTHER_SHEET, NORMAL_TURNED, TEXEL_HEMMED, NO_SURFACE = range(6)
"""What became of a texel: it was projected, or the shown isosurface is not within MAX_SHIFT_VOXELS,
or another sheet of it is; the normal there is turned by more than a right angle; light has no room
to arrive there; or its own point has no normal.
"""

MAX_BACKTRACK = 0.1
"""Share of the way between two isovalues that the field may go back on its way from one to the
other.
"""


@kernel(exact=True)
def strays(voxels, p, d, level, reach):
    """How far the field goes back between ``p`` and ``reach`` along ``d``, over its distance from
    ``level`` at p.
    """
    own = value(voxels, p)
    nearest = abs(own - level)
    back = 0.0
    t = STEP_VOXELS
    while t < reach:
        away = abs(value(voxels, point_within(voxels.shape, p, d, t)) - level)
        nearest, back, t = min(nearest, away), max(back, away - nearest), t + STEP_VOXELS
    return back / max(abs(own - level), 1e-300)


@kernel(exact=True)
def way_to(field, p, n, level, halvings=HALVINGS):
    """The way from ``p`` to the isosurface ``level`` along the normal ``n``, that is not zero:
    (direction, voxels).

    Out of the solid or into it, to where the trilinear field first crosses the level; the direction
    is of index space, a voxel long, and the way, found by ``halvings`` (see ``crossing``), inf
    where it does not within MAX_SHIFT_VOXELS.
    """
    d = downhill(n, field.spacing, 1.0 if value(field.voxels, p) > level else -1.0)
    return d, crossing(field.voxels, p, d, level, halvings)


@kernel(exact=True)
def project_point(field, p, level):
    """Move ``p`` along the normal onto the isosurface ``level``: (verdict, point, normal there).

    The straight way of ``way_to``; both are those of ``p`` itself where that fails. Verdicts are
    TEXEL_PROJECTED … NO_SURFACE.
    """
    n = normal(field, p)
    if math.isnan(value(field.voxels, p)) or is_zero(n):
        return NO_SURFACE, p, n
    d, t = way_to(field, p, n, level)
    if not t < math.inf:
        return TOO_FAR, p, n
    there = point_within(field.voxels.shape, p, d, t)
    m = normal(field, there)
    if strays(field.voxels, p, d, level, t) > MAX_BACKTRACK:
        return OTHER_SHEET, p, n
    if not dot(n, m) > 0.0:
        return NORMAL_TURNED, p, n
    if hemmed(field, there, m, level):
        return (TEXEL_HEMMED, p, n)
    return (TEXEL_PROJECTED, there, m)


@kernel(
    types.void(
        FIELD_RECORD,
        REAL_ARRAY,
        types.float64,
        TEXEL_PLACES,
        REAL_ROWS,
        REAL_ROWS,
        types.uint8[::1],
    )
)
def project_texels(field, step, level, texels, points, normals, verdicts):
    """Move ``texels`` (m, 3; z, y, x) onto the isosurface ``level``, a voxel-space isovalue.

    ``step`` (3,) voxels per texel along x, y, z. Writes ``points`` and ``normals`` (3, m), and the
    ``verdicts`` (m,): TEXEL_PROJECTED, or why a texel stays where it is.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        verdict, there, n = project_point(field, p, level)
        verdicts[m] = np.uint8(verdict)
        put_column(points, m, there)
        put_column(normals, m, n)


@kernel(types.void(FIELD_RECORD, REAL_ARRAY, types.float64, TEXEL_PLACES, REAL_ARRAY))
def measure_distances(field, step, level, texels, ways):
    """Estimate the ``ways`` (m,), in voxels, from ``texels`` (m, 3; z, y, x) to the isosurface
    ``level``.

    To first order, |ρ - level| / |∇ρ| with the smoothed gradient; inf where that is zero, and where
    ρ is not a number.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        away = abs(value(field.voxels, p) - level)
        slope = length(smooth_gradient(field.voxels, p))
        way = away / slope if slope > 0.0 else math.inf
        ways[m] = math.inf if math.isnan(way) else way
