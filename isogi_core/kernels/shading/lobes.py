"""Light that comes straight from lobes: small far lights, each seen along shadow rays from a
picture's own points.

A lobe is a directional lamp. Few rays find where its shadows have their edges: one to its middle
from every fourth pixel of every fourth row, and from the others where those around disagree. Where
the answers change from pixel to pixel, rays to the lobe's rim find points that see all of it, or
nothing, and whose light is known. Pixels whose rays disagree are in the half-shadow: from these it
is followed by every fourth pixel, as far as it goes, then filled between pixels that are in it, and
its ends are sought pixel by pixel. In the half-shadow more rays are drawn, fewer the more
neighbours share theirs (interleaved sampling: Keller and Heidrich 2001): those opposite each other,
whose mean is right for all that changes evenly. A point that a lobe only grazes gets so little of
it that the ray to its middle is enough.

Where shadow rays start, who is asked when, and whom a point believes, no light changes:
``ShadowPoints`` have it.
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
"""Rays to the rim of a lobe: at ends of diameters that cross, turned by another angle for each
pixel.
"""

PENUMBRA_RAYS = (16, 8, 8, 4, 4)
"""Rays to a lobe from a point in its half-shadow, by how many pairs of neighbours share theirs with
it; powers of two.
"""

NEIGHBOUR_AXES = ((0, 1, 2.0), (1, 0, 2.0), (1, 1, 1.0), (1, -1, 1.0))
"""Steps along y and x to the two neighbours of a pair, on either side, and what each counts beside
OWN.
"""

POINT_WEIGHT = 4.0
"""What a point's own rays count: with all four pairs the mean is binomial along x and y."""

SHARP_SINE = math.sin(math.radians(0.25))
"""Lobes whose half angle has at most this sine are seen along one ray."""

STRATIFIED_VARIANCE = {4: 0.5, 8: 0.35, 16: 0.25}
"""Variance of the mean of stratified rays over the variance of as many random rays, where they see
a part of a lobe.

0.18 behind straight edges at any distance from its middle, by 16 rays, which leave an error of 4.3
% of its light; what rays to the rim miss of them, a tenth of all half-shadow at its ends, is
another 0.9 %. It falls as the root of rays.
"""

GRAZING_SHARE = 0.03
"""What a lobe brings at most, over what it would from straight above, where its half-shadows are
not looked for.
"""

NO_LOBE, LOBE_HIDDEN, LOBE_SEEN, LOBE_HALF_SEEN, LOBE_UNASKED = range(5)
"""What a point sees of what is above its horizon of a lobe: none is there; nothing; all; a part;
not known yet.
"""

SEEN_ROWS = types.uint8[:, ::1]
PAIR_ARRAY = types.int64[::1]
SIDE_CODES = types.uint8[::1]
SHARE_ROWS = types.float64[:, ::1]
"""Lobes and points that go together: number of the lobe times the points, plus that of the point.
Of which NEIGHBOUR_AXES neighbours share their rays with each, a bit for each; and how much of the
lobe the point sees, with its variance.
"""


@kernel()
def radius(lamps, k):
    """The sine of the half angle of lobe ``k``; 0 for one that is seen along one ray."""
    sine = length(row(lamps.edges[k], 0))
    return sine if sine > SHARP_SINE else 0.0


@kernel()
def cosine_of(points, lamps, k, m):
    """The cosine at point ``m`` of the direction to the middle of lobe ``k``."""
    return dot(point_of(points.normals, m), row(lamps.places, k))


@kernel()
def irradiance(cosine, s):
    """E of a lobe whose half angle has the sine ``s`` over that from straight above, where only the
    horizon hides it.

    The mean cosine over a flat disc of radius s whose middle has the ``cosine`` x s, what is below
    the horizon being 0: s/π (x (π/2 + x √(1 - x²) + asin x) + 2/3 (1 - x²)^1.5), and x s for a disc
    that is all above.
    """
    if cosine >= s:
        return cosine
    x = max(cosine / s, -1.0)
    root = math.sqrt(1.0 - x * x)
    return s / math.pi * (x * (0.5 * math.pi + x * root + math.asin(x)) + 2.0 / 3.0 * root**3)


@kernel()
def agreed(around, m, seen):
    """What the neighbours ``around`` point ``m`` all have ``seen`` (m,) of a lobe, LOBE_HIDDEN or
    LOBE_SEEN; else UNKNOWN.
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
    """Fill what points have ``seen`` (lobes, m) of lobes' middles: NO_LOBE by their normals,
    LOBE_HIDDEN or LOBE_SEEN.

    The points are a ``part`` of the ``order``, all of one turn. They see what all ``around`` them
    do; from the others rays go to the middle of what is above their horizon.
    """
    most = (part[1] - part[0]) * seen.shape[0]
    owners = np.empty(most, np.int64)
    lobes = np.empty(most, np.int64)
    ways = np.empty((3, most))
    count = 0
    for k in range(seen.shape[0]):
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
                put_column(ways, count, madd(towards, 0.5 * max(s - cosine, 0.0), n))
                count += 1
    reached = np.empty(count, np.bool_)
    find_unoccluded(surface, picture.starts, owners[:count], ways[:, :count], reached)
    for i in range(count):
        seen[lobes[i], owners[i]] = LOBE_SEEN if reached[i] else LOBE_HIDDEN


@kernel()
def is_seen(seen, m, what):
    """Whether there is a point ``m``, and it has ``seen`` (m,) that."""
    return m >= 0 and seen[m] == what


@kernel()
def may_be_half(points, lamps, k, m, seen):
    """Whether point ``m`` may see a part of lobe ``k`` that is worth more rays."""
    known = seen[k, m] == LOBE_HIDDEN or seen[k, m] == LOBE_SEEN
    s = radius(lamps, k)
    return known and s > 0.0 and irradiance(cosine_of(points, lamps, k, m), s) > GRAZING_SHARE


@kernel(types.void(SHADOW_POINTS, LAMPS, PART, SEEN_ROWS, SEEN_ROWS))
def mark_edges(picture, lamps, part, seen, asked):
    """Set ``asked`` (lobes, m) for points of a ``part`` whose rim rays are to be cast: those at
    edges of shadows, and ``edgy`` ones.
    """
    width = picture.rows.shape[1]
    for m in range(part[0], part[1]):
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
        a, b, c, d = neighbours(picture.rows, y, x, 0, 1)
        for k in range(seen.shape[0]):
            other = LOBE_SEEN + LOBE_HIDDEN - seen[k, m]
            sees = seen[k]
            edge = picture.edgy[m] or is_seen(sees, a, other) or is_seen(sees, b, other)
            edge = edge or is_seen(sees, c, other) or is_seen(sees, d, other)
            asked[k, m] = edge and may_be_half(picture.points, lamps, k, m, seen)


@kernel()
def halves_around(picture, m, seen):
    """How many of the four neighbours that point ``m`` believes have ``seen`` (m,) a lobe in
    part.
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
    """Find pairs about those in the half-shadow, ``halves``, that are not ``asked`` yet, and mark
    them.

    They are of a ``turn``, or of ANY_TURN, and nearest to a pixel at its step; after the first turn
    amid two in the half-shadow at least. Those amid four are in it, too, and need no rays: they are
    written to the end of ``more``, the others to its beginning. It has room for 8 times the
    ``halves``. Returns how many are to be asked, and where the others begin.
    """
    points = seen.shape[1]
    width = picture.rows.shape[1]
    step = step_of(turn)
    count = 0
    last = more.shape[0]
    for pair in halves:
        k, m = divmod(pair, points)
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
        if 0 < turn <= turn_of(x, y):
            continue  # none of that turn believes it
        for above in range(step * ((y - 1) // step), y + step + 1, step):
            for aside in range(step * ((x - 1) // step), x + step + 1, step):
                n = number_at(picture.rows, above, aside)
                if n < 0 or asked[k, n] or (turn != ANY_TURN and turn_of(aside, above) != turn):
                    continue
                amid = halves_around(picture, n, seen[k])
                if (turn > 0 and amid < 2) or not may_be_half(picture.points, lamps, k, n, seen):
                    continue
                asked[k, n] = 1
                if amid == 4:
                    seen[k, n] = LOBE_HALF_SEEN
                    last -= 1
                    more[last] = k * points + n
                else:
                    more[count] = k * points + n
                    count += 1
    return count, last


@kernel()
def rim_way(lamps, k, turn):
    """World direction to the rim of lamp ``k``, ``turn`` radians about its axis."""
    across = madd(
        scale(row(lamps.edges[k], 0), math.cos(turn)), math.sin(turn), row(lamps.edges[k], 1)
    )
    return madd(across, math.sqrt(max(1.0 - dot(across, across), 0.0)), row(lamps.places, k))


@kernel(types.void(SURFACE, SHADOW_POINTS, LAMPS, PAIR_ARRAY, SIDE_CODES))
def see_rims(surface, picture, lamps, pairs, sees):
    """Fill what points and lobes of ``pairs`` see of each other by their rims, ``sees`` (pairs,):
    LOBE_HIDDEN, LOBE_SEEN or LOBE_HALF_SEEN.

    Of RIM_RAYS rays none is cast from below a point's own surface: it would end there.
    """
    points = picture.points
    most = RIM_RAYS * pairs.shape[0]
    count = 0
    owners = np.empty(most, np.int64)
    asking = np.empty(most, np.int64)
    ways = np.empty((3, most))
    for j in range(pairs.shape[0]):
        k, m = divmod(pairs[j], points.pixels.shape[0])
        first = 0.5 * math.pi * point_2d(mix(np.int64(points.pixels[m]), LOBES_STREAM), 0, k)[0]
        for i in range(RIM_RAYS):
            w = rim_way(lamps, k, first + 2.0 * math.pi * i / RIM_RAYS)
            if dot(point_of(points.normals, m), w) > 0.0:
                owners[count] = m
                asking[count] = j
                put_column(ways, count, w)
                count += 1
    reached = np.empty(count, np.bool_)
    find_unoccluded(surface, picture.starts, owners[:count], ways[:, :count], reached)
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
    """The numbers of the two points beside point ``m`` along one of the NEIGHBOUR_AXES."""
    y, x = divmod(np.int64(picture.points.pixels[m]), picture.rows.shape[1])
    dy, dx, _ = NEIGHBOUR_AXES[axis]
    return number_at(picture.rows, y - dy, x - dx), number_at(picture.rows, y + dy, x + dx)


@kernel(types.void(SHADOW_POINTS, PAIR_ARRAY, SEEN_ROWS, SIDE_CODES))
def find_sides(picture, pairs, seen, sides):
    """Fill ``sides`` (pairs,): along which axes both neighbours are in the half-shadow, too, on one
    smooth surface.
    """
    for j in range(pairs.shape[0]):
        k, m = divmod(pairs[j], seen.shape[1])
        sides[j] = 0
        for axis in range(len(NEIGHBOUR_AXES)):
            a, b = opposite(picture, m, axis)
            both = is_seen(seen[k], a, LOBE_HALF_SEEN) and is_seen(seen[k], b, LOBE_HALF_SEEN)
            if both and near_between(picture.points.points, m, a, b):
                sides[j] |= 1 << axis


@kernel(
    types.void(SURFACE, SHADOW_POINTS, LAMPS, PAIR_ARRAY, types.int64, types.float64, SHARE_ROWS)
)
def see_discs(surface, picture, lamps, pairs, rays, even, shares):
    """Fill ``shares`` (pairs, 2): E/π from lobes by a number of ``rays`` of each of the ``pairs``,
    and its variance.

    It is that over E/π of the lobe from straight above, were all of it there; the rays are spread
    as EVEN says.
    """
    points = picture.points
    count = rays * pairs.shape[0]
    owners = np.empty(count, np.int64)
    ways = np.empty((3, count))
    brought = np.empty(count)
    for i in range(count):
        k, m = divmod(pairs[i // rays], points.pixels.shape[0])
        u, v = point_2d(mix(np.int64(points.pixels[m]), LOBES_STREAM), i % rays, k)
        w, cosine = draw_from_disc(row(lamps.places, k), lamps.edges[k], u, v)
        owners[i] = m
        brought[i] = max(dot(point_of(points.normals, m), w), 0.0) / cosine
        put_column(ways, i, w)
    reached = np.empty(count, np.bool_)
    find_unoccluded(surface, picture.starts, owners, ways, reached)
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
def share_rays(picture, lamps, pairs, sides, places, own, part, shares):
    """Fill ``shares`` (pairs, 2) of a ``part`` of the ``pairs`` by their rays and by rays that
    neighbours share.

    The part is of one lobe, whose points have their ``places`` (m,) among the pairs. ``own``
    (pairs, 2) are the shares by each pair's own rays. What is shared is how much of what is above a
    point's horizon it sees.
    """
    for j in range(part[0], part[1]):
        k, m = divmod(pairs[j], places.shape[0])
        mean = POINT_WEIGHT * own[j, 0]
        variance = POINT_WEIGHT * POINT_WEIGHT * own[j, 1]
        total = POINT_WEIGHT
        bare = irradiance(cosine_of(picture.points, lamps, k, m), radius(lamps, k))
        for axis in range(len(NEIGHBOUR_AXES)):
            if not sides[j] >> axis & 1:
                continue
            for n in opposite(picture, m, axis):
                above = bare / irradiance(cosine_of(picture.points, lamps, k, n), radius(lamps, k))
                weight = NEIGHBOUR_AXES[axis][2]
                i = places[n]
                total = total + weight
                mean = mean + weight * above * own[i, 0]
                variance += (weight * above) ** 2 * own[i, 1]
        shares[j, 0] = mean / total
        shares[j, 1] = variance / total**2


@kernel()
def add_lobe_light(lit, m, colour, share, variance):
    """Add a ``share`` of the light ``colour``, whose ``variance`` is known, to point ``m``."""
    for c in range(3):
        lit[m, c] += share * colour[c]
    lit[m, 3] += (
        variance
        * (RED_LUMINANCE * colour[0] + GREEN_LUMINANCE * colour[1] + BLUE_LUMINANCE * colour[2])
        ** 2
    )


@kernel()
def share_around(picture, m, seen):
    """The share of points in the nine pixels about point ``m`` that have ``seen`` (m,) a lobe, of
    those facing it.
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
    """Fill ``lit`` (m, 4): E/π, linear RGB, straight from directional ``lamps``, and the variance
    of its luminance.

    It is of points of a ``part``, of lobes that these have ``seen`` (lobes, m) whole; with edges of
    shadows that are made ``smooth``, where no rays to rims tell more. The variance is of
    half-shadows, see ``add_halves``.
    """
    lit[part[0] : part[1]] = 0.0
    for k in range(seen.shape[0]):
        colour = row(lamps.colours, k)
        s = radius(lamps, k)
        for m in range(part[0], part[1]):
            if seen[k, m] == NO_LOBE or (seen[k, m] == LOBE_HIDDEN and not smooth):
                continue
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
    """Add the ``shares`` (pairs, 2) of lobes that points see in part to their light; see
    ``frame.rays.lobe_light``.
    """
    for j in range(pairs.shape[0]):
        k, m = divmod(pairs[j], lit.shape[0])
        add_lobe_light(lit, m, row(lamps.colours, k), shares[j, 0], shares[j, 1])


@kernel(types.void(PIXEL_ARRAY, types.float32[:, ::1], types.float64, FRAMEBUFFER))
def add_lobes(pixels, lit, unit, framebuffer):
    """Add light of lobes, as ``light_points`` has it and in ``unit``, to the ``framebuffer`` at the
    ``pixels`` (m,).

    Errors are then of both, but where nothing is known of the one.
    """
    radiance = framebuffer.radiance
    for m in range(pixels.shape[0]):
        p = pixels[m]
        r, g, b = radiance[p, 0] / unit, radiance[p, 1] / unit, radiance[p, 2] / unit
        noise = framebuffer.error[p] * luminance(r, g, b)
        r, g, b = r + lit[m, 0], g + lit[m, 1], b + lit[m, 2]
        error = min(math.sqrt(noise * noise + lit[m, 3]) / max(luminance(r, g, b), MIN_LIGHT), 1.0)
        if framebuffer.state[p] == PROVISIONAL:
            error = 1.0
        put_pixel(framebuffer, p, (r * unit, g * unit, b * unit), framebuffer.state[p], error)
