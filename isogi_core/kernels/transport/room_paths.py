"""Paths in a room: they wander over an isosurface and walls, and gather the light of luminaires and of all else."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD, to_index
from isogi_core.kernels.tracing.intersect import OUTSIDE, UNKNOWN
from isogi_core.kernels.tracing.vec import SMALLEST, column, dot, length, madd, put_column, scale, sub
from isogi_core.kernels.tracing.walls import NUMBERS, ROWS, WALLS, meet_walls
from isogi_core.kernels.transport.colours import COLOURS, albedo_at
from isogi_core.kernels.transport.integrator import launch
from isogi_core.kernels.transport.light_paths import (
    FAR,
    SURROUNDINGS,
    aim_shadow_rays,
    make_shadow_rays,
    to_world,
)
from isogi_core.kernels.transport.lights import NOTHING, arriving, row
from isogi_core.kernels.transport.paths import PATH_RULES, SAMPLE_RANGE, SampleRange
from isogi_core.kernels.transport.rng import PAIRS, mix, point_of_words
from isogi_core.kernels.transport.wavefront import (
    WAVE,
    Vertices,
    columns,
    compact,
    generate,
    intersect,
    make_vertices,
    next_vertex,
    partition,
    russian_roulette,
    sample_direction,
    whole,
)

SHORT = 1.0 - 1e-9
"""Share of the way to a luminaire on which something may stand before it."""


class Room(NamedTuple):
    """The ``walls`` of a scene, and how they and the isosurface reflect; all in the world, linear RGB, float64.

    Of k walls ``corners`` (k, 3), ``edges`` (k, 2, 3), unit ``normals`` (k, 3) of their fronts, ``areas`` (k,),
    ``albedos`` and ``radiances`` that they give off (k, 3); both are of the front, and of the back where ``twofold``
    (k,) is 1. The isosurface has the ``colours``, or the ``albedo`` (3,) where there are none.
    """

    walls: Any
    corners: Any
    edges: Any
    normals: Any
    areas: Any
    albedos: Any
    radiances: Any
    twofold: Any
    albedo: Any
    colours: Any


ROOM = record(Room, WALLS, ROWS, types.float64[:, :, ::1], ROWS, NUMBERS, ROWS, ROWS, NUMBERS, NUMBERS, COLOURS)


class RoomStarts(NamedTuple):
    """g starts of paths, as ``PathStarts``, on the isosurface or on a wall: its number, or NOWHERE, in ``walls`` (g,).

    ``isovalues`` of those on a wall are that of the surface in the room.
    """

    points: Any
    normals: Any
    isovalues: Any
    seeds: Any
    walls: Any


STARTS = record(RoomStarts, ROWS, ROWS, NUMBERS, types.uint64[::1], NUMBERS)


class RoomWave(NamedTuple):
    """A wave of paths and its ``shadow`` rays; (n,) the walls that vertices stand on, ``own``, and that rays ``met``.

    ``carried`` (3, paths) is what light at a path's vertex counts in what it has ``gathered`` (3, paths).
    """

    shadow: Any
    own: Any
    met: Any
    carried: Any
    gathered: Any


@kernel()
def balance_area(room, k, cosine, slope, distance):
    """Share p_c/(p_c + p_a) of a ray to wall ``k`` between the two ways in which it is drawn.

    By cosine p_c = cosθ/π, by area p_a = r²/(A |slope|), the slope being that of the ray to the wall's normal. The same
    share of the radiance is what a ray of either sort adds to E/π. Source: Veach and Guibas 1995, balance heuristic.
    """
    by_cosine = cosine / math.pi
    by_area = distance * distance / max(room.areas[k] * abs(slope), SMALLEST)
    return by_cosine / max(by_cosine + by_area, SMALLEST)


@kernel()
def lit_from(room, k, slope):
    """Whether a ray with this component along the normal of wall ``k`` meets a side that is lit."""
    return slope < 0.0 or room.twofold[k] > 0.0


@kernel()
def sample_luminaire(room, k, p, n, u, v):
    """Direction, distance and E/π of what the luminaire ``k`` sends to the world point ``p`` with normal ``n``."""
    away = sub(madd(madd(row(room.corners, k), u, row(room.edges[k], 0)), v, row(room.edges[k], 1)), p)
    distance = length(away)
    if not distance > 0.0:
        return n, 0.0, NOTHING
    w = scale(away, 1.0 / distance)
    cosine, slope = dot(n, w), dot(row(room.normals, k), w)
    if not (cosine > 0.0 and lit_from(room, k, slope)):
        return w, 0.0, NOTHING
    return w, SHORT * distance, scale(row(room.radiances, k), balance_area(room, k, cosine, slope, distance))


@kernel()
def aim_at_luminaire(wave, vertices, bounce, room, k, source, spacing):
    """Turn the wave's rays towards the luminaire ``k``, which draws the random numbers of a ``source``."""
    shadow, rays, count = wave.shadow, wave.shadow.wave, vertices.count
    origins, normals = columns(vertices.points, count), columns(vertices.normals, count)
    starts, lights = columns(shadow.starts, count), columns(shadow.light, count)
    directions = columns(rays.directions, count)
    directions[:, count:] = 1.0
    dimension = np.uint64((1 + source) * PAIRS + bounce)
    for i in range(count):
        low, high, sample = np.uint64(rays.low[i]), np.uint64(rays.high[i]), np.uint64(rays.samples[i])
        u, v = point_of_words(low, high, sample, dimension)
        o = column(origins, i)
        w, shadow.reach[i], shine = sample_luminaire(room, k, to_world(o, spacing), column(normals, i), u, v)
        lit = wave.own[i] != k and max(shine[0], shine[1], shine[2]) > 0.0
        put_column(directions, i, to_index(w, spacing))
        put_column(lights, i, shine)
        put_column(starts, i, o if lit else FAR)


@kernel()
def add_carried(wave, i, light):
    """Add ``light`` that arrives at the vertex of path ``i`` of a wave to what it has gathered."""
    m = wave.shadow.wave.owners[i]
    for c in range(3):
        wave.gathered[c, m] += wave.carried[c, m] * light[c]


@kernel()
def add_unblocked(field, cells, wave, room, count):
    """Add the light of those shadow rays that nothing blocks, neither the surface nor a wall."""
    shadow, rays, n = wave.shadow, wave.shadow.wave, whole(count)
    starts, directions, lights = (
        columns(shadow.starts, count),
        columns(rays.directions, count),
        columns(shadow.light, count),
    )
    intersect(field, cells, rays, shadow.starts, count)
    meet_walls(room.walls, starts, directions, wave.own[:n], rays.t[:n], wave.met[:n])
    for i in range(count):
        if starts[0, i] < math.inf and not rays.t[i] < shadow.reach[i]:
            add_carried(wave, i, column(lights, i))


@kernel()
def gather_sources(field, cells, wave, vertices, bounce, room, light):
    """Add what lamps, bright parts of a sharp environment, and luminaires send to the vertices of a wave."""
    first, lamps = 0 if light.table[0].shape[0] > 0 else 1, light.lamps.kinds.shape[0]
    for source in range(first, 1 + lamps):
        aim_shadow_rays(wave.shadow, vertices, bounce, light, source, field.spacing)
        add_unblocked(field, cells, wave, room, vertices.count)
    for k in range(room.areas.shape[0]):
        if max(room.radiances[k, 0], room.radiances[k, 1], room.radiances[k, 2]) > 0.0:
            aim_at_luminaire(wave, vertices, bounce, room, k, 1 + lamps + k, field.spacing)
            add_unblocked(field, cells, wave, room, vertices.count)


@kernel()
def gather_ends(wave, vertices, escaped, light):
    """Add the environment that the ``escaped`` paths leave to."""
    rays = wave.shadow.wave
    normals, ways = columns(vertices.normals, vertices.count), columns(rays.ways, vertices.count)
    for i in rays.escaped[:escaped]:
        w = column(ways, i)
        cosine = dot(column(normals, i), w)
        add_carried(wave, i, arriving(light.constant, light.image, light.matrix, light.table, w, cosine))


@kernel()
def gather_walls(wave, vertices, hits, room):
    """Add the light of luminaires that paths meet; ``hits`` stay that meet a lit side: returns how many."""
    rays, staying = wave.shadow.wave, 0
    normals, ways = columns(vertices.normals, vertices.count), columns(rays.ways, vertices.count)
    for h in range(hits):
        i = rays.hits[h]
        k, w = int(wave.met[i]), column(ways, i)
        slope = dot(row(room.normals, k), w) if k >= 0 else 0.0
        rays.hits[staying] = i
        if k < 0 or lit_from(room, k, slope):
            staying += 1
            if k >= 0:
                share = balance_area(room, k, dot(column(normals, i), w), slope, rays.t[i])
                add_carried(wave, i, scale(row(room.radiances, k), share))
    return staying


@kernel()
def surface_albedo(room, p):
    """The albedo of the isosurface in a room at ``p``, in index space."""
    if room.colours.table.shape[0] > 0:
        return albedo_at(room.colours, p)
    return room.albedo[0], room.albedo[1], room.albedo[2]


@kernel()
def carry(wave, vertices, hits, chance, room):
    """Multiply what paths carry by the albedo of what they hit, over the ``chance`` that they go on."""
    rays, count = wave.shadow.wave, vertices.count
    origins, directions = columns(vertices.points, count), columns(rays.directions, count)
    for i in rays.hits[:hits]:
        k, m = int(wave.met[i]), rays.owners[i]
        p = madd(column(origins, i), rays.t[i], column(directions, i))
        albedo = row(room.albedos, k) if k >= 0 else surface_albedo(room, p)
        for c in range(3):
            wave.carried[c, m] *= albedo[c] / chance


@kernel()
def stand_on_walls(wave, vertices, following, room):
    """Put the vertices ``following`` that are on walls there, with the normals of the sides that were met."""
    rays, count, hits = wave.shadow.wave, vertices.count, following.count
    origins, directions = columns(vertices.points, count), columns(rays.directions, count)
    points, normals, ways = columns(following.points, hits), columns(following.normals, hits), columns(rays.ways, count)
    for h in range(hits):
        i = rays.hits[h]
        k = int(wave.met[i])
        wave.own[h] = k
        if k >= 0:
            n = row(room.normals, k)
            side = 1.0 if dot(n, column(ways, i)) < 0.0 else -1.0
            put_column(points, h, madd(column(origins, i), rays.t[h], column(directions, i)))
            put_column(normals, h, scale(n, side))
            rays.sides[h] = UNKNOWN


@kernel()
def light_wave(field, cells, wave, vertices, spare, room, rules, light):
    """Walk the paths of a wave to their ends and gather light on the way."""
    rays, last = wave.shadow.wave, rules.weights.shape[0] - 1
    for bounce in range(last + 1):
        count = vertices.count
        n = whole(count)
        gather_sources(field, cells, wave, vertices, bounce, room, light)
        sample_direction(rays, vertices, bounce, field.spacing)
        intersect(field, cells, rays, vertices.points, count)
        origins, directions = columns(vertices.points, count), columns(rays.directions, count)
        meet_walls(room.walls, origins, directions, wave.own[:n], rays.t[:n], wave.met[:n])
        hits = partition(rays, count)
        gather_ends(wave, vertices, count - hits, light)
        hits = gather_walls(wave, vertices, hits, room)
        hits = russian_roulette(rays, hits, bounce, rules.survival)
        if hits == 0 or bounce == last:
            return
        carry(wave, vertices, hits, rules.survival if bounce > 0 else 1.0, room)
        following = Vertices(spare.points, spare.normals, hits)
        compact(rays, vertices, following)
        for h in range(hits):
            rays.t[h] = rays.t[rays.hits[h]]
        next_vertex(field, rays, count, following)
        stand_on_walls(wave, vertices, following, room)
        vertices, spare = following, vertices


@kernel()
def launch_in_room(field, starts):
    """Where the first rays start, (3, g): off the surface, see ``launch``, and on a wall."""
    origins = starts.points.copy()
    for i in range(starts.isovalues.shape[0]):
        if starts.walls[i] < 0.0:
            p, n = column(starts.points, i), column(starts.normals, i)
            put_column(origins, i, launch(field, starts.isovalues[i], p, n, OUTSIDE))
    return origins


@kernel()
def begin(wave, starts, first, count):
    """Say where the first ``count`` vertices of a wave stand, whose first path has the number ``first``."""
    g = starts.walls.shape[0]
    for m in range(count):
        wave.own[m] = starts.walls[(first + m) % g]
        if wave.own[m] >= 0.0:
            wave.shadow.wave.sides[m] = UNKNOWN


@kernel()
def first_carried(rules, total, gathered):
    """What each of ``total`` paths carries at first, (3, total); none has ``gathered`` (3 k, total or more) any yet."""
    gathered[:, :total] = 0.0
    carried = np.empty((3, total))
    for c in range(3):
        carried[c] = rules.weights[0, c]
    return carried


@kernel()
def light_paths(field, cells, room, starts, samples, rules, light, gathered):
    """``light_paths`` of the module of that name in a ``room``; see ``light_in_room``."""
    total = starts.isovalues.shape[0] * samples.count
    carried = first_carried(rules, total, gathered)
    origins = launch_in_room(field, starts)
    n = whole(min(WAVE, total))
    shadow, space, spare = make_shadow_rays(n), make_vertices(n), make_vertices(n)
    wave = RoomWave(shadow, np.full(n, -1.0), np.full(n, -1.0), carried, gathered)
    for first in range(0, total, WAVE):
        vertices = Vertices(space.points, space.normals, min(WAVE, total - first))
        generate(shadow.wave, vertices, starts, origins, samples.first, first)
        begin(wave, starts, first, vertices.count)
        light_wave(field, cells, wave, vertices, spare, room, rules, light)


@kernel()
def add_gathered(gathered, count, sums):
    """Add what ``count`` paths of each of g starts have ``gathered`` (channels, g · count), sample by sample, to their
    ``sums`` (g, channels).
    """
    g = sums.shape[0]
    for m in range(g * count):
        for j in range(sums.shape[1]):
            sums[m % g, j] += gathered[j, m]


@kernel(types.void(FIELD, ACTIVE_CELLS, ROOM, STARTS, SAMPLE_RANGE, PATH_RULES, SURROUNDINGS, ROWS))
def light_in_room(field, cells, room, starts, samples, rules, light, sums):
    """Add E/π of a ``SampleRange`` at each of g ``RoomStarts``, with all light that is reflected, to ``sums`` (g, 3).

    Each bounce counts the albedo of what it hit, of the ``room`` or of the isosurface, and all the first of the
    weights (bounces + 1, 3) of the ``rules``, of which the others are not read. ``light`` are the Surroundings: lamps
    and what lies outside. Luminaires are drawn by area and by cosine, and both are balanced. Sums grow sample by
    sample: the company of a start changes no bit. Source: Kajiya 1986; Veach and Guibas 1995.
    """
    g, last = starts.isovalues.shape[0], samples.first + samples.count
    step = max(WAVE // max(g, 1), 1)
    gathered = np.empty((3, g * step))
    for first in range(samples.first, last, step):
        some = SampleRange(first, min(step, last - first))
        light_paths(field, cells, room, starts, some, rules, light, gathered)
        add_gathered(gathered, some.count, sums)


@kernel(types.void(types.int64[:, ::1], types.uint64[::1]))
def fill_seeds(words, seeds):
    """Fill ``seeds`` (g,) with the sequences that belong to rows of ``words`` (g, 2 or more), mixed one by one."""
    for i in range(words.shape[0]):
        seed = np.uint64(words[i, 0])
        for j in range(1, words.shape[1]):
            seed = mix(seed, words[i, j])
        seeds[i] = seed
