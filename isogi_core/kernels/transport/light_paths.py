"""Paths that gather light where they hit, for a light that stays where it is."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.vec import column, dot, put_column
from isogi_core.kernels.transport.lights import LAMPS, NO_LAMPS, NOTHING, arriving, draw_bright, illuminate
from isogi_core.kernels.transport.rng import PAIRS, point_of_words
from isogi_core.kernels.transport.wavefront import (
    WAVE,
    Vertices,
    columns,
    generate,
    go_on,
    intersect,
    launch_all,
    make_vertices,
    make_wave,
    partition,
    russian_roulette,
    sample_direction,
    whole,
)

FAR = (math.inf, math.inf, math.inf)
"""Where rays start that are not to meet anything."""

NO_TABLE = (np.zeros(0), np.zeros((0, 0)))


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


class ShadowRays(NamedTuple):
    """A ``wave`` and its shadow rays: room (3 n,) for where they start and what they carry, and how far they go."""

    wave: Any
    starts: Any
    light: Any
    reach: Any


@kernel()
def make_shadow_rays(n):
    """Room for a wave of ``n`` paths and their shadow rays."""
    return ShadowRays(make_wave(n), np.zeros(3 * n), np.empty(3 * n), np.empty(n))


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


@kernel()
def add_light(gathered, m, weights, bounce, light):
    """Add ``light`` after ``bounce`` bounces to what path ``m`` has gathered."""
    for c in range(3):
        gathered[c, m] += weights[bounce, c] * light[c]


@kernel()
def gather_sources(field, cells, shadow, vertices, bounce, weights, light, gathered):
    """Add what lamps, and the bright parts of a sharp environment, send to the vertices of a wave."""
    wave, count = shadow.wave, vertices.count
    lights = columns(shadow.light, count)
    first = 0 if light.table[0].shape[0] > 0 else 1
    for source in range(first, 1 + light.lamps.kinds.shape[0]):
        aim_shadow_rays(shadow, vertices, bounce, light, source, field.spacing)
        intersect(field, cells, wave, shadow.starts, count)
        for i in range(count):
            if not wave.t[i] < shadow.reach[i]:
                add_light(gathered, wave.owners[i], weights, bounce, column(lights, i))


@kernel()
def gather_ends(wave, vertices, escaped, bounce, weights, light, gathered):
    """Add the environment that the ``escaped`` paths leave to."""
    normals, ways = columns(vertices.normals, vertices.count), columns(wave.ways, vertices.count)
    for i in wave.escaped[:escaped]:
        w = column(ways, i)
        end = arriving(light.constant, light.image, light.matrix, light.table, w, dot(column(normals, i), w))
        add_light(gathered, wave.owners[i], weights, bounce, end)


@kernel()
def light_wave(field, cells, shadow, vertices, spare, rules, light, gathered):
    """Walk the paths of a wave to their ends, as ``walk_wave`` does, and gather light on the way."""
    wave, weights, last = shadow.wave, rules.weights, rules.weights.shape[0] - 1
    for bounce in range(last + 1):
        count = vertices.count
        gather_sources(field, cells, shadow, vertices, bounce, weights, light, gathered)
        sample_direction(wave, vertices, bounce, field.spacing)
        intersect(field, cells, wave, vertices.points, count)
        hits = partition(wave, count)
        gather_ends(wave, vertices, count - hits, bounce, weights, light, gathered)
        hits = russian_roulette(wave, hits, bounce, rules.survival)
        if hits == 0 or bounce == last:
            return
        vertices, spare = go_on(field, wave, vertices, spare, hits, 1, 0)


@kernel()
def light_paths(field, cells, starts, samples, rules, light, gathered):
    """A ``SampleRange`` of E/π at each of g ``PathStarts``, with all light that is reflected there.

    The order of paths is that of ``walk_paths``. Writes linear RGB to ``gathered`` (3, at least g · count): Σ_k
    weights[k] (E/π at vertex k, of the light that comes straight from its sources), where the weights (bounces + 1, 3)
    of the ``rules`` are R^k over the chance to get there (see ``russian_roulette``), and ``light`` are the
    Surroundings. Light arrives at where rays start, a little above the surface. Source: Kajiya 1986; DESIGN
    section 3.
    """
    total = starts.isovalues.shape[0] * samples.count
    gathered[:, :total] = 0.0
    origins = launch_all(field, starts)
    n = whole(min(WAVE, total))
    shadow, room, spare = make_shadow_rays(n), make_vertices(n), make_vertices(n)
    for begin in range(0, total, WAVE):
        vertices = Vertices(room.points, room.normals, min(WAVE, total - begin))
        generate(shadow.wave, vertices, starts, origins, samples.first, begin)
        light_wave(field, cells, shadow, vertices, spare, rules, light, gathered)
