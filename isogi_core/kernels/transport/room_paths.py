"""Paths over an isosurface and walls, which gather the light of luminaires
and of the surroundings.
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
"""Part of the way to a luminaire on which geometry may block it;
the rest is the luminaire itself.
"""


class Room(NamedTuple):
    """The ``walls`` of a scene and the reflection of walls and isosurface; world space, linear RGB,
    float64.

    Of k walls: ``corners`` (k, 3), ``edges`` (k, 2, 3), unit ``normals`` (k, 3) of their fronts,
    ``areas`` (k,), ``albedos`` and emitted ``radiances`` (k, 3). Both belong to the front, and to
    the back if ``twofold`` (k,) is 1. The isosurface has the ``colours``, or the ``albedo`` (3,) if
    there are none.
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
    """One isosurface of a ``field`` within its active ``cells``,
    and the walls of a ``room`` around it.
    """

    field: Any
    cells: Any
    room: Any


IN_ROOM = record(InRoom, FIELD_RECORD, ACTIVE_CELLS, ROOM_RECORD)


@kernel()
def balance_area(room, k, cosine, slope, distance):
    """Return the part of the radiance of wall ``k`` that a ray towards it adds to E/π, if both
    cosine and area sampling may draw the ray: p_c/(p_c + p_a).

    Cosine sampling has the density p_c = cosθ/π, cosθ being ``cosine``. Area sampling has p_a =
    r²/(A |slope|), r being the ``distance``, and ``slope`` the cosine between the ray and the
    wall's normal. Source: Veach and Guibas 1995, balance heuristic.
    """
    by_cosine = cosine / math.pi
    by_area = distance * distance / max(room.areas[k] * abs(slope), SMALLEST_NORMAL)
    return by_cosine / max(by_cosine + by_area, SMALLEST_NORMAL)


@kernel()
def lit_from(room, k, slope):
    """Return True if a ray with the component ``slope`` along the normal of wall ``k`` meets a
    side that reflects and emits.
    """
    return slope < 0.0 or room.twofold[k] > 0.0


@kernel()
def sample_luminaire(room, k, p, n, u, v):
    """Sample luminaire ``k`` from the world point ``p`` with normal ``n``:
    (direction, distance, E/π).
    """
    # Pick a point on the wall; reject it if it is behind the surface or shows a dark side.
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
    """Turn the rays of the wave towards luminaire ``k``,
    with the random numbers of a ``source``.
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
    # Each source and bounce draws from a different dimension.
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
        # Rays that cannot bring light, and those from the luminaire itself, hit nothing.
        lit = wave.own[i] != k and max(shine[0], shine[1], shine[2]) > 0.0
        put_column(directions, i, to_index(w, spacing))
        put_column(lights, i, shine)
        put_column(starts, i, o if lit else NO_START)


@cast_wave.case(InRoom)
def cast_among_walls(scene, state, points, count):
    """Cast the rays of a wave from ``points`` to their first hits,
    on the isosurface or on a wall.
    """
    wave = state.wave
    rays = state.wave.rays
    n = whole(count)
    intersect(scene.field, scene.cells, rays, points, count)
    origins = columns(points, count)
    directions = columns(rays.directions, count)
    meet_walls(scene.room.walls, origins, directions, wave.own[:n], rays.t[:n], wave.met[:n])


@gather_sources.case(Surroundings)
def gather_from_all(scene, state, vertices, bounce, light):
    """Add the light of lamps, bright parts of the environment, and luminaires at the vertices of a
    wave, in any scene with a ``room``.

    Luminaires are the walls that emit light. As sources they are numbered after the environment, 0,
    and the lamps, so that each draws different random numbers.
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
    """Add the light of rays that escape and of luminaires that they hit; return the number of
    paths that continue.
    """
    return gather_walls(state.wave, vertices, gather_ends(state.wave, vertices, light), scene.room)


@kernel()
def gather_walls(wave, vertices, hits, room):
    """Add the light of luminaires among the first ``hits`` hits; return the number of paths that
    continue.

    A path ends on the back of a wall that reflects on its front only.
    """
    rays = wave.rays
    staying = 0
    normals = columns(vertices.normals, vertices.count)
    ways = columns(rays.ways, vertices.count)
    for h in range(hits):
        i = rays.hits[h]
        k = int(wave.met[i])
        w = column(ways, i)
        # Find the side of the wall that the ray hits.
        if k >= 0:
            slope = dot(row(room.normals, k), w)
        else:
            slope = 0.0
        rays.hits[staying] = i
        # Keep paths on surfaces and on lit sides, and add the wall's light, balanced with shadow
        # rays.
        if k < 0 or lit_from(room, k, slope):
            staying += 1
            if k >= 0:
                share = balance_area(room, k, dot(column(normals, i), w), slope, rays.t[i])
                add_carried(wave, i, scale(row(room.radiances, k), share))
    return staying


@kernel()
def surface_albedo(room, p):
    """Return the albedo of the isosurface at ``p`` in index space."""
    if room.colours.table.shape[0] > 0:
        return albedo_at(room.colours, p)
    return room.albedo[0], room.albedo[1], room.albedo[2]


@kernel()
def carry(wave, vertices, hits, chance, room):
    """Multiply throughputs by the albedo of the wall or surface that paths hit, over the
    ``chance`` that they continue.

    Call it before ``compact``, which moves paths away from the places of their rays.
    """
    rays = wave.rays
    count = vertices.count
    origins = columns(vertices.points, count)
    directions = columns(rays.directions, count)
    for i in rays.hits[:hits]:
        k = int(wave.met[i])
        m = rays.owners[i]
        p = madd(column(origins, i), rays.t[i], column(directions, i))
        # Take the albedo of the wall, or of the isosurface at the hit point.
        if k >= 0:
            albedo = row(room.albedos, k)
        else:
            albedo = surface_albedo(room, p)
        for c in range(3):
            wave.carried[c, m] *= albedo[c] / chance


@kernel()
def stand_on_walls(wave, vertices, following, room):
    """Put the vertices ``following`` that lie on walls there,
    with the normal of the side that was hit.
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
            # Turn the wall's normal towards the ray; no ray from a wall is given a side of the
            # isosurface.
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
    """Move the paths that continue to their hit points on the isosurface or on a wall."""
    rays = state.wave.rays
    count = vertices.count
    # Roulette spares the first hit: ``russian_roulette``.
    chance = rules.survival if bounce > 0 else 1.0
    carry(state.wave, vertices, following.count, chance, scene.room)
    compact(rays, vertices, following)
    # Move distances to the places of the vertices, too: ``stand_on_walls`` reads them there. Points
    # on walls replace those of ``next_vertex``, which takes all hits for points of the isosurface.
    for h in range(following.count):
        rays.t[h] = rays.t[rays.hits[h]]
    next_vertex(scene.field, rays, count, following)
    stand_on_walls(state.wave, vertices, following, scene.room)


@kernel()
def begin_on_walls(wave, starts, first, count):
    """Set the walls of the first ``count`` vertices of a wave,
    whose first path has the number ``first``.
    """
    g = starts.walls.shape[0]
    for m in range(count):
        wave.own[m] = starts.walls[(first + m) % g]
        if wave.own[m] >= 0.0:
            wave.rays.sides[m] = UNKNOWN_SIDE


@begin_wave.case(InRoom)
def begin_in_room(scene, state, vertices, starts, first):
    """Set the vertices of a wave, on the isosurface or on walls."""
    begin_on_walls(state.wave, starts, first, vertices.count)


@kernel(types.void(IN_ROOM, PATH_STARTS, SAMPLE_RANGE, PATH_RULES, SURROUNDINGS_RECORD, REAL_ROWS))
def light_in_room(scene, starts, samples, rules, light, sums):
    """Add E/π of a ``SampleRange`` at each of g ``PathStarts``, all reflections included, to
    ``sums`` (g, 3).

    The ``scene`` is InRoom. Each bounce multiplies by the albedo of the wall or the isosurface that
    it hits, and all light has the first of the weights (bounces + 1, 3) of the ``rules``; the other
    weights are not read. ``light`` are the Surroundings: lamps and environment. Luminaires are
    sampled by area and by cosine, combined by the balance heuristic. Sums grow sample by sample, so
    that the result does not depend on which starts are traced together. Source: Kajiya 1986; Veach
    and Guibas 1995.
    """
    add_paths(scene, starts, samples, rules, light, sums)


@kernel(types.void(types.int64[:, ::1], types.uint64[::1]))
def fill_seeds(words, seeds):
    """Fill ``seeds`` (g,) with the seeds of the rows of ``words`` (g, 2 or more),
    by mixing the words in order.
    """
    for i in range(words.shape[0]):
        seed = np.uint64(words[i, 0])
        for j in range(1, words.shape[1]):
            seed = mix(seed, words[i, j])
        seeds[i] = seed
