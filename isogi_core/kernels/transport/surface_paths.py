"""Paths among several isosurfaces: a ray meets the nearest, and a share of all rays passes straight
through it.

What meets a surface leaves it on the side it came from, or, diffuse too, on the other. Walls let
nothing through.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record
from isogi_core.kernels.tracing.active_cells import ACTIVE_CELLS
from isogi_core.kernels.tracing.cast import cast_batch
from isogi_core.kernels.tracing.field import FIELD_RECORD
from isogi_core.kernels.tracing.intersect import SOLID_SIGN, UNKNOWN_SIDE, launch
from isogi_core.kernels.tracing.peels import MAX_SURFACES
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.vec import SMALLEST_NORMAL, column, madd, put_column, scale
from isogi_core.kernels.tracing.walls import NO_WALL, meet_walls
from isogi_core.kernels.transport.integrator import (
    add_paths,
    advance,
    begin_wave,
    columns,
    compact,
    make_state,
    meet,
    next_vertex,
    whole,
)
from isogi_core.kernels.transport.light_paths import SURROUNDINGS_RECORD, add_sent
from isogi_core.kernels.transport.paths import PATH_RULES, PATH_STARTS, SAMPLE_RANGE
from isogi_core.kernels.transport.rng import point_of_words
from isogi_core.kernels.transport.room_paths import ROOM_RECORD, begin_on_walls, stand_on_walls
from isogi_core.kernels.transport.streams import LEAVING, MAX_CROSSINGS, PAIRS_PER_PURPOSE, PASSING

NO_SURFACE = -1
"""The number of no surface: of what is a wall, or nothing."""


class Surfaces(NamedTuple):
    """s isosurfaces, the first of them the one that paths start on, whose isovalue each start has
    for itself.

    Of each the ``cells`` that may hold it (MOST of them: the others say nothing), its ``isovalues``
    (s,), of which the first is not read, the ``albedos`` (s, 3) of both its sides, and the share
    ``clears`` (s,) of rays that passes. Of what falls on either side the share ``transmissions``
    (s, 3) leaves the other, diffuse.
    """

    cells: Any
    isovalues: Any
    albedos: Any
    clears: Any
    transmissions: Any


SURFACES_RECORD = record(
    Surfaces,
    types.UniTuple(ACTIVE_CELLS, MAX_SURFACES),
    REAL_ARRAY,
    REAL_ROWS,
    REAL_ARRAY,
    REAL_ROWS,
)


class Among(NamedTuple):
    """The ``surfaces`` of a ``field`` that rays meet, and their ``room``."""

    field: Any
    surfaces: Any
    room: Any


AMONG_RECORD = record(Among, FIELD_RECORD, SURFACES_RECORD, ROOM_RECORD)


class Company(NamedTuple):
    """A ``wave`` of paths among s surfaces in a room.

    (n,) the ``own`` isovalues of the surfaces that paths started on, and the numbers of those that
    vertices stand ``on`` and that rays ``met``, or NONE. For each surface and ray the way ``t`` to
    it, and the side that it ``came`` from, (s, n). ``end`` (n,) is the way to the wall that a ray
    meets at last. ``passed`` (n,) is the share of a shadow ray's light that gets through,
    ``pending`` (n,) the rays that go on.
    """

    wave: Any
    own: Any
    on: Any
    met: Any
    t: Any
    came: Any
    end: Any
    passed: Any
    pending: Any


@kernel()
def cast_at_all(scene, company, origins, count):
    """Cast a wave's rays from ``origins`` at each surface, ways and sides, and at the walls that
    end them.
    """
    surfaces = scene.surfaces
    wave = company.wave
    n = whole(count)
    isovalues = np.empty(n)
    sides = np.empty(n, np.int8)
    directions = columns(wave.rays.directions, count)
    for k in range(surfaces.clears.shape[0]):
        for i in range(n):
            if k == 0:
                isovalues[i] = company.own[i]
            else:
                isovalues[i] = surfaces.isovalues[k]
            if company.on[i] == k:
                sides[i] = wave.rays.sides[i]
            else:
                sides[i] = UNKNOWN_SIDE
        rays = Rays(isovalues, origins, directions, sides)
        cast_batch(scene.field, surfaces.cells[k], rays, company.t[k, :n], company.came[k, :n])
    company.end[:n] = math.inf
    meet_walls(scene.room.walls, origins, directions, wave.own[:n], company.end[:n], wave.met[:n])


@kernel()
def cast_past(scene, company, k, origins, count, going):
    """Cast those of the first ``going`` pending rays on that have just passed surface ``k``, from
    there.
    """
    n = whole(going)
    directions = columns(company.wave.rays.directions, count)
    some = np.empty(n, np.int64)
    size = 0
    for j in range(going):
        if company.met[company.pending[j]] == k:
            some[size] = company.pending[j]
            size += 1
    if size == 0:
        return
    rays = Rays(np.empty(size), np.empty((3, size)), np.empty((3, size)), np.empty(size, np.int8))
    t = np.empty(size)
    came = np.empty(size, np.int8)
    for j in range(size):
        i = some[j]
        d = column(directions, i)
        if k == 0:
            rays.isovalues[j] = company.own[i]
        else:
            rays.isovalues[j] = scene.surfaces.isovalues[k]
        put_column(rays.origins, j, madd(column(origins, i), company.t[k, i], d))
        put_column(rays.directions, j, d)
        rays.sides[j] = -company.came[k, i]
    cast_batch(scene.field, scene.surfaces.cells[k], rays, t, came)
    for j in range(size):
        company.t[k, some[j]] += t[j]
        company.came[k, some[j]] = came[j]


@kernel()
def nearest_surface(company, i):
    """The surface that ray ``i`` meets next; the first of those at the same place, and 0 where it
    meets none.
    """
    best = 0
    for k in range(1, company.t.shape[0]):
        if company.t[k, i] < company.t[best, i]:
            best = k
    return best


@kernel()
def happens(rays, i, number, chance):
    """Whether path ``i`` of a wave draws what has this ``chance``, by its pair of random numbers of
    this ``number``.
    """
    low = np.uint64(rays.low[i])
    high = np.uint64(rays.high[i])
    sample = np.uint64(rays.samples[i])
    return point_of_words(low, high, sample, np.uint64(number))[0] < chance


@kernel()
def passes(rays, i, bounce, crossing, clear):
    """Whether ray ``i`` from a path's vertex passes the surface at its crossing of this number, by
    chance.
    """
    if clear <= 0.0 or clear >= 1.0:
        return clear > 0.0
    return happens(rays, i, PASSING + crossing * PAIRS_PER_PURPOSE + bounce, clear)


@kernel()
def goes_on(surfaces, company, i, bounce, crossing, aimed):
    """Whether ray ``i``, at its next crossing, goes on; an ``aimed`` one, as far as it reaches,
    with what it brings.
    """
    rays = company.wave.rays
    k = nearest_surface(company, i)
    if aimed:
        reach = company.wave.shadow.reach[i]
    else:
        reach = math.inf
    walled = company.end[i] <= company.t[k, i]
    if walled:
        rays.t[i] = company.end[i]
    else:
        rays.t[i] = company.t[k, i]
    rays.came[i] = company.came[k, i]
    company.met[i] = NO_SURFACE if walled else k
    if rays.t[i] >= reach or (walled and not aimed):
        return False
    if aimed:
        company.passed[i] *= 0.0 if walled else surfaces.clears[k]
        return company.passed[i] > 0.0
    return passes(rays, i, bounce, crossing, surfaces.clears[k])


@kernel()
def follow_rays(scene, company, room, bounce, count, aimed):
    """Follow a wave's rays from the points in ``room`` to the surfaces that stop them.

    Writes how far that is, and from which side they met which surface, or which wall. ``aimed``
    rays go no farther than they reach, and bring the share ``passed`` of their light.
    """
    origins = columns(room, count)
    origins[:, count:] = math.inf
    company.passed[:count] = 1.0
    cast_at_all(scene, company, origins, count)
    for i in range(count):
        company.pending[i] = i
    going = count
    for crossing in range(MAX_CROSSINGS):
        staying = 0
        for j in range(going):
            i = company.pending[j]
            company.pending[staying] = i
            staying += goes_on(scene.surfaces, company, i, bounce, crossing, aimed)
        going = staying
        if going == 0:
            break
        for k in range(scene.surfaces.clears.shape[0]):
            cast_past(scene, company, k, origins, count, going)
    for j in range(going):
        company.passed[company.pending[j]] = 0.0
    for i in range(count):
        if company.met[i] != NO_SURFACE:
            company.wave.met[i] = NO_WALL


@add_sent.case(Among)
def add_sent_among(scene, state, vertices, bounce):
    """Add what the shadow rays of a wave bring, of which surfaces let a share pass, and walls
    nothing.
    """
    shadow = state.wave.shadow
    count = vertices.count
    follow_rays(scene, state, shadow.starts, bounce, count, True)
    starts = columns(shadow.starts, count)
    lights = columns(shadow.light, count)
    carried = state.wave.carried
    gathered = state.wave.gathered
    for i in range(count):
        if state.passed[i] > 0.0 and starts[0, i] < math.inf:
            m = state.wave.rays.owners[i]
            for c in range(3):
                gathered[c, m] += state.passed[i] * carried[c, m] * lights[c, i]


@meet.case(Among)
def meet_among(scene, state, vertices, bounce):
    """Follow the rays of a wave to the surfaces or the walls that stop them."""
    follow_rays(scene, state, vertices.points, bounce, vertices.count, False)


@kernel()
def choose_side(surfaces, company, h, k, vertex, chance):
    """Have path ``h`` leave its ``vertex`` on surface ``k`` by its albedo, or by its transmission:
    whether by that.

    Each is drawn by what it leaves of the light that the path carries, so that no colour of it ever
    counts more than three times that. What it carries counts over that chance, and over the
    ``chance`` to get there.
    """
    rays = company.wave.rays
    carried = company.wave.carried
    m = rays.owners[h]
    back = 0.0
    through = 0.0
    for c in range(3):
        back += carried[c, m] * surfaces.albedos[k, c]
        through += carried[c, m] * surfaces.transmissions[k, c]
    if through > 0.0:
        share = through / (through + back)
    else:
        share = 0.0
    other = share > 0.0 and happens(rays, h, LEAVING + vertex, share)
    if other:
        counts = surfaces.transmissions[k]
    else:
        counts = surfaces.albedos[k]
        share = 1.0 - share
    for c in range(3):
        carried[c, m] *= counts[c] / (chance * share)
    return other


@kernel()
def stand_on(scene, company, following, count, bounce, chance):
    """Put the vertices ``following`` the rays of a ``bounce`` on what was met: its number, its
    isovalue, and the side that paths leave; of a wall, what these carry. ``count`` rays were cast,
    and hits were followed with a ``chance``.
    """
    rays = company.wave.rays
    carried = company.wave.carried
    ways = columns(rays.ways, count)
    surfaces = scene.surfaces
    walls = scene.room.albedos
    for h in range(following.count):
        i = rays.hits[h]
        k = int(company.met[i])
        company.own[h] = company.own[i]
        company.on[h] = k
        rays.t[h] = rays.t[i]
        if k <= 0:
            rays.isovalues[h] = company.own[h]
        else:
            rays.isovalues[h] = surfaces.isovalues[k]
        if k == NO_SURFACE:
            for c in range(3):
                carried[c, rays.owners[h]] *= walls[int(company.wave.met[i]), c] / chance
        elif choose_side(surfaces, company, h, k, bounce + 1, chance):
            rays.sides[h] = -rays.sides[h]
            rays.signs[h] = -rays.signs[h]
            put_column(
                ways, i, scale(column(ways, i), -1.0)
            )  # where the field is flat normals are against them


@kernel()
def start_on_either_side(scene, company, vertices, starts):
    """Have paths leave the surface that they start on, on one of its sides, each counting its share
    of what leaves.
    """
    surfaces = scene.surfaces
    rays = company.wave.rays
    g = starts.isovalues.shape[0]
    through = surfaces.transmissions[0]
    origins = columns(vertices.points, vertices.count)
    normals = columns(vertices.normals, vertices.count)
    for h in range(vertices.count if max(through[0], through[1], through[2]) > 0.0 else 0):
        m = rays.owners[h]
        if company.on[h] == NO_SURFACE:
            continue
        for c in range(3):
            company.wave.carried[c, m] /= max(surfaces.albedos[0, c] + through[c], SMALLEST_NORMAL)
        if choose_side(surfaces, company, h, 0, 0, 1.0):
            n = scale(column(normals, h), -1.0)
            start = column(starts.points, m % g)
            rays.sides[h] = SOLID_SIGN
            put_column(normals, h, n)
            put_column(origins, h, launch(scene.field, rays.isovalues[h], start, n, SOLID_SIGN))


@advance.case(Among)
def advance_among(scene, state, vertices, following, bounce, rules):
    """Move the paths that go on to where they hit surfaces or walls."""
    rays = state.wave.rays
    count = vertices.count
    compact(rays, vertices, following)
    stand_on(scene, state, following, count, bounce, rules.survival if bounce > 0 else 1.0)
    next_vertex(scene.field, rays, count, following)
    stand_on_walls(state.wave, vertices, following, scene.room)


@make_state.case(Among)
def make_company(scene, starts, wave):
    """The company of a ``wave`` of paths among surfaces."""
    n = wave.own.shape[0]
    s = scene.surfaces.clears.shape[0]
    numbers = np.zeros((3, n))
    places = np.zeros((3, n), np.int64)
    met = (numbers[0], places[0], places[1])
    ways = (np.empty((s, n)), np.empty((s, n), np.int8))
    return Company(wave, *met, *ways, numbers[1], numbers[2], places[2])


@begin_wave.case(Among)
def begin_among(scene, state, vertices, starts, first):
    """Say where the vertices of a wave stand, and put them on either side of the surface."""
    wave = state.wave
    begin_on_walls(wave, starts, first, vertices.count)
    for h in range(wave.own.shape[0]):
        state.own[h] = wave.rays.isovalues[h]
    for h in range(vertices.count):
        state.on[h] = NO_SURFACE if wave.own[h] >= 0.0 else 0
    start_on_either_side(scene, state, vertices, starts)


@kernel(
    types.void(AMONG_RECORD, PATH_STARTS, SAMPLE_RANGE, PATH_RULES, SURROUNDINGS_RECORD, REAL_ROWS)
)
def light_among_surfaces(scene, starts, samples, rules, light, sums):
    """Add E/π of a ``SampleRange`` at each of g ``PathStarts``, with all light that is reflected,
    to ``sums`` (g, 3).

    The ``scene`` is Among. A ray that meets a surface passes straight through it with the chance
    ``clear``, or meets a diffuse one there: of a thin shell that is lit on either side. Light of
    shadow rays is multiplied by the ``clear`` of all that they cross. Each bounce counts the albedo
    of what it hit, or its transmission where it goes on from the other side, over the chance of
    that side, and all the first of the weights (bounces + 1, 3) of the ``rules``, of which the
    others are not read. Where the surface of the starts has a transmission t beside its albedo a, E
    is that of both its sides by their shares in what leaves, (a E_own + t E_other) / (a + t).
    ``light`` are the Surroundings, and luminaires are balanced as in ``light_in_room``. Sums grow
    sample by sample: the company of a start changes no bit. Source: Kajiya 1986; clear shells as in
    Beason et al. 2006 (S3).
    """
    add_paths(scene, starts, samples, rules, light, sums)
