"""Light that comes straight from lobes: small far lights, each seen along shadow rays from a picture's own points.

A lobe is a directional lamp. Rays to its rim tell first whether a point sees all of it or nothing, of which the light
is known; where they disagree, in the half-shadow, more rays are drawn.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
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
from isogi_core.kernels.tracing.vec import dot, madd, put_column, scale
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


@kernel()
def rim_way(lamps, k, turn):
    """World direction to the rim of lamp ``k``, ``turn`` radians about its axis."""
    across = madd(scale(row(lamps.edges[k], 0), math.cos(turn)), math.sin(turn), row(lamps.edges[k], 1))
    return madd(across, math.sqrt(max(1.0 - dot(across, across), 0.0)), row(lamps.places, k))


@kernel()
def aim_at_rim(lamps, k, points, rim, owners, ways):
    """Write the ``rim`` rays of each point that its own surface does not block; returns how many there are."""
    count = 0
    for m in range(points.pixels.shape[0]):
        first = 0.5 * math.pi * point_2d(mix(np.int64(points.pixels[m]), STREAM), 0, k)[0]
        for i in range(rim):
            w = row(lamps.places, k) if rim == 1 else rim_way(lamps, k, first + 2.0 * math.pi * i / rim)
            if dot(point_of(points.normals, m), w) > 0.0:
                owners[count] = m
                put_column(ways, count, w)
                count += 1
    return count


@kernel()
def see_rim(surface, points, lamps, k, rim):
    """How many of the ``rim`` rays of each point get away, (m,) int64."""
    n = points.pixels.shape[0]
    owners, ways, reached = np.empty(rim * n, np.int64), np.empty((3, rim * n)), np.empty(rim * n, np.bool_)
    count = aim_at_rim(lamps, k, points, rim, owners, ways)
    find_unoccluded(surface, points, owners[:count], ways, reached)
    seen = np.zeros(n, np.int64)
    for i in range(count):
        seen[owners[i]] += reached[i]
    return seen


@kernel()
def aim_at_disc(lamps, k, points, owners, ways, shares):
    """Write RAYS rays from each of the points ``owners`` to a lamp's disc, and the shares of its light they bring."""
    for i in range(RAYS * owners.shape[0]):
        m = owners[i // RAYS]
        u, v = point_2d(mix(np.int64(points.pixels[m]), STREAM), i % RAYS, k)
        w, cosine = draw_from_disc(row(lamps.places, k), lamps.edges[k], u, v)
        put_column(ways, i, w)
        shares[i] = max(dot(point_of(points.normals, m), w), 0.0) / cosine


@kernel()
def add_light(lit, m, colour, share, variance):
    """Add a ``share`` of the light ``colour``, whose ``variance`` is known, to point ``m``."""
    for c in range(3):
        lit[m, c] += share * colour[c]
    lit[m, 3] += variance * (RED * colour[0] + GREEN * colour[1] + BLUE * colour[2]) ** 2


@kernel()
def light_half_shadow(surface, points, lamps, k, owners, lit):
    """Add what comes from lamp ``k`` to the points ``owners``, by RAYS rays from each, with its variance."""
    count = RAYS * owners.shape[0]
    ways, shares, reached = np.empty((3, count)), np.empty(count), np.empty(count, np.bool_)
    aim_at_disc(lamps, k, points, owners, ways, shares)
    find_unoccluded(surface, points, np.repeat(owners, RAYS), ways, reached)
    for i in range(owners.shape[0]):
        mine = slice(RAYS * i, RAYS * (i + 1))
        brought = shares[mine] * reached[mine]
        add_light(lit, owners[i], row(lamps.colours, k), brought.mean(), EVEN * brought.var() / (RAYS - 1))


@kernel(types.void(SURFACE, PIXEL_POINTS, LAMPS, types.float32[:, ::1]))
def light_lobes(surface, points, lamps, lit):
    """Fill ``lit`` (m, 4): E/π, linear RGB, straight from directional ``lamps``, and the variance of its luminance.

    ``points`` are ``PixelPoints``, whose pixels own the random numbers. Rays start where paths do. The variance is of
    the half-shadows' rays.
    """
    lit[:] = 0.0
    for k in range(lamps.kinds.shape[0]):
        edge = row(lamps.edges[k], 0)
        rim = 1 if dot(edge, edge) <= SHARP * SHARP else RIM
        seen = see_rim(surface, points, lamps, k, rim)
        for m in np.flatnonzero(seen == rim):
            share = max(dot(point_of(points.normals, m), row(lamps.places, k)), 0.0)
            add_light(lit, m, row(lamps.colours, k), share, 0.0)
        half = np.flatnonzero((seen > 0) & (seen < rim))
        if half.shape[0] > 0:
            light_half_shadow(surface, points, lamps, k, half, lit)


@kernel(types.void(PIXELS, types.float32[:, ::1], types.float64, FRAMEBUFFER))
def add_lobes(pixels, lit, unit, framebuffer):
    """Add the light of lobes, as ``light_lobes`` has it and in ``unit``, to the ``framebuffer`` at the ``pixels`` (m,).

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
