"""Irradiance ratios: texels' light over their unshadowed light, carried to the pixels."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.shading.framebuffer import (
    FINAL,
    FRAMEBUFFER,
    PIXEL_POINTS,
    POINTS,
    PROVISIONAL,
    luminance,
    put_pixel,
)
from isogi_core.kernels.shading.lattice import (
    BURIED,
    CORNERS,
    DARKEST,
    LATTICE,
    PARTIAL,
    UNBAKED,
    VOID,
    base_texel,
    trilinear,
)

LEAST = 0.05
"""Share of the light's mean that unshadowed light is taken to be at least, so that ratios stay small."""

LEAST_COSINE = np.float32(1e-3)
"""Cosine between a texel's normal and a pixel's that weights count with at least: where all face away, all count."""

TURNED = np.float32(0.1055)
"""1 - cosine, of 27°, at which weights have fallen to a fifth; they are a half at 16°."""

NONE, ONE = np.float32(0.0), np.float32(1.0)

RECORD = 8
"""Numbers of a texel, one half of a cache line: three ratios, the error's, the normal, the grade."""


class Unshadowed(NamedTuple):
    """Unshadowed light by the normal.

    ``quadric`` (3, 9) float32, of linear RGB over 1, y, z, x, xy, yz, z², xz, x² - y², and ``least`` (3,) of each
    colour; ``reflected`` (3,) is added to it: what texels hold of lobes, which light them by way of other surfaces.
    """

    quadric: Any
    least: Any
    reflected: Any


UNSHADOWED = record(Unshadowed, types.float32[:, ::1], types.float32[::1], types.float32[::1])


@kernel()
def unshadowed_light(unshadowed, x, y, z):
    """Irradiance over π, linear RGB, of what nothing shadows about the unit normal (x, y, z).

    ``least`` at least, and the ``reflected`` light. Source: Ramamoorthi and Hanrahan 2001, eqs. 11 to 13.
    """
    xy, yz, zz, xz, across = x * y, y * z, z * z, x * z, x * x - y * y
    q, low, more = unshadowed.quadric, unshadowed.least, unshadowed.reflected
    r = q[0, 0] + y * q[0, 1] + z * q[0, 2] + x * q[0, 3]
    g = q[1, 0] + y * q[1, 1] + z * q[1, 2] + x * q[1, 3]
    b = q[2, 0] + y * q[2, 1] + z * q[2, 2] + x * q[2, 3]
    r += xy * q[0, 4] + yz * q[0, 5] + zz * q[0, 6] + xz * q[0, 7] + across * q[0, 8]
    g += xy * q[1, 4] + yz * q[1, 5] + zz * q[1, 6] + xz * q[1, 7] + across * q[1, 8]
    b += xy * q[2, 4] + yz * q[2, 5] + zz * q[2, 6] + xz * q[2, 7] + across * q[2, 8]
    return max(r, low[0]) + more[0], max(g, low[1]) + more[1], max(b, low[2]) + more[2]


@kernel()
def unbaked_light(unshadowed, light):
    """What stands in for light that is not baked, of unshadowed ``light``: all but what is ``reflected``."""
    return light[0] - unshadowed.reflected[0], light[1] - unshadowed.reflected[1], light[2] - unshadowed.reflected[2]


@kernel()
def put_ratio(ratios, t, light, error, over):
    """Write ``light`` and its ``error`` over unshadowed light to texel ``t`` of ``ratios``; 0 where all is dark."""
    ratios[t, 0] = light[0] / max(over[0], DARKEST)
    ratios[t, 1] = light[1] / max(over[1], DARKEST)
    ratios[t, 2] = light[2] / max(over[2], DARKEST)
    ratios[t, 3] = error / max(luminance(over[0], over[1], over[2]), DARKEST)


RATIOS = types.float32[:, ::1]


@kernel(types.void(types.uint8[::1], types.float32[:, ::1], POINTS, UNSHADOWED, RATIOS))
def find_ratios(grade, lit, normals, unshadowed, ratios):
    """Fill ``ratios`` (m, RECORD) of texels with the ``grade`` (m,) and the light ``lit`` (m, 4) of ``light_texels``.

    ``normals`` (m, 3) are those that they are lit about. Of what is not baked unshadowed light stands in; void and
    buried texels have none.
    """
    for t in range(grade.shape[0]):
        x, y, z = normals[t, 0], normals[t, 1], normals[t, 2]
        over = unshadowed_light(unshadowed, x, y, z)
        light, error = (NONE, NONE, NONE), NONE
        if PARTIAL <= grade[t] <= FINAL:
            light, error = (lit[t, 0], lit[t, 1], lit[t, 2]), lit[t, 3]
        elif grade[t] == UNBAKED:
            light = unbaked_light(unshadowed, over)
        put_ratio(ratios, t, light, error, over)
        ratios[t, 4], ratios[t, 5], ratios[t, 6], ratios[t, 7] = x, y, z, np.float32(grade[t])


@kernel()
def agree(ratios, t, x, y, z):
    """What texel ``t`` counts by the cosine c between its normal and (x, y, z): (c / (1 + (1 - c) / TURNED))².

    It falls off slowly, so that where all texels are turned away from a pixel no single one decides: with the 16th
    power of the cosine rims of thin walls err by a sixth more at their 99th percentile. What faces away hardly counts.
    """
    cosine = x * ratios[t, 4] + y * ratios[t, 5] + z * ratios[t, 6]
    weight = max(cosine, LEAST_COSINE) / (ONE + (ONE - cosine) / TURNED)
    return weight * weight


@kernel(inline=True)
def blend_ratios(corners, m, ratios, n, f):
    """Sums over those of point ``m``'s texels that are not void or buried: (r, g, b, variance, weight), float32.

    And the least grade of all eight. Weights are trilinear ones, for fractions ``f`` (z, y, x), times ``agree`` with
    the point's normal ``n``.
    """
    r = g = b = variance = weight = NONE
    least = np.float32(VOID)
    fz, fy, fx = f
    for c in range(8):
        t = corners[m, c]
        grade = ratios[t, 7]
        w = (fz if c & 4 else ONE - fz) * (fy if c & 2 else ONE - fy) * (fx if c & 1 else ONE - fx)
        w *= agree(ratios, t, n[0], n[1], n[2]) if grade <= FINAL else NONE
        noise = w * ratios[t, 3]
        r, g, b, variance = r + w * ratios[t, 0], g + w * ratios[t, 1], b + w * ratios[t, 2], variance + noise * noise
        weight, least = weight + w, min(least, grade)
    return r, g, b, variance, weight, least


@kernel()
def stand_in(corners, m, ratios, unshadowed, under, fz, fy, fx):
    """The share of each colour at point ``m`` where no texel counts: none if any is buried, as if unbaked if not."""
    buried = 0.0
    for c in range(8):
        if ratios[corners[m, c], 7] == BURIED:
            buried += trilinear(c, fz, fy, fx)
    if buried > 0.0:
        return NONE, NONE, NONE
    light = unbaked_light(unshadowed, under)
    return light[0] / max(under[0], DARKEST), light[1] / max(under[1], DARKEST), light[2] / max(under[2], DARKEST)


@kernel(types.void(LATTICE, PIXEL_POINTS, CORNERS, RATIOS, UNSHADOWED, types.float32, FRAMEBUFFER))
def carry_ratios(lattice, points, corners, ratios, unshadowed, unit, framebuffer):
    """Carry texels' ``ratios`` (texels, RECORD) to the ``framebuffer`` at the pixels of ``PixelPoints``.

    Weights are trilinear (S1, section 4.2), times what ``agree`` makes of a texel's normal and the point's;
    ``corners`` (m, 8) are the numbers of the points' texels. Void and buried texels are left out, and of what is not
    baked yet unshadowed light stands in. Light is counted in ``unit``, the radiance of 1; a point is as good as the
    least of its texels.
    """
    normals = points.normals
    for m in range(points.pixels.shape[0]):
        _, _, _, fz, fy, fx = base_texel(lattice, points.points, m)
        f, n = (np.float32(fz), np.float32(fy), np.float32(fx)), (normals[m, 0], normals[m, 1], normals[m, 2])
        r, g, b, variance, weight, least = blend_ratios(corners, m, ratios, n, f)
        under = unshadowed_light(unshadowed, n[0], n[1], n[2])
        if not weight > NONE:
            r, g, b = stand_in(corners, m, ratios, unshadowed, under, f[0], f[1], f[2])
            weight = ONE
        whole = ONE / weight
        r, g, b = r * whole * under[0], g * whole * under[1], b * whole * under[2]
        noise = math.sqrt(variance) * whole * luminance(under[0], under[1], under[2])
        error = ONE if least <= PARTIAL else min(noise / max(luminance(r, g, b), DARKEST), ONE)
        state = np.uint8(min(max(least, np.float32(PROVISIONAL)), np.float32(FINAL)))
        put_pixel(framebuffer, points.pixels[m], (r * unit, g * unit, b * unit), state, error)
