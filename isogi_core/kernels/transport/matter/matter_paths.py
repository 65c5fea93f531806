"""Paths among walls around refracting matter: vertices lie on walls,
and rays between them pass through matter.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ROWS, kernel, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD_RECORD
from isogi_core.kernels.tracing.intersect import SOLID_SIGN, UNKNOWN_SIDE
from isogi_core.kernels.tracing.vec import column, dot, put_column, scale
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.integrator import (
    add_carried,
    add_paths,
    advance,
    begin_wave,
    columns,
    compact,
    gather_met,
    launch_starts,
    make_state,
    meet,
    partition,
)
from isogi_core.kernels.transport.light_paths import SURROUNDINGS_RECORD, Surroundings, cast_wave
from isogi_core.kernels.transport.lights import arriving, radiance, row
from isogi_core.kernels.transport.matter.passage import MATTER_RECORD, make_passage, pass_matter
from isogi_core.kernels.transport.paths import PATH_RULES, PATH_STARTS, SAMPLE_RANGE
from isogi_core.kernels.transport.rng import point_of_words
from isogi_core.kernels.transport.room_paths import (
    ROOM_RECORD,
    balance_area,
    cast_among_walls,
    lit_from,
)
from isogi_core.kernels.transport.sampling import about, sample_cosine_hemisphere
from isogi_core.kernels.transport.streams import DIRECTIONS

INWARD = -2.0
ALONG_RAY = -3.0
"""Values of ``PathStarts.walls`` for starts on no wall: INWARD on the isosurface, with
cosine-weighted rays about its inner normal; ALONG_RAY anywhere, with one ray along the start's
``normal``.
"""


class Through(NamedTuple):
    """An isosurface of a ``field`` within its active ``cells``, whose ``matter`` light passes,
    and its ``room``.
    """

    field: Any
    cells: Any
    room: Any
    matter: Any


THROUGH_RECORD = record(Through, FIELD_RECORD, ACTIVE_CELLS, ROOM_RECORD, MATTER_RECORD)


class Crossing(NamedTuple):
    """State of a ``wave`` whose rays pass matter: their ``passage``,
    and the ``starts`` of its paths.
    """

    wave: Any
    passage: Any
    starts: Any


@make_state.case(Through)
def make_crossing(scene, starts, wave):
    """Make the state of a ``wave`` whose rays pass matter."""
    return Crossing(wave, make_passage(wave.own.shape[0]), starts)


@launch_starts.case(Through)
def launch_through(scene, starts):
    """Return the origins of first rays, (3, g): the points themselves."""
    return starts.points


@begin_wave.case(Through)
def begin_through(scene, state, vertices, starts, first):
    """Set the walls of the first vertices of a wave, whose first path has the number ``first``.

    Vertices on no wall lose their normals, so that no shadow ray lights them.
    """
    wave = state.wave
    g = starts.walls.shape[0]
    normals = columns(vertices.normals, vertices.count)
    for m in range(vertices.count):
        wave.own[m] = starts.walls[(first + m) % g]
        wave.rays.sides[m] = UNKNOWN_SIDE
        if wave.own[m] < 0.0:
            put_column(normals, m, (0.0, 0.0, 0.0))


@kernel()
def first_way(rays, starts, k, i):
    """Return the first direction of path ``i`` of a wave, which starts at ``k``, on no wall."""
    n = column(starts.normals, k)
    if starts.walls[k] == ALONG_RAY:
        return n
    low = np.uint64(rays.low[i])
    high = np.uint64(rays.high[i])
    sample = np.uint64(rays.samples[i])
    u, v = point_of_words(low, high, sample, np.uint64(DIRECTIONS))
    return about(scale(n, -1.0), sample_cosine_hemisphere(u, v))


@kernel()
def enter_passage(wave, vertices, passage, starts, bounce):
    """Start the passage of the wave's rays;
    first rays of paths that start on no wall get their direction here.
    """
    rays = wave.rays
    count = vertices.count
    g = starts.walls.shape[0]
    points = columns(vertices.points, count)
    ways = columns(rays.ways, count)
    for i in range(count):
        k = rays.owners[i] % g
        # First rays from no wall get their direction here; other rays were sampled at the wall.
        free = bounce == 0 and starts.walls[k] < 0.0
        if free:
            put_column(ways, i, first_way(rays, starts, k, i))
        put_column(passage.origins, i, column(points, i))
        put_column(passage.ways, i, column(ways, i))
        if free and starts.walls[k] == INWARD:
            passage.sides[i] = SOLID_SIGN
        else:
            passage.sides[i] = UNKNOWN_SIDE
        # No shadow ray was cast for a free start, so that its ray counts as bent from the
        # beginning.
        passage.own[i] = NO_WALL if free else wave.own[i]
        passage.straight[i] = 0.0 if free else 1.0


@kernel()
def leave_passage(wave, passage, count):
    """Write the walls that rays of a passage ended on to the wave: distance 0 on a wall,
    infinite for rays that left.
    """
    rays = wave.rays
    for i in range(count):
        wave.met[i] = passage.met[i]
        if passage.met[i] == NO_WALL:
            rays.t[i] = math.inf
        else:
            rays.t[i] = 0.0


@kernel()
def gather_passed_ends(wave, vertices, passage, escaped, light):
    """Add the environment's light along ``escaped`` paths; all of it, without balance weight,
    if no shadow ray could bring it.
    """
    normals = columns(vertices.normals, vertices.count)
    for i in wave.rays.escaped[:escaped]:
        w = column(passage.ways, i)
        if passage.straight[i] > 0.0:
            cosine = dot(column(normals, i), w)
            add_carried(
                wave, i, arriving(light.constant, light.image, light.matrix, light.table, w, cosine)
            )
        else:
            add_carried(wave, i, radiance(light.constant, light.image, light.matrix, w))


@kernel()
def gather_passed_walls(wave, vertices, passage, hits, room, spacing):
    """Add the light of luminaires that paths hit;
    return the number of paths that hit a reflecting side.
    """
    rays = wave.rays
    staying = 0
    count = vertices.count
    normals = columns(vertices.normals, count)
    starts = columns(vertices.points, count)
    for h in range(hits):
        i = rays.hits[h]
        k = int(passage.met[i])
        w = column(passage.ways, i)
        slope = dot(row(room.normals, k), w)
        rays.hits[staying] = i
        # A path ends on the dark back of a wall.
        if lit_from(room, k, slope):
            staying += 1
            share = 1.0
            # Shadow rays may bring the light of a straight ray too, so that both are balanced.
            if passage.straight[i] > 0.0:
                x, y, z = column(passage.origins, i)
                a, b, c = column(starts, i)
                sx, sy, sz = spacing
                way = math.sqrt(((x - a) * sx) ** 2 + ((y - b) * sy) ** 2 + ((z - c) * sz) ** 2)
                share = balance_area(room, k, dot(column(normals, i), w), slope, way)
            add_carried(wave, i, scale(row(room.radiances, k), share))
    return staying


@kernel()
def stand_at_ends(wave, passage, following, room, chance):
    """Put the vertices ``following`` on the walls that were hit; multiply throughputs by albedo
    over ``chance``.

    ``compact`` has moved the state of rays to the places h of their vertices; the ``passage`` still
    has them at their former places i.
    """
    rays = wave.rays
    hits = following.count
    points = columns(following.points, hits)
    normals = columns(following.normals, hits)
    for h in range(hits):
        i, m = rays.hits[h], rays.owners[h]
        k = int(passage.met[i])
        # Turn the wall's normal towards the side that the ray came from.
        n = row(room.normals, k)
        put_column(points, h, column(passage.origins, i))
        put_column(normals, h, scale(n, 1.0 if dot(n, column(passage.ways, i)) < 0.0 else -1.0))
        wave.own[h] = k
        rays.sides[h] = UNKNOWN_SIDE
        for c in range(3):
            wave.carried[c, m] *= room.albedos[k, c] / chance


@cast_wave.case(Through)
def cast_past_matter(scene, state, points, count):
    """Cast the shadow rays of a wave from ``points``: matter blocks them as walls do."""
    cast_among_walls(scene, state, points, count)


@meet.case(Through)
def meet_through(scene, state, vertices, bounce):
    """Follow the rays of a wave through matter to walls or out of the scene."""
    wave = state.wave
    passage = state.passage
    count = vertices.count
    enter_passage(wave, vertices, passage, state.starts, bounce)
    pass_matter(
        scene.field, scene.cells, scene.room.walls, scene.matter, wave, passage, bounce, count
    )
    leave_passage(wave, passage, count)


@gather_met.case(Through, Surroundings)
def gather_met_through(scene, state, vertices, bounce, light):
    """Add the environment's light and that of luminaires;
    return the number of paths that continue.
    """
    wave = state.wave
    passage = state.passage
    count = vertices.count
    hits = partition(wave.rays, count)
    gather_passed_ends(wave, vertices, passage, count - hits, light)
    return gather_passed_walls(wave, vertices, passage, hits, scene.room, scene.field.spacing)


@advance.case(Through)
def advance_through(scene, state, vertices, following, bounce, rules):
    """Move the paths that continue to the walls that they hit."""
    compact(state.wave.rays, vertices, following)
    stand_at_ends(
        state.wave, state.passage, following, scene.room, rules.survival if bounce > 0 else 1.0
    )


@kernel(
    types.void(
        THROUGH_RECORD, PATH_STARTS, SAMPLE_RANGE, PATH_RULES, SURROUNDINGS_RECORD, REAL_ROWS
    )
)
def light_through_matter(scene, starts, samples, rules, light, sums):
    """Add the light of a ``SampleRange`` of paths at each of g ``PathStarts`` to ``sums`` (g, 3).

    The ``scene`` is Through. The result depends on the start:

    - on a wall: E/π with all reflections by walls;
    - INWARD: radiance of the solid side, averaged over π and cosines there, B/π;
    - ALONG_RAY: radiance that arrives along the start's normal.

    Rays meet the isosurface as ``Matter`` does: they refract and reflect by Fresnel, are absorbed
    and scattered. Light that luminaires and the environment send through it (caustics) is found by
    chance alone, and lamps that no ray can hit cast shadows. Bounces, weights and sums are as in
    ``light_in_room``. Source: Kajiya 1986; Beason et al. 2006 (S3).
    """
    add_paths(scene, starts, samples, rules, light, sums)
