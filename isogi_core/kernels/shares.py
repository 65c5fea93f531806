"""Shares: texels' light over what would arrive about their normals without shadows, carried to the pixels.

Trilinear weights alone mix the light of texels whose normals differ, and light from one side tells normals apart. The
share of unshadowed light that a texel has changes less from one to the next: pixels blend shares, count those more
whose normals are as their own, and put what they get under the light about their own normal.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.lattice import (
    BURIED,
    CORNERS,
    DARKEST,
    LATTICE,
    PARTIAL,
    PIXELS,
    POINTS,
    UNBAKED,
    VOID,
    WIDE,
    fractions,
    trilinear,
)
from isogi_core.kernels.planes import FINAL, PLANES, PROVISIONAL, luminance, put_pixel

LEAST = 0.05
"""Share of the light's mean that unshadowed light is taken to be at least, so that shares stay small."""

LEAST_COSINE = np.float32(0.2)
"""Cosine between a texel's normal and a pixel's that weights count with at least: where all face away, all count."""

DOUBLINGS = 4
"""How often that cosine is squared: weights have its 16th power, and fall to a half at 17°."""

NONE, ONE = np.float32(0.0), np.float32(1.0)

RECORD = 8
"""Numbers of a texel, one half of a cache line: three shares, the error's share, the normal, the grade."""


class Bare(NamedTuple):
    """Unshadowed light by the normal.

    ``quadric`` (3, 9) float32, of linear RGB over 1, y, z, x, xy, yz, z², xz, x² - y², and ``least`` (3,) of each
    colour; ``reflected`` (3,) is added to it: what texels hold of lobes, which light them by way of other surfaces.
    """

    quadric: Any
    least: Any
    reflected: Any


BARE = record(Bare, types.float32[:, ::1], types.float32[::1], types.float32[::1])


@kernel()
def bare_light(bare, x, y, z):
    """Irradiance over π, linear RGB, of what nothing shadows about the unit normal (x, y, z).

    ``least`` at least, and the ``reflected`` light. Source: Ramamoorthi and Hanrahan 2001, eqs. 11 to 13.
    """
    xy, yz, zz, xz, across = x * y, y * z, z * z, x * z, x * x - y * y
    q, low, more = bare.quadric, bare.least, bare.reflected
    r = q[0, 0] + y * q[0, 1] + z * q[0, 2] + x * q[0, 3]
    g = q[1, 0] + y * q[1, 1] + z * q[1, 2] + x * q[1, 3]
    b = q[2, 0] + y * q[2, 1] + z * q[2, 2] + x * q[2, 3]
    r += xy * q[0, 4] + yz * q[0, 5] + zz * q[0, 6] + xz * q[0, 7] + across * q[0, 8]
    g += xy * q[1, 4] + yz * q[1, 5] + zz * q[1, 6] + xz * q[1, 7] + across * q[1, 8]
    b += xy * q[2, 4] + yz * q[2, 5] + zz * q[2, 6] + xz * q[2, 7] + across * q[2, 8]
    return max(r, low[0]) + more[0], max(g, low[1]) + more[1], max(b, low[2]) + more[2]


@kernel()
def unbaked_light(bare, light):
    """What stands in for light that is not baked, of unshadowed ``light``: all but what is ``reflected``."""
    return light[0] - bare.reflected[0], light[1] - bare.reflected[1], light[2] - bare.reflected[2]


@kernel()
def put_share(shares, t, light, error, over):
    """Write ``light`` and its ``error`` over unshadowed light to texel ``t`` of ``shares``; 0 where all is dark."""
    shares[t, 0] = light[0] / max(over[0], DARKEST)
    shares[t, 1] = light[1] / max(over[1], DARKEST)
    shares[t, 2] = light[2] / max(over[2], DARKEST)
    shares[t, 3] = error / max(luminance(over[0], over[1], over[2]), DARKEST)


@kernel(types.void(types.uint8[::1], types.float32[:, ::1], POINTS, BARE, types.float32[:, ::1]))
def share_texels(grade, lit, normals, bare, shares):
    """Fill ``shares`` (m, RECORD) of texels with the ``grade`` (m,) and the light ``lit`` (m, 4) of ``light_texels``.

    ``normals`` (m, 3) are those that they are lit about. Of what is not baked unshadowed light stands in; void and
    buried texels have none.
    """
    for t in range(grade.shape[0]):
        x, y, z = normals[t, 0], normals[t, 1], normals[t, 2]
        over = bare_light(bare, x, y, z)
        light, error = (NONE, NONE, NONE), NONE
        if PARTIAL <= grade[t] <= FINAL:
            light, error = (lit[t, 0], lit[t, 1], lit[t, 2]), lit[t, 3]
        elif grade[t] == UNBAKED:
            light = unbaked_light(bare, over)
        put_share(shares, t, light, error, over)
        shares[t, 4], shares[t, 5], shares[t, 6], shares[t, 7] = x, y, z, np.float32(grade[t])


@kernel()
def agree(shares, t, x, y, z):
    """The cosine between the normal of texel ``t`` and (x, y, z), LEAST_COSINE at least, squared DOUBLINGS times."""
    cosine = max(x * shares[t, 4] + y * shares[t, 5] + z * shares[t, 6], LEAST_COSINE)
    for _ in range(DOUBLINGS):
        cosine *= cosine
    return cosine


@kernel(inline=True)
def blend_shares(corners, m, shares, x, y, z, fz, fy, fx):
    """Sums over those of point ``m``'s texels that are not void or buried: (r, g, b, variance, weight), float32.

    And the least grade of all eight. Weights are trilinear ones, for fractions (z, y, x), times ``agree``.
    """
    r = g = b = variance = weight = NONE
    least = np.float32(VOID)
    for c in range(8):
        t = corners[m, c]
        grade = shares[t, 7]
        w = (fz if c & 4 else ONE - fz) * (fy if c & 2 else ONE - fy) * (fx if c & 1 else ONE - fx)
        w *= agree(shares, t, x, y, z) if grade <= FINAL else NONE
        noise = w * shares[t, 3]
        r, g, b, variance = r + w * shares[t, 0], g + w * shares[t, 1], b + w * shares[t, 2], variance + noise * noise
        weight, least = weight + w, min(least, grade)
    return r, g, b, variance, weight, least


@kernel()
def stand_in(corners, m, shares, bare, under, fz, fy, fx):
    """The share of each colour at point ``m`` where no texel counts: none if any is buried, as if unbaked if not."""
    buried = 0.0
    for c in range(8):
        if shares[corners[m, c], 7] == BURIED:
            buried += trilinear(c, fz, fy, fx)
    if buried > 0.0:
        return NONE, NONE, NONE
    light = unbaked_light(bare, under)
    return light[0] / max(under[0], DARKEST), light[1] / max(under[1], DARKEST), light[2] / max(under[2], DARKEST)


@kernel(types.void(LATTICE, POINTS, PIXELS, CORNERS, WIDE, types.float32[:, ::1], POINTS, BARE, types.float32, PLANES))
def carry_shares(lattice, points, pixels, corners, wide, shares, normals, bare, unit, planes):
    """Carry texels' ``shares`` (texels, RECORD) to the ``planes`` at the points' ``pixels`` (m,).

    Points read the ``corners`` (m, 8) of ``wide`` (m,) cells or of others. Weights are trilinear (S1, section 4.2),
    times the cosine between a texel's normal and the point's, one of ``normals`` (m, 3), as ``agree`` has it. Void and
    buried texels are left out, and of what is not baked yet unshadowed light stands in. Light is counted in ``unit``,
    the radiance of 1; a point is as good as the least of its texels.
    """
    for m in range(points.shape[0]):
        fz, fy, fx = fractions(lattice, points, m, wide[m])
        f, n = (np.float32(fz), np.float32(fy), np.float32(fx)), (normals[m, 0], normals[m, 1], normals[m, 2])
        r, g, b, variance, weight, least = blend_shares(corners, m, shares, n[0], n[1], n[2], f[0], f[1], f[2])
        under = bare_light(bare, n[0], n[1], n[2])
        if not weight > NONE:
            r, g, b = stand_in(corners, m, shares, bare, under, fz, fy, fx)
            weight = ONE
        whole = ONE / weight
        r, g, b = r * whole * under[0], g * whole * under[1], b * whole * under[2]
        noise = math.sqrt(variance) * whole * luminance(under[0], under[1], under[2])
        error = ONE if least <= PARTIAL else min(noise / max(luminance(r, g, b), DARKEST), ONE)
        state = np.uint8(min(max(least, np.float32(PROVISIONAL)), np.float32(FINAL)))
        put_pixel(planes, pixels[m], (r * unit, g * unit, b * unit), state, error)
