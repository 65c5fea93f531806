"""Irradiance ratios: texels' direct light over their unshadowed light, interpolated to the pixels.

The direct light of a pixel is Σ w D / Σ w U times the pixel's unshadowed light, D and U being the
direct and the unshadowed light of its texels. The ratio changes less from texel to texel than the
light, which follows the normal. Texels that face away from the light have a small U, and so weigh
little. Reflected light comes from surfaces and does not follow the environment: it is interpolated
as it is. If texels keep both as one number, the excess over their unshadowed light counts as
reflected.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.shading.framebuffer import (
    FINAL,
    FRAMEBUFFER,
    PROVISIONAL,
    luminance,
    put_pixel,
)
from isogi_core.kernels.shading.lattice import (
    BURIED_GRADE,
    CORNER_ROWS,
    LATTICE,
    MIN_LIGHT,
    PARTIAL_GRADE,
    UNBAKED_GRADE,
    VOID_GRADE,
    base_texel,
    trilinear,
)
from isogi_core.kernels.shading.surface_points import POINT_ROWS, SURFACE_POINTS

MIN_UNSHADOWED = 0.05
"""Least unshadowed light, as a share of the light's mean, so that ratios stay small."""

LEAST_COSINE = np.float32(1e-3)
"""Least cosine between a texel's normal and a pixel's in weights:
if all texels face away, all count.
"""

NORMAL_TURN_LIMIT = np.float32(0.1055)
"""1 - cosine of 27°, at which weights have fallen to a fifth; they are a half at 16°."""

ZERO_F32 = np.float32(0.0)
ONE_F32 = np.float32(1.0)

DIRECT_COLUMN = 0
NOISE_COLUMN = 3
UNSHADOWED_COLUMN = 4
GRADE_COLUMN = 7
REFLECTED_COLUMN = 8
NORMAL_COLUMN = 11
RECORD_LENGTH = 16
"""First places of the numbers in a texel's record, and its length in single floats: one cache line.

In order: direct light, linear RGB; the standard error of all light; unshadowed light about the
normal; the grade; reflected light; the normal. The last two numbers belong to ``filtering``.
"""


class Unshadowed(NamedTuple):
    """Unshadowed light as a function of the normal, a quadratic form.

    ``quadric`` (3, 9) float32 holds the factors of 1, y, z, x, xy, yz, z², xz, x² - y² for linear
    RGB; ``least`` (3,) is the lower bound of each colour.
    """

    quadric: Any
    least: Any


UNSHADOWED = record(Unshadowed, types.float32[:, ::1], types.float32[::1])


@kernel()
def unshadowed_light(unshadowed, x, y, z):
    """Return the irradiance over π, linear RGB, that arrives about the unit normal (x, y, z)
    without shadows; at least ``unshadowed.least``.

    Source: Ramamoorthi and Hanrahan 2001, eqs. 11 to 13.
    """
    xy = x * y
    yz = y * z
    zz = z * z
    xz = x * z
    across = x * x - y * y
    # Evaluate the quadratic form for the three colours.
    q = unshadowed.quadric
    low = unshadowed.least
    r = q[0, 0] + y * q[0, 1] + z * q[0, 2] + x * q[0, 3]
    g = q[1, 0] + y * q[1, 1] + z * q[1, 2] + x * q[1, 3]
    b = q[2, 0] + y * q[2, 1] + z * q[2, 2] + x * q[2, 3]
    r += xy * q[0, 4] + yz * q[0, 5] + zz * q[0, 6] + xz * q[0, 7] + across * q[0, 8]
    g += xy * q[1, 4] + yz * q[1, 5] + zz * q[1, 6] + xz * q[1, 7] + across * q[1, 8]
    b += xy * q[2, 4] + yz * q[2, 5] + zz * q[2, 6] + xz * q[2, 7] + across * q[2, 8]
    return max(r, low[0]), max(g, low[1]), max(b, low[2])


TEXEL_RECORDS = types.float32[:, ::1]


@kernel(
    types.void(
        types.uint8[::1],
        types.float32[:, ::1],
        POINT_ROWS,
        UNSHADOWED,
        types.boolean,
        TEXEL_RECORDS,
    )
)
def fill_records(grade, lit, normals, unshadowed, whole, texels):
    """Fill the records ``texels`` (m, RECORD_LENGTH) from the ``grade`` (m,), the light ``lit`` (m,
    LIGHT_NUMBERS) of ``light_texels``, and the ``normals`` (m, 3) that it arrives about.

    All records get the unshadowed light about their normals. It is also the direct light of texels
    that are not baked; void and buried texels have no direct light.

    If light is kept as a ``whole``, direct and reflected together, at most the unshadowed light
    counts as direct. Otherwise texels that face away from a lamp would pass their reflected light
    on as a ratio, and pixels that face the lamp would show many times of it.
    """
    for t in range(grade.shape[0]):
        x, y, z = normals[t, 0], normals[t, 1], normals[t, 2]
        under = unshadowed_light(unshadowed, x, y, z)
        # Split the light into direct and reflected light. Columns 4 to 6 of ``lit`` hold the part
        # that is known to be reflected; of a whole, the excess over unshadowed light counts, too.
        there = PARTIAL_GRADE <= grade[t] <= FINAL
        unbaked = grade[t] == UNBAKED_GRADE
        for c in range(3):
            if there:
                reflected = max(lit[t, 4 + c], lit[t, c] - under[c] if whole else ZERO_F32)
            else:
                reflected = ZERO_F32
            if there:
                texels[t, DIRECT_COLUMN + c] = lit[t, c] - reflected
            elif unbaked:
                texels[t, DIRECT_COLUMN + c] = under[c]
            else:
                texels[t, DIRECT_COLUMN + c] = ZERO_F32
            texels[t, UNSHADOWED_COLUMN + c] = under[c]
            texels[t, REFLECTED_COLUMN + c] = reflected
        # Copy error, normal and grade.
        texels[t, NOISE_COLUMN] = lit[t, 3] if there else ZERO_F32
        texels[t, NORMAL_COLUMN] = x
        texels[t, NORMAL_COLUMN + 1] = y
        texels[t, NORMAL_COLUMN + 2] = z
        texels[t, GRADE_COLUMN] = np.float32(grade[t])


@kernel()
def agree(texels, t, n):
    """Return the weight of texel ``t`` by the cosine c between its normal and ``n``: (c / (1 + (1 -
    c) / NORMAL_TURN_LIMIT))².

    The weight falls slowly, so that no single texel decides if all are turned away from a pixel:
    with c¹⁶ the 99th percentile of the error at rims of thin walls is a sixth higher. Texels that
    face away hardly count.
    """
    cosine = (
        n[0] * texels[t, NORMAL_COLUMN]
        + n[1] * texels[t, NORMAL_COLUMN + 1]
        + n[2] * texels[t, NORMAL_COLUMN + 2]
    )
    weight = max(cosine, LEAST_COSINE) / (ONE_F32 + (ONE_F32 - cosine) / NORMAL_TURN_LIMIT)
    return weight * weight


@kernel()
def madd_colour(sums, w, texels, t, first):
    """Return ``sums`` plus ``w`` times the colour that begins at ``first``
    in the record of texel ``t``.
    """
    return (
        sums[0] + w * texels[t, first],
        sums[1] + w * texels[t, first + 1],
        sums[2] + w * texels[t, first + 2],
    )


@kernel(inline=True)
def blend_records(corners, m, texels, n, f):
    """Return weighted sums over the eight texels of point ``m``: direct, unshadowed and reflected
    light, variance, and the weights; last the least grade.

    Weights are trilinear at the fractions ``f`` (z, y, x), times ``agree`` with the point's normal
    ``n``. Void and buried texels have weight 0, and grades above FINAL, which do not lower the
    least grade. Noises of texels are independent, so that their weighted squares add up to the
    variance. All are float32.
    """
    direct = unshadowed = reflected = (ZERO_F32, ZERO_F32, ZERO_F32)
    variance = ZERO_F32
    weight = ZERO_F32
    least = np.float32(VOID_GRADE)
    (fz, fy, fx) = f
    for c in range(8):
        t = corners[m, c]
        grade = texels[t, GRADE_COLUMN]
        w = (
            (fz if c & 4 else ONE_F32 - fz)
            * (fy if c & 2 else ONE_F32 - fy)
            * (fx if c & 1 else ONE_F32 - fx)
        )
        # Multiply by 0 instead of skipping: the loop stays free of branches.
        if grade <= FINAL:
            w *= agree(texels, t, n)
        else:
            w *= ZERO_F32
        direct = madd_colour(direct, w, texels, t, DIRECT_COLUMN)
        unshadowed = madd_colour(unshadowed, w, texels, t, UNSHADOWED_COLUMN)
        reflected = madd_colour(reflected, w, texels, t, REFLECTED_COLUMN)
        noise = w * texels[t, NOISE_COLUMN]
        variance = variance + noise * noise
        weight = weight + w
        least = min(least, grade)
    return direct, unshadowed, reflected, variance, weight, least


@kernel()
def stand_in(corners, m, texels, under, f):
    """Return the light of point ``m`` if none of its texels counts, as all are void or buried.

    If one with a trilinear weight at the point's fractions ``f`` (z, y, x) is buried, the point
    lies in matter or in a hollow that no light reaches: it is black. If all are void, nothing is
    known of its shadows, and the unshadowed light ``under`` stands in.
    """
    buried = 0.0
    for c in range(8):
        if texels[corners[m, c], GRADE_COLUMN] == BURIED_GRADE:
            buried += trilinear(c, f[0], f[1], f[2])
    if buried > 0.0:
        return (ZERO_F32, ZERO_F32, ZERO_F32)
    return under


@kernel()
def shade_ratio(blended, under):
    """Return the light of a point, linear RGB, and the standard error of its luminance, from
    the sums ``blended`` of ``blend_records`` and the point's unshadowed light ``under``.
    """
    direct, over, reflected, variance, weight, _ = blended
    r = direct[0] / max(over[0], MIN_LIGHT) * under[0] + reflected[0] / weight
    g = direct[1] / max(over[1], MIN_LIGHT) * under[1] + reflected[1] / weight
    b = direct[2] / max(over[2], MIN_LIGHT) * under[2] + reflected[2] / weight
    # The error grows with the ratio of the point's unshadowed light to that of its texels.
    brighter = luminance(under[0], under[1], under[2]) / max(
        luminance(over[0], over[1], over[2]), MIN_LIGHT
    )
    return (r, g, b), math.sqrt(variance) * brighter


@kernel(
    types.void(
        LATTICE, SURFACE_POINTS, CORNER_ROWS, TEXEL_RECORDS, UNSHADOWED, types.float32, FRAMEBUFFER
    )
)
def carry_ratios(lattice, points, corners, texels, unshadowed, unit, framebuffer):
    """Interpolate the light of the records ``texels`` (texels, RECORD_LENGTH) to the
    ``framebuffer`` at the pixels of ``SurfacePoints``, as irradiance ratios.

    ``corners`` (m, 8) are the numbers of each point's texels; for their weights see
    ``blend_records``. ``unit`` is the radiance that a light of 1 stands for. The state of a point
    is the least of its texels', and its error is 1 while that is provisional.
    """
    normals = points.normals
    for m in range(points.pixels.shape[0]):
        _, _, _, fz, fy, fx = base_texel(lattice, points.points, m)
        f = (np.float32(fz), np.float32(fy), np.float32(fx))
        n = (normals[m, 0], normals[m, 1], normals[m, 2])
        # Multiply the ratio of the texels by the unshadowed light about the pixel's normal.
        under = unshadowed_light(unshadowed, n[0], n[1], n[2])
        blended = blend_records(corners, m, texels, n, f)
        least = blended[5]
        if blended[4] > ZERO_F32:
            (r, g, b), noise = shade_ratio(blended, under)
        else:
            (r, g, b) = stand_in(corners, m, texels, under, f)
            noise = ZERO_F32
        if least <= PARTIAL_GRADE:
            error = ONE_F32
        else:
            error = min(noise / max(luminance(r, g, b), MIN_LIGHT), ONE_F32)
        state = np.uint8(min(max(least, np.float32(PROVISIONAL)), np.float32(FINAL)))
        put_pixel(framebuffer, points.pixels[m], (r * unit, g * unit, b * unit), state, error)
