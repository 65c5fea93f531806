"""Light that comes straight from lobes: small far lights, each seen along shadow rays from a picture's own points.

A lobe is a directional lamp. Few rays find where its shadows have their edges: one to its middle from every fourth
pixel of every fourth row, and from the others where those around disagree. Where the answers change from pixel to
pixel, rays to the lobe's rim tell what sees all of it, or nothing, of which the light is known; about pixels in the
half-shadow, whose rim rays disagree, all neighbours are asked too. In the half-shadow more rays are drawn. A point
that a lobe only grazes gets so little of it that the ray to its middle is enough.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.shading.framebuffer import (
    BLUE,
    FRAMEBUFFER,
    GREEN,
    PIXEL_POINTS,
    PIXELS,
    PROVISIONAL,
    RED,
    luminance,
    point_of,
    put_pixel,
)
from isogi_core.kernels.shading.lattice import DARKEST
from isogi_core.kernels.shading.local_models import find_unoccluded
from isogi_core.kernels.tracing.cast import SURFACE
from isogi_core.kernels.tracing.vec import add, dot, length, madd, put_column, scale, sub
from isogi_core.kernels.transport.lights import LAMPS, draw_from_disc, row
from isogi_core.kernels.transport.rng import mix, point_2d

RIM = 4
"""Rays to the rim of a lobe: at ends of diameters that cross, turned anew for each pixel."""

RAYS = 16
"""Rays to a lobe from a point in its half-shadow, a power of two."""

SHARP = math.sin(math.radians(0.25))
"""Lobes whose half angle has at most this sine are seen along one ray."""

STREAM = 1 << 24
"""Where the random numbers of lobes begin: paths from the same pixels have others."""

EVEN = 0.25
"""Variance of the mean of RAYS stratified rays over that of as many random ones, where they see more or less of a lobe.

0.18 behind straight edges at any distance from its middle, which leave an error of 4.3 % of its light; what rays to
the rim miss of them, a tenth of all half-shadow at its ends, is another 0.9 %.
"""

BENT = 0.25
"""How far a point may be from the middle of two neighbours, over their distance, for what these see to hold for it."""

GRAZING = 0.03
"""What a lobe brings at most, over what it would from straight above, where its half-shadows are not looked for."""

APART = 4.0
"""Voxels between two neighbours, at most, that are four pixels apart and believed: surfaces hide nothing smaller."""

AWAY, DARK, LIT, HALF, UNKNOWN = range(5)
"""What a point sees of what is above its horizon of a lobe: none is there; nothing; all; a part; not known yet."""

TURNS = 5
"""Turns in which pixels are asked, each of them amid four of the turns before."""

SEEN = types.uint8[:, ::1]
PART = types.UniTuple(types.int64, 2)
PAIRS = types.int64[::1]
"""Lobes and points that go together: number of the lobe times the points, plus that of the point."""

AROUND = types.int32[:, ::1]


class Aimed(NamedTuple):
    """Shadow rays: the points that they start from, ``owners`` (n,), directions ``ways`` (3, n), and ``pairs`` (n,)."""

    owners: Any
    pairs: Any
    ways: Any


AIMED = record(Aimed, types.int64[::1], types.int64[::1], types.float64[:, ::1])


class Pixels(NamedTuple):
    """All surface points of a picture: ``points`` are ``PixelPoints``, ``rows`` (h, w) their numbers, -1 where none."""

    points: Any
    rows: Any


PICTURE = record(Pixels, PIXEL_POINTS, types.int32[:, ::1])


@kernel()
def radius(lamps, k):
    """The sine of the half angle of lobe ``k``; 0 for one that is seen along one ray."""
    sine = length(row(lamps.edges[k], 0))
    return sine if sine > SHARP else 0.0


@kernel()
def cosine_of(points, lamps, k, m):
    """The cosine at point ``m`` of the direction to the middle of lobe ``k``."""
    return dot(point_of(points.normals, m), row(lamps.places, k))


@kernel()
def irradiance(points, lamps, k, m):
    """E of lobe ``k`` at point ``m`` over that from straight above, where nothing but the horizon hides it.

    The mean cosine over a flat disc of radius s whose middle has the cosine x s, what is below the horizon being 0:
    s/π (x (π/2 + x √(1 - x²) + asin x) + 2/3 (1 - x²)^1.5), and x s for a disc that is all above.
    """
    cosine, s = cosine_of(points, lamps, k, m), radius(lamps, k)
    if cosine >= s:
        return cosine
    x = max(cosine / s, -1.0)
    root = math.sqrt(1.0 - x * x)
    return s / math.pi * (x * (0.5 * math.pi + x * root + math.asin(x)) + 2.0 / 3.0 * root**3)


@kernel(types.void(PIXEL_POINTS, LAMPS, PART, SEEN))
def face_lobes(points, lamps, part, seen):
    """Begin with what points of a ``part`` have ``seen`` (lobes, m): AWAY or UNKNOWN, by their normals."""
    for k in range(seen.shape[0]):
        for m in range(part[0], part[1]):
            seen[k, m] = AWAY if cosine_of(points, lamps, k, m) <= -radius(lamps, k) else UNKNOWN


@kernel()
def row_at(rows, y, x):
    """The number of the point in a pixel, -1 where there is none or the picture ends."""
    inside = 0 <= y < rows.shape[0] and 0 <= x < rows.shape[1]
    return np.int64(rows[y, x]) if inside else -1


@kernel()
def turn_of(x, y):
    """When a pixel is asked: 0 where 4 divides x and y; the last two turns amid next neighbours, others two apart."""
    if (x | y) & 1:
        return 3 if x & y & 1 else 4
    return 2 if (x + y) & 2 else (x & 2) // 2


@kernel()
def between(points, m, a, b):
    """Whether point ``m`` is in the middle of its neighbours ``a`` and ``b``, as on one smooth surface."""
    if a < 0 or b < 0:
        return False
    p, q = point_of(points, a), point_of(points, b)
    bend = sub(scale(add(p, q), 0.5), point_of(points, m))
    return length(bend) <= BENT * length(sub(p, q))


@kernel()
def apart(points, a, b):
    """How far points ``a`` and ``b`` are from each other, in index space."""
    return length(sub(point_of(points, a), point_of(points, b)))


@kernel(types.void(PICTURE, PART, AROUND))
def find_around(picture, part, around):
    """Fill ``around`` (m, 4): the neighbours that are asked before a point, first -1 where one is not of its surface.

    They are the diagonal ones of a point of an odd turn, and those beside, above and below it of an even one.
    """
    rows, points, width = picture.rows, picture.points, picture.rows.shape[1]
    for m in range(part[0], part[1]):
        y, x = divmod(np.int64(points.pixels[m]), width)
        turn = turn_of(x, y)
        step = 2 if turn < 3 else 1
        aside = step * (turn & 1)
        a, b = row_at(rows, y - aside, x - step), row_at(rows, y + aside, x + step)
        c, d = row_at(rows, y - step, x + aside), row_at(rows, y + step, x - aside)
        smooth = turn > 0 and between(points.points, m, a, b) and between(points.points, m, c, d)
        if smooth and step > 1:
            smooth = max(apart(points.points, a, b), apart(points.points, c, d)) <= APART
        around[m, 0], around[m, 1], around[m, 2], around[m, 3] = a if smooth else -1, b, c, d


@kernel()
def agreed(around, m, seen):
    """What the neighbours ``around`` point ``m`` all have ``seen`` (m,) of a lobe, DARK or LIT; else UNKNOWN."""
    if around[m, 0] < 0:
        return UNKNOWN
    found = seen[around[m, 0]]
    same = found == seen[around[m, 1]] and found == seen[around[m, 2]] and found == seen[around[m, 3]]
    return found if same and (found == DARK or found == LIT) else UNKNOWN


@kernel(types.void(SURFACE, PIXEL_POINTS, AIMED, types.int64, types.boolean[::1]))
def cast_shadow_rays(surface, points, aimed, count, reached):
    """Fill ``reached`` (count,): whether the first ``count`` of the rays that are ``aimed`` get away."""
    find_unoccluded(surface, points, aimed.owners[:count], aimed.ways[:, :count], reached)


@kernel(types.int64(PICTURE, PART, types.int64, AROUND, SEEN))
def believe(picture, part, turn, around, seen):
    """Have points of a ``part`` and a ``turn`` see what all ``around`` them do; how many pairs are UNKNOWN still."""
    width, unknown = picture.rows.shape[1], 0
    for m in range(part[0], part[1]):
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
        if turn_of(x, y) != turn:
            continue
        for k in range(seen.shape[0]):
            if seen[k, m] == UNKNOWN and turn > 0:
                seen[k, m] = agreed(around, m, seen[k])
            unknown += seen[k, m] == UNKNOWN
    return unknown


@kernel(types.void(PICTURE, LAMPS, PART, types.int64, SEEN, AIMED))
def aim_at_middles(picture, lamps, part, turn, seen, aimed):
    """Aim rays from UNKNOWN points of a ``part`` and a ``turn`` to the middles of what is above their horizon."""
    points, width, count = picture.points, picture.rows.shape[1], 0
    for k in range(seen.shape[0]):
        for m in range(part[0], part[1]):
            if seen[k, m] != UNKNOWN:
                continue
            y, x = divmod(np.int64(points.pixels[m]), width)
            if turn_of(x, y) == turn:
                below = max(radius(lamps, k) - cosine_of(points, lamps, k, m), 0.0)
                aimed.owners[count], aimed.pairs[count] = m, k * seen.shape[1] + m
                put_column(aimed.ways, count, madd(row(lamps.places, k), 0.5 * below, point_of(points.normals, m)))
                count += 1


@kernel()
def may_be_half(points, lamps, k, m, seen):
    """Whether point ``m`` may see a part of lobe ``k`` that is worth more rays."""
    known = seen[k, m] == DARK or seen[k, m] == LIT
    return known and radius(lamps, k) > 0.0 and irradiance(points, lamps, k, m) > GRAZING


@kernel(types.void(PICTURE, LAMPS, PART, SEEN, SEEN))
def mark_edges(picture, lamps, part, seen, asked):
    """Set ``asked`` (lobes, m) for points of a ``part`` whose rim rays are to be cast.

    These are at edges of shadows, and at edges of the surface, behind which such may begin.
    """
    points, rows, width = picture.points.points, picture.rows, picture.rows.shape[1]
    for m in range(part[0], part[1]):
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
        a, b, c, d = row_at(rows, y, x - 1), row_at(rows, y, x + 1), row_at(rows, y - 1, x), row_at(rows, y + 1, x)
        smooth = between(points, m, a, b) and between(points, m, c, d)
        for k in range(seen.shape[0]):
            other = LIT + DARK - seen[k, m]
            edge = not smooth or seen[k, a] == other or seen[k, b] == other
            edge = edge or seen[k, c] == other or seen[k, d] == other
            asked[k, m] = edge and may_be_half(picture.points, lamps, k, m, seen)


@kernel(types.int64(PICTURE, LAMPS, PAIRS, SEEN, SEEN, PAIRS))
def spread_edges(picture, lamps, halves, seen, asked, more):
    """Write to ``more`` the pairs about those in the half-shadow that are not asked yet, and mark them as ``asked``.

    Returns how many there are, 8 times the ``halves`` at most.
    """
    points, width, count = seen.shape[1], picture.rows.shape[1], 0
    for pair in halves:
        k, m = divmod(pair, points)
        y, x = divmod(np.int64(picture.points.pixels[m]), width)
        for i in range(9):
            n = row_at(picture.rows, y + i // 3 - 1, x + i % 3 - 1)
            if n >= 0 and not asked[k, n] and may_be_half(picture.points, lamps, k, n, seen):
                asked[k, n] = 1
                more[count] = k * points + n
                count += 1
    return count


@kernel()
def rim_way(lamps, k, turn):
    """World direction to the rim of lamp ``k``, ``turn`` radians about its axis."""
    across = madd(scale(row(lamps.edges[k], 0), math.cos(turn)), math.sin(turn), row(lamps.edges[k], 1))
    return madd(across, math.sqrt(max(1.0 - dot(across, across), 0.0)), row(lamps.places, k))


@kernel(types.int64(PIXEL_POINTS, LAMPS, PAIRS, AIMED))
def aim_at_rims(points, lamps, pairs, aimed):
    """Aim RIM rays to the lobes of ``pairs``, but none from below a point's own surface; how many.

    They are ``aimed`` with the place of their pair in place of its number. There is room for all.
    """
    count = 0
    for j in range(pairs.shape[0]):
        k, m = divmod(pairs[j], points.pixels.shape[0])
        first = 0.5 * math.pi * point_2d(mix(np.int64(points.pixels[m]), STREAM), 0, k)[0]
        for i in range(RIM):
            w = rim_way(lamps, k, first + 2.0 * math.pi * i / RIM)
            if dot(point_of(points.normals, m), w) > 0.0:
                aimed.owners[count], aimed.pairs[count] = m, j
                put_column(aimed.ways, count, w)
                count += 1
    return count


@kernel(types.void(PIXEL_POINTS, LAMPS, PAIRS, AIMED, types.float64[::1]))
def aim_at_discs(points, lamps, pairs, aimed, brought):
    """Aim RAYS rays to the discs of the lobes of ``pairs``; what each brings where it gets away.

    That is E/π over that of the lobe from straight above, were all of it there.
    """
    for i in range(RAYS * pairs.shape[0]):
        k, m = divmod(pairs[i // RAYS], points.pixels.shape[0])
        u, v = point_2d(mix(np.int64(points.pixels[m]), STREAM), i % RAYS, k)
        w, cosine = draw_from_disc(row(lamps.places, k), lamps.edges[k], u, v)
        aimed.owners[i], brought[i] = m, max(dot(point_of(points.normals, m), w), 0.0) / cosine
        put_column(aimed.ways, i, w)


@kernel()
def add_light(lit, m, colour, share, variance):
    """Add a ``share`` of the light ``colour``, whose ``variance`` is known, to point ``m``."""
    for c in range(3):
        lit[m, c] += share * colour[c]
    lit[m, 3] += variance * (RED * colour[0] + GREEN * colour[1] + BLUE * colour[2]) ** 2


@kernel()
def share_around(picture, m, seen):
    """The share of points in the nine pixels about point ``m`` that have ``seen`` (m,) a lobe, of those facing it."""
    width, lit, facing = picture.rows.shape[1], 0.0, 0.0
    y, x = divmod(np.int64(picture.points.pixels[m]), width)
    for i in range(9):
        n = row_at(picture.rows, y + i // 3 - 1, x + i % 3 - 1)
        if n >= 0 and seen[n] != AWAY:
            lit, facing = lit + (seen[n] == LIT), facing + 1.0
    return lit / facing


@kernel(types.void(PICTURE, LAMPS, PART, types.boolean, SEEN, types.float32[:, ::1]))
def light_points(picture, lamps, part, smooth, seen, lit):
    """Fill ``lit`` (m, 4): E/π, linear RGB, straight from directional ``lamps``, and the variance of its luminance.

    It is of points of a ``part``, of lobes that these have ``seen`` (lobes, m) whole; with edges of shadows that are
    made ``smooth``, where no rays to rims tell more. The variance is of half-shadows, see ``add_halves``.
    """
    lit[part[0] : part[1]] = 0.0
    for k in range(seen.shape[0]):
        for m in range(part[0], part[1]):
            if seen[k, m] == AWAY or (seen[k, m] == DARK and not smooth):
                continue
            share = share_around(picture, m, seen[k]) if smooth else 1.0 if seen[k, m] == LIT else 0.0
            if share > 0.0:
                add_light(lit, m, row(lamps.colours, k), share * irradiance(picture.points, lamps, k, m), 0.0)


@kernel(types.void(LAMPS, PAIRS, types.float64[:, ::1], types.float32[:, ::1]))
def add_halves(lamps, pairs, shares, lit):
    """Add the ``shares`` (pairs, 2) of lobes that points see in part to their light; see ``frame.pixel_rays``."""
    for j in range(pairs.shape[0]):
        k, m = divmod(pairs[j], lit.shape[0])
        add_light(lit, m, row(lamps.colours, k), shares[j, 0], shares[j, 1])


@kernel(types.void(PIXELS, types.float32[:, ::1], types.float64, FRAMEBUFFER))
def add_lobes(pixels, lit, unit, framebuffer):
    """Add light of lobes, as ``light_points`` has it and in ``unit``, to the ``framebuffer`` at the ``pixels`` (m,).

    Errors are then of both, but where nothing is known of the one.
    """
    radiance = framebuffer.radiance
    for m in range(pixels.shape[0]):
        p = pixels[m]
        r, g, b = radiance[p, 0] / unit, radiance[p, 1] / unit, radiance[p, 2] / unit
        noise = framebuffer.error[p] * luminance(r, g, b)
        r, g, b = r + lit[m, 0], g + lit[m, 1], b + lit[m, 2]
        error = min(math.sqrt(noise * noise + lit[m, 3]) / max(luminance(r, g, b), DARKEST), 1.0)
        error = 1.0 if framebuffer.state[p] == PROVISIONAL else error
        put_pixel(framebuffer, p, (r * unit, g * unit, b * unit), framebuffer.state[p], error)
