"""Shine: rays that a microfacet lobe sends from the points of a picture, and what they bring or
meet.

Ways are drawn either by the lobe or towards a light: the bright parts of a sharp environment, a
lamp with an extent, or a luminaire; their density is that of all these together (Veach and Guibas
1995, balance heuristic for one sample). Of several ways one has a ray, by what it would bring were
nothing before the lights (Talbot et al. 2005, resampled importance sampling). So its light is right
on the average, whatever it meets. Lamps without an extent have shadow rays of their own.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_TRIPLE, SINGLE_ROWS, kernel, record
from isogi_core.kernels.shading.surface_points import (
    BINOMIAL_WEIGHTS,
    RADIUS,
    SURFACE_POINTS,
    point_of,
)
from isogi_core.kernels.tracing.cast import SURFACE, cast_batch
from isogi_core.kernels.tracing.field import normal, to_index
from isogi_core.kernels.tracing.intersect import OUTSIDE_SIGN, launch
from isogi_core.kernels.tracing.ray_stream import Rays
from isogi_core.kernels.tracing.vec import (
    SMALLEST_NORMAL,
    column,
    dot,
    is_zero,
    madd,
    normalize,
    orthonormal_basis,
    put_column,
    scale,
    sub,
    times,
)
from isogi_core.kernels.tracing.walls import NO_WALL, nearest_wall
from isogi_core.kernels.transport.light_paths import NO_START, to_world
from isogi_core.kernels.transport.lights import (
    LAMPS,
    NO_LIGHT,
    illuminate,
    row,
)
from isogi_core.kernels.transport.microfacets import (
    MIN_VIEW_COSINE,
    SHINE_LOBE,
    light_below,
    reflected,
    reflected_pdf,
    sample_reflected,
    schlick_fresnel,
)
from isogi_core.kernels.transport.ray_lights import (
    SHINE_LIGHTS,
    count_lights,
    draw_light,
    expect_along,
    lamps_before,
)
from isogi_core.kernels.transport.rng import point_2d
from isogi_core.kernels.transport.room_paths import ROOM_RECORD, lit_from
from isogi_core.kernels.transport.sampling import BELOW_ONE, about
from isogi_core.kernels.transport.streams import SHINE_CHOICE, SHINE_LAMP, SHINE_WAY

MET_NOTHING = -2
MET_ISOSURFACE = -1
"""What a ray ``met``, besides the numbers of walls: nothing, or the isosurface."""


class ShineDraws(NamedTuple):
    """n rays: the points that they start from, ``owners`` int64, and sample numbers of sequences
    ``seeds`` uint64.
    """

    owners: Any
    seeds: Any
    samples: Any


class ShineEnds(NamedTuple):
    """What n rays bring and meet: light ``brought``, and what light that leaves where they end
    counts, ``weights``, both float32 (n, 3); the ``points`` there, whose ``pixels`` are the rays'
    numbers; ``met`` int8 (n,) is a wall, MET_ISOSURFACE or MET_NOTHING.
    """

    brought: Any
    weights: Any
    points: Any
    met: Any


SHINE_DRAWS = record(ShineDraws, types.int64[::1], types.uint64[::1], types.int64[::1])
SHINE_ENDS = record(ShineEnds, SINGLE_ROWS, SINGLE_ROWS, SURFACE_POINTS, types.int8[::1])


@kernel()
def to_local(n, w):
    """The world direction ``w`` about the normal ``n``: z is along that."""
    s, t = orthonormal_basis(n)
    return dot(s, w), dot(t, w), dot(n, w)


@kernel()
def to_viewer(p, n, eye, spacing):
    """The unit direction from ``p`` to the ``eye``, both in index space, about the normal ``n``: z
    is along that.

    A normal that is turned away from the viewer counts as seen from its other side.
    """
    v = normalize(to_world(sub(eye, p), spacing))
    x, y, z = to_local(n, v)
    return normalize((x, y, max(abs(z), MIN_VIEW_COSINE)))


@kernel(inline=True)
def draw_way(lobe, lights, p, n, v, seed, sample):
    """A world direction from the world point ``p``, by the lobe or towards a light."""
    a, b = point_2d(seed, sample, SHINE_WAY)
    aside = share_aside(lobe, lights)
    if a < 1.0 - aside:
        return about(n, sample_reflected(lobe.alpha, v, a / (1.0 - aside), b))
    count = count_lights(lights)
    place = (a - 1.0 + aside) / aside * count
    which = min(int(place), count - 1)
    return draw_light(lights, which, p, min(place - which, BELOW_ONE), b)


@kernel()
def share_aside(lobe, lights):
    """The share of ways that are drawn towards lights."""
    if count_lights(lights) > 0:
        return lobe.aside
    return 0.0


@kernel()
def mirrored(lobe, v, l):
    """What the lobe mirrors from ``l`` to ``v``, times cosθ and its strength; linear RGB."""
    return scale(schlick_fresnel(lobe.facing, v, l), lobe.strength * reflected(lobe.alpha, v, l))


@kernel(inline=True)
def judge_way(lobe, lights, p, v, l, w):
    """What light along the way ``w``, locally ``l``, counts, and the light were nothing before it,
    linear RGB; what is expected of both, and that over the density of ``draw_way``.
    """
    if not l[2] > 0.0:
        return NO_LIGHT, NO_LIGHT, 0.0, 0.0
    share = mirrored(lobe, v, l)
    aside = share_aside(lobe, lights)
    light, density = expect_along(lights, p, w)
    hope = dot(share, light) + lights.ambient * (share[0] + share[1] + share[2])
    drawn = (1.0 - aside) * reflected_pdf(lobe.alpha, v, l) + aside * density
    return share, light, hope, hope / max(drawn, SMALLEST_NORMAL)


@kernel(inline=True)
def choose_way(lobe, lights, p, n, v, seed, sample):
    """The way of a ray from the world point ``p``; what light from there counts, and that light
    were nothing before it.

    Of the ways x drawn with densities p(x) one is chosen as often as t(x)/p(x), t being what is
    expected; it counts f cosθ/t times the mean of all t/p.
    """
    if lights.ways > 1:
        chance = point_2d(seed, sample, SHINE_CHOICE)[0]
    else:
        chance = 0.0
    total = 0.0
    expected = 1.0
    chosen = n
    colour = NO_LIGHT
    bright = NO_LIGHT
    for j in range(lights.ways):
        w = draw_way(lobe, lights, p, n, v, seed, sample * lights.ways + j)
        share, light, hope, part = judge_way(lobe, lights, p, v, to_local(n, w), w)
        total += part
        taken = part / total if total > 0.0 else 0.0
        if chance < taken:
            chosen = w
            colour = share
            bright = light
            expected = hope
            chance = chance / taken
        else:
            chance = (chance - taken) / max(1.0 - taken, SMALLEST_NORMAL)
    return chosen, scale(colour, total / (lights.ways * expected)), bright


@kernel()
def put_row(rows, m, v):
    """Write a vector to row ``m`` of a float32 (n, 3) array."""
    rows[m, 0], rows[m, 1], rows[m, 2] = v


@kernel()
def add_row(rows, m, weight, light):
    """Add the product of two colours to row ``m`` of a float32 (n, 3) array."""
    for c in range(3):
        rows[m, c] += np.float32(weight[c] * light[c])


@kernel()
def cast_from(surface, origins, directions, t):
    """Fill ``t`` (n,) with how far rays (3, n), which start off the surface, come to it: inf where
    they never do.
    """
    count = t.shape[0]
    came = np.empty(count, np.int8)
    rays = Rays(
        np.full(count, surface.isovalue), origins, directions, np.full(count, OUTSIDE_SIGN, np.int8)
    )
    cast_batch(surface.field, surface.cells, rays, t, came)


@kernel()
def end_ray(surface, room, ray, t, k, ends, i):
    """Write where ray number ``i``, (origin, direction, way), ends: on wall ``k``, on the surface,
    or nowhere.

    The back of a wall that is lit from its front alone is black.
    """
    o, d, w = ray
    p = madd(o, t, d)
    if k >= 0:
        slope = dot(row(room.normals, k), w)
        if lit_from(room, k, slope):
            ends.met[i] = k
        else:
            ends.met[i] = MET_NOTHING
        n = scale(row(room.normals, k), -1.0 if slope > 0.0 else 1.0)
    else:
        ends.met[i] = MET_ISOSURFACE
        n = normal(surface.field, p)
        n = scale(w, -1.0) if is_zero(n) else n
    put_row(ends.points.points, i, p)
    put_row(ends.points.normals, i, n)


@kernel(
    types.void(
        SURFACE,
        ROOM_RECORD,
        SURFACE_POINTS,
        REAL_TRIPLE,
        SHINE_LOBE,
        SHINE_LIGHTS,
        SHINE_DRAWS,
        SHINE_ENDS,
    ),
)
def cast_shine(surface, room, points, eye, lobe, lights, draws, ends):
    """Cast the rays of a ``lobe`` from ``SurfacePoints``, as ``draws`` has them, and fill their
    ``ends``.

    The ``eye`` is in index space. Rays meet the isosurface and the walls of a ``room``, which may
    have none.
    """
    count = draws.owners.shape[0]
    origins = np.empty((3, count))
    directions = np.ones((3, count))
    ways = np.empty((3, count))
    t = np.empty(count)
    aim_rays(surface, points, eye, lobe, lights, draws, (origins, directions, ways), ends)
    cast_from(surface, origins, directions, t)
    end_rays(surface, room, lights, (origins, directions, ways), t, ends)
    for k in range(lights.around.lamps.kinds.shape[0]):
        add_lamp(surface, room, points, eye, lobe, (lights.around.lamps, k), draws, ends)


@kernel()
def aim_rays(surface, points, eye, lobe, lights, draws, rays, ends):
    """Choose the way of each of ``rays``, (origins, directions, ways); its weight, and what it
    brings where it meets nothing, go to ``ends``.
    """
    field = surface.field
    (origins, directions, ways) = rays
    for i in range(draws.owners.shape[0]):
        m = draws.owners[i]
        p, n = point_of(points.points, m), point_of(points.normals, m)
        o = launch(field, surface.isovalue, p, n, OUTSIDE_SIGN)
        v = to_viewer(p, n, eye, field.spacing)
        w, weight, light = choose_way(
            lobe, lights, to_world(o, field.spacing), n, v, draws.seeds[i], draws.samples[i]
        )
        alive = max(weight[0], weight[1], weight[2]) > 0.0
        put_column(ways, i, w)
        put_column(origins, i, o if alive else NO_START)
        put_row(ends.weights, i, weight)
        put_row(ends.brought, i, times(weight, light))
        if alive:
            put_column(directions, i, to_index(w, field.spacing))


@kernel()
def end_rays(surface, room, lights, rays, t, ends):
    """Fill the ``ends`` of ``rays``, (origins, directions, ways), which come as far as ``t`` (n,)
    on the surface.
    """
    origins, directions, ways = rays
    for i in range(t.shape[0]):
        ends.met[i] = MET_NOTHING
        if not origins[0, i] < math.inf:
            continue
        o, d, w = column(origins, i), column(directions, i), column(ways, i)
        reach, wall = nearest_wall(room.walls, o, d, NO_WALL, t[i])
        if reach < math.inf:
            end_ray(surface, room, (o, d, w), reach, int(wall), ends, i)
            light = lamps_before(lights, to_world(o, surface.field.spacing), w, reach)
            put_row(ends.brought, i, times(point_of(ends.weights, i), light))


@kernel()
def add_lamp(surface, room, points, eye, lobe, lamp, draws, ends):
    """Add what a ``lamp``, (lamps, its number), without an extent brings where nothing is before
    it; a ray each.
    """
    lamps, k = lamp
    count = draws.owners.shape[0]
    field = surface.field
    origins = np.empty((3, count))
    directions = np.ones((3, count))
    lights = np.empty((3, count))
    t = np.empty(count)
    reach = np.empty(count)
    for i in range(count):
        m = draws.owners[i]
        p, n = point_of(points.points, m), point_of(points.normals, m)
        o = launch(field, surface.isovalue, p, n, OUTSIDE_SIGN)
        v = to_viewer(p, n, eye, field.spacing)
        w, reach[i], light = illuminate(lamps, k, to_world(o, field.spacing), n, 0.5, 0.5)
        l = to_local(n, w)
        put_column(origins, i, NO_START)
        put_column(lights, i, NO_LIGHT)
        if l[2] > 0.0:
            share = scale(mirrored(lobe, v, l), math.pi / l[2])
            put_column(origins, i, o)
            put_column(directions, i, to_index(w, field.spacing))
            put_column(lights, i, times(share, light))
    cast_from(surface, origins, directions, t)
    for i in range(count):
        if origins[0, i] < math.inf:
            o, d = column(origins, i), column(directions, i)
            if not nearest_wall(room.walls, o, d, NO_WALL, t[i])[0] < reach[i]:
                add_row(ends.brought, i, (1.0, 1.0, 1.0), column(lights, i))


@kernel(types.void(SURFACE_POINTS, REAL_TRIPLE, REAL_TRIPLE, SHINE_LOBE, SINGLE_ROWS))
def fill_below(points, eye, spacing, lobe, below):
    """Fill ``below`` (m, 3) with ``light_below`` of ``SurfacePoints`` seen from the ``eye``, in
    index space.
    """
    for m in range(points.pixels.shape[0]):
        v = to_viewer(point_of(points.points, m), point_of(points.normals, m), eye, spacing)
        put_row(below, m, light_below(lobe, v[2]))


@kernel(types.void(SURFACE, SURFACE_POINTS, LAMPS, types.uint64[::1], SINGLE_ROWS))
def light_ends(surface, points, lamps, seeds, lit):
    """Fill ``lit`` (m, 3) with an estimate of E/π straight from directional ``lamps`` at
    ``SurfacePoints``.

    One shadow ray from each point to each lamp, drawn from the disc of that by the sequences
    ``seeds``.
    """
    count = points.pixels.shape[0]
    field = surface.field
    lit[:] = 0.0
    origins = np.empty((3, count))
    directions = np.ones((3, count))
    lights = np.empty((3, count))
    t = np.empty(count)
    for k in range(lamps.kinds.shape[0]):
        for i in range(count):
            p, n = point_of(points.points, i), point_of(points.normals, i)
            a, b = point_2d(seeds[i], 0, SHINE_LAMP + k)
            w, _, light = illuminate(lamps, k, p, n, a, b)
            facing = max(light[0], light[1], light[2]) > 0.0
            put_column(
                origins,
                i,
                launch(field, surface.isovalue, p, n, OUTSIDE_SIGN) if facing else NO_START,
            )
            put_column(directions, i, to_index(w, field.spacing))
            put_column(lights, i, light)
        cast_from(surface, origins, directions, t)
        for i in range(count):
            if origins[0, i] < math.inf and t[i] == math.inf:
                add_row(lit, i, (1.0, 1.0, 1.0), column(lights, i))


ZERO_F32 = np.float32(0.0)
ONE_F32 = np.float32(1.0)


@kernel(inline=True)
def biweight(normals, n, normal, narrow):
    """What the normal of point ``n`` counts for a ``normal``: Tukey's biweight of the length
    between both, by the inverse of its squared width.
    """
    x = normals[n, 0] - normal[0]
    y = normals[n, 1] - normal[1]
    z = normals[n, 2] - normal[2]
    rest = max(ONE_F32 - (x * x + y * y + z * z) * narrow, ZERO_F32)
    return rest * rest


@kernel(
    types.void(
        types.int32[:, ::1],
        types.uint32[::1],
        SINGLE_ROWS,
        types.int64,
        SINGLE_ROWS,
        types.int64,
        types.float32,
        SINGLE_ROWS,
    )
)
def filter_shine(rows, pixels, normals, first, light, step, width, found):
    """Fill ``found`` (k, 4) with the mean ``light`` (m, 4) about the points of a picture from
    number ``first`` on.

    Light is linear RGB and the variance of its luminance. The mean is that of five by five pixels,
    a ``step`` apart, which count binomially, and by how like their ``normals`` (m, 3) are within a
    ``width``. ``rows`` and ``pixels`` are as of ``pool_noise``. Source: Dammertz and others 2010;
    Schied and others 2017 on variance.
    """
    (height, across) = rows.shape
    narrow = ONE_F32 / (width * width)
    for i in range(found.shape[0]):
        m = first + i
        y, x = divmod(np.int64(pixels[m]), across)
        normal = normals[m, 0], normals[m, 1], normals[m, 2]
        red = green = blue = variance = total = ZERO_F32
        for dy in range(-RADIUS, RADIUS + 1):
            v = y + dy * step
            for dx in range(-RADIUS if 0 <= v < height else RADIUS + 1, RADIUS + 1):
                u = x + dx * step
                if 0 <= u < across:
                    n = np.int64(rows[v, u])
                else:
                    n = -1
                if n >= 0:
                    w = np.float32(
                        BINOMIAL_WEIGHTS[dy + RADIUS] * BINOMIAL_WEIGHTS[dx + RADIUS]
                    ) * biweight(normals, n, normal, narrow)
                    red = red + w * light[n, 0]
                    green = green + w * light[n, 1]
                    blue = blue + w * light[n, 2]
                    variance = variance + w * w * light[n, 3]
                    total = total + w
        found[i, 0], found[i, 1], found[i, 2] = red / total, green / total, blue / total
        found[i, 3] = variance / (total * total)
