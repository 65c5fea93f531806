"""Bricks: for a range of isovalues, which cells may hold the surface, and how far it is from anywhere.

A brick is 4 × 4 × 4 cells. Its mask has a bit per cell; its leap is the Chebyshev distance, in bricks,
to the nearest brick with a bit set. A cell's bit is clear only where the field's sign is certain in the
cell and a little around it: rays may then be followed in float32 (see ``packets``).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.field import VOXELS

BRICK = 4
FAR = 63
"""Longest leap, in bricks."""

LEAP = 16
"""The bit of a word at which the leap begins."""

CELLS = (1 << LEAP) - 1
"""The bits of a word that stand for cells."""

POSITION_ERROR = 2.0**-20
"""How far a float32 ray strays from the true one, over the volume's longest side; see ``scouts``."""

VALUE_ERROR = 2.0**-19
"""Rounding of a float32 trilinear value, over the largest magnitude in it."""

FLAT = types.float32[::1]


class Bricks(NamedTuple):
    """The bricks of one volume for one range of isovalues; arrays are flat, x fastest.

    ``words`` int32 (4 · bricks), one for each layer of a brick along z: bit y % 4 * 4 + x % 4 of a cell,
    and the brick's leap from bit 16 on; ``margins`` float32 (bricks): values nearer to zero than this have
    no certain sign; ``shape`` bricks along z, y, x.
    """

    words: Any
    margins: Any
    shape: tuple[int, int, int]


BRICKS = record(Bricks, types.int32[::1], FLAT, types.UniTuple(types.int64, 3))


def brick_shape(shape):
    """Bricks along (z, y, x) for a volume of ``shape`` voxels."""
    nz, ny, nx = shape
    return (-(-(nz - 1) // BRICK), -(-(ny - 1) // BRICK), -(-(nx - 1) // BRICK))


@kernel()
def wide_range(voxels, i0, j0, k0):
    """Smallest and largest voxel of a brick's cells and of the cells around it; (-inf, inf) with a NaN among them."""
    nz, ny, nx = voxels.shape
    low, high = math.inf, -math.inf
    whole = True
    for k in range(max(k0 - 1, 0), min(k0 + BRICK + 2, nz)):
        for j in range(max(j0 - 1, 0), min(j0 + BRICK + 2, ny)):
            for i in range(max(i0 - 1, 0), min(i0 + BRICK + 2, nx)):
                v = float(voxels[k, j, i])
                whole &= not math.isnan(v)
                low, high = min(low, v), max(high, v)
    return (low, high) if whole else (-math.inf, math.inf)


@kernel(types.void(VOXELS, FLAT, FLAT, FLAT))
def fill_ranges(voxels, low, high, margins):
    """Fill ``low``, ``high`` and ``margins`` (bricks,), which serve every isovalue of the volume."""
    nz, ny, nx = voxels.shape
    bz, by, bx = -(-(nz - 1) // BRICK), -(-(ny - 1) // BRICK), -(-(nx - 1) // BRICK)
    stray = 3.0 * POSITION_ERROR * max(nx, ny, nz)
    for k in range(bz):
        for j in range(by):
            for i in range(bx):
                b = (k * by + j) * bx + i
                low[b], high[b] = wide_range(voxels, i * BRICK, j * BRICK, k * BRICK)
                largest = max(abs(low[b]), abs(high[b]))
                margins[b] = stray * (high[b] - low[b]) + VALUE_ERROR * largest


@kernel()
def certain_rows(voxels, i0, j, k, level, sign):
    """Bits of the cells along x in row (j, k) of voxels whose both ends are beyond ``level`` on the side ``sign``."""
    nx = voxels.shape[2]
    row = voxels[k, j]
    word = 0
    for i in range(BRICK + 1):
        word |= (sign * float(row[min(i0 + i, nx - 1)]) > sign * level) << i
    return word & (word >> 1) & 15


@kernel()
def certain_layer(voxels, i0, j0, k, level, sign):
    """Bits of the 16 cells of a brick that lie along plane ``k`` with all corners in it beyond ``level``."""
    ny = voxels.shape[1]
    word = 0
    before = certain_rows(voxels, i0, min(j0, ny - 1), k, level, sign)
    for j in range(BRICK):
        row = certain_rows(voxels, i0, min(j0 + j + 1, ny - 1), k, level, sign)
        word |= (row & before) << (BRICK * j)
        before = row
    return word


@kernel()
def mark_brick(voxels, i0, j0, k0, outside, solid, words, b):
    """Write the masks of brick ``b``: cells with not all corners above ``solid`` or all below ``outside``."""
    nz = voxels.shape[0]
    above = certain_layer(voxels, i0, j0, k0, solid, 1.0)
    below = certain_layer(voxels, i0, j0, k0, outside, -1.0)
    empty = True
    for k in range(BRICK):
        plane = min(k0 + k + 1, nz - 1)
        upper, lower = (
            certain_layer(voxels, i0, j0, plane, solid, 1.0),
            certain_layer(voxels, i0, j0, plane, outside, -1.0),
        )
        word = CELLS & ~((above & upper) | (below & lower))
        words[BRICK * b + k] = word
        empty &= word == 0
        above, below = upper, lower
    return empty


@kernel()
def relax(leaps, shape, j, k, dj, dk, nearest):
    """Take into ``nearest`` (row of x) the leaps of the row (j + dj, k + dk) and of its neighbours along x."""
    bz, by, bx = shape
    if not (0 <= j + dj < by and 0 <= k + dk < bz):
        return
    first = ((k + dk) * by + j + dj) * bx
    row = leaps[first : first + bx]
    for i in range(bx):
        nearest[i] = min(nearest[i], row[i])
    for i in range(1, bx):
        nearest[i] = min(nearest[i], row[i - 1])
    for i in range(bx - 1):
        nearest[i] = min(nearest[i], row[i + 1])


@kernel()
def sweep(leaps, shape, way, nearest):
    """One of the two sweeps of the chessboard distance (Rosenfeld and Pfaltz 1968): ``way`` 1 forth, -1 back."""
    bz, by, bx = shape
    for kk in range(bz):
        k = kk if way > 0 else bz - 1 - kk
        for jj in range(by):
            j = jj if way > 0 else by - 1 - jj
            nearest[:] = FAR
            for dj in range(-1, 2):
                relax(leaps, shape, j, k, dj, -way, nearest)
            relax(leaps, shape, j, k, -way, 0, nearest)
            first = (k * by + j) * bx
            row = leaps[first : first + bx]
            left = FAR
            for ii in range(bx):
                i = ii if way > 0 else bx - 1 - ii
                left = min(int(row[i]), min(int(nearest[i]), left) + 1)
                row[i] = left


@kernel(types.void(VOXELS, FLAT, FLAT, FLAT, types.float64, types.float64, types.int32[::1]))
def fill_bricks(voxels, low, high, margins, iso_low, iso_high, words):
    """Fill ``words`` for isovalues ``iso_low`` … ``iso_high``; the rest is from ``fill_ranges``."""
    nz, ny, nx = voxels.shape
    bz, by, bx = -(-(nz - 1) // BRICK), -(-(ny - 1) // BRICK), -(-(nx - 1) // BRICK)
    leaps = np.empty(bz * by * bx, np.uint8)
    words[:] = 0
    for k in range(bz):
        for j in range(by):
            for i in range(bx):
                b = (k * by + j) * bx + i
                solid, outside = iso_high + margins[b], iso_low - margins[b]
                empty = low[b] > solid or high[b] < outside
                if not empty:
                    empty = mark_brick(voxels, i * BRICK, j * BRICK, k * BRICK, outside, solid, words, b)
                leaps[b] = FAR if empty else 0
    nearest = np.empty(bx, np.uint8)
    sweep(leaps, (bz, by, bx), 1, nearest)
    sweep(leaps, (bz, by, bx), -1, nearest)
    for b in range(leaps.size):
        for k in range(BRICK):
            words[BRICK * b + k] |= int(leaps[b]) << LEAP


def brick_ranges(voxels):
    """Smallest and largest voxel in and around each brick, and the margins: what serves every isovalue."""
    low, high, margins = np.empty((3, math.prod(brick_shape(voxels.shape))), np.float32)
    fill_ranges(voxels, low, high, margins)
    return low, high, margins


def make_bricks(voxels, ranges, lowest, highest):
    """The Bricks of isovalues from ``lowest`` to ``highest``; ``ranges`` are the volume's ``brick_ranges``."""
    low, high, margins = ranges
    words = np.empty(BRICK * len(margins), np.int32)
    fill_bricks(voxels, low, high, margins, lowest, highest, words)
    return Bricks(words, margins, brick_shape(voxels.shape))
