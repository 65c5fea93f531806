"""Paths that gather the light of glowing regions alone, over an isosurface and walls: see ``tracing.glow``."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.field import FIELD, to_index
from isogi_core.kernels.tracing.glow import GLOWS, gather_on_way, way_through_ball
from isogi_core.kernels.tracing.vec import SMALLEST, column, dot, normalize, put_column, sub
from isogi_core.kernels.tracing.walls import ROWS, meet_walls
from isogi_core.kernels.transport.integrator import about
from isogi_core.kernels.transport.light_paths import FAR, make_shadow_rays, to_world
from isogi_core.kernels.transport.paths import PATH_RULES, SAMPLE_RANGE, SampleRange
from isogi_core.kernels.transport.rng import PAIRS, point_of_words
from isogi_core.kernels.transport.room_paths import (
    ROOM,
    STARTS,
    RoomWave,
    add_gathered,
    begin,
    carry,
    first_carried,
    gather_walls,
    launch_in_room,
    stand_on_walls,
)
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


class Glowing(NamedTuple):
    """What paths meet and what they gather: the ``field`` and its ``cells``, a ``room`` that is dark, and ``glows``."""

    field: Any
    cells: Any
    room: Any
    glows: Any


@kernel()
def cap_of(glows, k, p):
    """1 - cosα of the cone from ``p`` about the ball about region ``k``; 0 where p is in that ball."""
    away = sub(column(glows.centres, k), p)
    square = glows.radii[k] * glows.radii[k] / max(dot(away, away), SMALLEST)
    return square / (1.0 + math.sqrt(1.0 - square)) if square < 1.0 else 0.0


@kernel()
def density_towards(glows, k, p, w):
    """Density, per steradian, of the direction ``w`` from ``p`` when drawn evenly from the cone of ``cap_of``."""
    cap = cap_of(glows, k, p)
    if not cap > 0.0:
        return 0.0
    near, far = way_through_ball(sub(column(glows.centres, k), p), glows.radii[k], w)
    return 1.0 / (2.0 * math.pi * cap) if near < far else 0.0


@kernel()
def draw_towards(glows, k, p, u, v):
    """A direction from ``p`` in the cone of ``cap_of``, from (u, v) in [0, 1)²; p must be outside of the ball."""
    down, turn = u * cap_of(glows, k, p), 2.0 * math.pi * v
    aside = math.sqrt(max(down * (2.0 - down), 0.0))
    axis = normalize(sub(column(glows.centres, k), p))
    return about(axis, (aside * math.cos(turn), aside * math.sin(turn), 1.0 - down))


@kernel()
def balance(glows, k, p, w, cosine):
    """Share p_c/(p_c + p_k) of a ray between the two ways in which it is drawn, by cosine and towards region ``k``.

    The same share of its radiance is what a ray of either sort adds to E/π. Source: Veach and Guibas 1995, balance
    heuristic.
    """
    by_cosine = cosine / math.pi
    return by_cosine / max(by_cosine + density_towards(glows, k, p, w), SMALLEST)


@kernel()
def aim_at_glow(wave, vertices, bounce, glows, k, spacing):
    """Turn the wave's rays towards region ``k``; returns how many there are, those in its ball and from behind none."""
    shadow, rays, count = wave.shadow, wave.shadow.wave, vertices.count
    origins, normals = columns(vertices.points, count), columns(vertices.normals, count)
    starts, ways, directions = columns(shadow.starts, count), columns(rays.ways, count), columns(rays.directions, count)
    directions[:, count:] = 1.0
    dimension, aimed = np.uint64((1 + k) * PAIRS + bounce), 0
    for i in range(count):
        low, high, sample = np.uint64(rays.low[i]), np.uint64(rays.high[i]), np.uint64(rays.samples[i])
        u, v = point_of_words(low, high, sample, dimension)
        o, n = column(origins, i), column(normals, i)
        p = to_world(o, spacing)
        outside = cap_of(glows, k, p) > 0.0
        w = draw_towards(glows, k, p, u, v) if outside else n
        lit = outside and dot(n, w) > 0.0
        aimed += lit
        put_column(ways, i, w)
        put_column(directions, i, to_index(w, spacing))
        put_column(starts, i, o if lit else FAR)
    return aimed


@kernel()
def gather(wave, vertices, i, k, scene, reach, share):
    """Add the ``share`` of what the ray from vertex ``i`` gathers of region ``k`` before ``reach`` to its path."""
    count, m = vertices.count, wave.shadow.wave.owners[i]
    w = column(columns(wave.shadow.wave.ways, count), i)
    p = to_world(column(columns(vertices.points, count), i), scene.field.spacing)
    light = gather_on_way(scene.field, scene.glows, k, p, w, reach)
    if light > 0.0:
        light *= share * balance(scene.glows, k, p, w, dot(column(columns(vertices.normals, count), i), w))
        for c in range(3):
            wave.gathered[3 * k + c, m] += wave.carried[c, m] * light


@kernel()
def cast_among_walls(wave, points, count, scene):
    """Cast the wave's rays from ``points`` to what they meet first, the isosurface or a wall."""
    rays, n = wave.shadow.wave, whole(count)
    intersect(scene.field, scene.cells, rays, points, count)
    origins, directions = columns(points, count), columns(rays.directions, count)
    meet_walls(scene.room.walls, origins, directions, wave.own[:n], rays.t[:n], wave.met[:n])


@kernel()
def gather_aimed(wave, vertices, bounce, scene):
    """Add what rays towards each of the regions gather."""
    shadow, count = wave.shadow, vertices.count
    for k in range(scene.glows.rates.shape[0]):
        if aim_at_glow(wave, vertices, bounce, scene.glows, k, scene.field.spacing) == 0:
            continue
        cast_among_walls(wave, shadow.starts, count, scene)
        starts = columns(shadow.starts, count)
        for i in range(count):
            if starts[0, i] < math.inf:
                gather(wave, vertices, i, k, scene, shadow.wave.t[i], 1.0)


@kernel()
def go_on(wave, vertices, following, scene):
    """Move the paths that hit something to the vertices ``following``, on the isosurface or on walls."""
    rays, count = wave.shadow.wave, vertices.count
    compact(rays, vertices, following)
    for h in range(following.count):
        rays.t[h] = rays.t[rays.hits[h]]
    next_vertex(scene.field, rays, count, following)
    stand_on_walls(wave, vertices, following, scene.room)


@kernel()
def gather_all(wave, vertices, bounce, scene, room, survival):
    """Add what paths gather of all that glows on the ways that were cast, and on a ``room``; how many go on."""
    rays, count = wave.shadow.wave, vertices.count
    for k in range(scene.glows.rates.shape[0]):
        for i in range(count):
            gather(wave, vertices, i, k, scene, rays.t[i], 1.0)
    hits = gather_walls(wave, vertices, partition(rays, count), room)
    return russian_roulette(rays, hits, bounce, survival)


@kernel()
def glow_wave(wave, vertices, spare, scene, rules):
    """Walk the paths of a wave to their ends and gather glow on the way, as ``room_paths.light_wave`` does light."""
    rays, last = wave.shadow.wave, rules.weights.shape[0] - 1
    for bounce in range(last + 1):
        count = vertices.count
        gather_aimed(wave, vertices, bounce, scene)
        sample_direction(rays, vertices, bounce, scene.field.spacing)
        cast_among_walls(wave, vertices.points, count, scene)
        hits = gather_all(wave, vertices, bounce, scene, scene.room, rules.survival)
        if hits == 0 or bounce == last:
            return
        carry(wave, vertices, hits, rules.survival if bounce > 0 else 1.0, scene.room)
        following = Vertices(spare.points, spare.normals, hits)
        go_on(wave, vertices, following, scene)
        vertices, spare = following, vertices


@kernel()
def glow_paths(scene, starts, samples, rules, gathered):
    """Write what each path of a ``SampleRange`` gathers to ``gathered`` (3 k, at least g · count)."""
    total = starts.isovalues.shape[0] * samples.count
    carried = first_carried(rules, total, gathered)
    origins = launch_in_room(scene.field, starts)
    n = whole(min(WAVE, total))
    shadow, space, spare = make_shadow_rays(n), make_vertices(n), make_vertices(n)
    wave = RoomWave(shadow, np.full(n, -1.0), np.full(n, -1.0), carried, gathered)
    for first in range(0, total, WAVE):
        vertices = Vertices(space.points, space.normals, min(WAVE, total - first))
        generate(shadow.wave, vertices, starts, origins, samples.first, first)
        begin(wave, starts, first, vertices.count)
        glow_wave(wave, vertices, spare, scene, rules)


@kernel(types.void(FIELD, ACTIVE_CELLS, ROOM, STARTS, SAMPLE_RANGE, PATH_RULES, GLOWS, ROWS))
def glow_in_room(field, cells, room, starts, samples, rules, glows, sums):
    """Add E/π of each of k ``glows``, of radiance 1, at each of g ``RoomStarts`` to ``sums`` (g, 3 k).

    All light that is reflected is in it; bounces count as in ``light_in_room``, the ``room`` gives off no light, and
    may have no walls. Rays are drawn by cosine and towards the ball about each region, and both are balanced. Sums grow
    sample by sample: the company of a start changes no bit. Source: Kajiya 1986, with emission along the way.
    """
    g, last = starts.isovalues.shape[0], samples.first + samples.count
    step = max(WAVE // max(g, 1), 1)
    scene, gathered = Glowing(field, cells, room, glows), np.empty((sums.shape[1], g * step))
    for first in range(samples.first, last, step):
        some = SampleRange(first, min(step, last - first))
        glow_paths(scene, starts, some, rules, gathered)
        add_gathered(gathered, some.count, sums)
