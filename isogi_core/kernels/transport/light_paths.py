"""Paths that gather light where they hit, for a light that stays where it is."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import Choice, kernel, record
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.vec import column, dot, put_column
from isogi_core.kernels.transport.integrate import (
    add_carried,
    advance,
    begin,
    gather_met,
    gather_sources,
    launch_starts,
    make_state,
    meet,
)
from isogi_core.kernels.transport.lights import LAMPS, NO_LAMPS, NOTHING, arriving, draw_bright, illuminate
from isogi_core.kernels.transport.rng import PAIRS, point_of_words
from isogi_core.kernels.transport.wavefront import (
    columns,
    compact,
    intersect,
    launch_all,
    next_vertex,
    partition,
)

FAR = (math.inf, math.inf, math.inf)
"""Where rays start that are not to meet anything."""

NO_TABLE = (np.zeros(0), np.zeros((0, 0)))


class Open(NamedTuple):
    """One isosurface of a ``field``, within its active ``cells``, and nothing else that rays meet.

    What paths carry after k bounces is row k of their weights (bounces + 1, 3): R^k over the chance to get there (see
    ``russian_roulette``).
    """

    field: Any
    cells: Any


class Alone(NamedTuple):
    """The state of a ``wave`` that needs nothing else."""

    wave: Any


class Surroundings(NamedTuple):
    """All light that falls on a scene.

    An environment, ``constant`` (3,) plus ``image`` (h, w, 3), turned by ``matrix`` (3, 3); a ``table`` to
    draw its bright directions by (see ``draw_bright``), empty where that is not worth a ray; ``lamps``.
    """

    constant: Any
    image: Any
    matrix: Any
    table: Any = NO_TABLE
    lamps: Any = NO_LAMPS


SURROUNDINGS = record(
    Surroundings,
    types.float64[::1],
    types.float32[:, :, ::1],
    types.float64[:, ::1],
    types.Tuple((types.float64[::1], types.float64[:, ::1])),
    LAMPS,
)


@kernel()
def to_world(v, spacing):
    """An index-space vector in world space."""
    return (v[0] * spacing[0], v[1] * spacing[1], v[2] * spacing[2])


@kernel()
def sample_source(light, source, p, n, u, v):
    """Direction, distance and E/π of the light that one ``source`` sends to the world point ``p`` with normal ``n``.

    Source 0 is the environment's bright parts, source k > 0 is lamp k - 1; (u, v) in [0, 1)².
    """
    if source > 0:
        return illuminate(light.lamps, source - 1, p, n, u, v)
    w = draw_bright(light.table, light.matrix, u, v)
    cosine = dot(n, w)
    if not cosine > 0.0:
        return w, math.inf, NOTHING
    return w, math.inf, arriving(light.constant, light.image, light.matrix, light.table, w, cosine)


@kernel()
def aim_shadow_rays(shadow, vertices, bounce, light, source, spacing):
    """Turn the wave's rays towards a ``source``; those that it cannot light are to meet nothing."""
    wave, count = shadow.wave, vertices.count
    origins, normals = columns(vertices.points, count), columns(vertices.normals, count)
    starts, lights = columns(shadow.starts, count), columns(shadow.light, count)
    directions = columns(wave.directions, count)
    directions[:, count:] = 1.0
    dimension = np.uint64((1 + source) * PAIRS + bounce)  # after the directions
    for i in range(count):
        low, high, sample = np.uint64(wave.low[i]), np.uint64(wave.high[i]), np.uint64(wave.samples[i])
        u, v = point_of_words(low, high, sample, dimension)
        o = column(origins, i)
        w, shadow.reach[i], shine = sample_source(light, source, to_world(o, spacing), column(normals, i), u, v)
        put_column(directions, i, to_index(w, spacing))
        put_column(lights, i, shine)
        put_column(starts, i, o if max(shine[0], shine[1], shine[2]) > 0.0 else FAR)


@Choice
def cast_wave(scene, state, points, count):
    """Cast ``count`` rays of a wave from ``points`` to what they meet first."""


@Choice
def add_sent(scene, state, vertices, bounce):
    """Add the light of those shadow rays of a wave that reach their source."""


@cast_wave.case(Open)
def cast_at_surface(scene, state, points, count):
    """Cast a wave's rays from ``points`` at the isosurface."""
    intersect(scene.field, scene.cells, state.wave.shadow.wave, points, count)


@add_sent.case()
def add_unblocked(scene, state, vertices, bounce):
    """Add the light of those shadow rays that nothing blocks."""
    shadow, count = state.wave.shadow, vertices.count
    starts, lights = columns(shadow.starts, count), columns(shadow.light, count)
    cast_wave(scene, state, shadow.starts, count)
    for i in range(count):
        if starts[0, i] < math.inf and not shadow.wave.t[i] < shadow.reach[i]:
            add_carried(state.wave, i, column(lights, i))


@gather_sources.case(Open, Surroundings)
def gather_from_outside(scene, state, vertices, bounce, light):
    """Add what lamps, and the bright parts of a sharp environment, send to the vertices of a wave."""
    first = 0 if light.table[0].shape[0] > 0 else 1
    for source in range(first, 1 + light.lamps.kinds.shape[0]):
        aim_shadow_rays(state.wave.shadow, vertices, bounce, light, source, scene.field.spacing)
        add_sent(scene, state, vertices, bounce)


@kernel()
def gather_ends(wave, vertices, light):
    """Add the environment that paths leave to; returns how many hit something."""
    rays, count = wave.shadow.wave, vertices.count
    normals, ways = columns(vertices.normals, count), columns(rays.ways, count)
    hits = partition(rays, count)
    for i in rays.escaped[: count - hits]:
        w = column(ways, i)
        cosine = dot(column(normals, i), w)
        add_carried(wave, i, arriving(light.constant, light.image, light.matrix, light.table, w, cosine))
    return hits


@gather_met.case(Open, Surroundings)
def gather_environment(scene, state, vertices, light):
    """Add the environment that paths leave to; returns how many go on."""
    return gather_ends(state.wave, vertices, light)


@make_state.case()
def make_alone(scene, starts, wave):
    """The state of a wave that needs nothing else."""
    return Alone(wave)


@launch_starts.case(Open)
def launch_in_the_open(scene, starts):
    """Where first rays start, (3, g): off the surface."""
    return launch_all(scene.field, starts)


@begin.case(Open)
def begin_in_the_open(scene, state, vertices, starts, first):
    """Leave the vertices as they are: all stand on the surface."""


@meet.case()
def meet_nearest(scene, state, vertices, bounce):
    """Cast the rays of a wave to what they meet first."""
    cast_wave(scene, state, vertices.points, vertices.count)


@advance.case(Open)
def advance_in_the_open(scene, state, vertices, following, bounce, rules):
    """Move the paths that hit the surface there, to carry the weight of one more bounce."""
    rays, carried = state.wave.shadow.wave, state.wave.carried
    for i in rays.hits[: following.count]:
        for c in range(3):
            carried[c, rays.owners[i]] = rules.weights[bounce + 1, c]
    compact(rays, vertices, following)
    next_vertex(scene.field, rays, vertices.count, following)
