"""Light of texels: their points, radiance transfer (S1, eqs. 6 and 8), irradiance, and projection.

A texel is lit on the isosurface through its point of the lattice. ``locate_texels`` finds point,
normal and isovalue; ``bake_texels`` traces paths from there and projects their ends on harmonics;
``bake_irradiance`` sums the light of an environment that does not turn. ``project_texels`` moves
texels onto one given isosurface.
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
    add_paths,
    advance,
    begin_branches,
    blocks,
    branch_ends,
    columns,
    limits,
    make_ends,
    trace_ends,
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
    """Return the seed of a lattice texel for one of its two independent randomisations, half 0 or
    1.

    The two halves of a texel's samples give an estimate of its noise.
    """
    return mix(mix(mix(z, y), x), half)


@kernel(exact=True)
def hemmed(field, p, n, level):
    """Return True if the field is solid RAY_OFFSET_VOXELS above ``p`` along the normal ``n``.

    Light has no room to arrive at such a point.
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
    """Find the points of ``texels`` (m, 3; z, y, x), (3, m) in index space, and the isosurface
    through each.

    ``step`` (3,) holds the voxels per texel along x, y, z. Writes ``normals`` (3, m), the float32
    isovalue in units of the voxels at which each texel is lit, and ``void`` (m,), True for void
    texels. A texel is void if it has no gradient, no value or no outer side, or if it is hemmed in.
    Texels at the edge of a plateau move to its rim: see ``leave_plateau``.
    """
    for m in range(texels.shape[0]):
        # Evaluate the field and its smoothed gradient (S1, fig. 5) at the texel.
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        n = normal(field, p)
        v = np.float32(value(field.voxels, p))
        # Move the texel to the rim of a plateau if it lies on one.
        if not (math.isnan(v) or is_zero(n)):
            p, n, v = leave_plateau(field, p, n)
        void[m] = math.isnan(v) or is_zero(n) or hemmed(field, p, n, v)
        put_column(points, m, p)
        put_column(normals, m, n)
        isovalues[m] = v


@Choice
def make_carried(scene, paths):
    """Allocate the albedos (3, n) that n ``paths`` carry;
    empty if the whole surface reflects alike.
    """


@Choice
def count_ends(ends, carried, rules, c, counts):
    """Fill ``counts`` (n,) with the weight of each path in channel ``c`` by the ``rules``.

    Returns the range of blocks of the ``PathEnds`` with weights that are not 0, (first, last).
    """


@make_carried.case(Open)
def make_nothing(scene, paths):
    """Allocate nothing: the whole surface reflects alike."""
    return np.ones((3, 0))


@limits.case(TransferRules)
def limits_of_transfer(rules):
    """Return the bounces and branches; two weights are of paths without bounces, and of those
    that never leave.
    """
    return rules.weights.shape[1] - 2, rules.branches


@count_ends.case(TransferRules)
def count_by_weights(ends, carried, rules, c, counts):
    """Weight each path by the number of its bounces; branches share the weight of their path."""
    # Skip blocks of paths whose weights are all 0: the unbranched ones, or the branches.
    weights = rules.weights[c]
    branches = rules.branches
    straight = weights[:2].any()
    reflected = weights[0] != 0.0 or weights[2:].any()
    first = 0 if straight or branches == 1 else 1
    last = blocks(branches) if reflected else 1
    stride = ends.bounces.shape[0] // blocks(branches)
    # Weight 0 belongs to paths that never leave, weight k + 1 to those that leave after k bounces.
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
    """Add the spherical harmonics of the directions of ``PathEnds`` to ``sums`` (blocks of starts,
    n² · PATH_WIDTH), each with its weight in ``counts``.

    There are ``starts`` starts; ``samples`` holds the number of samples that each took, and the
    room for samples; ``some`` (first, last) is the range of blocks of ends. Lane i % PATH_WIDTH of
    block i // PATH_WIDTH belongs to start i, and takes its samples in order, and the branches of
    each in order. So the result does not depend on which starts are traced together.
    """
    stride = starts * samples[1]
    # Evaluate the harmonics of one end of PATH_WIDTH starts at a time.
    for block in range(sums.shape[0]):
        for s in range(samples[0]):
            for j in range(some[0], some[1]):
                m = j * stride + s * starts + block * PATH_WIDTH
                x, y, z = load_columns(ends.directions, m)
                accumulate(order, x, y, z, load(counts, m, PATH_WIDTH), sums[block])


@kernel()
def project_ends(ends, carried, rules, orders, starts, samples, sums):
    """Add the ends of ``trace_ends`` to ``sums`` (channels, …), each with its weight by
    ``count_ends``.

    ``samples`` are the samples that each of the ``starts`` took, and the room for samples. The
    caller divides by the number N of all samples. Source: S1, eq. 8 with cosine-distributed
    directions, τ_i = Σ R^k Y_i(ω) / N.
    """
    counts = np.zeros(ends.bounces.shape[0] + PATH_WIDTH)
    for c in range(sums.shape[0]):
        some = count_ends(ends, carried, rules, c, counts)
        add_harmonics(ends, counts, orders[c], starts, samples, some, sums[c])


@kernel()
def exchange(sums, rows, outside, store):
    """Copy between the block layout of ``project_ends`` and the sums ``outside`` of
    ``bake_texels``; ``store`` writes to these.
    """
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
    """Return the ``PathStarts`` of both halves of each of the ``rows``."""
    texels, points, normals, isovalues = place
    g = 2 * rows.shape[0]
    here = np.empty((3, g))
    around = np.empty((3, g))
    levels = np.empty(g)
    seeds = np.empty(g, np.uint64)
    for i in range(g):
        # Starts 2 r and 2 r + 1 are the two halves of row r, which differ in their seeds alone.
        r = rows[i // 2]
        put_column(here, i, column(points, r))
        put_column(around, i, column(normals, r))
        levels[i] = isovalues[r]
        seeds[i] = texel_seed(texels[r, 0], texels[r, 1], texels[r, 2], i % 2)
    return PathStarts(here, around, levels, seeds, np.full(g, NO_WALL))


@kernel()
def bake_together(scene, place, rows, samples, rules, orders, out):
    """Bake a few texels whose paths fill waves together; arguments as for ``bake_rows``."""
    # Take starts in pairs, one for each half of a texel's samples.
    g = 2 * rows.shape[0]
    last = samples.first + samples.count
    (bounces, branches) = limits(rules)
    starts = start_halves(place, rows)
    # Trace as many samples at once as fill a wave.
    step = min(max(WAVE_PATHS // g, 1), samples.count)
    most = orders.max()
    tree = PathTree(bounces, rules.survival, branches)
    ends = make_ends(g, step, branches)
    carried = make_carried(scene, ends.bounces.shape[0])
    sums = np.zeros((orders.shape[0], whole(g) // PATH_WIDTH, most * most * PATH_WIDTH))
    # Continue the sums of former samples, so that refinement gives the same bits as one long bake.
    exchange(sums, rows, out, False)
    # Trace the paths to their ends, and project these on spherical harmonics.
    for begin in range(samples.first, last, step):
        some = SampleRange(begin, min(step, last - begin))
        trace_ends(scene, starts, some, tree, ends, carried)
        project_ends(ends, carried, rules, orders, g, (some.count, step), sums)
    exchange(sums, rows, out, True)


@kernel()
def bake_rows(scene, place, rows, samples, rules, orders, sums):
    """Add a ``SampleRange`` of paths from the ``rows`` to ``sums``,
    some texels at a time: see ``bake_texels``.
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
    """Add a ``SampleRange`` of transfer samples of the ``rows`` to ``sums``, for both halves of
    each texel.

    ``place`` holds the input and output of ``locate_texels``: texels, points, normals and
    isovalues, which lie within the range of ``cells``. The weights (channels, bounces + 2) of the
    ``TransferRules`` hold the weight of a path that never leaves at 0, and of one that leaves after
    k bounces at k + 1. ``sums`` are (m, 2, channels, n²); n is the greatest of the channels'
    ``orders``. Source: S1, section 4.1, "for all texels".
    """
    bake_rows(Open(field, cells), place, rows, samples, rules, orders, sums)


@kernel()
def light_together(field, cells, place, rows, samples, rules, light, sums):
    """Bake the irradiance of a few texels whose paths fill waves together:
    see ``bake_irradiance``.
    """
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
    """Add a ``SampleRange`` of E/π of the ``rows`` to ``sums`` (m, 2, 3), for both halves of each
    texel.

    ``place`` and the random numbers are those of ``bake_texels``. The weights (bounces + 1, 3) of
    the ``PathRules`` are R^k over the probability to get there (see ``russian_roulette``);
    ``light`` are the Surroundings. The sums are linear RGB with all bounces; times the albedo they
    are the radiance that leaves the surface.
    """
    together = max(WAVE_PATHS // (2 * samples.count), PATH_WIDTH)
    for i in range(0, rows.shape[0], together):
        light_together(field, cells, place, rows[i : i + together], samples, rules, light, sums)


class ColouredRules(NamedTuple):
    """Weights of a path in each of r rows of sums on a coloured surface, and its ``PathTree``.

    Rows have harmonics of ``orders`` (r,). A path that leaves without a bounce has the weight
    ``straight`` (r,). A path that leaves after bounces has the weight ``reflected`` (r,), times the
    product of the albedos that it met over the probability to get there, mixed from RGB by
    ``mixes`` (r, 3); rows that are ``squared`` (r,) take the square of that product.
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
    """One isosurface of a ``field`` within its active ``cells``, whose albedo ``colours``
    define at each point.
    """

    field: Any
    cells: Any
    colours: Any


@limits.case(ColouredRules)
def limits_of_colours(rules):
    """Return the bounces and branches of ColouredRules."""
    return rules.bounces, rules.branches


@make_carried.case(Coloured)
def make_albedos(scene, paths):
    """Allocate the products of the albedos that each path met."""
    return np.ones((3, paths))


@advance.case(Coloured)
def advance_on_colours(scene, state, vertices, following, bounce, rules):
    """Move the paths that hit the surface there,
    and multiply their carried product by albedo over probability.
    """
    rays = state.wave.rays
    carried = state.wave.carried
    chance = rules.survival if bounce > 0 else 1.0
    origins = columns(vertices.points, vertices.count)
    directions = columns(rays.directions, vertices.count)
    # Multiply by the albedo at the hit point, divided by the probability of Russian roulette.
    for i in rays.hits[: following.count]:
        albedo = albedo_at(
            scene.colours, madd(column(origins, i), rays.t[i], column(directions, i))
        )
        for c in range(3):
            carried[c, rays.owners[i]] *= albedo[c] / chance
    advance_in_the_open(scene, state, vertices, following, bounce, rules)


@begin_branches.case(Coloured, PathEnds)
def carry_along(scene, wave, count, ends):
    """Mark new branches as unfinished, and give them the products that their parents carry."""
    branch_ends(wave, count, ends)
    for owner in wave.rays.owners[:count]:
        put_column(wave.carried, owner, column(wave.carried, owner % wave.starting))


@kernel()
def count_path(rules, row, bounces, carried, m):
    """Return the weight in a ``row`` of sums of path ``m``, which left after ``bounces``; 0 if it
    never left (-1), or if entry m is no path (NO_PATH).

    ``carried`` (3, paths) holds the product of albedos over the probability to get there.
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
    """Weight each path by the albedos that it met; branches share the weight of their path."""
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
    """Add transfer samples on a surface with ``colours``: ``bake_texels`` by ColouredRules, with
    the same paths.

    Adds Σ (Π R(x_j)) Y_i(ω) over all paths to ``sums`` (m, 2, r, n²), with the points x_j that a
    path hits; divided by the number of samples it is τ_i.
    """
    bake_rows(Coloured(field, cells, colours), place, rows, samples, rules, rules.orders, sums)


TEXEL_PROJECTED, TOO_FAR, OTHER_SHEET, NORMAL_TURNED, TEXEL_HEMMED, NO_SURFACE = range(6)
"""Verdicts on a texel: projected; the isosurface is not within MAX_SHIFT_VOXELS; the crossing
lies on another sheet of it; the normal there is turned by more than a right angle; light has no
room to arrive there; the texel has no normal.
"""

MAX_BACKTRACK = 0.1
"""Largest part of the way between two isovalues by which the field may run backwards in between."""


@kernel(exact=True)
def strays(voxels, p, d, level, reach):
    """Return how far the field runs away from ``level`` between ``p`` and ``reach`` along ``d``, as
    a share of the difference between ``level`` and the field at ``p``.

    On the way from a texel to its isosurface it should only come nearer; a large share says that
    the way leads through another sheet.
    """
    here = value(voxels, p)
    nearest = abs(here - level)
    back = 0.0
    t = STEP_VOXELS
    # Sample the way in steps; the field should come nearer to the level with each.
    while t < reach:
        away = abs(value(voxels, point_within(voxels.shape, p, d, t)) - level)
        nearest, back, t = min(nearest, away), max(back, away - nearest), t + STEP_VOXELS
    return back / max(abs(here - level), 1e-300)


@kernel(exact=True)
def way_to(field, p, n, level, halvings=HALVINGS):
    """Return direction and length in voxels of the way from ``p`` to the isosurface ``level`` along
    the normal ``n``.

    ``n`` is not zero. The direction is a voxel long, in index space, out of the solid or into it.
    The length goes to the first crossing of the trilinear field, refined by ``halvings`` (see
    ``crossing``); it is infinite if there is none within MAX_SHIFT_VOXELS.
    """
    d = downhill(n, field.spacing, 1.0 if value(field.voxels, p) > level else -1.0)
    return d, crossing(field.voxels, p, d, level, halvings)


@kernel(exact=True)
def project_point(field, p, level):
    """Move ``p`` along its normal onto the isosurface ``level``; return (verdict, point, normal).

    Point and normal are those of ``p`` if the verdict is not TEXEL_PROJECTED.
    """
    # Follow the normal to the first crossing of the level.
    n = normal(field, p)
    if math.isnan(value(field.voxels, p)) or is_zero(n):
        return NO_SURFACE, p, n
    d, t = way_to(field, p, n, level)
    if not t < math.inf:
        return TOO_FAR, p, n
    # Refuse a crossing on another sheet, with a turned normal, or without room for light.
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
    """Move ``texels`` (m, 3; z, y, x) onto the isosurface ``level``, in units of the voxels.

    ``step`` (3,) holds the voxels per texel along x, y, z. Writes ``points`` and ``normals`` (3,
    m), and the ``verdicts`` (m,): TEXEL_PROJECTED, or the reason why a texel stays in place.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        verdict, there, n = project_point(field, p, level)
        verdicts[m] = np.uint8(verdict)
        put_column(points, m, there)
        put_column(normals, m, n)


@kernel(types.void(FIELD_RECORD, REAL_ARRAY, types.float64, TEXEL_PLACES, REAL_ARRAY))
def measure_distances(field, step, level, texels, ways):
    """Estimate the distances ``ways`` (m,) in voxels from ``texels`` (m, 3; z, y, x) to the
    isosurface ``level``.

    To first order, |ρ - level| / |∇ρ| with the smoothed gradient ∇ρ; infinite if that is zero or ρ
    is not a number.
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        away = abs(value(field.voxels, p) - level)
        slope = length(smooth_gradient(field.voxels, p))
        way = away / slope if slope > 0.0 else math.inf
        ways[m] = math.inf if math.isnan(way) else way
