"""The integrator: one loop for all paths of a wave, all first rays, then all second ones, and so
on.

Records choose what rays meet, what they gather, and how paths go on. ``scene`` is what rays meet,
with its ``field``: Open, Coloured, InRoom, Among, or Through. ``source`` is what paths gather: the
light of Surroundings or of Glows, PathEnds (after how many bounces each path left and in which
direction, for any light to come), or Strays. ``rules`` say how they go on: PathRules, or a
PathTree. The module of each record says how it takes the steps of the loop: see ``Choice``.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, Choice, kernel
from isogi_core.kernels.simd.maths import u32
from isogi_core.kernels.simd.memory import load
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.cast import ORIGINS, SIDE_ARRAY, cast_batch
from isogi_core.kernels.tracing.field import FIELD_RECORD, gradients, to_index, to_world_normal
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, launch, shading_normal
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.vec import column, load_columns, madd, put_column, store_columns
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.paths import NO_PATH, PathEnds, PathRules, PathTree, SampleRange
from isogi_core.kernels.transport.rng import WORD_BITS, WORD_MASK, point_of_words
from isogi_core.kernels.transport.sampling import about, sample_cosine_hemisphere
from isogi_core.kernels.transport.streams import DIRECTIONS, FIRST_ROULETTE_PAIR

WAVE_PATHS = 4096
"""Paths of a wave: all that is known of them stays in the second-level cache."""


class Wave(NamedTuple):
    """The paths of a wave that go on, in the first places of arrays (n,), and room for columns (3
    n,).

    ``owners`` are their numbers; ``low``, ``high``, ``samples`` the words that own their random
    numbers; ``isovalues`` those of their surfaces, ``sides`` where their next rays start, ``signs``
    the same as float64; ``t`` and ``came`` what these meet; ``hits`` and ``escaped`` the places of
    those that meet something and of those that do not; ``directions`` are in index space, ``ways``
    in the world; ``weights`` are room for ``smooth_gradients``.
    """

    owners: Any
    low: Any
    high: Any
    samples: Any
    isovalues: Any
    sides: Any
    signs: Any
    t: Any
    came: Any
    hits: Any
    escaped: Any
    directions: Any
    ways: Any
    weights: Any


class Vertices(NamedTuple):
    """The ``count`` vertices that a wave's paths are at: room (3 n,) for where rays start, and
    normals there.
    """

    points: Any
    normals: Any
    count: int


@kernel()
def whole(count):
    """The places that ``count`` paths take in whole vectors."""
    return (count + PATH_WIDTH - 1) // PATH_WIDTH * PATH_WIDTH


@kernel()
def make_wave(n):
    """Room for the waves of ``n`` paths."""
    words_of = np.zeros((3, n), np.uint32)
    places = np.empty((3, n), np.int64)
    return Wave(
        places[0],
        words_of[0],
        words_of[1],
        words_of[2],
        np.zeros(n),
        np.zeros(n, np.int8),
        np.ones(n),
        np.empty(n),
        np.empty(n, np.int8),
        places[1],
        places[2],
        np.empty(3 * n),
        np.empty(3 * n),
        np.empty((3, 9, PATH_WIDTH)),
    )


@kernel()
def make_vertices(n):
    """Room for the vertices of ``n`` paths."""
    return Vertices(np.zeros(3 * n), np.zeros(3 * n), n)


@kernel()
def columns(room, count):
    """The (3, n) array that vectors of ``count`` paths make in their room."""
    n = whole(count)
    return room[: 3 * n].reshape(3, n)


@kernel()
def generate(wave, vertices, starts, origins, first, begin):
    """Fill the wave with paths ``begin`` … ``begin + vertices.count``; see ``trace_paths``.

    ``origins`` (3, g) are where first rays start, ``first`` the number of the first sample.
    """
    count = vertices.count
    here = columns(vertices.points, count)
    normals = columns(vertices.normals, count)
    g = starts.isovalues.shape[0]
    i = begin % g
    sample = first + begin // g
    for m in range(count):
        wave.owners[m] = begin + m
        wave.samples[m] = sample
        wave.isovalues[m] = starts.isovalues[i]
        wave.sides[m] = OUTSIDE_SIGN
        wave.low[m] = starts.seeds[i] & WORD_MASK
        wave.high[m] = starts.seeds[i] >> WORD_BITS
        put_column(here, m, column(origins, i))
        put_column(normals, m, column(starts.normals, i))
        i += 1
        if i == g:
            i = 0
            sample = sample + 1


@kernel()
def sample_direction(wave, vertices, bounce, spacing):
    """Draw ``ways`` and ``directions`` of all paths about their normals, cosine-weighted."""
    count = vertices.count
    normals = columns(vertices.normals, count)
    ways = columns(wave.ways, count)
    directions = columns(wave.directions, count)
    dimension = u32(DIRECTIONS + bounce)
    for i in range(0, count, PATH_WIDTH):
        low = load(wave.low, i, PATH_WIDTH)
        high = load(wave.high, i, PATH_WIDTH)
        sample = load(wave.samples, i, PATH_WIDTH)
        u, v = point_of_words(low, high, sample, dimension)
        w = about(load_columns(normals, i), sample_cosine_hemisphere(u, v))
        store_columns(ways, i, w)
        store_columns(directions, i, to_index(w, spacing))


@kernel()
def intersect(field, cells, wave, points, count):
    """Cast the rays from ``points``; what fills up the last vector starts at infinity and meets
    nothing.
    """
    n = whole(count)
    origins = columns(points, count)
    origins[:, count:] = math.inf
    rays = Rays(wave.isovalues[:n], origins, columns(wave.directions, count), wave.sides[:n])
    cast_batch(field, cells, rays, wave.t[:n], wave.came[:n])


@kernel()
def partition(wave, count):
    """List the places of rays that hit something, and of those that escape; returns how many
    hit.
    """
    hits = escaped = 0
    for i in range(count):
        hit = wave.t[i] < math.inf
        wave.hits[hits] = i
        wave.escaped[escaped] = i
        hits += hit
        escaped += not hit
    return hits


@kernel()
def russian_roulette(wave, hits, bounce, survival):
    """Of paths that hit something, but the first time, a share ``survival`` goes on; returns how
    many.

    Each stands for those that do not: its light counts over its chance. Source: Arvo and Kirk,
    "Particle Transport and Image Synthesis", 1990.
    """
    if bounce == 0 or survival >= 1.0:
        return hits
    staying = 0
    dimension = np.uint64(FIRST_ROULETTE_PAIR + bounce)
    for h in range(hits):
        i = wave.hits[h]
        u, _ = point_of_words(
            np.uint64(wave.low[i]), np.uint64(wave.high[i]), np.uint64(wave.samples[i]), dimension
        )
        wave.hits[staying] = i
        staying += u < survival
    return staying


@kernel()
def compact(wave, vertices, following):
    """Move the paths that hit something to the first places, and where they hit it to the vertices
    ``following``.
    """
    count = vertices.count
    hits = following.count
    origins = columns(vertices.points, count)
    directions = columns(wave.directions, count)
    points = columns(following.points, hits)
    for h in range(hits):
        i = wave.hits[h]
        put_column(points, h, madd(column(origins, i), wave.t[i], column(directions, i)))
        wave.owners[h] = wave.owners[i]
        wave.isovalues[h] = wave.isovalues[i]
        wave.sides[h] = wave.came[i]
        wave.signs[h] = wave.came[i]
        wave.low[h] = wave.low[i]
        wave.high[h] = wave.high[i]
        wave.samples[h] = wave.samples[i]


@kernel()
def mend_normals(field, wave, some, points, normals, ways):
    """Turn normals of a flat field, of paths ``some`` (first, last), against the ray that hit:
    ``shading_normal``.
    """
    for h in range(some[0], some[1]):
        if normals[0, h] == 0.0 and normals[1, h] == 0.0 and normals[2, h] == 0.0:
            way = column(ways, wave.hits[h])
            put_column(
                normals, h, shading_normal(field, column(points, h), int(wave.sides[h]), way)
            )


@kernel()
def next_vertex(field, wave, count, following):
    """Find the normals at the points ``following``, ``shading_normal``, and move these to where
    rays start, ``launch``.

    ``count`` rays were cast to get there.
    """
    hits = following.count
    points = columns(following.points, hits)
    normals = columns(following.normals, hits)
    ways = columns(wave.ways, count)
    for i in range(0, hits, PATH_WIDTH):
        last = min(i + PATH_WIDTH, hits)
        sign = load(wave.signs, i, PATH_WIDTH)
        p = load_columns(points, i)
        gradients(field, points, i, last - i, wave.weights, normals)
        n = to_world_normal(load_columns(normals, i), field.spacing)
        store_columns(normals, i, (n[0] * sign, n[1] * sign, n[2] * sign))
        mend_normals(field, wave, (i, last), points, normals, ways)
        isovalues = load(wave.isovalues, i, PATH_WIDTH)
        store_columns(points, i, launch(field, isovalues, p, load_columns(normals, i), sign))


@kernel()
def launch_all(field, starts):
    """Where the first rays start, (3, g): off the surface, see ``launch``, and on a wall."""
    origins = starts.points.copy()
    for i in range(starts.isovalues.shape[0]):
        if starts.walls[i] < 0.0:
            p, n = column(starts.points, i), column(starts.normals, i)
            put_column(origins, i, launch(field, starts.isovalues[i], p, n, OUTSIDE_SIGN))
    return origins


@kernel(types.void(FIELD_RECORD, REAL_ARRAY, ORIGINS, ORIGINS, REAL_ARRAY, SIDE_ARRAY, ORIGINS))
def bounce_rays(field, isovalues, origins, directions, t, came, numbers):
    """Turn rays ``origins`` + t · ``directions`` (3, n) that hit, in place, into cosine rays from
    there.

    ``isovalues`` (n,) of the surfaces; ``t`` and ``came`` (n,) as ``cast_batch`` writes them;
    ``numbers`` (2, n) in [0, 1). They start off the surface as a path's do. Source: S1, section
    4.1.
    """
    for m in range(origins.shape[1]):
        d = column(directions, m)
        p = madd(column(origins, m), t[m], d)
        n = shading_normal(field, p, int(came[m]), d)
        w = about(n, sample_cosine_hemisphere(numbers[0, m], numbers[1, m]))
        put_column(origins, m, launch(field, isovalues[m], p, n, int(came[m])))
        put_column(directions, m, to_index(w, field.spacing))


class ShadowRays(NamedTuple):
    """Shadow rays of a wave: room (3 n,) for where they start and what they carry, and how far they
    reach, (n,).
    """

    starts: Any
    light: Any
    reach: Any


class PathWave(NamedTuple):
    """The ``rays`` of a wave of paths that gather light, and its ``shadow`` rays.

    (n,) are the walls that vertices stand on, ``own``, and that rays ``met``. ``carried`` (3,
    paths) is what light at a path's vertex counts in what it has ``gathered`` (channels, paths).
    """

    rays: Any
    shadow: Any
    own: Any
    met: Any
    carried: Any
    gathered: Any


@Choice
def limits(rules):
    """How many bounces paths have at most, and in how many branches they go on from what they hit
    first.
    """


@Choice
def make_state(scene, starts, wave):
    """The state of a wave in a scene: a record with that ``wave``, and room for what rays need
    besides.
    """


@Choice
def launch_starts(scene, starts):
    """Where first rays start, (3, g)."""


@Choice
def begin_wave(scene, state, vertices, starts, first):
    """Say on what the first vertices of a wave stand, whose first path has the number ``first``."""


@Choice
def gather_sources(scene, state, vertices, bounce, source):
    """Add what rays towards the sources bring to the vertices of a wave."""


@Choice
def meet(scene, state, vertices, bounce):
    """Cast the rays of a wave, and write what each of them meets first."""


@Choice
def gather_met(scene, state, vertices, bounce, source):
    """Gather what the cast rays brought; list the rays whose paths go on from what they hit:
    returns how many.
    """


@Choice
def advance(scene, state, vertices, following, bounce, rules):
    """Move the paths that go on to the vertices ``following``; what they carry is multiplied by the
    albedo there.
    """


@Choice
def split(scene, state, vertices, spare, bounce, rules, source):
    """Let paths that go on from ``vertices`` branch: returns their vertices then, and the ``spare``
    vertices.
    """


@limits.case(PathRules)
def limits_of_weights(rules):
    """Paths have as many bounces as there are weights beside the first, and no branches."""
    return rules.weights.shape[0] - 1, 1


@split.case()
def stay_single(scene, state, vertices, spare, bounce, rules, source):
    """Let no path branch."""
    return vertices, spare


@gather_sources.case()
def gather_nothing(scene, state, vertices, bounce, source):
    """Cast no rays towards sources: there are none."""


@kernel()
def make_shadow_rays(n):
    """Room for the shadow rays of a wave of ``n`` paths."""
    return ShadowRays(np.zeros(3 * n), np.empty(3 * n), np.empty(n))


@kernel()
def make_paths(n, rules, total, gathered):
    """The waves of ``n`` of ``total`` paths, which carry the first weight, and have ``gathered``
    nothing yet.
    """
    gathered[:, :total] = 0.0
    carried = np.empty((3, total))
    for c in range(3):
        carried[c] = rules.weights[0, c]
    return PathWave(
        make_wave(n),
        make_shadow_rays(n),
        np.full(n, NO_WALL),
        np.full(n, NO_WALL),
        carried,
        gathered,
    )


@kernel()
def add_carried(wave, i, light):
    """Add ``light`` that arrives at the vertex of path ``i`` of a wave to what it has gathered."""
    m = wave.rays.owners[i]
    for c in range(3):
        wave.gathered[c, m] += wave.carried[c, m] * light[c]


@kernel()
def walk(scene, state, vertices, spare, rules, source):
    """Walk the paths of a wave to their ends, and gather on the way; ``spare`` is room for other
    vertices.
    """
    rays = state.wave.rays
    (last, _) = limits(rules)
    for bounce in range(last + 1):
        gather_sources(scene, state, vertices, bounce, source)
        sample_direction(rays, vertices, bounce, scene.field.spacing)
        meet(scene, state, vertices, bounce)
        hits = gather_met(scene, state, vertices, bounce, source)
        hits = russian_roulette(rays, hits, bounce, rules.survival)
        if hits == 0 or bounce == last:
            return
        following = Vertices(spare.points, spare.normals, hits)
        advance(scene, state, vertices, following, bounce, rules)
        vertices, spare = split(scene, state, following, vertices, bounce, rules, source)


@kernel()
def places_for(total, branches):
    """The places of a wave, at most WAVE_PATHS or so, for ``total`` paths that go on in this number
    of ``branches``.
    """
    return whole(min(WAVE_PATHS // branches, total)) * branches


@kernel()
def trace_paths(scene, starts, samples, rules, source, wave):
    """Walk a ``SampleRange`` of paths from each of g ``starts``, in waves that fill the places of
    ``wave``.

    Path s · g + i is the sample ``first + s`` of start i.
    """
    total = starts.isovalues.shape[0] * samples.count
    n = wave.rays.owners.shape[0]
    most = WAVE_PATHS // limits(rules)[1]
    origins = launch_starts(scene, starts)
    room = make_vertices(n)
    spare = make_vertices(n)
    state = make_state(scene, starts, wave)
    for first in range(0, total, most):
        vertices = Vertices(room.points, room.normals, min(most, total - first))
        generate(wave.rays, vertices, starts, origins, samples.first, first)
        begin_wave(scene, state, vertices, starts, first)
        walk(scene, state, vertices, spare, rules, source)


@kernel()
def gather_paths(scene, starts, samples, rules, source, gathered):
    """Write what each path of ``trace_paths`` gathers to ``gathered`` (channels, at least g ·
    count).
    """
    total = starts.isovalues.shape[0] * samples.count
    trace_paths(
        scene,
        starts,
        samples,
        rules,
        source,
        make_paths(places_for(total, 1), rules, total, gathered),
    )


@kernel()
def add_paths(scene, starts, samples, rules, source, sums):
    """Add what a ``SampleRange`` of paths gathers at each of g ``starts`` to its ``sums`` (g,
    channels).

    Sums grow sample by sample: the company of a start changes no bit. Source: Kajiya 1986.
    """
    g = sums.shape[0]
    last = samples.first + samples.count
    step = max(WAVE_PATHS // max(g, 1), 1)
    gathered = np.empty((sums.shape[1], g * step))
    for first in range(samples.first, last, step):
        some = SampleRange(first, min(step, last - first))
        gather_paths(scene, starts, some, rules, source, gathered)
        for m in range(g * some.count):
            for j in range(sums.shape[1]):
                sums[m % g, j] += gathered[j, m]


class EndWave(NamedTuple):
    """The ``rays`` of a wave of paths that gather no light, of which ``starting`` ones start and
    may branch.

    ``carried`` (3, paths) are the albedos that each has met, multiplied, where these differ from
    place to place.
    """

    rays: Any
    starting: int
    carried: Any


@Choice
def begin_branches(scene, wave, count, source):
    """Say what the ``count`` branches of a wave have gathered and carry."""


@begin_branches.case()
def begin_alike(scene, wave, count, source):
    """Leave all as it is: branches are known by the paths that they are of."""


@limits.case(PathTree)
def limits_of_tree(rules):
    """Say how far a ``PathTree`` goes."""
    return rules.bounces, rules.branches


@kernel()
def blocks(branches):
    """How many parts the ``PathEnds`` have: one of paths as they start, and one for each of their
    ``branches``.
    """
    return 1 if branches == 1 else 1 + branches


@kernel()
def make_ends(starts, count, branches):
    """Room for the ``PathEnds`` of ``starts`` starts, ``count`` samples each."""
    n = blocks(branches) * starts * count
    return PathEnds(np.zeros(n, np.int64), np.zeros((3, n + PATH_WIDTH)))


@kernel()
def branch(wave, vertices, room, branches, stride):
    """Let each of the wave's paths go on in a number of ``branches``, from vertices in ``room``,
    which it returns.

    Branch j of path m is path m + (1 + j) · ``stride``, and draws from sample ``branches`` · s + j.
    """
    hits = vertices.count
    count = branches * vertices.count
    points = columns(vertices.points, hits)
    normals = columns(vertices.normals, hits)
    further = columns(room.points, count)
    around = columns(room.normals, count)
    for h in range(hits - 1, -1, -1):  # each is read before others are written in its place
        owner = wave.owners[h]
        sample = wave.samples[h]
        isovalue = wave.isovalues[h]
        low = wave.low[h]
        high = wave.high[h]
        side = wave.sides[h]
        sign = wave.signs[h]
        for j in range(branches):
            i = branches * h + j
            wave.owners[i] = owner + (1 + j) * stride
            wave.samples[i] = branches * sample + j
            wave.low[i] = low
            wave.high[i] = high
            wave.isovalues[i] = isovalue
            wave.sides[i] = side
            wave.signs[i] = sign
            put_column(further, i, column(points, h))
            put_column(around, i, column(normals, h))
    return Vertices(room.points, room.normals, count)


@split.case(PathTree)
def branch_once(scene, state, vertices, spare, bounce, rules, source):
    """Let paths branch that go on from what they hit first."""
    if bounce > 0 or rules.branches == 1:
        return vertices, spare
    following = branch(state.wave.rays, vertices, spare, rules.branches, state.wave.starting)
    begin_branches(scene, state.wave, following.count, source)
    return following, vertices


@kernel()
def branch_ends(wave, count, ends):
    """Say of the wave's ``count`` branches that they have not left, and of the paths that they are
    of nothing.
    """
    for owner in wave.rays.owners[:count]:
        ends.bounces[owner % wave.starting] = NO_PATH
        ends.bounces[owner] = -1


@begin_branches.case(PathEnds)
def begin_ends(scene, wave, count, ends):
    """Say of the wave's branches that they have not left."""
    branch_ends(wave, count, ends)


@gather_met.case(PathEnds)
def write_ends(scene, state, vertices, bounce, ends):
    """Write the ends of paths that leave; returns how many go on."""
    rays = state.wave.rays
    count = vertices.count
    hits = partition(rays, count)
    ways = columns(rays.ways, count)
    for i in rays.escaped[: count - hits]:
        m = rays.owners[i]
        ends.bounces[m] = bounce
        put_column(ends.directions, m, column(ways, i))
    return hits


@kernel()
def trace_ends(scene, starts, samples, tree, ends, carried):
    """Walk a ``SampleRange`` of paths from each of g ``PathStarts``, as a ``PathTree`` says, to
    their ends.

    Isovalues are within the range of the scene's cells. Writes the ``PathEnds`` of at least g ·
    count paths, and what these have ``carried``.
    """
    total = starts.isovalues.shape[0] * samples.count
    ends.bounces[:total] = -1
    ends.bounces[total:] = NO_PATH
    ends.directions[:] = 0.0
    carried[:, :total] = 1.0
    rays = make_wave(places_for(total, tree.branches))
    wave = EndWave(rays, ends.bounces.shape[0] // blocks(tree.branches), carried)
    trace_paths(scene, starts, samples, tree, ends, wave)
