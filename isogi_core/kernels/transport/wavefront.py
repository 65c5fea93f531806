"""Wavefront path tracing: many paths together, all their first rays, then all second ones, and so on."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, kernel
from isogi_core.kernels.simd.maths import u32
from isogi_core.kernels.simd.memory import load
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.tracing.cast import ORIGINS, SIDE_ARRAY, cast_batch
from isogi_core.kernels.tracing.field import FIELD_RECORD, gradients, to_index, to_world_normal
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, launch, shading_normal
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.vec import column, load_columns, madd, put_column, store_columns
from isogi_core.kernels.transport.rng import WORD_BITS, WORD_MASK, point_of_words
from isogi_core.kernels.transport.sampling import about, sample_cosine_hemisphere
from isogi_core.kernels.transport.streams import DIRECTIONS, FIRST_ROULETTE_PAIR

WAVE_PATHS = 4096
"""Paths of a wave: all that is known of them stays in the second-level cache."""


class Wave(NamedTuple):
    """The paths of a wave that go on, in the first places of arrays (n,), and room for columns (3 n,).

    ``owners`` are their numbers; ``low``, ``high``, ``samples`` the words that own their random numbers;
    ``isovalues`` those of their surfaces, ``sides`` where their next rays start, ``signs`` the same as float64; ``t``
    and ``came`` what these meet; ``hits`` and ``escaped`` the places of those that meet something and of those that
    do not; ``directions`` are in index space, ``ways`` in the world; ``weights`` are room for ``smooth_gradients``.
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
    """The ``count`` vertices that a wave's paths are at: room (3 n,) for where rays start, and normals there."""

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
    here, normals = columns(vertices.points, count), columns(vertices.normals, count)
    g = starts.isovalues.shape[0]
    i, sample = begin % g, first + begin // g
    for m in range(count):
        wave.owners[m], wave.samples[m], wave.isovalues[m] = begin + m, sample, starts.isovalues[i]
        wave.sides[m], wave.low[m], wave.high[m] = (
            OUTSIDE_SIGN,
            starts.seeds[i] & WORD_MASK,
            starts.seeds[i] >> WORD_BITS,
        )
        put_column(here, m, column(origins, i))
        put_column(normals, m, column(starts.normals, i))
        i += 1
        if i == g:
            i, sample = 0, sample + 1


@kernel()
def sample_direction(wave, vertices, bounce, spacing):
    """Draw ``ways`` and ``directions`` of all paths about their normals, cosine-weighted."""
    count = vertices.count
    normals, ways, directions = (
        columns(vertices.normals, count),
        columns(wave.ways, count),
        columns(wave.directions, count),
    )
    dimension = u32(DIRECTIONS + bounce)
    for i in range(0, count, PATH_WIDTH):
        low, high, sample = (
            load(wave.low, i, PATH_WIDTH),
            load(wave.high, i, PATH_WIDTH),
            load(wave.samples, i, PATH_WIDTH),
        )
        u, v = point_of_words(low, high, sample, dimension)
        w = about(load_columns(normals, i), sample_cosine_hemisphere(u, v))
        store_columns(ways, i, w)
        store_columns(directions, i, to_index(w, spacing))


@kernel()
def intersect(field, cells, wave, points, count):
    """Cast the rays from ``points``; what fills up the last vector starts at infinity and meets nothing."""
    n = whole(count)
    origins = columns(points, count)
    origins[:, count:] = math.inf
    rays = Rays(wave.isovalues[:n], origins, columns(wave.directions, count), wave.sides[:n])
    cast_batch(field, cells, rays, wave.t[:n], wave.came[:n])


@kernel()
def partition(wave, count):
    """List the places of rays that hit something, and of those that escape; returns how many hit."""
    hits = escaped = 0
    for i in range(count):
        hit = wave.t[i] < math.inf
        wave.hits[hits], wave.escaped[escaped] = i, i
        hits += hit
        escaped += not hit
    return hits


@kernel()
def russian_roulette(wave, hits, bounce, survival):
    """Of paths that hit something, but the first time, a share ``survival`` goes on; returns how many.

    Each stands for those that do not: its light counts over its chance. Source: Arvo and Kirk, "Particle Transport
    and Image Synthesis", 1990.
    """
    if bounce == 0 or survival >= 1.0:
        return hits
    staying, dimension = 0, np.uint64(FIRST_ROULETTE_PAIR + bounce)
    for h in range(hits):
        i = wave.hits[h]
        u, _ = point_of_words(np.uint64(wave.low[i]), np.uint64(wave.high[i]), np.uint64(wave.samples[i]), dimension)
        wave.hits[staying] = i
        staying += u < survival
    return staying


@kernel()
def compact(wave, vertices, following):
    """Move the paths that hit something to the first places, and where they hit it to the vertices ``following``."""
    count, hits = vertices.count, following.count
    origins, directions = columns(vertices.points, count), columns(wave.directions, count)
    points = columns(following.points, hits)
    for h in range(hits):
        i = wave.hits[h]
        put_column(points, h, madd(column(origins, i), wave.t[i], column(directions, i)))
        wave.owners[h], wave.isovalues[h] = wave.owners[i], wave.isovalues[i]
        wave.sides[h], wave.signs[h] = wave.came[i], wave.came[i]
        wave.low[h], wave.high[h], wave.samples[h] = wave.low[i], wave.high[i], wave.samples[i]


@kernel()
def mend_normals(field, wave, some, points, normals, ways):
    """Turn normals of a flat field, of paths ``some`` (first, last), against the ray that hit: ``shading_normal``."""
    for h in range(some[0], some[1]):
        if normals[0, h] == 0.0 and normals[1, h] == 0.0 and normals[2, h] == 0.0:
            way = column(ways, wave.hits[h])
            put_column(normals, h, shading_normal(field, column(points, h), int(wave.sides[h]), way))


@kernel()
def next_vertex(field, wave, count, following):
    """Find the normals at the points ``following``, ``shading_normal``, and move these to where rays start, ``launch``.

    ``count`` rays were cast to get there.
    """
    hits = following.count
    points, normals, ways = columns(following.points, hits), columns(following.normals, hits), columns(wave.ways, count)
    for i in range(0, hits, PATH_WIDTH):
        last, sign, p = min(i + PATH_WIDTH, hits), load(wave.signs, i, PATH_WIDTH), load_columns(points, i)
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
    """Turn rays ``origins`` + t · ``directions`` (3, n) that hit, in place, into cosine rays from there.

    ``isovalues`` (n,) of the surfaces; ``t`` and ``came`` (n,) as ``cast_batch`` writes them; ``numbers``
    (2, n) in [0, 1). They start off the surface as a path's do. Source: S1, section 4.1.
    """
    for m in range(origins.shape[1]):
        d = column(directions, m)
        p = madd(column(origins, m), t[m], d)
        n = shading_normal(field, p, int(came[m]), d)
        w = about(n, sample_cosine_hemisphere(numbers[0, m], numbers[1, m]))
        put_column(origins, m, launch(field, isovalues[m], p, n, int(came[m])))
        put_column(directions, m, to_index(w, field.spacing))
