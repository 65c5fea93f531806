"""Paths that gather the light of a fixed environment and of lamps at each surface that they hit."""

import math
from typing import Any, NamedTuple

from numba import types

from isogi_core.kernels._jit import REAL_ROWS, Choice, kernel, record
from isogi_core.kernels.simd.maths import u32
from isogi_core.kernels.simd.memory import load
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD_RECORD, to_index
from isogi_core.kernels.tracing.vec import column, dot, put_column, store_columns
from isogi_core.kernels.transport.integrator import (
    add_carried,
    add_paths,
    advance,
    begin_wave,
    columns,
    compact,
    gather_met,
    gather_sources,
    intersect,
    launch_all,
    launch_starts,
    make_state,
    meet,
    next_vertex,
    partition,
)
from isogi_core.kernels.transport.lights import (
    BRIGHT_TABLE,
    LAMPS,
    NO_LAMPS,
    NO_LIGHT,
    NO_TABLE,
    arriving,
    balanced_light,
    draw_bright,
    has_bright_pixels,
    illuminate,
)
from isogi_core.kernels.transport.paths import PATH_RULES, PATH_STARTS, SAMPLE_RANGE, PathRules
from isogi_core.kernels.transport.rng import point_of_words
from isogi_core.kernels.transport.streams import FIRST_SOURCE_PAIR, PAIRS_PER_PURPOSE


class Open(NamedTuple):
    """One isosurface of a ``field`` within its active ``cells``: the only thing that rays meet.

    By PathRules the throughput of a path after k bounces is row k of the weights (bounces + 1, 3):
    R^k over the probability to get there (see ``russian_roulette``).
    """

    field: Any
    cells: Any


OPEN = record(Open, FIELD_RECORD, ACTIVE_CELLS)


class Alone(NamedTuple):
    """State of a ``wave`` that needs nothing else."""

    wave: Any


@Choice
def cast_wave(scene, state, points, count):
    """Cast ``count`` rays of a wave from ``points`` to their first hits."""


@make_state.case()
def make_alone(scene, starts, wave):
    """Make the state of a wave that needs nothing else."""
    return Alone(wave)


@launch_starts.case()
def launch_off(scene, starts):
    """Return the origins of first rays, (3, g): offset from the isosurface by ``launch``,
    or on walls.
    """
    return launch_all(scene.field, starts)


@begin_wave.case()
def begin_in_the_open(scene, state, vertices, starts, first):
    """Keep the vertices as they are: all lie on the isosurface."""


@cast_wave.case()
def cast_at_surface(scene, state, points, count):
    """Cast the rays of a wave from ``points`` at the isosurface."""
    intersect(scene.field, scene.cells, state.wave.rays, points, count)


@meet.case()
def meet_nearest(scene, state, vertices, bounce):
    """Cast the rays of a wave to their first hits."""
    cast_wave(scene, state, vertices.points, vertices.count)


@advance.case()
def advance_in_the_open(scene, state, vertices, following, bounce, rules):
    """Move the paths that hit the surface to their hit points."""
    compact(state.wave.rays, vertices, following)
    next_vertex(scene.field, state.wave.rays, vertices.count, following)


@advance.case(Open, PathRules)
def advance_by_weights(scene, state, vertices, following, bounce, rules):
    """Set the throughput of each path that goes on to row ``bounce`` + 1 of the weights, which
    count all bounces so far, and move it to its hit point.
    """
    rays = state.wave.rays
    carried = state.wave.carried
    # Paths are found by the places of their rays, which change as they move: set weights first.
    for i in rays.hits[: following.count]:
        for c in range(3):
            carried[c, rays.owners[i]] = rules.weights[bounce + 1, c]
    advance_in_the_open(scene, state, vertices, following, bounce, rules)


NO_START = (math.inf, math.inf, math.inf)
"""Origin of rays that are to hit nothing."""


class Surroundings(NamedTuple):
    """All light that falls on a scene.

    The environment is ``constant`` (3,) plus ``image`` (h, w, 3), turned by ``matrix`` (3, 3).
    ``table`` samples its bright directions (see ``draw_bright``); it is empty if shadow rays to the
    environment do not pay. ``lamps`` are LampArrays.
    """

    constant: Any
    image: Any
    matrix: Any
    table: Any = NO_TABLE
    lamps: Any = NO_LAMPS


SURROUNDINGS_RECORD = record(
    Surroundings,
    types.float64[::1],
    types.float32[:, :, ::1],
    types.float64[:, ::1],
    BRIGHT_TABLE,
    LAMPS,
)


@kernel()
def to_world(v, spacing):
    """Convert an index-space vector to world space."""
    return (v[0] * spacing[0], v[1] * spacing[1], v[2] * spacing[2])


@kernel()
def sample_source(light, source, p, n, u, v):
    """Sample a ``source`` from the world point ``p`` with normal ``n``: (direction, distance, E/π).

    Source 0 is the bright part of the environment, source k > 0 is lamp k - 1; (u, v) are uniform
    in [0, 1)².
    """
    if source > 0:
        return illuminate(light.lamps, source - 1, p, n, u, v)
    w, row, column = draw_bright(light.table, light.matrix, u, v)
    cosine = dot(n, w)
    if not cosine > 0.0:
        return w, math.inf, NO_LIGHT
    return w, math.inf, balanced_light(light.table, row, column, cosine)


@kernel()
def aim_shadow_rays(wave, vertices, bounce, light, source, spacing):
    """Turn the rays of the wave towards a ``source``;
    rays that it cannot light are set to hit nothing.
    """
    shadow = wave.shadow
    rays = wave.rays
    count = vertices.count
    origins = columns(vertices.points, count)
    normals = columns(vertices.normals, count)
    starts = columns(shadow.starts, count)
    lights = columns(shadow.light, count)
    directions = columns(rays.directions, count)
    directions[:, count:] = 1.0
    # Draw the random numbers of all rays first, in vectors; they wait where the light of the rays
    # comes. Each source and bounce draws from a different dimension.
    dimension = u32(FIRST_SOURCE_PAIR + source * PAIRS_PER_PURPOSE + bounce)
    for i in range(0, count, PATH_WIDTH):
        low = load(rays.low, i, PATH_WIDTH)
        high = load(rays.high, i, PATH_WIDTH)
        sample = load(rays.samples, i, PATH_WIDTH)
        u, v = point_of_words(low, high, sample, dimension)
        store_columns(lights, i, (u, v, u))
    for i in range(count):
        u = lights[0, i]
        v = lights[1, i]
        o = column(origins, i)
        w, shadow.reach[i], shine = sample_source(
            light, source, to_world(o, spacing), column(normals, i), u, v
        )
        put_column(directions, i, to_index(w, spacing))
        put_column(lights, i, shine)
        put_column(starts, i, o if max(shine[0], shine[1], shine[2]) > 0.0 else NO_START)


@Choice
def add_sent(scene, state, vertices, bounce):
    """Add the light of the shadow rays of a wave that reach their source."""


@add_sent.case()
def add_unblocked(scene, state, vertices, bounce):
    """Add the light of the shadow rays that nothing blocks."""
    shadow = state.wave.shadow
    count = vertices.count
    starts = columns(shadow.starts, count)
    lights = columns(shadow.light, count)
    cast_wave(scene, state, shadow.starts, count)
    for i in range(count):
        if starts[0, i] < math.inf and not state.wave.rays.t[i] < shadow.reach[i]:
            add_carried(state.wave, i, column(lights, i))


@gather_sources.case(Open, Surroundings)
def gather_from_outside(scene, state, vertices, bounce, light):
    """Add the light that lamps and bright parts of the environment send
    to the vertices of a wave.
    """
    first = 0 if has_bright_pixels(light.table) else 1
    for source in range(first, 1 + light.lamps.kinds.shape[0]):
        aim_shadow_rays(state.wave, vertices, bounce, light, source, scene.field.spacing)
        add_sent(scene, state, vertices, bounce)


@kernel()
def gather_ends(wave, vertices, light):
    """Add the environment's light of rays that escape;
    return the number of rays that hit something.
    """
    rays = wave.rays
    count = vertices.count
    normals = columns(vertices.normals, count)
    ways = columns(rays.ways, count)
    hits = partition(rays, count)
    # Weight radiance against shadow rays to the environment by the balance heuristic.
    for i in rays.escaped[: count - hits]:
        w = column(ways, i)
        cosine = dot(column(normals, i), w)
        add_carried(
            wave, i, arriving(light.constant, light.image, light.matrix, light.table, w, cosine)
        )
    return hits


@gather_met.case(Open, Surroundings)
def gather_environment(scene, state, vertices, bounce, light):
    """Add the environment's light of rays that escape; return the number of paths that continue."""
    return gather_ends(state.wave, vertices, light)


@kernel(types.void(OPEN, PATH_STARTS, SAMPLE_RANGE, PATH_RULES, SURROUNDINGS_RECORD, REAL_ROWS))
def light_in_the_open(scene, starts, samples, rules, light, sums):
    """Add the light of a ``SampleRange`` of paths at each of g ``PathStarts`` to ``sums`` (g, 3).

    The ``scene`` is Open, ``light`` are the Surroundings. Light gathered after k bounces has row k
    of the weights (bounces + 1, 3) of the ``rules``: R^k for E/π, or R^(k + 1) for radiance that
    leaves, over the probability to get there (see ``russian_roulette``). Sums grow sample by
    sample, so that their bits do not depend on how the samples are split into calls. Source: S1,
    figure 2; the reference of figures 7 and 11.
    """
    add_paths(scene, starts, samples, rules, light, sums)
