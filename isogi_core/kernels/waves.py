"""Waves: many paths together, all their first rays, then all second ones, and so on.

A wave's paths lie in columns, and a vector of neighbours draws its random numbers and directions at once.
After each bounce the paths that go on close ranks. Each has the bits that ``integrator.trace_path`` gives.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import gradients, to_index, to_world_normal
from isogi_core.kernels.integrator import ROULETTE, about, facing_normal, launch
from isogi_core.kernels.intersect import OUTSIDE
from isogi_core.kernels.packets import cast_batch
from isogi_core.kernels.reals import ABREAST, read, words
from isogi_core.kernels.rng import WORD, WORD_BITS, point_of_words
from isogi_core.kernels.sampling import sample_cosine_hemisphere
from isogi_core.kernels.vec import column, madd, put_column, read_columns, write_columns

WAVE = 4096
"""Paths of a wave: all that is known of them stays in the second-level cache."""


class Wave(NamedTuple):
    """The paths of a wave that go on, in the first places of arrays (n,), and room for columns (3 n,).

    ``owners`` are their numbers; ``low``, ``high``, ``samples`` the words that own their random numbers;
    ``levels`` their isovalues, ``sides`` where their next rays start, ``signs`` the same as reals; ``t`` and
    ``came`` what these meet; ``hits`` and ``gone`` the places of those that meet something and of those that
    do not; ``directions`` are in index space, ``ways`` in the world; ``weights`` are room for
    ``smooth_gradients``. Apart from it goes a pair of columns: where rays start, and the normals there.
    """

    owners: Any
    low: Any
    high: Any
    samples: Any
    levels: Any
    sides: Any
    signs: Any
    t: Any
    came: Any
    hits: Any
    gone: Any
    directions: Any
    ways: Any
    weights: Any


@kernel()
def whole(count):
    """The places that ``count`` paths take in whole vectors."""
    return (count + ABREAST - 1) // ABREAST * ABREAST


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
        np.empty((3, 9, ABREAST)),
    )


@kernel()
def columns(room, count):
    """The (3, n) array that vectors of ``count`` paths make in their room."""
    n = whole(count)
    return room[: 3 * n].reshape(3, n)


@kernel()
def muster(wave, pair, isovalues, origins, normals, seeds, first, begin, count):
    """Fill the wave with paths ``begin`` … ``begin + count``; see ``walk_paths``. ``origins``: of the first rays."""
    starts = isovalues.shape[0]
    here, facing = columns(pair[0], count), columns(pair[1], count)
    i, sample = begin % starts, first + begin // starts
    for m in range(count):
        wave.owners[m], wave.samples[m], wave.levels[m], wave.sides[m] = begin + m, sample, isovalues[i], OUTSIDE
        wave.low[m], wave.high[m] = seeds[i] & WORD, seeds[i] >> WORD_BITS
        put_column(here, m, column(origins, i))
        put_column(facing, m, column(normals, i))
        i += 1
        if i == starts:
            i, sample = 0, sample + 1


@kernel()
def aim(wave, pair, count, bounce, spacing):
    """Draw ``ways`` and ``directions`` about the normals."""
    normals, ways, directions = columns(pair[1], count), columns(wave.ways, count), columns(wave.directions, count)
    dimension = words(bounce)
    for i in range(0, count, ABREAST):
        u, v = point_of_words(read(wave.low, i), read(wave.high, i), read(wave.samples, i), dimension)
        w = about(read_columns(normals, i), sample_cosine_hemisphere(u, v))
        write_columns(ways, i, w)
        write_columns(directions, i, to_index(w, spacing))


@kernel()
def shoot(field, bricks, wave, pair, count):
    """Cast the rays; what fills up the last vector starts at infinity and meets nothing."""
    n = whole(count)
    origins = columns(pair[0], count)
    origins[:, count:] = math.inf
    cast_batch(
        field,
        bricks,
        wave.levels[:n],
        origins,
        columns(wave.directions, count),
        wave.sides[:n],
        wave.t[:n],
        wave.came[:n],
    )


@kernel()
def sift(wave, count):
    """List the places of rays that hit something, and of those that leave; returns how many hit."""
    hits = gone = 0
    for i in range(count):
        hit = wave.t[i] < math.inf
        wave.hits[hits], wave.gone[gone] = i, i
        hits += hit
        gone += not hit
    return hits


@kernel()
def spin(wave, hits, bounce, survival):
    """Russian roulette: of paths that hit something, but the first time, a share ``survival`` goes on.

    Each stands for those that do not: its light counts over its chance. Returns how many go on. Source: Arvo
    and Kirk, "Particle Transport and Image Synthesis", 1990.
    """
    if bounce == 0 or survival >= 1.0:
        return hits
    staying, dimension = 0, np.uint64(ROULETTE + bounce)
    for h in range(hits):
        i = wave.hits[h]
        u, _ = point_of_words(np.uint64(wave.low[i]), np.uint64(wave.high[i]), np.uint64(wave.samples[i]), dimension)
        wave.hits[staying] = i
        staying += u < survival
    return staying


@kernel()
def release(wave, count, gone, bounce, left, ways):
    """Write the ends of the ``gone`` paths among ``count``."""
    last = columns(wave.ways, count)
    for i in wave.gone[:gone]:
        m = wave.owners[i]
        left[m] = bounce
        put_column(ways, m, column(last, i))


@kernel()
def close_ranks(wave, pair, count, hits, following):
    """Move the paths that hit something to the first places, and where they hit it to ``following``."""
    origins, directions, points = columns(pair[0], count), columns(wave.directions, count), columns(following[0], hits)
    for h in range(hits):
        i = wave.hits[h]
        put_column(points, h, madd(column(origins, i), wave.t[i], column(directions, i)))
        wave.owners[h], wave.levels[h] = wave.owners[i], wave.levels[i]
        wave.sides[h], wave.signs[h] = wave.came[i], wave.came[i]
        wave.low[h], wave.high[h], wave.samples[h] = wave.low[i], wave.high[i], wave.samples[i]


@kernel()
def mend_normals(field, wave, first, last, points, normals, ways):
    """Turn normals of a flat field, of paths first … last, against the ray that hit there: ``facing_normal``."""
    for h in range(first, last):
        if normals[0, h] == 0.0 and normals[1, h] == 0.0 and normals[2, h] == 0.0:
            way = column(ways, wave.hits[h])
            put_column(normals, h, facing_normal(field, column(points, h), int(wave.sides[h]), way))


@kernel()
def rise(field, wave, count, hits, pair):
    """Find the normals at a pair's points, ``facing_normal``, and move these to where rays start, ``launch``."""
    points, normals, ways = columns(pair[0], hits), columns(pair[1], hits), columns(wave.ways, count)
    for i in range(0, hits, ABREAST):
        last, sign, p = min(i + ABREAST, hits), read(wave.signs, i), read_columns(points, i)
        gradients(field, points, i, last - i, wave.weights, normals)
        n = to_world_normal(read_columns(normals, i), field.spacing)
        write_columns(normals, i, (n[0] * sign, n[1] * sign, n[2] * sign))
        mend_normals(field, wave, i, last, points, normals, ways)
        write_columns(points, i, launch(field, read(wave.levels, i), p, read_columns(normals, i), sign))


@kernel()
def launch_all(field, isovalues, points, normals):
    """Where the first rays start, (3, n): see ``launch``."""
    origins = np.empty(points.shape)
    for i in range(isovalues.shape[0]):
        p, n = column(points, i), column(normals, i)
        put_column(origins, i, launch(field, isovalues[i], p, n, OUTSIDE))
    return origins


@kernel()
def walk_wave(field, bricks, wave, pair, spare, count, bounces, survival, left, ways):
    """Walk the ``count`` paths of a wave to their ends; ``spare`` is room for a second pair."""
    for bounce in range(bounces + 1):
        aim(wave, pair, count, bounce, field.spacing)
        shoot(field, bricks, wave, pair, count)
        hits = sift(wave, count)
        release(wave, count, count - hits, bounce, left, ways)
        hits = spin(wave, hits, bounce, survival)
        if hits == 0 or bounce == bounces:
            return
        close_ranks(wave, pair, count, hits, spare)
        rise(field, wave, count, hits, spare)
        pair, spare, count = spare, pair, hits


@kernel()
def walk_paths(field, bricks, isovalues, points, normals, seeds, first, count, bounces, survival, left, ways):
    """``trace_path`` of samples ``first`` … ``first + count`` from each of g starts, to the same bits.

    A start is a point and a normal (3, g), an isovalue (g,) within the range of ``bricks`` and the seed
    (g,) of the sequence that its paths draw from; rays start outside. Path s · g + i is the sample
    ``first + s`` of start i. Writes the bounces before it left, or -1, to ``left`` (at least g · count,)
    and the world direction in which it left, or zeros, to ``ways`` (3, at least g · count).
    """
    total = isovalues.shape[0] * count
    left[:total] = -1
    ways[:, :total] = 0.0
    origins = launch_all(field, isovalues, points, normals)
    n = whole(min(WAVE, total))
    wave, pair, spare = make_wave(n), (np.zeros(3 * n), np.zeros(3 * n)), (np.zeros(3 * n), np.zeros(3 * n))
    for begin in range(0, total, WAVE):
        together = min(WAVE, total - begin)
        muster(wave, pair, isovalues, origins, normals, seeds, first, begin, together)
        walk_wave(field, bricks, wave, pair, spare, together, bounces, survival, left, ways)
