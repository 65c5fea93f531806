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
    z, fz = axis_texel(np.float64(points[m, 2]), lattice.density[2], lattice.shape[0])
    y, fy = axis_texel(np.float64(points[m, 1]), lattice.density[1], lattice.shape[1])
    x, fx = axis_texel(np.float64(points[m, 0]), lattice.density[0], lattice.shape[2])
    return z, y, x, fz, fy, fx


@kernel()
def inner(z, y, x):
    """Offset of a texel inside its chunk."""
    return ((z % CHUNK) * CHUNK + y % CHUNK) * CHUNK + x % CHUNK


@kernel(types.void(LATTICE, POINTS, types.boolean[:, :, ::1]))
def touch_chunks(lattice, points, touched):
    """Set ``touched`` (chunks z, y, x) for each chunk that a point reads."""
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        k, j, i = z // CHUNK, y // CHUNK, x // CHUNK
        touched[k, j, i] = True
        if (z + 1) // CHUNK > k or (y + 1) // CHUNK > j or (x + 1) // CHUNK > i:
            for c in range(1, 8):
                touched[(z + (c >> 2)) // CHUNK, (y + ((c >> 1) & 1)) // CHUNK, (x + (c & 1)) // CHUNK] = True


@kernel()
def corner(slots, z, y, x, c):
    """Place of corner ``c`` of the lattice cell at (z, y, x) among the texels of the touched chunks."""
    k, j, i = z + (c >> 2), y + ((c >> 1) & 1), x + (c & 1)
    return slots[k // CHUNK, j // CHUNK, i // CHUNK] * CHUNK**3 + inner(k, j, i)


@kernel()
def inside_chunk(z, y, x):
    """Whether all eight corners of the lattice cell at (z, y, x) lie in one chunk."""
    return z % CHUNK < CHUNK - 1 and y % CHUNK < CHUNK - 1 and x % CHUNK < CHUNK - 1


@kernel(types.void(LATTICE, POINTS, types.int32[:, :, ::1], types.boolean[::1]))
def mark_texels(lattice, points, slots, read):
    """Set ``read`` (slots · CHUNK³,) for each texel that a point reads; ``slots`` (z, y, x) numbers the chunks."""
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        first = corner(slots, z, y, x, 0)
        single = inside_chunk(z, y, x)
        for c in range(8):
            read[first + inner(c >> 2, (c >> 1) & 1, c & 1) if single else corner(slots, z, y, x, c)] = True


@kernel("int64(boolean[::1], int32[::1], int32[::1])")
def number_texels(read, numbers, places):
    """Number the texels that are ``read``: ``numbers`` gets 0, 1, 2, …, ``places`` the inverse; returns how many."""
    count = 0
    for place in range(read.shape[0]):
        if read[place]:
            numbers[place] = count
            places[count] = place
            count += 1
    return count


@kernel(types.void(LATTICE, POINTS, types.int32[:, :, ::1], types.int32[::1], types.int32[:, ::1]))
def find_corners(lattice, points, slots, numbers, corners):
    """Fill ``corners`` (points, 8), x fastest, with the view's own ``numbers`` (slots · CHUNK³,) of the texels."""
    for m in range(points.shape[0]):
        z, y, x, _, _, _ = base_texel(lattice, points, m)
        first = corner(slots, z, y, x, 0)
        single = inside_chunk(z, y, x)
        for c in range(8):
            place = first + inner(c >> 2, (c >> 1) & 1, c & 1) if single else corner(slots, z, y, x, c)
            corners[m, c] = numbers[place]


@kernel(types.void(types.int32[:, ::1], types.int32[::1], types.float32[::1], types.float32[::1]))
def weigh_chunks(corners, chunk, weights, area):
    """Add to ``area`` (chunks,) the ``weights`` (points,) of the points that read each chunk: its share of the screen.

    ``chunk`` (texels,) is the chunk of each texel that ``corners`` numbers.
    """
    for m in range(corners.shape[0]):
        first, crossed = chunk[corners[m, 0]], 0
        for axis in (1, 2, 4):
            if chunk[corners[m, axis]] != first:
                crossed |= axis
        for c in range(8):
            if c & crossed == c:
                area[chunk[corners[m, c]]] += weights[m]


@kernel()
def dot_light(transfer, light):
    """τ·ℓ per channel of ``light`` (3, n), linear RGB; ``transfer`` is (1, n) or (3, n). Source: S1, eq. 9."""
    grey = transfer.shape[0] == 1
    r, g, b = 0.0, 0.0, 0.0
    for i in range(transfer.shape[1]):
        r += transfer[0, i] * light[0, i]
        g += transfer[0 if grey else 1, i] * light[1, i]
        b += transfer[0 if grey else 2, i] * light[2, i]
    return r, g, b


@kernel()
def dot_noise(spread, light):
    """Σ spread · light over channels and coefficients, both (channels, n)."""
    total = 0.0
    for c in range(spread.shape[0]):
        even, odd = 0.0, 0.0
        for i in range(0, spread.shape[1] - 1, 2):
            even += spread[c, i] * light[c, i]
            odd += spread[c, i + 1] * light[c, i + 1]
        if spread.shape[1] % 2:
            even += spread[c, -1] * light[c, -1]
        total += even + odd
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
    for m in range(rows.shape[0]):
        row = rows[m]
        if row >= 0:
            r, g, b = dot_light(transfer[row], light)
            lit[m, 0], lit[m, 1], lit[m, 2] = max(r, 0.0), max(g, 0.0), max(b, 0.0)
            lit[m, 3] = abs(dot_noise(spread[row], spread_light))


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
            n = (np.float64(normals[m, 0]), np.float64(normals[m, 1]), np.float64(normals[m, 2]))
            bare = unshadowed(sky.order, sky.lobe, sky.light, n, basis)
            r, g, b, weight = r + unlit * bare[0], g + unlit * bare[1], b + unlit * bare[2], weight + unlit
        radiance[m, 0], radiance[m, 1], radiance[m, 2] = r / weight, g / weight, b / weight
        state[m] = least
        noise = math.sqrt(variance) / max(luminance(r, g, b), 1e-30)
        error[m] = 1.0 if least == PROVISIONAL else min(noise, 1.0)
