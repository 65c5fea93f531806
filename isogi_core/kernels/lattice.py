"""The illumination lattice under a view: which texels its pixels read, and their light carried to the pixels.

A pixel reads the eight texels around its surface point (S1, section 4.2). Texels are grouped in
cubic chunks; a view numbers the chunks it touches (slots) and the texels it reads, so that
light is computed once per texel and not once per pixel.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.lights import unshadowed

CHUNK = 16
"""Texels along each side of a chunk."""

UNLIT = -1
"""Row of a texel that is not baked yet."""

VOID_ROW = -2
"""Row of a texel that can hold no light (see integrator.VOID)."""

PROVISIONAL, CONVERGING, FINAL = 1, 2, 3


class Lattice(NamedTuple):
    """Texels along z, y, x, and texels per voxel along x, y, z."""

    shape: tuple[int, int, int]
    density: tuple[float, float, float]


LATTICE = record(Lattice, types.UniTuple(types.int64, 3), types.UniTuple(types.float64, 3))
POINTS = types.float32[:, ::1]


@kernel()
def axis_texel(p, density, n):
    """The lower of the two texels along one axis around coordinate ``p`` (voxels), and the fraction beyond it."""
    q = p * density
    t = min(max(int(math.floor(q)), 0), n - 2)
    return t, min(max(q - t, 0.0), 1.0)


@kernel()
def base_texel(lattice, points, m):
    """Lowest corner (z, y, x) of the lattice cell around point ``m``, and the fractions (z, y, x) inside it."""
    z, fz = axis_texel(points[m, 2], lattice.density[2], lattice.shape[0])
    y, fy = axis_texel(points[m, 1], lattice.density[1], lattice.shape[1])
    x, fx = axis_texel(points[m, 0], lattice.density[0], lattice.shape[2])
    return z, y, x, fz, fy, fx


@kernel()
def inner(z, y, x):
    """Offset of a texel inside its chunk."""
    return ((z % CHUNK) * CHUNK + y % CHUNK) * CHUNK + x % CHUNK


@kernel(types.void(LATTICE, POINTS, types.float32[::1], types.float32[:, :, ::1]))
def count_pixels(lattice, points, weights, area):
    """Add to ``area`` (chunks z, y, x) the ``weights`` (m,) of the points that read each chunk: its share of the screen."""
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        for k in range(z // CHUNK, (z + 1) // CHUNK + 1):
            for j in range(y // CHUNK, (y + 1) // CHUNK + 1):
                for i in range(x // CHUNK, (x + 1) // CHUNK + 1):
                    area[k, j, i] += weights[m]


@kernel(types.void(LATTICE, POINTS, types.int32[:, :, ::1], types.boolean[:, ::1]))
def mark_texels(lattice, points, slots, read):
    """Set ``read`` (slots, CHUNK³) for each texel that a point reads; ``slots`` (chunks z, y, x) numbers the chunks."""
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        for c in range(8):
            k, j, i = z + (c >> 2), y + ((c >> 1) & 1), x + (c & 1)
            read[slots[k // CHUNK, j // CHUNK, i // CHUNK], inner(k, j, i)] = True


@kernel(types.void(LATTICE, POINTS, types.int32[:, :, ::1], types.int32[:, ::1], types.int32[:, ::1]))
def find_corners(lattice, points, slots, numbers, corners):
    """Fill ``corners`` (points, 8), x fastest, with the view's own texel ``numbers`` (slots, CHUNK³)."""
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        for c in range(8):
            k, j, i = z + (c >> 2), y + ((c >> 1) & 1), x + (c & 1)
            corners[m, c] = numbers[slots[k // CHUNK, j // CHUNK, i // CHUNK], inner(k, j, i)]


@kernel()
def band_dot(coefficients, light, c):
    """Dot product τ·ℓ of a row of coefficients and channel ``c`` of the light. Source: S1, eq. 9."""
    total = 0.0
    for i in range(coefficients.shape[0]):
        total += coefficients[i] * light[c, i]
    return total


@kernel(
    types.void(
        types.int32[::1],
        types.float32[:, :, ::1],
        types.float32[:, :, ::1],
        types.float32[:, ::1],
        types.float32[:, ::1],
        types.float32[:, ::1],
    )
)
def light_texels(rows, transfer, spread, light, spread_light, lit):
    """Fill ``lit`` (m, 4): linear RGB radiance and absolute standard error of its luminance, per texel.

    ``transfer`` and ``spread`` (row, channels, n) hold τ and half the difference of its two
    randomisations; ``light`` (3, n) is the turned environment times the albedo, ``spread_light``
    (channels, n) the same weighted to luminance. Negative sums of coefficients are cut to 0.
    """
    channels = transfer.shape[1]
    for m in range(rows.shape[0]):
        row = rows[m]
        if row < 0:
            continue
        for c in range(3):
            lit[m, c] = max(band_dot(transfer[row, c if channels == 3 else 0], light, c), 0.0)
        error = 0.0
        for c in range(spread.shape[1]):
            error += band_dot(spread[row, c], spread_light, c)
        lit[m, 3] = abs(error)


class Sky(NamedTuple):
    """What stands in for light that is not baked: ``lobe`` (n²) = A_l/π per coefficient, ``light`` (3, n²) × albedo."""

    order: int
    lobe: Any
    light: Any


SKY = record(Sky, types.int64, types.float64[::1], types.float64[:, ::1])


@kernel()
def luminance(r, g, b):
    """Relative luminance of linear RGB (ITU-R BT.709)."""
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


@kernel()
def trilinear(c, fz, fy, fx):
    """Weight of corner ``c`` (bit 0 is x, bit 1 is y, bit 2 is z) of a cell at the fractions (z, y, x)."""
    return (fz if c & 4 else 1.0 - fz) * (fy if c & 2 else 1.0 - fy) * (fx if c & 1 else 1.0 - fx)


@kernel()
def gather(corners, rows, grade, lit, fz, fy, fx):
    """Weighted sums over a point's eight texels: (r, g, b, variance, lit weight, unlit weight, least grade)."""
    r, g, b, variance, weight, unlit, least = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, FINAL
    for c in range(8):
        t = corners[c]
        w = trilinear(c, fz, fy, fx)
        if rows[t] >= 0:
            r, g, b = r + w * lit[t, 0], g + w * lit[t, 1], b + w * lit[t, 2]
            variance += (w * lit[t, 3]) ** 2
            weight += w
            least = min(least, int(grade[t]))
        elif rows[t] == UNLIT:
            unlit += w
            least = PROVISIONAL
    return r, g, b, variance, weight, unlit, least


@kernel(
    types.void(
        LATTICE,
        POINTS,
        types.int32[:, ::1],
        types.int32[::1],
        types.uint8[::1],
        types.float32[:, ::1],
        POINTS,
        SKY,
        POINTS,
        types.uint8[::1],
        types.float32[::1],
    )
)
def carry_light(lattice, points, corners, rows, grade, lit, normals, sky, radiance, state, error):
    """Carry the texels' light to the points: ``radiance`` (m, 3), ``state`` (m,), relative ``error`` (m,).

    Trilinear (S1, section 4.2) over the texels that hold light; void ones are left out, and what is
    not baked yet stands in as unshadowed light about the point's normal (``normals`` (m, 3); may
    hold no rows where no texel is missing). ``grade`` (texels,) is CONVERGING or FINAL; a point is
    as good as the least of its texels.
    """
    basis = np.empty(sky.order * sky.order)
    for m in range(points.shape[0]):
        _, _, _, fz, fy, fx = base_texel(lattice, points, m)
        r, g, b, variance, weight, unlit, least = gather(corners[m], rows, grade, lit, fz, fy, fx)
        if not weight > 0.0:
            unlit = 1.0
        if unlit > 0.0:
            n = (float(normals[m, 0]), float(normals[m, 1]), float(normals[m, 2]))
            bare = unshadowed(sky.order, sky.lobe, sky.light, n, basis)
            r, g, b, weight = r + unlit * bare[0], g + unlit * bare[1], b + unlit * bare[2], weight + unlit
        radiance[m, 0], radiance[m, 1], radiance[m, 2] = r / weight, g / weight, b / weight
        state[m] = least
        noise = math.sqrt(variance) / max(luminance(r, g, b), 1e-30)
        error[m] = 1.0 if least == PROVISIONAL else min(noise, 1.0)
