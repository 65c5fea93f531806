"""The illumination lattice under a view: the texels around a point, and their light carried to the
pixels.

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
"""Texels along each side of a chunk, where a scene does not say."""

UNLIT_ROW = -1
"""Row of a texel that is not baked yet."""

VOID_ROW = -2
"""Row of a texel that can hold no light (see bake.precision.VOID)."""

BURIED_ROW = -3
"""Row of a texel that no light ever reaches, inside a solid or a closed hollow."""

LEAST_SPREAD = np.float32(0.2)
"""Share of their second moment that paths differ by at least, wherever a light stands.

It stands for reflected light, whose noise hardly follows the light. Without most of it (0.02) 90.0
% of the pixels lie within 1.96 times their standard error, with it 92.5 %; frames' errors are
estimated alike.
"""

Shape = tuple[int, int, int]

LIGHT_NUMBERS = 7
"""Numbers of a texel's light: linear RGB, its standard error, and what of it is reflected light,
linear RGB.
"""

NO_LIGHT = np.float32(0.0)
MIN_LIGHT = np.float32(1e-30)
ONE_F32 = np.float32(1.0)

UNBAKED_GRADE = 0
PARTIAL_GRADE = PROVISIONAL
BURIED_GRADE = FINAL + 1
VOID_GRADE = FINAL + 2
"""Grades of texels besides CONVERGING and FINAL: nothing baked, not all layers baked, buried, void.

The latter two take nothing from a point's state.
"""


class Lattice(NamedTuple):
    """Texels along z, y, x, and texels per voxel along x, y, z; chunks have 1 << ``bits`` texels
    along each side.
    """

    shape: Shape
    density: tuple[float, float, float]
    bits: int

    @classmethod
    def of(
        cls, shape: Shape, density: tuple[float, float, float], chunk: int = DEFAULT_CHUNK_SIDE
    ) -> "Lattice":
        """The lattice whose ``chunk`` has this number of texels along each side, a power of two up
        to 32.
        """
        return cls(shape, density, chunk.bit_length() - 1)

    @property
    def chunk(self) -> int:
        """Texels along each side of a chunk."""
        return 1 << self.bits

    @property
    def rows(self) -> int:
        """Rows of texels along x of a chunk."""
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
        """Lattice indices (z, y, x) of the texels at ``offsets`` of the chunk ``index`` (z, y, x);
        (m, 3) int32.
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
    """The lower of the two texels along one axis around coordinate ``p`` (voxels), and the fraction
    beyond it.

    Texels are unsigned: places that are made of them are then known not to count from an array's
    end.
    """
    q = p * density
    t = min(max(int(math.floor(q)), 0), n - 2)
    return np.uint32(t), min(max(q - t, 0.0), 1.0)


@kernel()
def base_texel(lattice, points, m):
    """Lowest corner (z, y, x) of the lattice cell around point ``m``, and the fractions (z, y, x)
    inside it.
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
    """Fill ``lit`` (m, LIGHT_NUMBERS): linear RGB radiance, standard error of its luminance, and
    what of it is reflected light.

    All are in ``BakeSpec.unit``. ``transfer`` (row, channels, n) holds τ, ``scatter`` (row,) the
    standard error over the standard deviation of one path's luminance; ``light`` (3, n) is the
    turned environment times the albedo over ``BakeSpec.unit``, ``square`` (n,) the square of its
    luminance. The columns are those of terms that meet lights of their own, side by side; their
    first ones are ``firsts``, and those from ``straight`` on are of reflected light. Radiance is
    τ·ℓ (S1, eq. 9), cut to 0 where negative; one path's variance is τ·q - (τ·ℓ)², see
    ``bake.noise``. The sums are written out here, so that they run in vectors.
    """
    blue = transfer.shape[1] - 1
    green = min(blue, 1)
    first = np.uint64(straight)
    columns = np.uint64(transfer.shape[2])
    for m in range(rows.shape[0]):
        row = np.uint32(rows[m])
        if rows[m] < 0:
            continue
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
        even = NO_LIGHT
        for i in firsts:
            even += max(transfer[row, green, i] * square[i], NO_LIGHT)
        mean = luminance(r, g, b)
        spread = math.sqrt(max(second - mean * mean, NO_LIGHT) + LEAST_SPREAD * even)
        lit[m, 0] = max(r, NO_LIGHT)
        lit[m, 1] = max(g, NO_LIGHT)
        lit[m, 2] = max(b, NO_LIGHT)
        lit[m, 3] = scatter[row] * spread
        for c in range(3):
            lit[m, 4 + c] = min(max(reflected[c], NO_LIGHT), lit[m, c])


class Sky(NamedTuple):
    """What stands in for light that is not baked: ``lobe`` (n²) = A_l/π per coefficient, ``light``
    (3, n²) × albedo.
    """

    order: int
    lobe: Any
    light: Any


SKY = record(Sky, types.int64, types.float64[::1], types.float64[:, ::1])


@kernel()
def trilinear(c, fz, fy, fx):
    """Weight of corner ``c`` (bit 0 is x, bit 1 is y, bit 2 is z) of a cell at the fractions (z, y,
    x).
    """
    return (fz if c & 4 else 1.0 - fz) * (fy if c & 2 else 1.0 - fy) * (fx if c & 1 else 1.0 - fx)


@kernel(inline=True)
def blend_texels(corners, m, lit, fz, fy, fx):
    """Weighted sums over the eight texels of point ``m``, all of which are lit: (r, g, b,
    variance), float32.
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
        noise = w * lit[t, 3]
        r = r + w * lit[t, 0]
        g = g + w * lit[t, 1]
        b = b + w * lit[t, 2]
        variance = variance + noise * noise
    return r, g, b, variance


@kernel()
def blend_some(corners, m, grade, lit, fz, fy, fx):
    """``blend_texels`` where texels may be missing: (r, g, b, variance, weights of lit, unbaked and
    buried ones).
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
    """What ``blend_some`` found, made whole by unshadowed light about the normal ``n``: (r, g, b,
    variance).

    Buried texels count, as dark ones, where there are no others.
    """
    r, g, b, variance, weight, unbaked, buried = some
    if not weight + unbaked > 0.0:
        weight = buried
        unbaked = 0.0 if buried > 0.0 else 1.0
    if unbaked > 0.0:
        open_ = unshadowed(sky.order, sky.lobe, sky.light, n, basis)
        r = r + unbaked * open_[0]
        g = g + unbaked * open_[1]
        b = b + unbaked * open_[2]
        weight = weight + unbaked
    whole = 1.0 / weight
    return (
        np.float32(r * whole),
        np.float32(g * whole),
        np.float32(b * whole),
        np.float32(variance * whole * whole),
    )


@kernel()
def span_of(grade, corners, m):
    """Least and greatest grade of the eight texels of point ``m``."""
    least = np.uint8(VOID_GRADE)
    most = np.uint8(0)
    for c in range(8):
        own = grade[corners[m, c]]
        least, most = min(least, own), max(most, own)
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
    """Carry the texels' light ``lit`` (texels, LIGHT_NUMBERS) to the ``framebuffer`` at the pixels
    of ``SurfacePoints``.

    Trilinear (S1, section 4.2) over the texels that hold light, whose numbers are ``corners`` (m,
    8); void and buried ones are left out, and what is not baked yet stands in as unshadowed light
    about the point's normal (read only where a texel is missing). Both are counted in ``unit``, the
    radiance of 1. ``grade`` (texels,) is UNBAKED_GRADE, PARTIAL_GRADE, CONVERGING, FINAL,
    BURIED_GRADE or VOID_GRADE; a point is as good as the least of its texels.
    """
    basis = np.empty(sky.order * sky.order)
    for m in range(points.pixels.shape[0]):
        _, _, _, fz, fy, fx = base_texel(lattice, points.points, m)
        least, most = span_of(grade, corners, m)
        if PARTIAL_GRADE <= least and most <= FINAL:
            r, g, b, variance = blend_texels(corners, m, lit, fz, fy, fx)
        else:
            some = blend_some(corners, m, grade, lit, fz, fy, fx)
            r, g, b, variance = fill_in(some, point_of(points.normals, m), sky, basis)
        noise = min(math.sqrt(variance) / max(luminance(r, g, b), MIN_LIGHT), ONE_F32)
        if least <= PARTIAL_GRADE:
            error = ONE_F32
        else:
            error = noise
        state = min(max(least, PROVISIONAL), FINAL)
        put_pixel(framebuffer, points.pixels[m], (r * unit, g * unit, b * unit), state, error)
