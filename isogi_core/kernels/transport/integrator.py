"""The integrator: a wavefront path tracer, ``walk``, which all light transport shares.

A wave holds up to WAVE_PATHS paths. Each stage of the loop handles all paths of the wave before the
next stage begins: sample directions, intersect, gather light, play Russian roulette, compact, find
the next vertices. The arrays of a wave fit the second-level cache, and each stage runs in SIMD
vectors of PATH_WIDTH paths.

The types of three records select the code of each stage when a kernel is compiled (see ``Choice``).
The module that defines a record also defines its cases.

- ``scene``: the geometry that rays meet, with its ``field``. Open, Coloured, InRoom, Among or
  Through.
- ``source``: the quantity that paths gather. Light of Surroundings or of Glows; or PathEnds, which
  hold the number of bounces and the direction of each path that leaves the volume, so that any
  light can be applied later.
- ``rules``: how paths continue. PathRules, or a PathTree whose paths branch.

Source: Laine, Karras and Aila, "Megakernels Considered Harmful: Wavefront Path Tracing on GPUs",
2013.
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
"""Paths of a wave at most. Their arrays fit the second-level cache."""


class Wave(NamedTuple):
    """State of the rays of a wave, one entry per path; paths that continue fill the first places.

    Arrays are (n,); ``directions`` and ``ways`` are (3 n,), to be viewed through ``columns``.

    - ``owners``: number of the path.
    - ``low``, ``high``, ``samples``: the start's seed in two words, and the sample number. Together
      they determine all random numbers of the path.
    - ``isovalues``: isovalue of the surface that the path runs on.
    - ``sides``, ``signs``: side of the surface that the next ray starts on, as int8 and as float64.
    - ``t``, ``came``: distance to the intersection, infinite if there is none, and the side that
      the ray arrives on.
    - ``hits``, ``escaped``: places of the rays that hit something, after Russian roulette of those
      whose paths continue; and of the rays that escape.
    - ``directions``, ``ways``: ray directions in index space and in world space.
    - ``weights``: scratch space of ``gradients``.
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
    """Current vertices of the ``count`` paths of a wave: ray origins and normals, (3 n,) each."""

    points: Any
    normals: Any
    count: int


@kernel()
def whole(count):
    """Round a number of paths up to whole SIMD vectors."""
    return (count + PATH_WIDTH - 1) // PATH_WIDTH * PATH_WIDTH


@kernel()
def make_wave(n):
    """Allocate the state of a wave of ``n`` paths."""
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
    """Allocate the vertices of ``n`` paths."""
    return Vertices(np.zeros(3 * n), np.zeros(3 * n), n)


@kernel()
def columns(flat, count):
    """View the beginning of the (3 n,) array ``flat`` as vectors of ``count`` paths: (3, count
    rounded up to whole SIMD vectors).

    The rows follow each other without gaps, as kernels demand that take contiguous arrays
    (``cast_batch``). So the place of a vector depends on ``count``: read an array by the count that
    it was written by.
    """
    n = whole(count)
    return flat[: 3 * n].reshape(3, n)


@kernel()
def generate(wave, vertices, starts, origins, first, begin):
    """Start paths ``begin`` to ``begin + vertices.count`` of the numbering in ``trace_paths``.

    ``origins`` (3, g) are the origins of first rays, ``first`` is the number of the first sample.
    """
    count = vertices.count
    here = columns(vertices.points, count)
    normals = columns(vertices.normals, count)
    # Path p is sample first + p // g of start p % g: all starts take a sample before any takes the
    # next.
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
    """Sample a cosine-weighted direction about the normal of each path, into ``ways`` and
    ``directions``.

    Cosine sampling makes irradiance the mean of incident radiance times π (S1, section 4.1).
    """
    count = vertices.count
    normals = columns(vertices.normals, count)
    ways = columns(wave.ways, count)
    directions = columns(wave.directions, count)
    # Each bounce draws its pair of random numbers from a different dimension.
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
    """Cast the rays from ``points``, and write ``t`` and ``came`` of the wave.

    Lanes that only fill up the last vector start at infinity, so that they hit nothing.
    """
    n = whole(count)
    origins = columns(points, count)
    origins[:, count:] = math.inf
    rays = Rays(wave.isovalues[:n], origins, columns(wave.directions, count), wave.sides[:n])
    cast_batch(field, cells, rays, wave.t[:n], wave.came[:n])


@kernel()
def partition(wave, count):
    """List the places of the rays that hit the surface, and of those that escape;
    return the number of hits.
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
    """Continue each path that hit something with probability ``survival``; return the number that
    continue.

    The first bounce is never cut. The caller divides the carried weight by the probability. Source:
    Arvo and Kirk, "Particle Transport and Image Synthesis", 1990.
    """
    if bounce == 0 or survival >= 1.0:
        return hits
    # Compact the list of hits in place; the random number belongs to path and bounce.
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
    """Move the paths that continue to the first places, and write their hit points to
    ``following``, as vertices without normals.

    The first ``following.count`` of ``wave.hits`` are the places of these paths, ascending.
    Directions and ``t`` stay where they are: later stages read them through ``wave.hits``.
    """
    count = vertices.count
    hits = following.count
    origins = columns(vertices.points, count)
    directions = columns(wave.directions, count)
    points = columns(following.points, hits)
    # Each place i is read before it is written: as hits ascend, i >= h.
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
    """Replace zero normals of the paths ``some`` (first, last) by the direction against their ray.

    A field that is flat at a point has no gradient there: see ``shading_normal``.
    """
    for h in range(some[0], some[1]):
        if normals[0, h] == 0.0 and normals[1, h] == 0.0 and normals[2, h] == 0.0:
            way = column(ways, wave.hits[h])
            put_column(
                normals, h, shading_normal(field, column(points, h), int(wave.sides[h]), way)
            )


@kernel()
def next_vertex(field, wave, count, following):
    """Compute normals at the points ``following``, and offset these to the origins of the next
    rays.

    ``count`` rays were cast to get there. See ``shading_normal`` and ``launch``.
    """
    hits = following.count
    points = columns(following.points, hits)
    normals = columns(following.normals, hits)
    ways = columns(wave.ways, count)
    for i in range(0, hits, PATH_WIDTH):
        # Take the gradient of the field at a vector of points, on the side that rays arrive on.
        last = min(i + PATH_WIDTH, hits)
        sign = load(wave.signs, i, PATH_WIDTH)
        p = load_columns(points, i)
        gradients(field, points, i, last - i, wave.weights, normals)
        n = to_world_normal(load_columns(normals, i), field.spacing)
        store_columns(normals, i, (n[0] * sign, n[1] * sign, n[2] * sign))
        mend_normals(field, wave, (i, last), points, normals, ways)
        # Offset the points along the normals, so that rays do not meet the surface that they start
        # on.
        isovalues = load(wave.isovalues, i, PATH_WIDTH)
        store_columns(points, i, launch(field, isovalues, p, load_columns(normals, i), sign))


@kernel()
def launch_all(field, starts):
    """Return the origins of first rays, (3, g): offset from the isosurface by ``launch``,
    or on a wall.
    """
    origins = starts.points.copy()
    for i in range(starts.isovalues.shape[0]):
        if starts.walls[i] < 0.0:
            p, n = column(starts.points, i), column(starts.normals, i)
            put_column(origins, i, launch(field, starts.isovalues[i], p, n, OUTSIDE_SIGN))
    return origins


@kernel(types.void(FIELD_RECORD, REAL_ARRAY, ORIGINS, ORIGINS, REAL_ARRAY, SIDE_ARRAY, ORIGINS))
def bounce_rays(field, isovalues, origins, directions, t, came, numbers):
    """Replace rays that hit the surface by cosine-distributed rays from their hit points, in place.

    ``origins`` + t · ``directions`` (3, n) are the hit points; ``isovalues`` (n,) belong to their
    surfaces; ``t`` and ``came`` (n,) are outputs of ``cast_batch``; ``numbers`` (2, n) are uniform
    in [0, 1). Source: S1, section 4.1.
    """
    for m in range(origins.shape[1]):
        d = column(directions, m)
        p = madd(column(origins, m), t[m], d)
        n = shading_normal(field, p, int(came[m]), d)
        w = about(n, sample_cosine_hemisphere(numbers[0, m], numbers[1, m]))
        put_column(origins, m, launch(field, isovalues[m], p, n, int(came[m])))
        put_column(directions, m, to_index(w, field.spacing))


class ShadowRays(NamedTuple):
    """Shadow rays of a wave: origins (3 n,), the light that each carries (3 n,),
    and its reach (n,).
    """

    starts: Any
    light: Any
    reach: Any


class PathWave(NamedTuple):
    """A wave of paths that gather light: its ``rays`` and ``shadow`` rays.

    ``own`` and ``met`` (n,) are the walls that vertices lie on and that rays hit. ``carried`` (3,
    paths) is the throughput of each path, ``gathered`` (channels, paths) the light it has
    collected.
    """

    rays: Any
    shadow: Any
    own: Any
    met: Any
    carried: Any
    gathered: Any


@Choice
def limits(rules):
    """Return the largest number of bounces of a path, and of branches after its first hit."""


@Choice
def make_state(scene, starts, wave):
    """Make the state of a wave in a scene: a record that holds ``wave``
    and scratch space for rays.
    """


@Choice
def launch_starts(scene, starts):
    """Return the origins of first rays, (3, g)."""


@Choice
def begin_wave(scene, state, vertices, starts, first):
    """Set the walls or surfaces that the first vertices of a wave lie on; its first path has
    the number ``first``.
    """


@Choice
def gather_sources(scene, state, vertices, bounce, source):
    """Add the light of sources that a vertex samples directly, by shadow rays, to each path."""


@Choice
def meet(scene, state, vertices, bounce):
    """Cast the rays of a wave, and write the first hit of each."""


@Choice
def gather_met(scene, state, vertices, bounce, source):
    """Gather the light that rays bring, list the rays whose paths continue,
    and return their number.
    """


@Choice
def advance(scene, state, vertices, following, bounce, rules):
    """Move the paths that continue to the vertices ``following``, and multiply their throughput
    by the albedo there.
    """


@Choice
def split(scene, state, vertices, spare, bounce, rules, source):
    """Let the paths at ``vertices`` branch if the rules say so;
    return their vertices and the ``spare`` ones.
    """


@limits.case(PathRules)
def limits_of_weights(rules):
    """Allow as many bounces as there are weights after the first, and no branches."""
    return rules.weights.shape[0] - 1, 1


@split.case()
def stay_single(scene, state, vertices, spare, bounce, rules, source):
    """Keep paths single."""
    return vertices, spare


@gather_sources.case()
def gather_nothing(scene, state, vertices, bounce, source):
    """Cast no shadow rays: the source has no light to sample."""


@kernel()
def make_shadow_rays(n):
    """Allocate the shadow rays of a wave of ``n`` paths."""
    return ShadowRays(np.zeros(3 * n), np.empty(3 * n), np.empty(n))


@kernel()
def make_paths(n, rules, total, gathered):
    """Allocate waves of ``n`` of ``total`` paths with the first weight
    as throughput; clear ``gathered``.
    """
    gathered[:, :total] = 0.0
    # The first weight is the throughput before any bounce.
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
    """Add ``light`` that arrives at the vertex of path ``i``, times the path's throughput, to
    the gathered light.
    """
    m = wave.rays.owners[i]
    for c in range(3):
        wave.gathered[c, m] += wave.carried[c, m] * light[c]


@kernel()
def walk(scene, state, vertices, spare, rules, source):
    """Trace the paths of a wave to their ends, and gather light on the way.

    ``spare`` is a second set of vertices; the two sets alternate from bounce to bounce.
    """
    rays = state.wave.rays
    (last, _) = limits(rules)
    # Trace rays from all vertices up to the last bounce.
    for bounce in range(last + 1):
        # Add direct light at the vertices that is sampled by shadow rays.
        gather_sources(scene, state, vertices, bounce, source)
        # Sample the direction of the next ray of each path, and find its first hit.
        sample_direction(rays, vertices, bounce, scene.field.spacing)
        meet(scene, state, vertices, bounce)
        # Add the light of rays that escape or meet an emitter; list the rays that hit the surface.
        hits = gather_met(scene, state, vertices, bounce, source)
        # End some of the paths at random; those left carry the weight of the others.
        hits = russian_roulette(rays, hits, bounce, rules.survival)
        if hits == 0 or bounce == last:
            return
        # Compact the remaining paths, and move them to their next vertices.
        following = Vertices(spare.points, spare.normals, hits)
        advance(scene, state, vertices, following, bounce, rules)
        vertices, spare = split(scene, state, following, vertices, bounce, rules, source)


@kernel()
def places_for(total, branches):
    """Return the number of places of a wave for ``total`` paths,
    each with room for its ``branches``.
    """
    return whole(min(WAVE_PATHS // branches, total)) * branches


@kernel()
def trace_paths(scene, starts, samples, rules, source, wave):
    """Trace a ``SampleRange`` of paths from each of g ``starts``, in waves of the size of ``wave``.

    Path s · g + i is sample ``first + s`` of start i.
    """
    # Allocate vertices and state once; all waves use them in turn.
    total = starts.isovalues.shape[0] * samples.count
    n = wave.rays.owners.shape[0]
    most = WAVE_PATHS // limits(rules)[1]
    origins = launch_starts(scene, starts)
    room = make_vertices(n)
    spare = make_vertices(n)
    state = make_state(scene, starts, wave)
    # Fill a wave with the next paths, and trace them to their ends.
    for first in range(0, total, most):
        vertices = Vertices(room.points, room.normals, min(most, total - first))
        generate(wave.rays, vertices, starts, origins, samples.first, first)
        begin_wave(scene, state, vertices, starts, first)
        walk(scene, state, vertices, spare, rules, source)


@kernel()
def gather_paths(scene, starts, samples, rules, source, gathered):
    """Write the light that each path of ``trace_paths`` gathers to ``gathered`` (channels, at
    least g · count).
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
    """Add the light that a ``SampleRange`` of paths gathers at each of g ``starts`` to ``sums`` (g,
    channels).

    Sums grow sample by sample, so that the result does not depend on which starts are traced
    together. Source: Kajiya 1986.
    """
    g = sums.shape[0]
    last = samples.first + samples.count
    step = max(WAVE_PATHS // max(g, 1), 1)
    gathered = np.empty((sums.shape[1], g * step))
    # Trace as many samples of all starts at once as fill a wave.
    for first in range(samples.first, last, step):
        some = SampleRange(first, min(step, last - first))
        gather_paths(scene, starts, some, rules, source, gathered)
        # Add the paths in the order of their samples.
        for m in range(g * some.count):
            for j in range(sums.shape[1]):
                sums[m % g, j] += gathered[j, m]


class EndWave(NamedTuple):
    """A wave of paths that gather no light but record their ends: its ``rays``, and the number of
    paths ``starting``.

    ``carried`` (3, paths) is the product of the albedos that each path met, if albedo varies over
    the surface.
    """

    rays: Any
    starting: int
    carried: Any


@Choice
def begin_branches(scene, wave, count, source):
    """Set the state of ``count`` new branches of a wave from that of their parents."""


@begin_branches.case()
def begin_alike(scene, wave, count, source):
    """Keep the state as it is: the number of a branch identifies its parent."""


@limits.case(PathTree)
def limits_of_tree(rules):
    """Return the bounces and branches of a ``PathTree``."""
    return rules.bounces, rules.branches


@kernel()
def blocks(branches):
    """Return the number of blocks in ``PathEnds``: one for unbranched paths,
    and one for each branch.
    """
    return 1 if branches == 1 else 1 + branches


@kernel()
def make_ends(starts, count, branches):
    """Allocate the ``PathEnds`` of ``starts`` starts, with ``count`` samples each."""
    n = blocks(branches) * starts * count
    return PathEnds(np.zeros(n, np.int64), np.zeros((3, n + PATH_WIDTH)))


@kernel()
def branch(wave, vertices, room, branches, stride):
    """Continue each path of the wave in several ``branches``, from vertices in ``room``, which are
    returned.

    Branch j of path m is path m + (1 + j) · ``stride``, and draws the random numbers of sample
    ``branches`` · s + j.
    """
    hits = vertices.count
    count = branches * vertices.count
    points = columns(vertices.points, hits)
    normals = columns(vertices.normals, hits)
    further = columns(room.points, count)
    around = columns(room.normals, count)
    # Go backwards, so that each path is read before its place is overwritten by branches.
    for h in range(hits - 1, -1, -1):
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
    """Replace each path that continues from its first hit by its branches; later hits keep paths
    single.

    Returns the vertices of the branches, and those of the paths as spare ones. The first ray is
    shared: it brings direct light, which converges with few rays; branches bring reflected light
    (see ``PathTree``).
    """
    if bounce > 0 or rules.branches == 1:
        return vertices, spare
    following = branch(state.wave.rays, vertices, spare, rules.branches, state.wave.starting)
    begin_branches(scene, state.wave, following.count, source)
    return following, vertices


@kernel()
def branch_ends(wave, count, ends):
    """Mark ``count`` branches as unfinished, and their parents as replaced by branches."""
    for owner in wave.rays.owners[:count]:
        ends.bounces[owner % wave.starting] = NO_PATH
        ends.bounces[owner] = -1


@begin_branches.case(PathEnds)
def begin_ends(scene, wave, count, ends):
    """Mark new branches as unfinished."""
    branch_ends(wave, count, ends)


@gather_met.case(PathEnds)
def write_ends(scene, state, vertices, bounce, ends):
    """Record bounce and direction of the paths that escape; return the number that continue."""
    rays = state.wave.rays
    count = vertices.count
    hits = partition(rays, count)
    ways = columns(rays.ways, count)
    # A path that escapes after k bounces adds R^k · Y_i(direction) to transfer coefficient i (S1,
    # eqs. 6 and 8).
    for i in rays.escaped[: count - hits]:
        m = rays.owners[i]
        ends.bounces[m] = bounce
        put_column(ends.directions, m, column(ways, i))
    return hits


@kernel()
def trace_ends(scene, starts, samples, tree, ends, carried):
    """Trace a ``SampleRange`` of paths from each of g ``PathStarts`` to their ends, by the rules of
    a ``PathTree``.

    Isovalues lie within the range of the scene's cells. Writes the ``PathEnds`` of at least g ·
    count paths, and the albedos that these ``carried``.
    """
    # Mark paths that are not traced as absent, and those that are traced as not yet escaped.
    total = starts.isovalues.shape[0] * samples.count
    ends.bounces[:total] = -1
    ends.bounces[total:] = NO_PATH
    ends.directions[:] = 0.0
    carried[:, :total] = 1.0
    rays = make_wave(places_for(total, tree.branches))
    wave = EndWave(rays, ends.bounces.shape[0] // blocks(tree.branches), carried)
    trace_paths(scene, starts, samples, tree, ends, wave)
