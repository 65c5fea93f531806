"""Lit paths: paths over an isosurface that gather light where they hit, for a light that stays where it is.

At each vertex lamps, and a sharp environment's bright parts, send their light along shadow rays (next-event
estimation); rays that leave look the environment up. Paths go in waves, as those of ``waves`` and with
the same directions, and what one gathers belongs to its start and sample alone.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.field import to_index
from isogi_core.kernels.lamps import LAMPS, NO_LAMPS, NOTHING, illuminate
from isogi_core.kernels.lights import arriving, draw_bright
from isogi_core.kernels.rng import PAIRS, point_of_words
from isogi_core.kernels.vec import column, dot, put_column
from isogi_core.kernels.waves import (
    WAVE,
    aim,
    close_ranks,
    columns,
    launch_all,
    make_wave,
    muster,
    rise,
    shoot,
    sift,
    spin,
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


class Beams(NamedTuple):
    """Shadow rays of a wave: room for where they start and what they carry, columns (3 n,), and how far they go."""

    starts: Any
    light: Any
    reach: Any


@kernel()
def make_beams(n):
    """Room for the shadow rays of ``n`` paths."""
    return Beams(np.zeros(3 * n), np.empty(3 * n), np.empty(n))


@kernel()
def to_world(v, spacing):
    """An index-space vector in world space."""
    return (v[0] * spacing[0], v[1] * spacing[1], v[2] * spacing[2])


@kernel()
def beam(light, source, p, n, u, v):
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
def aim_beams(wave, beams, pair, count, bounce, light, source, spacing):
    """Turn the wave's rays towards a ``source``; those that it cannot light are to meet nothing."""
    origins, normals = columns(pair[0], count), columns(pair[1], count)
    starts, lights, directions = (
        columns(beams.starts, count),
        columns(beams.light, count),
        columns(wave.directions, count),
    )
    directions[:, count:] = 1.0
    dimension = np.uint64((1 + source) * PAIRS + bounce)  # after the directions
    for i in range(count):
        low, high, sample = np.uint64(wave.low[i]), np.uint64(wave.high[i]), np.uint64(wave.samples[i])
        u, v = point_of_words(low, high, sample, dimension)
        o = column(origins, i)
        w, beams.reach[i], shine = beam(light, source, to_world(o, spacing), column(normals, i), u, v)
        put_column(directions, i, to_index(w, spacing))
        put_column(lights, i, shine)
        put_column(starts, i, o if max(shine[0], shine[1], shine[2]) > 0.0 else FAR)


@kernel()
def add_light(gathered, m, weights, bounce, light):
    """Add ``light`` after ``bounce`` bounces to what path ``m`` has gathered."""
    for c in range(3):
        gathered[c, m] += weights[bounce, c] * light[c]


@kernel()
def gather_sources(field, bricks, wave, beams, pair, count, bounce, weights, light, gathered):
    """Add what lamps, and the bright parts of a sharp environment, send to the vertices of a wave."""
    lights = columns(beams.light, count)
    first = 0 if light.table[0].shape[0] > 0 else 1
    for source in range(first, 1 + light.lamps.kinds.shape[0]):
        aim_beams(wave, beams, pair, count, bounce, light, source, field.spacing)
        shoot(field, bricks, wave, (beams.starts, beams.starts), count)
        for i in range(count):
            if not wave.t[i] < beams.reach[i]:
                add_light(gathered, wave.owners[i], weights, bounce, column(lights, i))


@kernel()
def gather_ends(wave, pair, count, gone, bounce, weights, light, gathered):
    """Add the environment that the ``gone`` paths among ``count`` leave to."""
    normals, ways = columns(pair[1], count), columns(wave.ways, count)
    for i in wave.gone[:gone]:
        w = column(ways, i)
        end = arriving(light.constant, light.image, light.matrix, light.table, w, dot(column(normals, i), w))
        add_light(gathered, wave.owners[i], weights, bounce, end)


@kernel()
def light_wave(field, bricks, wave, beams, pair, spare, count, weights, survival, light, gathered):
    """Walk the ``count`` paths of a wave to their ends, as ``walk_wave`` does, and gather light on the way."""
    last = weights.shape[0] - 1
    for bounce in range(last + 1):
        gather_sources(field, bricks, wave, beams, pair, count, bounce, weights, light, gathered)
        aim(wave, pair, count, bounce, field.spacing)
        shoot(field, bricks, wave, pair, count)
        hits = sift(wave, count)
        gather_ends(wave, pair, count, count - hits, bounce, weights, light, gathered)
        hits = spin(wave, hits, bounce, survival)
        if hits == 0 or bounce == last:
            return
        close_ranks(wave, pair, count, hits, spare)
        rise(field, wave, count, hits, spare)
        pair, spare, count = spare, pair, hits


@kernel()
def light_paths(field, bricks, isovalues, points, normals, seeds, first, count, weights, survival, light, gathered):
    """Samples ``first`` … ``first + count`` of E/π at each of g starts, with all light that is reflected there.

    Starts and their order are those of ``walk_paths``. Writes linear RGB to ``gathered`` (3, at least
    g · count): Σ_k weights[k] (E/π at vertex k, of the light that comes straight from its sources), where
    ``weights`` (bounces + 1, 3) is R^k, over the chance to get there (see ``spin``), and ``light`` are the
    Surroundings. Light arrives at where rays start, a little above the surface. Source: Kajiya 1986; DESIGN
    section 3.
    """
    total = isovalues.shape[0] * count
    gathered[:, :total] = 0.0
    origins = launch_all(field, isovalues, points, normals)
    n = whole(min(WAVE, total))
    wave, pair, spare = make_wave(n), (np.zeros(3 * n), np.zeros(3 * n)), (np.zeros(3 * n), np.zeros(3 * n))
    beams = make_beams(n)
    for begin in range(0, total, WAVE):
        together = min(WAVE, total - begin)
        muster(wave, pair, isovalues, origins, normals, seeds, first, begin, together)
        light_wave(field, bricks, wave, beams, pair, spare, together, weights, survival, light, gathered)
