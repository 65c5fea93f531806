"""The illumination lattice under a view: the texels around a point, and their light interpolated to
the pixels.

A pixel reads the eight texels around its surface point (S1, section 4.2). Light is computed once
per texel that a view reads, see ``chunks``, and not once per pixel.
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
from isogi_core.kernels.shading.surface_points import SURFACE_POINTS, point_of
from isogi_core.kernels.transport.lights import unshadowed

DEFAULT_CHUNK_SIDE = 16
"""Texels along each side of a chunk, if a scene does not say."""

UNLIT_ROW = -1
"""Row of a texel that is not baked yet."""

VOID_ROW = -2
"""Row of a texel that can hold no light (``bake.texel_light.VOID``)."""

BURIED_ROW = -3
"""Row of a texel that no light ever reaches, inside a solid or a closed hollow."""

LEAST_SPREAD = np.float32(0.2)
"""Least variance of a path over its second moment, whatever the light.

It stands for reflected light, whose noise hardly depends on the light's direction. With it, 92.5 %
of the pixels lie within 1.96 times their standard error; with a tenth of it (0.02), 90.0 %. The
errors of frames use the same value.
"""

Shape = tuple[int, int, int]

LIGHT_NUMBERS = 7
"""Numbers of a texel's light: linear RGB, its standard error,
and the reflected part, linear RGB.
"""

NO_LIGHT = np.float32(0.0)
MIN_LIGHT = np.float32(1e-30)
ONE_F32 = np.float32(1.0)

UNBAKED_GRADE = 0
PARTIAL_GRADE = PROVISIONAL
BURIED_GRADE = FINAL + 1
VOID_GRADE = FINAL + 2
"""Grades of texels besides CONVERGING and FINAL: nothing baked, not all layers baked, buried, void.

Buried and void texels do not lower the state of a point.
"""


class Lattice(NamedTuple):
    """The grid of texels over a volume: ``shape`` is texels along z, y, x, ``density`` texels per
    voxel along x, y, z.

    Chunks have 1 << ``bits`` texels along each side.
    """

    shape: Shape
    density: tuple[float, float, float]
    bits: int

    @classmethod
    def of(
        cls, shape: Shape, density: tuple[float, float, float], chunk: int = DEFAULT_CHUNK_SIDE
    ) -> "Lattice":
        """Return the lattice whose chunks have ``chunk`` texels along each side,
        a power of two up to 32.
        """
        return cls(shape, density, chunk.bit_length() - 1)

    @property
    def chunk(self) -> int:
        """Texels along each side of a chunk."""
        return 1 << self.bits

    @property
    def rows(self) -> int:
        """Rows of texels along x in a chunk."""
        return 1 << 2 * self.bits

    @property
    def texels(self) -> int:
        """Texels of a whole chunk."""
        return 1 << 3 * self.bits

    @property
    def chunks(self) -> Shape:
        """Chunks along z, y, x."""
        z, y, x = (-(-n // self.chunk) for n in self.shape)
        return z, y, x

    def positions(self, index: Shape, offsets: np.ndarray) -> np.ndarray:
        """Return the lattice indices (m, 3; z, y, x) int32 of the texels at ``offsets`` (m,) in
        the chunk ``index`` (z, y, x).
        """
        inside = np.stack(np.unravel_index(offsets, (self.chunk,) * 3), axis=-1)
        return (inside + np.array(index) * self.chunk).astype(np.int32)


LATTICE = record(
    Lattice, types.UniTuple(types.int64, 3), types.UniTuple(types.float64, 3), types.int64
)
CORNER_ROWS = types.uint32[:, ::1]
GRADE_ARRAY = types.uint8[::1]


@kernel()
def axis_texel(p, density, n):
    """Return the lower of the two texels around coordinate ``p`` (voxels) along one axis of ``n``
    texels, and the fraction beyond it, 0 to 1.

    Texels are unsigned, so that the compiler knows that indices made of them do not count from an
    array's end.
    """
    q = p * density
    t = min(max(int(math.floor(q)), 0), n - 2)
    return np.uint32(t), min(max(q - t, 0.0), 1.0)


@kernel()
def base_texel(lattice, points, m):
    """Return the lowest corner (z, y, x) of the lattice cell around point ``m``, and the
    fractions (z, y, x) inside the cell.
    """
    z, fz = axis_texel(np.float64(points[m, 2]), lattice.density[2], lattice.shape[0])
    y, fy = axis_texel(np.float64(points[m, 1]), lattice.density[1], lattice.shape[1])
    x, fx = axis_texel(np.float64(points[m, 0]), lattice.density[0], lattice.shape[2])
    return z, y, x, fz, fy, fx


@kernel(
    types.void(
        types.int32[::1],
        types.float32[:, :, ::1],
        types.float32[::1],
        types.float32[:, ::1],
        types.float32[::1],
        types.int32[::1],
        types.int64,
        types.float32[:, ::1],
    ),
    any_order=True,
)
def light_texels(rows, transfer, scatter, light, square, firsts, straight, lit):
    """Fill ``lit`` (m, LIGHT_NUMBERS) with the light of texels: linear RGB radiance, the standard
    error of its luminance, and the reflected part.

    All are in ``BakeSpec.unit``. ``rows`` (m,) are places in ``transfer`` (rows, channels, n),
    which holds τ, and in ``scatter`` (rows,), the standard error over the standard deviation of one
    path's luminance; negative rows are skipped. ``light`` (3, n) is the turned environment times
    the albedo, ``square`` (n,) the square of its luminance. Each term, which has a separate light,
    has a range of columns, which begins at one of ``firsts``; columns from ``straight`` on are
    reflected light.

    Radiance is τ·ℓ (S1, eq. 9), at least 0; the variance of one path is τ·q - (τ·ℓ)², see
    ``bake.noise``.
    """
    blue = transfer.shape[1] - 1
    green = min(blue, 1)
    first = np.uint64(straight)
    columns = np.uint64(transfer.shape[2])
    for m in range(rows.shape[0]):
        row = np.uint32(rows[m])
        if rows[m] < 0:
            continue
        # Sum reflected light first, so that it is known apart. The loops are written out for SIMD.
        r = g = b = second = NO_LIGHT
        for i in range(first, columns):
            r += transfer[row, 0, i] * light[0, i]
            g += transfer[row, green, i] * light[1, i]
            b += transfer[row, blue, i] * light[2, i]
            second += transfer[row, green, i] * square[i]
        reflected = r, g, b
        for i in range(first):
            r += transfer[row, 0, i] * light[0, i]
            g += transfer[row, green, i] * light[1, i]
            b += transfer[row, blue, i] * light[2, i]
            second += transfer[row, green, i] * square[i]
        # The second moment over all turns of the light is band 0 of each term.
        even = NO_LIGHT
        for i in firsts:
            even += max(transfer[row, green, i] * square[i], NO_LIGHT)
        mean = luminance(r, g, b)
        spread = math.sqrt(max(second - mean * mean, NO_LIGHT) + LEAST_SPREAD * even)
        # Truncated harmonics may make light negative: cut it at 0.
        lit[m, 0] = max(r, NO_LIGHT)
        lit[m, 1] = max(g, NO_LIGHT)
        lit[m, 2] = max(b, NO_LIGHT)
        lit[m, 3] = scatter[row] * spread
        for c in range(3):
            lit[m, 4 + c] = min(max(reflected[c], NO_LIGHT), lit[m, c])


class Sky(NamedTuple):
    """Unshadowed light that stands in for texels that are not baked: ``lobe`` (n²) holds A_l/π
    per coefficient, ``light`` (3, n²) the environment times the albedo.
    """

    order: int
    lobe: Any
    light: Any


SKY = record(Sky, types.int64, types.float64[::1], types.float64[:, ::1])


@kernel()
def trilinear(c, fz, fy, fx):
    """Return the weight of corner ``c`` (bit 0 is x, bit 1 y, bit 2 z) of a cell at the
    fractions (z, y, x).
    """
    return (fz if c & 4 else 1.0 - fz) * (fy if c & 2 else 1.0 - fy) * (fx if c & 1 else 1.0 - fx)


@kernel(inline=True)
def blend_texels(corners, m, lit, fz, fy, fx):
    """Return the weighted sums over the eight texels of point ``m``, all of which are lit: (r,
    g, b, variance), float32.
    """
    z, y, x = np.float32(fz), np.float32(fy), np.float32(fx)
    r = g = b = variance = np.float32(0.0)
    for c in range(8):
        t = corners[m, c]
        w = (
            (z if c & 4 else ONE_F32 - z)
            * (y if c & 2 else ONE_F32 - y)
            * (x if c & 1 else ONE_F32 - x)
        )
        # Noises of texels are independent: the variance of the sum has squared weights.
        noise = w * lit[t, 3]
        r = r + w * lit[t, 0]
        g = g + w * lit[t, 1]
        b = b + w * lit[t, 2]
        variance = variance + noise * noise
    return r, g, b, variance


@kernel()
def blend_some(corners, m, grade, lit, fz, fy, fx):
    """Return the weighted sums over the lit ones of the eight texels of point ``m``: (r, g, b,
    variance), and the total weights of lit, unbaked and buried ones.
    """
    r = 0.0
    g = 0.0
    b = 0.0
    variance = 0.0
    weight = 0.0
    unbaked = 0.0
    buried = 0.0
    for c in range(8):
        t = corners[m, c]
        w = trilinear(c, fz, fy, fx)
        # Void texels count nowhere.
        if PARTIAL_GRADE <= grade[t] <= FINAL:
            r, g, b = r + w * lit[t, 0], g + w * lit[t, 1], b + w * lit[t, 2]
            variance += (w * lit[t, 3]) ** 2
            weight += w
        elif grade[t] == UNBAKED_GRADE:
            unbaked += w
        elif grade[t] == BURIED_GRADE:
            buried += w
    return r, g, b, variance, weight, unbaked, buried


@kernel()
def fill_in(some, n, sky, basis):
    """Complete the sums of ``blend_some`` by unshadowed light about the normal ``n``; return (r, g,
    b, variance).

    Unbaked texels count as unshadowed. Buried texels count as dark, but only if no other texel
    counts.
    """
    r, g, b, variance, weight, unbaked, buried = some
    # If all texels are buried or void: dark if any is buried, else unshadowed.
    if not weight + unbaked > 0.0:
        weight = buried
        unbaked = 0.0 if buried > 0.0 else 1.0
    if unbaked > 0.0:
        open_ = unshadowed(sky.order, sky.lobe, sky.light, n, basis)
        r = r + unbaked * open_[0]
        g = g + unbaked * open_[1]
        b = b + unbaked * open_[2]
        weight = weight + unbaked
    # Divide by the weight of the texels that count.
    whole = 1.0 / weight
    return (
        np.float32(r * whole),
        np.float32(g * whole),
        np.float32(b * whole),
        np.float32(variance * whole * whole),
    )


@kernel()
def span_of(grade, corners, m):
    """Return the least and the greatest grade of the eight texels of point ``m``."""
    least = np.uint8(VOID_GRADE)
    most = np.uint8(0)
    for c in range(8):
        each = grade[corners[m, c]]
        least, most = min(least, each), max(most, each)
    return least, most


@kernel(
    types.void(
        LATTICE,
        SURFACE_POINTS,
        CORNER_ROWS,
        GRADE_ARRAY,
        types.float32[:, ::1],
        SKY,
        types.float32,
        FRAMEBUFFER,
    )
)
def carry_light(lattice, points, corners, grade, lit, sky, unit, framebuffer):
    """Interpolate the texels' light ``lit`` (texels, LIGHT_NUMBERS) to the ``framebuffer`` at the
    pixels of ``SurfacePoints``.

    Interpolation is trilinear (S1, section 4.2) over the texels ``corners`` (m, 8) of each point
    that hold light. Void and buried texels are left out; unshadowed light about the point's normal
    stands in for those that are not baked. ``unit`` is the radiance that a light of 1 stands for.
    ``grade`` (texels,) is UNBAKED_GRADE, PARTIAL_GRADE, CONVERGING, FINAL, BURIED_GRADE or
    VOID_GRADE; the state of a point is the least of its texels', and its error is 1 while that is
    provisional.
    """
    basis = np.empty(sky.order * sky.order)
    for m in range(points.pixels.shape[0]):
        _, _, _, fz, fy, fx = base_texel(lattice, points.points, m)
        least, most = span_of(grade, corners, m)
        # Most points have light in all texels, and take the fast way.
        if PARTIAL_GRADE <= least and most <= FINAL:
            r, g, b, variance = blend_texels(corners, m, lit, fz, fy, fx)
        else:
            some = blend_some(corners, m, grade, lit, fz, fy, fx)
            r, g, b, variance = fill_in(some, point_of(points.normals, m), sky, basis)
        # Convert the variance to an error relative to the luminance.
        noise = min(math.sqrt(variance) / max(luminance(r, g, b), MIN_LIGHT), ONE_F32)
        if least <= PARTIAL_GRADE:
            error = ONE_F32
        else:
            error = noise
        state = min(max(least, PROVISIONAL), FINAL)
        put_pixel(framebuffer, points.pixels[m], (r * unit, g * unit, b * unit), state, error)
