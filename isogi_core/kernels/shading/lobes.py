"""Light that comes straight from lobes (small lights at infinity), found by shadow rays from the
points of a picture.

A lobe is a directional lamp with the angular radius of a bright part of a probe. A ray to each lobe
from each pixel would cost too much, so that rays are cast only near the edges of shadows, in these
steps (``frame.rays.lobe_light`` calls them in this order):

1. ``see_middles``: one ray to the middle of the lobe from every fourth pixel of every fourth row.
   Other pixels adopt the answer of the pixels around them if these agree, and cast a ray if not.
   In pictures at rest, they also cast one if a pixel nearby gave another answer.
2. ``mark_edges`` and ``see_rims``: if the answer changes from one pixel to the next, rays to the
   rim of the lobe tell points that see all of it, or nothing, from points in the half-shadow, which
   see a part.
3. ``spread_edges``: a half-shadow is followed from such points, by every fourth pixel first; the
   pixels between are then filled, and the ends of the half-shadow are sought pixel by pixel.
4. ``see_discs``: points in the half-shadow cast more rays, spread over the disc of the lobe: fewer,
   the more of their neighbours share rays with them.
5. ``share_rays``: each point takes the mean of its rays and those of neighbours (interleaved
   sampling: Keller and Heidrich 2001). Neighbours count in opposite pairs only, so that the mean is
   unbiased for light that changes linearly.

A lobe that a point only grazes lights it so little that the ray to its middle is enough. The parts
that do not depend on the light, such as ray origins and the order of the pixels, are in
``ShadowPoints``.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.shading.framebuffer import (
    BLUE_LUMINANCE,
    FRAMEBUFFER,
    GREEN_LUMINANCE,
    PROVISIONAL,
    RED_LUMINANCE,
    luminance,
    put_pixel,
)
from isogi_core.kernels.shading.lattice import MIN_LIGHT
from isogi_core.kernels.shading.local_models import find_unoccluded
from isogi_core.kernels.shading.shadow_points import (
    ANY_TURN,
    ORDER_ARRAY,
    PART,
    SHADOW_POINTS,
    near_between,
    neighbours,
    step_of,
    turn_of,
)
from isogi_core.kernels.shading.surface_points import PIXEL_ARRAY, number_at, point_of
from isogi_core.kernels.tracing.cast import SURFACE
from isogi_core.kernels.tracing.vec import dot, length, madd, put_column, scale
from isogi_core.kernels.transport.lights import LAMPS, draw_from_disc, row
from isogi_core.kernels.transport.rng import mix, point_2d
from isogi_core.kernels.transport.streams import LOBES_STREAM

RIM_RAYS = 4
"""Rays from a point to the rim of a lobe: to the ends of two perpendicular diameters, rotated
by an angle that is random for each pixel.
"""

PENUMBRA_RAYS = (16, 8, 8, 4, 4)
"""Rays to a lobe from a point in its half-shadow, by the number of neighbour pairs that share
rays with it; powers of two.
"""

NEIGHBOUR_AXES = ((0, 1, 2.0), (1, 0, 2.0), (1, 1, 1.0), (1, -1, 1.0))
"""Steps along y and x to the two neighbours of a pair, on either side, and the weight of their
rays next to POINT_WEIGHT.
"""

POINT_WEIGHT = 4.0
"""Weight of a point's rays in the mean with its neighbours': with all four pairs the weights
are binomial (1, 2, 1) along x and y.
"""

SHARP_SINE = math.sin(math.radians(0.25))
"""Lobes whose half angle has at most this sine (0.25°) are tested by one ray."""

STRATIFIED_VARIANCE = {4: 0.5, 8: 0.35, 16: 0.25}
"""Variance of the mean of stratified rays over the variance of as many random rays, for lobes that
are seen in part; by the number of rays.

Measured behind straight edges at any distance from the lobe's middle: 0.18 for 16 rays, which leave
an error of 4.3 % of the lobe's light. Half-shadow that rays to the rim miss (a tenth of all of it,
at its ends) adds 0.9 %. The ratio falls as the square root of the number of rays.
"""

GRAZING_SHARE = 0.03
"""Share of a lobe's light at normal incidence up to which its half-shadows are not looked for."""

NO_LOBE, LOBE_HIDDEN, LOBE_SEEN, LOBE_HALF_SEEN, LOBE_UNASKED = range(5)
"""States of a point and a lobe: the lobe is below the point's horizon; hidden; seen whole; seen
in part; not known yet.
"""

SEEN_ROWS = types.uint8[:, ::1]
PAIR_ARRAY = types.int64[::1]
SIDE_CODES = types.uint8[::1]
SHARE_ROWS = types.float64[:, ::1]
"""Types of arrays over points and lobes. A pair is one int64, the number of the lobe times the
number of points plus the number of the point. Side codes have a bit for each of NEIGHBOUR_AXES
whose neighbours share their rays with the pair. Share rows hold the share of the lobe's light
that arrives at the point, and its variance.
"""


@kernel()
def radius(lamps, k):
    """Return the sine of the half angle of lobe ``k``; 0 for lobes that are tested by one ray."""
    sine = length(row(lamps.edges[k], 0))
    return sine if sine > SHARP_SINE else 0.0


@kernel()
def cosine_of(points, lamps, k, m):
    """Return the cosine between the normal of point ``m`` and the direction
    to the middle of lobe ``k``.
    """
    return dot(point_of(points.normals, m), row(lamps.places, k))


@kernel()
def irradiance(cosine, s):
    """Return the irradiance of a lobe over that at normal incidence, if nothing but the horizon
    hides it.

    ``s`` is the sine of the lobe's half angle, ``cosine`` that of the normal to the lobe's middle.
    The result is the mean of the clamped cosine over a flat disc of radius s whose middle is at
    ``cosine`` = x s: s/π (x (π/2 + x √(1 - x²) + asin x) + 2/3 (1 - x²)^1.5), or ``cosine`` if the
    whole disc is above the horizon.
    """
    if cosine >= s:
        return cosine
    # The horizon cuts the disc, or hides all of it (x = -1).
    x = max(cosine / s, -1.0)
    root = math.sqrt(1.0 - x * x)
    return s / math.pi * (x * (0.5 * math.pi + x * root + math.asin(x)) + 2.0 / 3.0 * root**3)


@kernel()
def agreed(around, m, seen):
    """Return the state of a lobe that point ``m`` may adopt, by its four neighbours ``around`` and
    the states ``seen`` (m,) of all points.

    It is LOBE_HIDDEN or LOBE_SEEN if all four have that state; LOBE_UNASKED, so that a ray is cast,
    if they disagree or if the point has no such neighbours on its surface.
    """
    if around[m, 0] < 0:
        return LOBE_UNASKED
    found = seen[around[m, 0]]
    same = (
        found == seen[around[m, 1]] and found == seen[around[m, 2]] and found == seen[around[m, 3]]
    )
    if same and (found == LOBE_HIDDEN or found == LOBE_SEEN):
        return found
    return LOBE_UNASKED


@kernel(types.void(SURFACE, SHADOW_POINTS, LAMPS, PART, SEEN_ROWS))
def see_middles(surface, picture, lamps, part, seen):
    """Fill ``seen`` (lobes, m) with NO_LOBE, LOBE_HIDDEN or LOBE_SEEN for the points of a ``part``,
    by one shadow ray to the middle of each lobe at most.

    The part (begin, end) is a range of ``picture.order`` of points of one turn, so that their
    neighbours of earlier turns are known already. Points adopt the answer of their neighbours if
    these agree.
    """
    most = (part[1] - part[0]) * seen.shape[0]
    owners = np.empty(most, np.int64)
    lobes = np.empty(most, np.int64)
    ways = np.empty((3, most))
    count = 0
    for k in range(seen.shape[0]):
        # List the rays that must be cast: origin, lobe and direction of each.
        towards = row(lamps.places, k)
        s = radius(lamps, k)
        for i in range(part[0], part[1]):
            m = np.int64(picture.order[i])
            n = point_of(picture.points.normals, m)
            cosine = dot(n, towards)
            if cosine <= -s:
                seen[k, m] = NO_LOBE
            else:
                seen[k, m] = agreed(picture.around, m, seen[k])
            if seen[k, m] == LOBE_UNASKED:
                owners[count] = m
                lobes[count] = k
                # Aim at the middle of the part above the horizon: the centre, raised by half of the
                # part below.
                put_column(ways, count, madd(towards, 0.5 * max(s - cosine, 0.0), n))
                count += 1
    # Cast all of them as one stream.
    reached = np.empty(count, np.bool_)
    find_unoccluded(surface, picture.starts, owners[:count], ways[:, :count], reached)
    for i in range(count):
        seen[lobes[i], owners[i]] = LOBE_SEEN if reached[i] else LOBE_HIDDEN


@kernel()
def is_seen(seen, m, state):
    """Return True if there is a point ``m`` (not -1)
    and ``seen`` (m,) holds this ``state`` for it.
    """
    return m >= 0 and seen[m] == state


@kernel()
def may_be_half(points, lamps, k, m, seen):
    """Return True if point ``m`` may be in the half-shadow of lobe ``k``, and the lobe is
    bright enough there to deserve more rays.
    """
    known = seen[k, m] == LOBE_HIDDEN or seen[k, m] == LOBE_SEEN
    s = radius(lamps, k)
    return known and s > 0.0 and irradiance(cosine_of(points, lamps, k, m), s) > GRAZING_SHARE


@kernel(types.void(SHADOW_POINTS, LAMPS, PART, SEEN_ROWS, SEEN_ROWS))
def mark_edges(picture, lamps, part, seen, asked):
    """Set ``asked`` (lobes, m) to 1 for points of a ``part`` that are to cast rays to the rims of
    lobes: those next to an edge of a shadow, and ``edgy`` ones; to 0 for the others.

    ``part`` is a range (begin, end) of point numbers.
    """
    width = picture.rows.shape[1]
    for m in range(part[0], part[1]):
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
        a, b, c, d = neighbours(picture.rows, y, x, 0, 1)
        for k in range(seen.shape[0]):
            # A point is at an edge if one of its four neighbours gave the opposite answer.
            other = LOBE_SEEN + LOBE_HIDDEN - seen[k, m]
            sees = seen[k]
            edge = picture.edgy[m] or is_seen(sees, a, other) or is_seen(sees, b, other)
            edge = edge or is_seen(sees, c, other) or is_seen(sees, d, other)
            asked[k, m] = edge and may_be_half(picture.points, lamps, k, m, seen)


@kernel()
def halves_around(picture, m, seen):
    """Return the number of neighbours ``around`` point ``m`` that are in a lobe's half-shadow,
    by its ``seen`` (m,); 0 to 4.
    """
    count = 0
    for i in range(4):
        count += is_seen(seen, picture.around[m, i], LOBE_HALF_SEEN)
    return count


@kernel(
    types.UniTuple(types.int64, 2)(
        SHADOW_POINTS, LAMPS, PAIR_ARRAY, types.int64, SEEN_ROWS, SEEN_ROWS, PAIR_ARRAY
    )
)
def spread_edges(picture, lamps, halves, turn, seen, asked, more):
    """Find pairs next to those in the half-shadow, ``halves``, that were not ``asked`` yet, and
    mark them.

    With a ``turn`` ≥ 0 only points of that turn are found; they are the nearest ones on that turn's
    grid. After turn 0, at least two of a point's four neighbours must be in the half-shadow. If all
    four are, the point is in it too, and needs no rays. ANY_TURN finds all of the eight pixels
    around.

    Writes pairs that need rays to the beginning of ``more``, and pairs that are known without rays
    to its end; it has room for 8 pairs per half. Returns the number of the former, and the place
    where the latter begin.
    """
    points = seen.shape[1]
    width = picture.rows.shape[1]
    step = step_of(turn)
    count = 0
    last = more.shape[0]
    for pair in halves:
        k, m = divmod(pair, points)
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
        # Points of this turn are judged by neighbours of earlier turns, of which this pair is none.
        if 0 < turn <= turn_of(x, y):
            continue
        # Look at the pixels around, on the grid of this turn.
        for v in range(step * ((y - 1) // step), y + step + 1, step):
            for u in range(step * ((x - 1) // step), x + step + 1, step):
                n = number_at(picture.rows, v, u)
                if n < 0 or asked[k, n] or (turn != ANY_TURN and turn_of(u, v) != turn):
                    continue
                # Skip points with too little evidence of a half-shadow, and those that would gain
                # nothing.
                halves_near = halves_around(picture, n, seen[k])
                if (turn > 0 and halves_near < 2) or not may_be_half(
                    picture.points, lamps, k, n, seen
                ):
                    continue
                asked[k, n] = 1
                # Adopt the state without rays if all four neighbours have it.
                if halves_near == 4:
                    seen[k, n] = LOBE_HALF_SEEN
                    last -= 1
                    more[last] = k * points + n
                else:
                    more[count] = k * points + n
                    count += 1
    return count, last


@kernel()
def rim_way(lamps, k, turn):
    """Return the world direction to the rim of lamp ``k`` at the angle ``turn``,
    in radians about its axis.
    """
    across = madd(
        scale(row(lamps.edges[k], 0), math.cos(turn)), math.sin(turn), row(lamps.edges[k], 1)
    )
    return madd(across, math.sqrt(max(1.0 - dot(across, across), 0.0)), row(lamps.places, k))


@kernel(types.void(SURFACE, SHADOW_POINTS, LAMPS, PAIR_ARRAY, SIDE_CODES))
def see_rims(surface, picture, lamps, pairs, sees):
    """Fill ``sees`` (pairs,) with LOBE_HIDDEN, LOBE_SEEN or LOBE_HALF_SEEN, by RIM_RAYS shadow rays
    to the rim of the lobe of each pair.

    No ray is cast below the horizon of a point: it would end on the surface at the point, and
    counts as hidden.
    """
    points = picture.points
    most = RIM_RAYS * pairs.shape[0]
    count = 0
    owners = np.empty(most, np.int64)
    asking = np.empty(most, np.int64)
    ways = np.empty((3, most))
    for j in range(pairs.shape[0]):
        k, m = divmod(pairs[j], points.pixels.shape[0])
        # Rotate the four rays by a random angle that belongs to pixel and lobe. Dimensions behind
        # those of the lobes keep it independent of the rays of ``see_discs``.
        seed = mix(np.int64(points.pixels[m]), LOBES_STREAM)
        first = 0.5 * math.pi * point_2d(seed, 0, lamps.kinds.shape[0] + k)[0]
        for i in range(RIM_RAYS):
            w = rim_way(lamps, k, first + 2.0 * math.pi * i / RIM_RAYS)
            if dot(point_of(points.normals, m), w) > 0.0:
                owners[count] = m
                asking[count] = j
                put_column(ways, count, w)
                count += 1
    reached = np.empty(count, np.bool_)
    find_unoccluded(surface, picture.starts, owners[:count], ways[:, :count], reached)
    # Count the rays that reach the lobe: none, all or some.
    sees[:] = 0
    for i in range(count):
        sees[asking[i]] += reached[i]
    for j in range(pairs.shape[0]):
        if sees[j] == 0:
            sees[j] = LOBE_HIDDEN
        elif sees[j] == RIM_RAYS:
            sees[j] = LOBE_SEEN
        else:
            sees[j] = LOBE_HALF_SEEN


@kernel()
def opposite(picture, m, axis):
    """Return the numbers of the two points on either side of point ``m`` along one of the
    NEIGHBOUR_AXES; -1 for a pixel that shows none.
    """
    y, x = divmod(np.int64(picture.points.pixels[m]), picture.rows.shape[1])
    dy, dx, _ = NEIGHBOUR_AXES[axis]
    return number_at(picture.rows, y - dy, x - dx), number_at(picture.rows, y + dy, x + dx)


@kernel(types.void(SHADOW_POINTS, PAIR_ARRAY, SEEN_ROWS, SIDE_CODES))
def find_sides(picture, pairs, seen, sides):
    """Fill ``sides`` (pairs,): bit i is set if both neighbours along NEIGHBOUR_AXES[i] are in
    the half-shadow too, on one smooth surface with the pair's point.
    """
    for j in range(pairs.shape[0]):
        k, m = divmod(pairs[j], seen.shape[1])
        sides[j] = 0
        for axis in range(len(NEIGHBOUR_AXES)):
            a, b = opposite(picture, m, axis)
            # Only whole pairs share: the errors of opposite neighbours cancel if light changes
            # linearly.
            both = is_seen(seen[k], a, LOBE_HALF_SEEN) and is_seen(seen[k], b, LOBE_HALF_SEEN)
            if both and near_between(picture.points.points, m, a, b):
                sides[j] |= 1 << axis


@kernel(
    types.void(SURFACE, SHADOW_POINTS, LAMPS, PAIR_ARRAY, types.int64, types.float64, SHARE_ROWS)
)
def see_discs(surface, picture, lamps, pairs, rays, even, shares):
    """Fill ``shares`` (pairs, 2) with the irradiance from the lobe of each pair, by ``rays`` shadow
    rays each, and its variance.

    Shares are relative to the irradiance of the whole lobe at normal incidence. ``even`` is the
    factor of STRATIFIED_VARIANCE for this number of rays.
    """
    points = picture.points
    count = rays * pairs.shape[0]
    owners = np.empty(count, np.int64)
    ways = np.empty((3, count))
    brought = np.empty(count)
    for i in range(count):
        k, m = divmod(pairs[i // rays], points.pixels.shape[0])
        # Sample the disc uniformly; the ray brings its cosine at the point, over that to the axis.
        u, v = point_2d(mix(np.int64(points.pixels[m]), LOBES_STREAM), i % rays, k)
        w, cosine = draw_from_disc(row(lamps.places, k), lamps.edges[k], u, v)
        owners[i] = m
        brought[i] = max(dot(point_of(points.normals, m), w), 0.0) / cosine
        put_column(ways, i, w)
    reached = np.empty(count, np.bool_)
    find_unoccluded(surface, picture.starts, owners, ways, reached)
    # Average the rays of each pair; their scatter gives the variance of the mean.
    for j in range(pairs.shape[0]):
        mean = 0.0
        squares = 0.0
        for i in range(j * rays, (j + 1) * rays):
            mean += reached[i] * brought[i] / rays
        for i in range(j * rays, (j + 1) * rays):
            squares += (reached[i] * brought[i] - mean) ** 2
        shares[j, 0] = mean
        shares[j, 1] = even * squares / (rays * (rays - 1))


@kernel(
    types.void(
        SHADOW_POINTS, LAMPS, PAIR_ARRAY, SIDE_CODES, ORDER_ARRAY, SHARE_ROWS, PART, SHARE_ROWS
    )
)
def share_rays(picture, lamps, pairs, sides, places, alone, part, shares):
    """Fill ``shares`` (pairs, 2) of a ``part`` of the ``pairs`` with the weighted mean of each
    pair's rays and those that its neighbours share, and the variance of that mean.

    The part (begin, end) belongs to one lobe; ``places`` (m,) are the places of that lobe's points
    among the pairs. ``alone`` (pairs, 2) are shares by the rays of each pair, see ``see_discs``;
    ``sides`` comes from ``find_sides``. Points share the visible fraction of the lobe above the
    horizon, and not its irradiance, as their normals differ.
    """
    for j in range(part[0], part[1]):
        k, m = divmod(pairs[j], places.shape[0])
        mean = POINT_WEIGHT * alone[j, 0]
        variance = POINT_WEIGHT * POINT_WEIGHT * alone[j, 1]
        total = POINT_WEIGHT
        unshadowed = irradiance(cosine_of(picture.points, lamps, k, m), radius(lamps, k))
        # Add the rays of neighbours, scaled from the irradiance at their normal to that at this
        # one.
        for axis in range(len(NEIGHBOUR_AXES)):
            if not sides[j] >> axis & 1:
                continue
            for n in opposite(picture, m, axis):
                rescale = unshadowed / irradiance(
                    cosine_of(picture.points, lamps, k, n), radius(lamps, k)
                )
                weight = NEIGHBOUR_AXES[axis][2]
                i = places[n]
                total = total + weight
                mean = mean + weight * rescale * alone[i, 0]
                variance += (weight * rescale) ** 2 * alone[i, 1]
        shares[j, 0] = mean / total
        shares[j, 1] = variance / total**2


@kernel()
def add_lobe_light(lit, m, colour, share, variance):
    """Add a ``share`` of the light ``colour`` to row ``m`` of ``lit``, and the ``variance`` of
    the share times the squared luminance of the colour.
    """
    for c in range(3):
        lit[m, c] += share * colour[c]
    lit[m, 3] += (
        variance
        * (RED_LUMINANCE * colour[0] + GREEN_LUMINANCE * colour[1] + BLUE_LUMINANCE * colour[2])
        ** 2
    )


@kernel()
def share_around(picture, m, seen):
    """Return the share of points in the 3 × 3 pixels about point ``m`` that see a lobe, among
    those that face it; ``seen`` (m,) holds their states.
    """
    width = picture.rows.shape[1]
    lit = 0.0
    facing = 0.0
    y, x = divmod(np.int64(picture.points.pixels[m]), width)
    for i in range(9):
        n = number_at(picture.rows, y + i // 3 - 1, x + i % 3 - 1)
        if n >= 0 and seen[n] != NO_LOBE:
            lit = lit + (seen[n] == LOBE_SEEN)
            facing = facing + 1.0
    return lit / facing


@kernel(types.void(SHADOW_POINTS, LAMPS, PART, types.boolean, SEEN_ROWS, types.float32[:, ::1]))
def light_points(picture, lamps, part, smooth, seen, lit):
    """Fill ``lit`` (m, 4) of a ``part`` of the points: E/π straight from directional ``lamps``,
    linear RGB, and the variance of its luminance.

    Counts the lobes that points have ``seen`` (lobes, m) whole; ``add_halves`` adds those seen in
    part, and all of the variance. If ``smooth``, edges of shadows are blurred over 3 × 3 pixels,
    for views that move, which cast no rays to rims.
    """
    lit[part[0] : part[1]] = 0.0
    for k in range(seen.shape[0]):
        colour = row(lamps.colours, k)
        s = radius(lamps, k)
        for m in range(part[0], part[1]):
            if seen[k, m] == NO_LOBE or (seen[k, m] == LOBE_HIDDEN and not smooth):
                continue
            # Take the share of lit points around, or all of the lobe's light if this point sees it.
            if smooth:
                share = share_around(picture, m, seen[k])
            elif seen[k, m] == LOBE_SEEN:
                share = 1.0
            else:
                share = 0.0
            if share > 0.0:
                add_lobe_light(
                    lit,
                    m,
                    colour,
                    share * irradiance(cosine_of(picture.points, lamps, k, m), s),
                    0.0,
                )


@kernel(types.void(LAMPS, PAIR_ARRAY, SHARE_ROWS, types.float32[:, ::1]))
def add_halves(lamps, pairs, shares, lit):
    """Add the light of lobes that points see in part to ``lit`` (m, 4), by the ``shares``
    (pairs, 2) of ``share_rays``.
    """
    for j in range(pairs.shape[0]):
        k, m = divmod(pairs[j], lit.shape[0])
        add_lobe_light(lit, m, row(lamps.colours, k), shares[j, 0], shares[j, 1])


@kernel(types.void(PIXEL_ARRAY, types.float32[:, ::1], types.float64, FRAMEBUFFER))
def add_lobes(pixels, lit, unit, framebuffer):
    """Add the light ``lit`` (m, 4) of lobes, which is in ``unit``, to the ``framebuffer`` at the
    ``pixels`` (m,).

    The relative error of a pixel becomes that of both lights together; a provisional pixel keeps an
    error of 1.
    """
    radiance = framebuffer.radiance
    for m in range(pixels.shape[0]):
        p = pixels[m]
        r, g, b = radiance[p, 0] / unit, radiance[p, 1] / unit, radiance[p, 2] / unit
        # Convert the relative error to a standard error, add the variances, and convert back.
        noise = framebuffer.error[p] * luminance(r, g, b)
        r, g, b = r + lit[m, 0], g + lit[m, 1], b + lit[m, 2]
        error = min(math.sqrt(noise * noise + lit[m, 3]) / max(luminance(r, g, b), MIN_LIGHT), 1.0)
        if framebuffer.state[p] == PROVISIONAL:
            error = 1.0
        put_pixel(framebuffer, p, (r * unit, g * unit, b * unit), framebuffer.state[p], error)
