"""Paths among several isosurfaces: each surface reflects light, transmits it diffusely, or lets
rays pass straight.

A ray that hits a surface leaves it on the side it came from or, by diffuse transmission, on the
other side; with the probability ``clear`` it passes straight through. Walls are opaque.
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
"""Number of no surface, for hits on walls and for misses."""


class Surfaces(NamedTuple):
    """s isosurfaces; paths start on the first one, whose isovalue each start defines for itself.

    Of each: the ``cells`` that may hold it (MAX_SURFACES records, of which only s are read);
    ``isovalues`` (s,), of which the first is not read; ``albedos`` (s, 3) of both sides; the share
    ``clears`` (s,) of rays that pass straight; the share ``transmissions`` (s, 3) of light that
    leaves the other side, diffusely.
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
    """The ``surfaces`` of a ``field`` that rays meet, and the walls of their ``room``."""

    field: Any
    surfaces: Any
    room: Any


AMONG_RECORD = record(Among, FIELD_RECORD, SURFACES_RECORD, ROOM_RECORD)


class AmongState(NamedTuple):
    """State of a ``wave`` of paths among s surfaces in a room.

    - ``own`` (n,): isovalue of the surface that each path started on.
    - ``on``, ``met`` (n,): surface that the vertex lies on, and that the ray hit, or NO_SURFACE.
    - ``t``, ``came`` (s, n): distance of each ray to each surface, and the side it arrives on.
    - ``end`` (n,): distance to the first wall.
    - ``passed`` (n,): share of a shadow ray's light that gets through.
    - ``pending`` (n,): rays that have further surfaces to cross.
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
def cast_at_all(scene, state, origins, count):
    """Cast the rays of a wave from ``origins`` at each surface, and at the walls that stop them."""
    surfaces = scene.surfaces
    wave = state.wave
    n = whole(count)
    isovalues = np.empty(n)
    sides = np.empty(n, np.int8)
    directions = columns(wave.rays.directions, count)
    # Find the first hit on each surface; a ray is given its side on the surface that it starts on.
    for k in range(surfaces.clears.shape[0]):
        for i in range(n):
            if k == 0:
                isovalues[i] = state.own[i]
            else:
                isovalues[i] = surfaces.isovalues[k]
            if state.on[i] == k:
                sides[i] = wave.rays.sides[i]
            else:
                sides[i] = UNKNOWN_SIDE
        rays = Rays(isovalues, origins, directions, sides)
        cast_batch(scene.field, surfaces.cells[k], rays, state.t[k, :n], state.came[k, :n])
    # Find the first wall.
    state.end[:n] = math.inf
    meet_walls(scene.room.walls, origins, directions, wave.own[:n], state.end[:n], wave.met[:n])


@kernel()
def cast_past(scene, state, k, origins, count, going):
    """Find the next crossing with surface ``k`` of those rays that have just passed it.

    Rays are the first ``going`` of the pending ones, which started from ``origins``. Distances to
    other surfaces stay valid: those crossings still lie ahead.
    """
    # List the rays whose last crossing was on surface k.
    n = whole(going)
    directions = columns(state.wave.rays.directions, count)
    some = np.empty(n, np.int64)
    size = 0
    for j in range(going):
        if state.met[state.pending[j]] == k:
            some[size] = state.pending[j]
            size += 1
    if size == 0:
        return
    # Start them at their crossing, on the other side of the surface.
    rays = Rays(np.empty(size), np.empty((3, size)), np.empty((3, size)), np.empty(size, np.int8))
    t = np.empty(size)
    came = np.empty(size, np.int8)
    for j in range(size):
        i = some[j]
        d = column(directions, i)
        if k == 0:
            rays.isovalues[j] = state.own[i]
        else:
            rays.isovalues[j] = scene.surfaces.isovalues[k]
        put_column(rays.origins, j, madd(column(origins, i), state.t[k, i], d))
        put_column(rays.directions, j, d)
        rays.sides[j] = -state.came[k, i]
    cast_batch(scene.field, scene.surfaces.cells[k], rays, t, came)
    # Distances are from the rays' origins, so that crossings of all surfaces compare.
    for j in range(size):
        state.t[k, some[j]] += t[j]
        state.came[k, some[j]] = came[j]


@kernel()
def nearest_surface(state, i):
    """Return the number of the surface that ray ``i`` crosses next, the least number if several
    are equally far.

    If the ray crosses none, all its distances are infinite, and the number is 0: check the distance
    before use.
    """
    best = 0
    for k in range(1, state.t.shape[0]):
        if state.t[k, i] < state.t[best, i]:
            best = k
    return best


@kernel()
def happens(rays, i, number, chance):
    """Return True if path ``i`` of a wave takes an event of probability ``chance``, by its
    random pair ``number``.
    """
    low = np.uint64(rays.low[i])
    high = np.uint64(rays.high[i])
    sample = np.uint64(rays.samples[i])
    return point_of_words(low, high, sample, np.uint64(number))[0] < chance


@kernel()
def passes(rays, i, bounce, crossing, clear):
    """Return True if ray ``i`` of a path passes the surface at this ``crossing``, at random
    with probability ``clear``.
    """
    if clear <= 0.0 or clear >= 1.0:
        return clear > 0.0
    return happens(rays, i, PASSING + crossing * PAIRS_PER_PURPOSE + bounce, clear)


@kernel()
def goes_on(surfaces, state, i, bounce, crossing, aimed):
    """Handle the next crossing of ray ``i``; return True if the ray continues past it.

    An ``aimed`` ray continues up to its reach with the light that is transmitted; other rays pass
    at random, or stop.
    """
    rays = state.wave.rays
    k = nearest_surface(state, i)
    if aimed:
        reach = state.wave.shadow.reach[i]
    else:
        reach = math.inf
    # Record the crossing, or the wall if that is nearer. A ray that meets neither counts as walled
    # at an infinite distance.
    walled = state.end[i] <= state.t[k, i]
    if walled:
        rays.t[i] = state.end[i]
    else:
        rays.t[i] = state.t[k, i]
    rays.came[i] = state.came[k, i]
    state.met[i] = NO_SURFACE if walled else k
    # End at the source of a shadow ray, or at a wall.
    if rays.t[i] >= reach or (walled and not aimed):
        return False
    if aimed:
        state.passed[i] *= 0.0 if walled else surfaces.clears[k]
        return state.passed[i] > 0.0
    return passes(rays, i, bounce, crossing, surfaces.clears[k])


@kernel()
def follow_rays(scene, state, points, bounce, count, aimed):
    """Follow the rays of a wave from ``points`` (3 n,) to the surfaces or walls that stop them.

    Writes distance, side, surface and wall of each hit. ``aimed`` rays end at their reach, and keep
    the share ``passed`` of their light.
    """
    # Find the first crossing of each ray with each surface.
    origins = columns(points, count)
    origins[:, count:] = math.inf
    state.passed[:count] = 1.0
    cast_at_all(scene, state, origins, count)
    for i in range(count):
        state.pending[i] = i
    going = count
    # Handle the nearest crossing of each pending ray. Only the surface that a ray has passed needs
    # another cast; the first crossings with all others still lie ahead of it.
    for crossing in range(MAX_CROSSINGS):
        staying = 0
        for j in range(going):
            i = state.pending[j]
            state.pending[staying] = i
            staying += goes_on(scene.surfaces, state, i, bounce, crossing, aimed)
        going = staying
        if going == 0:
            break
        for k in range(scene.surfaces.clears.shape[0]):
            cast_past(scene, state, k, origins, count, going)
    # End rays that have too many crossings at the last of these; such a shadow ray brings no light.
    for j in range(going):
        state.passed[state.pending[j]] = 0.0
    # A surface was nearer than the wall that ``cast_at_all`` found.
    for i in range(count):
        if state.met[i] != NO_SURFACE:
            state.wave.met[i] = NO_WALL


@add_sent.case(Among)
def add_sent_among(scene, state, vertices, bounce):
    """Add the light that shadow rays bring to the paths of a wave, times their throughput.

    Each surface on the way lets the share ``clear`` of it pass, and walls let nothing pass.
    """
    shadow = state.wave.shadow
    count = vertices.count
    follow_rays(scene, state, shadow.starts, bounce, count, True)
    starts = columns(shadow.starts, count)
    lights = columns(shadow.light, count)
    carried = state.wave.carried
    gathered = state.wave.gathered
    # Skip rays that start at infinity, NO_START: the source cannot light their vertices.
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
def choose_side(surfaces, state, h, k, vertex, chance):
    """Choose at random the side on which path ``h`` leaves its ``vertex`` on surface ``k``; return
    True for the other side.

    The probability of each side is its share of the light that leaves, so that no colour of the
    throughput grows more than threefold. The throughput is divided by that probability, and by the
    ``chance`` to get there.
    """
    rays = state.wave.rays
    carried = state.wave.carried
    m = rays.owners[h]
    # Sum the light that each side would send on.
    back = 0.0
    through = 0.0
    for c in range(3):
        back += carried[c, m] * surfaces.albedos[k, c]
        through += carried[c, m] * surfaces.transmissions[k, c]
    if through > 0.0:
        share = through / (through + back)
    else:
        share = 0.0
    # Choose a side, and divide by its probability.
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
def stand_on(scene, state, following, count, bounce, chance):
    """Set surface, isovalue and side of the vertices ``following``, and multiply throughputs by the
    light that leaves there.

    Rays of a ``bounce`` hit these vertices: ``count`` rays were cast, and each hit was continued
    with the probability ``chance``, by which throughputs are divided. The factor is the albedo of a
    wall, or that of ``choose_side`` on a surface.
    """
    rays = state.wave.rays
    carried = state.wave.carried
    ways = columns(rays.ways, count)
    surfaces = scene.surfaces
    walls = scene.room.albedos
    for h in range(following.count):
        i = rays.hits[h]
        k = int(state.met[i])
        # Move the path's state from the place of its ray to that of its vertex, as ``compact`` did
        # with the rest; ``stand_on_walls`` needs the distance there.
        state.own[h] = state.own[i]
        state.on[h] = k
        rays.t[h] = rays.t[i]
        # Surface 0 has an isovalue for each path; on walls isovalues are not used.
        if k <= 0:
            rays.isovalues[h] = state.own[h]
        else:
            rays.isovalues[h] = surfaces.isovalues[k]
        # Reflect at a wall, or choose a side of the surface.
        if k == NO_SURFACE:
            for c in range(3):
                carried[c, rays.owners[h]] *= walls[int(state.wave.met[i]), c] / chance
        elif choose_side(surfaces, state, h, k, bounce + 1, chance):
            rays.sides[h] = -rays.sides[h]
            rays.signs[h] = -rays.signs[h]
            # ``next_vertex`` takes the direction against the ray as normal if the field is flat.
            put_column(ways, i, scale(column(ways, i), -1.0))


@kernel()
def start_on_either_side(scene, state, vertices, starts):
    """Let each path leave its first surface, number 0, on either side if that transmits light;
    a side is drawn by its share of the light that leaves.
    """
    surfaces = scene.surfaces
    rays = state.wave.rays
    g = starts.isovalues.shape[0]
    through = surfaces.transmissions[0]
    origins = columns(vertices.points, vertices.count)
    normals = columns(vertices.normals, vertices.count)
    for h in range(vertices.count if max(through[0], through[1], through[2]) > 0.0 else 0):
        m = rays.owners[h]
        if state.on[h] == NO_SURFACE:
            continue
        # The light of a start is the mean of both sides, weighted by albedo and transmission:
        # divide by their sum.
        for c in range(3):
            state.wave.carried[c, m] /= max(surfaces.albedos[0, c] + through[c], SMALLEST_NORMAL)
        # Move the start of a path that leaves on the other side.
        if choose_side(surfaces, state, h, 0, 0, 1.0):
            n = scale(column(normals, h), -1.0)
            start = column(starts.points, m % g)
            rays.sides[h] = SOLID_SIGN
            put_column(normals, h, n)
            put_column(origins, h, launch(scene.field, rays.isovalues[h], start, n, SOLID_SIGN))


@advance.case(Among)
def advance_among(scene, state, vertices, following, bounce, rules):
    """Move the paths that continue to their hit points on surfaces or walls."""
    rays = state.wave.rays
    count = vertices.count
    # Normals need the isovalue and the side that ``stand_on`` sets. ``next_vertex`` takes all hits
    # for points of isosurfaces; vertices on walls replace its result last.
    compact(rays, vertices, following)
    stand_on(scene, state, following, count, bounce, rules.survival if bounce > 0 else 1.0)
    next_vertex(scene.field, rays, count, following)
    stand_on_walls(state.wave, vertices, following, scene.room)


@make_state.case(Among)
def make_among(scene, starts, wave):
    """Make the state of a ``wave`` of paths among surfaces."""
    n = wave.own.shape[0]
    s = scene.surfaces.clears.shape[0]
    numbers = np.zeros((3, n))
    places = np.zeros((3, n), np.int64)
    met = (numbers[0], places[0], places[1])
    ways = (np.empty((s, n)), np.empty((s, n), np.int8))
    return AmongState(wave, *met, *ways, numbers[1], numbers[2], places[2])


@begin_wave.case(Among)
def begin_among(scene, state, vertices, starts, first):
    """Set the surfaces and walls of the first vertices,
    and choose the sides that paths leave on.
    """
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
    """Add E/π of a ``SampleRange`` at each of g ``PathStarts``, all reflections included, to
    ``sums`` (g, 3).

    The ``scene`` is Among, ``light`` are the Surroundings.

    - A ray that hits a surface passes straight through with the probability ``clear``, else it
      meets a diffuse, thin shell lit from both sides.
    - Light of shadow rays is multiplied by the ``clear`` of all surfaces that they cross.
    - Each bounce multiplies by the albedo of the hit, or by its transmission if the path continues
      on the other side, over the probability of that side.
    - All light has the first of the weights (bounces + 1, 3) of the ``rules``; the others are not
      read.
    - If the surface of the starts has albedo a and transmission t, E is the mean of both sides,
      weighted by the light that leaves: (a E_near + t E_far) / (a + t).
    - Luminaires are combined by the balance heuristic as in ``light_in_room``.

    The result does not depend on which starts are traced together. Source: Kajiya 1986; clear
    shells as in Beason et al. 2006 (S3).
    """
    add_paths(scene, starts, samples, rules, light, sums)
