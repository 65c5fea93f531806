"""Paths in a room: they wander over an isosurface and walls, and gather the light of luminaires and
of all else.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD_RECORD, to_index
from isogi_core.kernels.tracing.intersect import UNKNOWN_SIDE
from isogi_core.kernels.tracing.vec import (
    SMALLEST_NORMAL,
    column,
    dot,
    length,
    madd,
    put_column,
    scale,
    sub,
)
from isogi_core.kernels.tracing.walls import WALLS_RECORD, meet_walls
from isogi_core.kernels.transport.colours import COLOURS_RECORD, albedo_at
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
    next_vertex,
    whole,
)
from isogi_core.kernels.transport.light_paths import (
    NO_START,
    SURROUNDINGS_RECORD,
    Surroundings,
    add_sent,
    cast_wave,
    gather_ends,
    gather_from_outside,
    to_world,
)
from isogi_core.kernels.transport.lights import NO_LIGHT, row
from isogi_core.kernels.transport.paths import PATH_RULES, PATH_STARTS, SAMPLE_RANGE
from isogi_core.kernels.transport.rng import mix, point_of_words
from isogi_core.kernels.transport.streams import FIRST_SOURCE_PAIR, PAIRS_PER_PURPOSE

SHADOWED_SHARE = 1.0 - 1e-9
"""Share of the way to a luminaire on which something may shadow it."""


class Room(NamedTuple):
    """The ``walls`` of a scene, and how they and the isosurface reflect; all in the world, linear
    RGB, float64.

    Of k walls ``corners`` (k, 3), ``edges`` (k, 2, 3), unit ``normals`` (k, 3) of their fronts,
    ``areas`` (k,), ``albedos`` and ``radiances`` that they give off (k, 3); both are of the front,
    and of the back where ``twofold`` (k,) is 1. The isosurface has the ``colours``, or the
    ``albedo`` (3,) where there are none.
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


ROOM_RECORD = record(
    Room,
    WALLS_RECORD,
    REAL_ROWS,
    types.float64[:, :, ::1],
    REAL_ROWS,
    REAL_ARRAY,
    REAL_ROWS,
    REAL_ROWS,
    REAL_ARRAY,
    REAL_ARRAY,
    COLOURS_RECORD,
)


class InRoom(NamedTuple):
    """One isosurface of a ``field``, within its active ``cells``, and the walls of a ``room`` about
    it.
    """

    field: Any
    cells: Any
    room: Any


IN_ROOM = record(InRoom, FIELD_RECORD, ACTIVE_CELLS, ROOM_RECORD)


@kernel()
def balance_area(room, k, cosine, slope, distance):
    """Share p_c/(p_c + p_a) of a ray to wall ``k`` between the two ways in which it is drawn.

    By cosine p_c = cosθ/π, by area p_a = r²/(A |slope|), the slope being that of the ray to the
    wall's normal. The same share of the radiance is what a ray of either sort adds to E/π. Source:
    Veach and Guibas 1995, balance heuristic.
    """
    by_cosine = cosine / math.pi
    by_area = distance * distance / max(room.areas[k] * abs(slope), SMALLEST_NORMAL)
    return by_cosine / max(by_cosine + by_area, SMALLEST_NORMAL)


@kernel()
def lit_from(room, k, slope):
    """Whether a ray with this component along the normal of wall ``k`` meets a side that is lit."""
    return slope < 0.0 or room.twofold[k] > 0.0


@kernel()
def sample_luminaire(room, k, p, n, u, v):
    """Direction, distance and E/π of what the luminaire ``k`` sends to the world point ``p`` with
    normal ``n``.
    """
    away = sub(
        madd(madd(row(room.corners, k), u, row(room.edges[k], 0)), v, row(room.edges[k], 1)), p
    )
    distance = length(away)
    if not distance > 0.0:
        return n, 0.0, NO_LIGHT
    w = scale(away, 1.0 / distance)
    cosine = dot(n, w)
    slope = dot(row(room.normals, k), w)
    if not (cosine > 0.0 and lit_from(room, k, slope)):
        return w, 0.0, NO_LIGHT
    return (
        w,
        SHADOWED_SHARE * distance,
        scale(row(room.radiances, k), balance_area(room, k, cosine, slope, distance)),
    )


@kernel()
def aim_at_luminaire(wave, vertices, bounce, room, k, source, spacing):
    """Turn the wave's rays towards the luminaire ``k``, which draws the random numbers of a
    ``source``.
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
    dimension = np.uint64(FIRST_SOURCE_PAIR + source * PAIRS_PER_PURPOSE + bounce)
    for i in range(count):
        low = np.uint64(rays.low[i])
        high = np.uint64(rays.high[i])
        sample = np.uint64(rays.samples[i])
        u, v = point_of_words(low, high, sample, dimension)
        o = column(origins, i)
        w, shadow.reach[i], shine = sample_luminaire(
            room, k, to_world(o, spacing), column(normals, i), u, v
        )
        lit = wave.own[i] != k and max(shine[0], shine[1], shine[2]) > 0.0
        put_column(directions, i, to_index(w, spacing))
        put_column(lights, i, shine)
        put_column(starts, i, o if lit else NO_START)


@cast_wave.case(InRoom)
def cast_among_walls(scene, state, points, count):
    """Cast a wave's rays from ``points`` to what they meet first, the isosurface or a wall."""
    wave = state.wave
    rays = state.wave.rays
    n = whole(count)
    intersect(scene.field, scene.cells, rays, points, count)
    origins = columns(points, count)
    directions = columns(rays.directions, count)
    meet_walls(scene.room.walls, origins, directions, wave.own[:n], rays.t[:n], wave.met[:n])


@gather_sources.case(Surroundings)
def gather_from_all(scene, state, vertices, bounce, light):
    """Add what lamps, bright parts of a sharp environment, and luminaires send to the vertices of a
    wave.
    """
    room = scene.room
    lamps = light.lamps.kinds.shape[0]
    gather_from_outside(scene, state, vertices, bounce, light)
    for k in range(room.areas.shape[0]):
        if max(room.radiances[k, 0], room.radiances[k, 1], room.radiances[k, 2]) > 0.0:
            aim_at_luminaire(
                state.wave, vertices, bounce, room, k, 1 + lamps + k, scene.field.spacing
            )
            add_sent(scene, state, vertices, bounce)


@gather_met.case(Surroundings)
def gather_all_met(scene, state, vertices, bounce, light):
    """Add the environment that paths leave to, and luminaires that they meet: returns how many go
    on.
    """
    return gather_walls(state.wave, vertices, gather_ends(state.wave, vertices, light), scene.room)


@kernel()
def gather_walls(wave, vertices, hits, room):
    """Add the light of luminaires that paths meet; ``hits`` stay that meet a lit side: returns how
    many.
    """
    rays = wave.rays
    staying = 0
    normals = columns(vertices.normals, vertices.count)
    ways = columns(rays.ways, vertices.count)
    for h in range(hits):
        i = rays.hits[h]
        k = int(wave.met[i])
        w = column(ways, i)
        if k >= 0:
            slope = dot(row(room.normals, k), w)
        else:
            slope = 0.0
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
    """Multiply what paths carry by the albedo of what they hit, over the ``chance`` that they go
    on.
    """
    rays = wave.rays
    count = vertices.count
    origins = columns(vertices.points, count)
    directions = columns(rays.directions, count)
    for i in rays.hits[:hits]:
        k = int(wave.met[i])
        m = rays.owners[i]
        p = madd(column(origins, i), rays.t[i], column(directions, i))
        if k >= 0:
            albedo = row(room.albedos, k)
        else:
            albedo = surface_albedo(room, p)
        for c in range(3):
            wave.carried[c, m] *= albedo[c] / chance


@kernel()
def stand_on_walls(wave, vertices, following, room):
    """Put the vertices ``following`` that are on walls there, with the normals of the sides that
    were met.
    """
    rays = wave.rays
    count = vertices.count
    hits = following.count
    origins = columns(vertices.points, count)
    directions = columns(rays.directions, count)
    points = columns(following.points, hits)
    normals = columns(following.normals, hits)
    ways = columns(rays.ways, count)
    for h in range(hits):
        i = rays.hits[h]
        k = int(wave.met[i])
        wave.own[h] = k
        if k >= 0:
            n = row(room.normals, k)
            if dot(n, column(ways, i)) < 0.0:
                side = 1.0
            else:
                side = -1.0
            put_column(points, h, madd(column(origins, i), rays.t[h], column(directions, i)))
            put_column(normals, h, scale(n, side))
            rays.sides[h] = UNKNOWN_SIDE


@advance.case(InRoom)
def advance_in_room(scene, state, vertices, following, bounce, rules):
    """Move the paths that go on to where they hit the isosurface or a wall."""
    rays = state.wave.rays
    count = vertices.count
    chance = rules.survival if bounce > 0 else 1.0
    carry(state.wave, vertices, following.count, chance, scene.room)
    compact(rays, vertices, following)
    for h in range(following.count):
        rays.t[h] = rays.t[rays.hits[h]]
    next_vertex(scene.field, rays, count, following)
    stand_on_walls(state.wave, vertices, following, scene.room)


@kernel()
def begin_on_walls(wave, starts, first, count):
    """Say where the first ``count`` vertices of a wave stand, whose first path has the number
    ``first``.
    """
    g = starts.walls.shape[0]
    for m in range(count):
        wave.own[m] = starts.walls[(first + m) % g]
        if wave.own[m] >= 0.0:
            wave.rays.sides[m] = UNKNOWN_SIDE


@begin_wave.case(InRoom)
def begin_in_room(scene, state, vertices, starts, first):
    """Say where the vertices of a wave stand, on the isosurface or on walls."""
    begin_on_walls(state.wave, starts, first, vertices.count)


@kernel(types.void(IN_ROOM, PATH_STARTS, SAMPLE_RANGE, PATH_RULES, SURROUNDINGS_RECORD, REAL_ROWS))
def light_in_room(scene, starts, samples, rules, light, sums):
    """Add E/π of a ``SampleRange`` at each of g ``PathStarts``, with all light that is reflected,
    to ``sums`` (g, 3).

    The ``scene`` is InRoom. Each bounce counts the albedo of what it hit, of the room or of the
    isosurface, and all the first of the weights (bounces + 1, 3) of the ``rules``, of which the
    others are not read. ``light`` are the Surroundings: lamps and what lies outside. Luminaires are
    drawn by area and by cosine, and both are balanced. Sums grow sample by sample: the company of a
    start changes no bit. Source: Kajiya 1986; Veach and Guibas 1995.
    """
    add_paths(scene, starts, samples, rules, light, sums)


@kernel(types.void(types.int64[:, ::1], types.uint64[::1]))
def fill_seeds(words, seeds):
    """Fill ``seeds`` (g,) with the sequences that belong to rows of ``words`` (g, 2 or more), mixed
    one by one.
    """
    for i in range(words.shape[0]):
        seed = np.uint64(words[i, 0])
        for j in range(1, words.shape[1]):
            seed = mix(seed, words[i, j])
        seeds[i] = seed
