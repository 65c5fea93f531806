"""Shine: rays of a microfacet lobe from the points of a picture, the light that they bring, and the
points that they end on.

Directions are sampled by the lobe or towards a light: the bright parts of a sharp environment, a
lamp with an extent, or a luminaire. Their density is the mixture of all these techniques (Veach and
Guibas 1995, balance heuristic for one sample). One of several candidate directions gets a ray,
chosen by the light that it would bring without occlusion (Talbot et al. 2005, resampled importance
sampling). The estimate is unbiased, whatever the ray hits. Lamps without an extent are lit by
further, separate shadow rays.
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
"""Values of ``ShineEnds.met`` for a ray that hit nothing, or the isosurface;
numbers ≥ 0 are walls.
"""


class ShineDraws(NamedTuple):
    """The random numbers of n rays: the numbers of the points that they start from, ``owners``
    int64, the ``seeds`` uint64 of their sequences, and the sample numbers ``samples`` int64.
    """

    owners: Any
    seeds: Any
    samples: Any


class ShineEnds(NamedTuple):
    """The results of n rays.

    - ``brought``, float32 (n, 3): light that the ray brings, linear RGB.
    - ``weights``, float32 (n, 3): factors of the light that leaves the point where the ray ends.
    - ``points``: the ends; their ``pixels`` are the numbers of the rays.
    - ``met``, int8 (n,): number of the wall, MET_ISOSURFACE or MET_NOTHING.
    """

    brought: Any
    weights: Any
    points: Any
    met: Any


SHINE_DRAWS = record(ShineDraws, types.int64[::1], types.uint64[::1], types.int64[::1])
SHINE_ENDS = record(ShineEnds, SINGLE_ROWS, SINGLE_ROWS, SURFACE_POINTS, types.int8[::1])


@kernel()
def to_local(n, w):
    """Return the world direction ``w`` in a frame whose z axis is the normal ``n``."""
    s, t = orthonormal_basis(n)
    return dot(s, w), dot(t, w), dot(n, w)


@kernel()
def to_viewer(p, n, eye, spacing):
    """Return the unit direction from ``p`` to the ``eye``, both in index space, in a frame whose z
    axis is the normal ``n``.

    A normal that is turned away from the viewer is taken as seen from its other side.
    """
    v = normalize(to_world(sub(eye, p), spacing))
    x, y, z = to_local(n, v)
    return normalize((x, y, max(abs(z), MIN_VIEW_COSINE)))


@kernel(inline=True)
def draw_way(lobe, lights, p, n, v, seed, sample):
    """Sample a world direction from the world point ``p``, by the lobe or towards a light.

    ``n`` is the normal there, ``v`` the local direction to the viewer; ``seed`` and ``sample`` give
    the random numbers.
    """
    a, b = point_2d(seed, sample, SHINE_WAY)
    to_lights = share_to_lights(lobe, lights)
    # The first number chooses the technique, and is rescaled to [0, 1) for use in it.
    if a < 1.0 - to_lights:
        return about(n, sample_reflected(lobe.alpha, v, a / (1.0 - to_lights), b))
    count = count_lights(lights)
    # Choose one of the lights with equal chances.
    place = (a - 1.0 + to_lights) / to_lights * count
    which = min(int(place), count - 1)
    return draw_light(lights, which, p, min(place - which, BELOW_ONE), b)


@kernel()
def share_to_lights(lobe, lights):
    """Return the share of directions that are sampled towards lights; 0 if there are none."""
    if count_lights(lights) > 0:
        return lobe.aside
    return 0.0


@kernel()
def mirrored(lobe, v, l):
    """Return the lobe's BRDF from ``l`` to ``v`` times cosθ and its strength; linear RGB."""
    return scale(schlick_fresnel(lobe.facing, v, l), lobe.strength * reflected(lobe.alpha, v, l))


@kernel(inline=True)
def judge_way(lobe, lights, p, v, l, w):
    """Return the weight f cosθ of light along the world direction ``w`` (locally ``l``), that light
    without occlusion, the target t of ``choose_way``, and t over the density p of ``draw_way``.

    Weight and light are linear RGB, the others numbers; all are zero below the surface.
    """
    if not l[2] > 0.0:
        return NO_LIGHT, NO_LIGHT, 0.0, 0.0
    share = mirrored(lobe, v, l)
    to_lights = share_to_lights(lobe, lights)
    light, density = expect_along(lights, p, w)
    # A ray that ends on a surface is expected to bring the ambient light.
    target = dot(share, light) + lights.ambient * (share[0] + share[1] + share[2])
    # Density of the mixture of both techniques.
    drawn = (1.0 - to_lights) * reflected_pdf(lobe.alpha, v, l) + to_lights * density
    return share, light, target, target / max(drawn, SMALLEST_NORMAL)


@kernel(inline=True)
def choose_way(lobe, lights, p, n, v, seed, sample):
    """Choose the direction of a ray from the world point ``p``; return the direction (a unit vector
    of the world), the weight by which light from there counts, and the light that would come from
    there without occlusion, both linear RGB.

    Of ``lights.ways`` candidates x with densities p(x), one is chosen with a probability in
    proportion to t(x)/p(x), t being the product of weight f cosθ and expected light, summed over
    the channels. Its weight is f cosθ/t times the mean of all t/p (Talbot et al. 2005).
    """
    # Draw one candidate after the other, and keep the chosen one (reservoir sampling).
    if lights.ways > 1:
        chance = point_2d(seed, sample, SHINE_CHOICE)[0]
    else:
        chance = 0.0
    sum_of_ratios = 0.0
    target = 1.0
    chosen = n
    colour = NO_LIGHT
    bright = NO_LIGHT
    for j in range(lights.ways):
        w = draw_way(lobe, lights, p, n, v, seed, sample * lights.ways + j)
        share, light, t, ratio = judge_way(lobe, lights, p, v, to_local(n, w), w)
        sum_of_ratios += ratio
        # Replace the choice with probability ratio / sum; rescale the random number for reuse.
        taken = ratio / sum_of_ratios if sum_of_ratios > 0.0 else 0.0
        if chance < taken:
            chosen = w
            colour = share
            bright = light
            target = t
            chance = chance / taken
        else:
            chance = (chance - taken) / max(1.0 - taken, SMALLEST_NORMAL)
    return chosen, scale(colour, sum_of_ratios / (lights.ways * target)), bright


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
    """Fill ``t`` (n,) with the distances at which rays (3, n) from outside hit the isosurface;
    infinite if they miss it.
    """
    count = t.shape[0]
    came = np.empty(count, np.int8)
    rays = Rays(
        np.full(count, surface.isovalue), origins, directions, np.full(count, OUTSIDE_SIGN, np.int8)
    )
    cast_batch(surface.field, surface.cells, rays, t, came)


@kernel()
def end_ray(surface, room, ray, t, k, ends, i):
    """Write the end of ray number ``i`` = (origin, direction, way), at distance ``t`` on wall
    ``k``, or on the isosurface if ``k`` < 0.

    A wall that is lit on its front alone is black from behind: such a ray counts as one that met
    nothing, so that no light is sought at its end.
    """
    o, d, w = ray
    p = madd(o, t, d)
    if k >= 0:
        # Turn the normal of the wall towards the side that the ray comes from.
        slope = dot(row(room.normals, k), w)
        if lit_from(room, k, slope):
            ends.met[i] = k
        else:
            ends.met[i] = MET_NOTHING
        n = scale(row(room.normals, k), -1.0 if slope > 0.0 else 1.0)
    else:
        ends.met[i] = MET_ISOSURFACE
        # If the field is flat there, the direction against the ray stands for the normal.
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
    """Cast the rays of a ``lobe`` from ``SurfacePoints``, by the random numbers of ``draws``, and
    fill their ``ends``.

    The ``eye`` is in index space. Rays meet the isosurface and the walls of a ``room``, which may
    have none.
    """
    count = draws.owners.shape[0]
    origins = np.empty((3, count))
    directions = np.ones((3, count))
    ways = np.empty((3, count))
    t = np.empty(count)
    # Choose directions and cast the rays.
    aim_rays(surface, points, eye, lobe, lights, draws, (origins, directions, ways), ends)
    cast_from(surface, origins, directions, t)
    end_rays(surface, room, lights, (origins, directions, ways), t, ends)
    # Add lamps without an extent, which no sampled direction hits.
    for k in range(lights.around.lamps.kinds.shape[0]):
        add_lamp(surface, room, points, eye, lobe, (lights.around.lamps, k), draws, ends)


@kernel()
def aim_rays(surface, points, eye, lobe, lights, draws, rays, ends):
    """Choose the direction of each ray; fill ``rays`` = (origins, directions, ways), (3, n) each,
    and the weights and unoccluded light of ``ends``.

    Directions are in index space, ways in the world. A ray that cannot bring light starts at
    infinity, so that it hits nothing.
    """
    field = surface.field
    (origins, directions, ways) = rays
    for i in range(draws.owners.shape[0]):
        m = draws.owners[i]
        # Start off the surface, and choose a direction by the light that it would bring.
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
    """Fill the ``ends`` of ``rays`` = (origins, directions, ways), which hit the isosurface at
    distances ``t`` (n,), infinite if they miss it.

    The light of a ray that ends on a surface is that of lamps before its end; a ray that meets
    nothing keeps its unoccluded light.
    """
    origins, directions, ways = rays
    for i in range(t.shape[0]):
        ends.met[i] = MET_NOTHING
        if not origins[0, i] < math.inf:
            continue
        o, d, w = column(origins, i), column(directions, i), column(ways, i)
        # A wall before the isosurface ends the ray.
        reach, wall = nearest_wall(room.walls, o, d, NO_WALL, t[i])
        if reach < math.inf:
            end_ray(surface, room, (o, d, w), reach, int(wall), ends, i)
            light = lamps_before(lights, to_world(o, surface.field.spacing), w, reach)
            put_row(ends.brought, i, times(point_of(ends.weights, i), light))


@kernel()
def add_lamp(surface, room, points, eye, lobe, lamp, draws, ends):
    """Add the light of one ``lamp`` = (lamps, its number) without an extent to ``ends``, by a
    shadow ray from each point.
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
        # Find direction, distance and light of the lamp at each point, times the lobe's BRDF.
        m = draws.owners[i]
        p, n = point_of(points.points, m), point_of(points.normals, m)
        o = launch(field, surface.isovalue, p, n, OUTSIDE_SIGN)
        v = to_viewer(p, n, eye, field.spacing)
        w, reach[i], light = illuminate(lamps, k, to_world(o, field.spacing), n, 0.5, 0.5)
        l = to_local(n, w)
        put_column(origins, i, NO_START)
        put_column(lights, i, NO_LIGHT)
        if l[2] > 0.0:
            # ``illuminate`` has included cosθ/π, which the BRDF times cosine replaces.
            share = scale(mirrored(lobe, v, l), math.pi / l[2])
            put_column(origins, i, o)
            put_column(directions, i, to_index(w, field.spacing))
            put_column(lights, i, times(share, light))
    # Add the light of those rays that reach the lamp before surface and walls.
    cast_from(surface, origins, directions, t)
    for i in range(count):
        if origins[0, i] < math.inf:
            o, d = column(origins, i), column(directions, i)
            if not nearest_wall(room.walls, o, d, NO_WALL, t[i])[0] < reach[i]:
                add_row(ends.brought, i, (1.0, 1.0, 1.0), column(lights, i))


@kernel(types.void(SURFACE_POINTS, REAL_TRIPLE, REAL_TRIPLE, SHINE_LOBE, SINGLE_ROWS))
def fill_below(points, eye, spacing, lobe, below):
    """Fill ``below`` (m, 3) with ``light_below`` at ``SurfacePoints`` seen from the ``eye``,
    in index space.
    """
    for m in range(points.pixels.shape[0]):
        v = to_viewer(point_of(points.points, m), point_of(points.normals, m), eye, spacing)
        put_row(below, m, light_below(lobe, v[2]))


@kernel(types.void(SURFACE, SURFACE_POINTS, LAMPS, types.uint64[::1], SINGLE_ROWS))
def light_ends(surface, points, lamps, seeds, lit):
    """Fill ``lit`` (m, 3) with an estimate of E/π straight from directional ``lamps`` at
    ``SurfacePoints``.

    One shadow ray goes from each point to each lamp, sampled from the lamp's disc by the sequences
    ``seeds`` (m,).
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
            # Sample the direction to the lamp; points that face away from it cast no ray. The place
            # does not matter to directional lamps, so that it stays in index space.
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
        # Rays that hit nothing bring the light of the lamp.
        cast_from(surface, origins, directions, t)
        for i in range(count):
            if origins[0, i] < math.inf and t[i] == math.inf:
                add_row(lit, i, (1.0, 1.0, 1.0), column(lights, i))


ZERO_F32 = np.float32(0.0)
ONE_F32 = np.float32(1.0)


@kernel(inline=True)
def biweight(normals, n, normal, narrow):
    """Return the weight of point ``n`` in a mean around a point with this ``normal``.

    It is Tukey's biweight of the distance d between the tips of both unit normals: (1 - d² ·
    ``narrow``)², or 0 if d is at least the filter's width; ``narrow`` is 1 / width².
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
    """Fill ``found`` (k, 4) with the filtered ``light`` (m, 4) of the k points from number
    ``first`` on.

    Light is linear RGB and the variance of its luminance. It is averaged over 5 × 5 pixels, a
    ``step`` apart, by binomial weights times the ``biweight`` of the ``normals`` (m, 3), whose
    width is ``width``. ``rows`` (h, w) number the points in the pixels of the picture, -1 if there
    is none; ``pixels`` (m,) are the points' pixels. Source: Dammertz et al. 2010; Schied et al.
    2017 for the variance.
    """
    (height, across) = rows.shape
    narrow = ONE_F32 / (width * width)
    for i in range(found.shape[0]):
        m = first + i
        y, x = divmod(np.int64(pixels[m]), across)
        normal = normals[m, 0], normals[m, 1], normals[m, 2]
        red = green = blue = variance = total = ZERO_F32
        # Sum the weighted light of the points in the window; variance has squared weights.
        for dy in range(-RADIUS, RADIUS + 1):
            v = y + dy * step
            # A row beyond the picture has no points: its range of columns is empty.
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
