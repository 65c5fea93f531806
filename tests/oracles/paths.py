"""One path at a time, ray by ray: the oracle of all kernels that trace paths, as the equations say
it.

Source: Kajiya 1986, with splitting and Russian roulette by Arvo and Kirk 1990, and multiple
importance sampling by Veach and Guibas 1995. Nothing is in waves or vectors here, and nothing is
left out for speed.

Its code is cached beside the kernels that it is of, and so must call nothing compiled that stands
in another file of tests: a change there would not be seen.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from isogi_core.kernels.tracing.field import to_index
from isogi_core.kernels.tracing.glow import NO_BITS, Glows, gather_on_way
from isogi_core.kernels.tracing.intersect import (
    OUTSIDE_SIGN,
    UNKNOWN_SIDE,
    cast,
    launch,
    shading_normal,
)
from isogi_core.kernels.tracing.vec import dot, madd, scale
from isogi_core.kernels.tracing.walls import NO_WALL, nearest_wall
from isogi_core.kernels.transport import streams
from isogi_core.kernels.transport.colours import albedo_at
from isogi_core.kernels.transport.glow_paths import balance_cone, cap_of, draw_towards
from isogi_core.kernels.transport.light_paths import sample_source, to_world
from isogi_core.kernels.transport.lights import arriving, row
from isogi_core.kernels.transport.paths import PathTree
from isogi_core.kernels.transport.rng import point_2d
from isogi_core.kernels.transport.room_paths import balance_area, lit_from, sample_luminaire
from isogi_core.kernels.transport.sampling import about, sample_cosine_hemisphere
from tests.kernels.rooms import room_of, sky

DARK = sky(0.0)
NO_GLOWS = Glows(np.zeros((3, 0)), np.zeros((3, 0)), *np.zeros((6, 0)), NO_BITS)


class World(NamedTuple):
    """All that rays meet: s isosurfaces of a ``field`` and the walls of a ``room``.

    ``levels`` (s,), the ``albedos`` and ``transmissions`` (s, 3) of either side, and the share of
    rays ``clears`` (s,) that passes straight through. A room with ``colours`` has the albedo of its
    one surface.
    """

    field: Any
    levels: Any
    albedos: Any
    clears: Any
    transmissions: Any
    room: Any


class Start(NamedTuple):
    """Where a path starts, on the first isosurface or on a wall (its number, or NO_WALL), and what
    it draws from.
    """

    point: Any
    normal: Any
    level: float
    wall: float
    seed: Any
    sample: int


class Path(NamedTuple):
    """What a path brought: ``light`` (3,), ``glow`` (k, 3), and its end.

    It left after ``bounces`` along ``way``, or never (-1), and ``carried`` (3,) then.
    """

    bounces: int
    way: Any
    carried: Any
    light: Any
    glow: Any


def one_surface(field, level=0.0, albedo=1.0, room=None):
    """One opaque isosurface with an albedo, a number or linear RGB, among the walls of a
    ``room``.
    """
    albedos = np.full((1, 3), albedo)
    none = np.zeros((1, 3))
    return World(
        field,
        np.array([level]),
        albedos,
        np.zeros(1),
        none,
        room_of([], field.spacing) if room is None else room,
    )


def several_surfaces(scene):
    """The surfaces and walls that kernels meet ``Among``, for the oracle."""
    surfaces = scene.surfaces
    each = surfaces.albedos, surfaces.clears, surfaces.transmissions
    return World(scene.field, surfaces.isovalues, *each, scene.room)


@njit(cache=True)
def crossings(world, levels, on, side, o, d):
    """What a ray o + t·d crosses, in order, up to the first thing that is opaque: (t, surface, side
    it came from) each.

    It starts on surface ``on``, or on wall -1 - ``on``, and wall k is surface -1 - k.
    """
    end, wall = nearest_wall(world.room.walls, o, d, -1.0 - on if on < 0 else NO_WALL, math.inf)
    found = [(end, -1 - int(wall), UNKNOWN_SIDE) for _ in range(1 if wall != NO_WALL else 0)]
    for k in range(len(levels)):
        t = 0.0
        here = side if k == on else UNKNOWN_SIDE
        while True:
            step, came = cast(world.field, levels[k], madd(o, t, d), d, here)
            t += step
            if not t < end:
                break
            place = 0
            while place < len(found) and found[place][0] <= t:
                place += 1
            found.insert(place, (t, k, came))
            if not world.clears[k] > 0.0:
                break
            here = -came
    return found


@njit(cache=True)
def first_met(world, found, draws, bounce):
    """What stops a ray that passes surfaces by chance: (t, surface, side it came from); t is inf
    where nothing does.
    """
    seed, sample = draws
    for crossing, (t, k, came) in enumerate(found):
        clear = world.clears[k] if k >= 0 else 0.0
        number = streams.PASSING + crossing * streams.PAIRS_PER_PURPOSE + bounce
        if not (clear > 0.0 and (clear >= 1.0 or point_2d(seed, sample, number)[0] < clear)):
            return t, k, came
    return math.inf, 0, UNKNOWN_SIDE


@njit(cache=True)
def passing(world, found, reach):
    """The share of a shadow ray's light that reaches a source at ``reach``."""
    share = 1.0
    for t, k, _ in found:
        if t < reach:
            share *= world.clears[k] if k >= 0 else 0.0
    return share


@njit(cache=True)
def choose_way(world, on, carried, draws, vertex, chance):
    """Leave surface ``on`` by its albedo or its transmission: (carried, whether by that).

    Each is drawn by what it leaves of the light that is carried.
    """
    albedo = world.albedos[on]
    through = world.transmissions[on]
    share = (carried * through).sum() / max((carried * (through + albedo)).sum(), 1e-300)
    if share > 0.0 and point_2d(draws[0], draws[1], streams.LEAVING + vertex)[0] < share:
        return carried * (through / (chance * share)), True
    return carried * (albedo / (chance * (1.0 - share))), False


@njit(cache=True)
def reflect(world, on, p, carried, draws, vertex, chance):
    """What is carried on from ``p`` on a surface or a wall ``on``, and whether from the other side
    of it.
    """
    if on < 0:
        return carried * (world.room.albedos[-1 - on] / chance), False
    if world.room.colours.table.shape[0] > 0:
        red, green, blue = albedo_at(world.room.colours, p)
        return carried * (np.array([red, green, blue]) / chance), False
    return choose_way(world, on, carried, draws, vertex, chance)


@njit(cache=True)
def draw_source(world, light, source, on, o, n, draws, bounce):
    """Direction, reach and E/π of a ray towards a ``source``: bright sky, a lamp, or a
    luminaire.
    """
    u, v = point_2d(
        draws[0], draws[1], streams.FIRST_SOURCE_PAIR + source * streams.PAIRS_PER_PURPOSE + bounce
    )
    p = to_world(o, world.field.spacing)
    k = source - 1 - light.lamps.kinds.shape[0]
    if k < 0:
        return sample_source(light, source, p, n, u, v)
    w, reach, shine = sample_luminaire(world.room, k, p, n, u, v)
    return w, reach, shine if on != -1 - k else (0.0, 0.0, 0.0)


@njit(cache=True)
def gather_sent(world, levels, light, vertex, carried, draws, bounce):
    """What sources send straight to a vertex, (3,)."""
    on, side, o, n = vertex
    total = np.zeros(3)
    last = 1 + light.lamps.kinds.shape[0] + world.room.areas.shape[0]
    for source in range(0 if light.table.rows.shape[0] > 0 else 1, last):
        w, reach, shine = draw_source(world, light, source, on, o, n, draws, bounce)
        if max(shine[0], shine[1], shine[2]) > 0.0:
            found = crossings(world, levels, on, side, o, to_index(w, world.field.spacing))
            total += carried * passing(world, found, reach) * np.array(shine)
    return total


@njit(cache=True)
def gather_end(world, light, n, w, t, on):
    """What a ray drawn by the cosine brings from its end, the sky or a luminaire, (3,); whether its
    path goes on.
    """
    if not t < math.inf:
        return np.array(
            arriving(light.constant, light.image, light.matrix, light.table, w, dot(n, w))
        ), False
    if on >= 0:
        return np.zeros(3), True
    slope = dot(row(world.room.normals, -1 - on), w)
    if not lit_from(world.room, -1 - on, slope):
        return np.zeros(3), False
    return world.room.radiances[-1 - on] * balance_area(
        world.room, -1 - on, dot(n, w), slope, t
    ), True


@njit(cache=True)
def glow_on_way(world, glows, k, o, n, w, t):
    """What a ray of either sort adds to E/π of region ``k``: its share of the radiance on its
    way.
    """
    p = to_world(o, world.field.spacing)
    return gather_on_way(world.field, glows, k, p, w, t) * balance_cone(glows, k, p, w, dot(n, w))


@njit(cache=True)
def aimed_glow(world, levels, glows, k, vertex, draws, bounce):
    """What a ray towards region ``k`` gathers, share by share of what passes the surfaces that it
    crosses.
    """
    on, side, o, n = vertex
    p = to_world(o, world.field.spacing)
    (u, v) = point_2d(
        draws[0], draws[1], streams.FIRST_SOURCE_PAIR + k * streams.PAIRS_PER_PURPOSE + bounce
    )
    if not cap_of(glows, k, p) > 0.0:
        return 0.0
    w = draw_towards(glows, k, p, u, v)
    total = 0.0
    passed = 1.0
    if not dot(n, w) > 0.0:
        return 0.0
    for t, surface, _ in crossings(world, levels, on, side, o, to_index(w, world.field.spacing)):
        left = passed * (world.clears[surface] if surface >= 0 else 0.0)
        total += (passed - left) * glow_on_way(world, glows, k, o, n, w, t)
        passed = left
    return total + passed * glow_on_way(world, glows, k, o, n, w, math.inf)


@njit(cache=True)
def stand(world, on, o, t, d, w, came):
    """The point that a ray met, and the normal there towards the side that it came from."""
    p = madd(o, t, d)
    if on >= 0:
        return p, shading_normal(world.field, p, came, w)
    n = row(world.room.normals, -1 - on)
    return p, scale(n, 1.0 if dot(n, w) < 0.0 else -1.0)


@njit(cache=True)
def begin(world, start, carried):
    """The first vertex of a path, on a wall or on either side of the first surface: (on, side,
    normal, carried).
    """
    if start.wall != NO_WALL:
        return -1 - int(start.wall), UNKNOWN_SIDE, start.normal, carried
    if not world.transmissions[0].max() > 0.0:
        return 0, OUTSIDE_SIGN, start.normal, carried
    share = carried / np.maximum(world.albedos[0] + world.transmissions[0], 1e-300)
    carried, other = choose_way(world, 0, share, (start.seed, start.sample), 0, 1.0)
    if other:
        return (0, -OUTSIDE_SIGN, scale(start.normal, -1.0), carried)
    return (0, OUTSIDE_SIGN, start.normal, carried)


@njit(cache=True)
def trace(world, sources, start, tree, branch, weight):
    """Trace one path of a ``PathTree`` from its ``start``, which carries ``weight`` (3,): its
    ``Path``.

    ``sources`` are the Surroundings and the Glows that it gathers. From its first hit it goes on as
    this ``branch``.
    """
    light, glows = sources
    levels = world.levels.copy()
    p = start.point
    sample = start.sample
    levels[0] = start.level
    total = np.zeros(3)
    glow = np.zeros((glows.rates.shape[0], 3))
    left = -1
    way = (0.0, 0.0, 0.0)
    on, side, n, carried = begin(world, start, weight)
    for bounce in range(tree.bounces + 1):
        if on >= 0:
            o = launch(world.field, levels[on], p, n, side)
        else:
            o = p
        draws = (start.seed, sample)
        vertex = on, side, o, n
        total += gather_sent(world, levels, light, vertex, carried, draws, bounce)
        u, v = point_2d(start.seed, sample, streams.DIRECTIONS + bounce)
        w = about(n, sample_cosine_hemisphere(u, v))
        d = to_index(w, world.field.spacing)
        t, met, came = first_met(world, crossings(world, levels, on, side, o, d), draws, bounce)
        for k in range(glows.rates.shape[0]):
            glow[k] += carried * aimed_glow(world, levels, glows, k, vertex, draws, bounce)
            glow[k] += carried * glow_on_way(world, glows, k, o, n, w, t)
        end, goes_on = gather_end(world, light, n, w, t, met)
        total += carried * end
        if not t < math.inf:
            left = bounce
            way = w
            break
        p, n = stand(world, met, o, t, d, w, came)
        if bounce == 0:
            sample = sample * tree.branches + branch
        elif (
            not point_2d(start.seed, sample, streams.FIRST_ROULETTE_PAIR + bounce)[0]
            < tree.survival
        ):
            break
        if not goes_on or bounce == tree.bounces:
            break
        chance = tree.survival if bounce > 0 else 1.0
        carried, other = reflect(world, met, p, carried, (start.seed, sample), bounce + 1, chance)
        on = met
        side = -came if other else came
        n = scale(n, -1.0) if other else n
    return Path(left, way, carried, total, glow)


@njit(cache=True)
def trace_all(world, sources, starts, samples, tree, weight, paths):
    """Fill ``paths`` (3 + 3 k, g · count) with the light and the glow that a ``SampleRange`` of
    paths brings.

    Path s · g + i is the sample ``first + s`` of start i, of g ``PathStarts``.
    """
    g = starts.isovalues.shape[0]
    for m in range(g * samples.count):
        i = m % g
        p = starts.points[0, i], starts.points[1, i], starts.points[2, i]
        n = starts.normals[0, i], starts.normals[1, i], starts.normals[2, i]
        start = Start(
            p, n, starts.isovalues[i], starts.walls[i], starts.seeds[i], samples.first + m // g
        )
        found = trace(world, sources, start, tree, 0, weight)
        paths[:3, m] = found.light
        paths[3:, m] = found.glow.ravel()


def gathered(world, starts, samples, bounces, light=DARK, glows=NO_GLOWS, weight=1.0, survival=1.0):
    """What each path brings, (g, count, 1 + k, 3): light, and of each of k regions the glow. See
    ``trace_all``.
    """
    g, k = starts.isovalues.shape[0], glows.rates.shape[0]
    paths = np.empty((3 + 3 * k, g * samples.count))
    tree = PathTree(bounces, survival, 1)
    trace_all(world, (light, glows), starts, samples, tree, np.full(3, weight), paths)
    return paths.reshape(1 + k, 3, samples.count, g).transpose(3, 2, 0, 1)
