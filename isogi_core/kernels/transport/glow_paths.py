"""Paths that gather only the light of glowing regions, over one isosurface and walls or among
several.

See ``tracing.glow`` for the emission along a ray. A region may lie behind surfaces that let light
pass: a ray that passes one at random goes on gathering, and a ray aimed at a region gathers the
transmitted part.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ROWS, kernel
from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.glow import GLOWS, Glows, gather_on_way, way_through_ball
from isogi_core.kernels.tracing.vec import SMALLEST_NORMAL, column, dot, normalize, put_column, sub
from isogi_core.kernels.transport.integrator import (
    add_paths,
    columns,
    gather_met,
    gather_sources,
    partition,
)
from isogi_core.kernels.transport.light_paths import NO_START, cast_wave, to_world
from isogi_core.kernels.transport.paths import PATH_RULES, PATH_STARTS, SAMPLE_RANGE
from isogi_core.kernels.transport.rng import point_of_words
from isogi_core.kernels.transport.room_paths import IN_ROOM, InRoom, gather_walls
from isogi_core.kernels.transport.sampling import about
from isogi_core.kernels.transport.streams import FIRST_SOURCE_PAIR, MAX_CROSSINGS, PAIRS_PER_PURPOSE
from isogi_core.kernels.transport.surface_paths import (
    AMONG_RECORD,
    Among,
    cast_at_all,
    cast_past,
    goes_on,
)


@kernel()
def cap_of(glows, k, p):
    """Return 1 - cosα of the cone from ``p`` around the bounding ball of region ``k``;
    0 if p is in the ball.
    """
    away = sub(column(glows.centres, k), p)
    square = glows.radii[k] * glows.radii[k] / max(dot(away, away), SMALLEST_NORMAL)
    if square < 1.0:
        return square / (1.0 + math.sqrt(1.0 - square))
    return 0.0


@kernel()
def density_towards(glows, k, p, w):
    """Return the density per steradian of direction ``w`` from ``p``, sampled uniformly in the
    cone of ``cap_of``.
    """
    cap = cap_of(glows, k, p)
    if not cap > 0.0:
        return 0.0
    near, far = way_through_ball(sub(column(glows.centres, k), p), glows.radii[k], w)
    if near < far:
        return 1.0 / (2.0 * math.pi * cap)
    return 0.0


@kernel()
def draw_towards(glows, k, p, u, v):
    """Sample a direction from ``p`` in the cone of ``cap_of`` by (u, v) in [0, 1)²; p lies
    outside of the ball.
    """
    down = u * cap_of(glows, k, p)
    turn = 2.0 * math.pi * v
    sine = math.sqrt(max(down * (2.0 - down), 0.0))
    axis = normalize(sub(column(glows.centres, k), p))
    return about(axis, (sine * math.cos(turn), sine * math.sin(turn), 1.0 - down))


@kernel()
def balance_cone(glows, k, p, w, cosine):
    """Return the weight p_c/(p_c + p_k) of a ray that cosine sampling and the cone of region ``k``
    may draw.

    A ray of either technique adds this part of its radiance to E/π. Source: Veach and Guibas 1995,
    balance heuristic.
    """
    by_cosine = cosine / math.pi
    return by_cosine / max(by_cosine + density_towards(glows, k, p, w), SMALLEST_NORMAL)


@kernel()
def aim_at_glow(wave, vertices, bounce, glows, k, spacing):
    """Turn the rays of the wave towards region ``k``; return the number of rays that can see it.

    Rays from inside the region's ball, or from surfaces turned away, are set to hit nothing.
    """
    shadow = wave.shadow
    rays = wave.rays
    count = vertices.count
    origins = columns(vertices.points, count)
    normals = columns(vertices.normals, count)
    starts = columns(shadow.starts, count)
    ways = columns(rays.ways, count)
    directions = columns(rays.directions, count)
    directions[:, count:] = 1.0
    # Each region and bounce draws from a different dimension.
    dimension = np.uint64(FIRST_SOURCE_PAIR + k * PAIRS_PER_PURPOSE + bounce)
    aimed = 0
    for i in range(count):
        low = np.uint64(rays.low[i])
        high = np.uint64(rays.high[i])
        sample = np.uint64(rays.samples[i])
        u, v = point_of_words(low, high, sample, dimension)
        o, n = column(origins, i), column(normals, i)
        p = to_world(o, spacing)
        # Sample the cone around the region's ball; points inside of it rely on cosine sampling
        # alone.
        outside = cap_of(glows, k, p) > 0.0
        if outside:
            w = draw_towards(glows, k, p, u, v)
        else:
            w = n
        # Rays that cannot bring light start at infinity, and hit nothing.
        lit = outside and dot(n, w) > 0.0
        aimed += lit
        put_column(ways, i, w)
        put_column(directions, i, to_index(w, spacing))
        put_column(starts, i, o if lit else NO_START)
    return aimed


@kernel()
def add_glow(wave, vertices, i, k, scene, glows, share):
    """Add the part ``share`` of the light of region ``k`` along the ray from vertex ``i``, up
    to its end, to its path.
    """
    rays = wave.rays
    count = vertices.count
    m = rays.owners[i]
    w = column(columns(rays.ways, count), i)
    p = to_world(column(columns(vertices.points, count), i), scene.field.spacing)
    light = gather_on_way(scene.field, glows, k, p, w, rays.t[i])
    if light > 0.0:
        # Weight against the other sampling technique; each region has three channels of the sums.
        light *= share * balance_cone(
            glows, k, p, w, dot(column(columns(vertices.normals, count), i), w)
        )
        for c in range(3):
            wave.gathered[3 * k + c, m] += wave.carried[c, m] * light


@gather_sources.case(InRoom, Glows)
def gather_aimed_glow(scene, state, vertices, bounce, glows):
    """Add the light that rays aimed at each region gather."""
    shadow = state.wave.shadow
    count = vertices.count
    for k in range(glows.rates.shape[0]):
        if aim_at_glow(state.wave, vertices, bounce, glows, k, scene.field.spacing) == 0:
            continue
        cast_wave(scene, state, shadow.starts, count)
        starts = columns(shadow.starts, count)
        for i in range(count):
            if starts[0, i] < math.inf:
                add_glow(state.wave, vertices, i, k, scene, glows, 1.0)


@gather_met.case(Glows)
def gather_met_glow(scene, state, vertices, bounce, glows):
    """Add the light of all regions along the rays that were cast;
    return the number of paths that continue.
    """
    rays = state.wave.rays
    count = vertices.count
    for k in range(glows.rates.shape[0]):
        for i in range(count):
            add_glow(state.wave, vertices, i, k, scene, glows, 1.0)
    return gather_walls(state.wave, vertices, partition(rays, count), scene.room)


@kernel(types.void(IN_ROOM, PATH_STARTS, SAMPLE_RANGE, PATH_RULES, GLOWS, REAL_ROWS))
def glow_in_room(scene, starts, samples, rules, glows, sums):
    """Add E/π of each of k ``glows`` of radiance 1 at each of g ``PathStarts`` to ``sums`` (g, 3
    k).

    All reflections are included, as in ``light_in_room``. The ``scene`` is InRoom; its walls, if
    there are any, emit no light. Rays are sampled by cosine and towards the ball around each
    region, combined by the balance heuristic. The result does not depend on which starts are traced
    together. Source: Kajiya 1986, with emission along the way.
    """
    add_paths(scene, starts, samples, rules, glows, sums)


@kernel()
def gather_to_crossings(scene, state, vertices, k, glows, place, going):
    """Add the light of region ``k`` that pending rays gather up to their next crossing; return how
    many go on.

    ``place`` is the bounce and the number of the crossing. The part of a ray that ends at the
    crossing adds its light now.
    """
    wave = state.wave
    staying = 0
    (bounce, crossing) = place
    for j in range(going):
        i = state.pending[j]
        before = state.passed[i]
        state.pending[staying] = i
        # The ray goes on with the part that passes; the part that is stopped has reached its end.
        on = goes_on(scene.surfaces, state, i, bounce, crossing, True)
        staying += on
        if on:
            ends = before - state.passed[i]
        else:
            ends = before
        add_glow(wave, vertices, i, k, scene, glows, ends)
    return staying


@gather_sources.case(Among, Glows)
def gather_aimed_among(scene, state, vertices, bounce, glows):
    """Add the light that rays aimed at each region gather, crossing by crossing."""
    shadow = state.wave.shadow
    count = vertices.count
    for k in range(glows.rates.shape[0]):
        if aim_at_glow(state.wave, vertices, bounce, glows, k, scene.field.spacing) == 0:
            continue
        # Cast the aimed rays at all surfaces.
        origins = columns(shadow.starts, count)
        going = 0
        origins[:, count:] = math.inf
        cast_at_all(scene, state, origins, count)
        for i in range(count):
            state.passed[i] = 1.0
            shadow.reach[i] = math.inf
            state.pending[going] = i
            going += origins[0, i] < math.inf
        # Let the rays pass one surface after the other, each time with the part that is
        # transmitted.
        for crossing in range(MAX_CROSSINGS):
            going = gather_to_crossings(scene, state, vertices, k, glows, (bounce, crossing), going)
            if going == 0:
                break
            for surface in range(scene.surfaces.clears.shape[0]):
                cast_past(scene, state, surface, origins, count, going)


@kernel(types.void(AMONG_RECORD, PATH_STARTS, SAMPLE_RANGE, PATH_RULES, GLOWS, REAL_ROWS))
def glow_among_surfaces(scene, starts, samples, rules, glows, sums):
    """Add E/π of each of k ``glows`` of radiance 1 at each of g ``PathStarts`` to ``sums`` (g, 3
    k).

    Rays meet the surfaces of the ``scene``, which is Among, as in ``light_among_surfaces``, and
    gather light as in ``glow_in_room``; walls emit no light. Source: Kajiya 1986; a lesion behind
    clear surfaces as in Beason et al. 2006 (S3).
    """
    add_paths(scene, starts, samples, rules, glows, sums)
