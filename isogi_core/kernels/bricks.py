"""Bricks: for a range of isovalues, which cells may hold the surface, and how far it is from anywhere.

A brick is 4 × 4 × 4 cells. Its mask has a bit per cell; a brick without one has leaps over the empty
bricks around it, one for each octant of directions. A cell's bit is clear only where the field's sign is certain in the
cell and a little around it: rays may then be followed in float32 (see ``packets``).
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.field import VOXELS
from isogi_core.kernels.leaps import fill_leaps

BRICK = 4
CELLS = (1 << 16) - 1
"""The bits of a word that stand for cells."""

POSITION_ERROR = 2.0**-20
"""How far a float32 ray strays from the true one, over the longest side; twice what ``packets`` derives."""

VALUE_ERROR = 2.0**-19
"""Rounding of a float32 trilinear value, over the largest magnitude in it."""

FLAT = types.float32[::1]


class Bricks(NamedTuple):
    """The bricks of one volume for one range of isovalues; arrays are flat, x fastest.

    ``tops`` int32 (bricks): where cells are marked the brick's place in ``cells`` / BRICK, less than
    2²⁸; else its leaps (see ``leaps``). ``cells`` int32, one for each layer of a marked brick along z:
    bit i = y % 4 * 4 + x % 4 for a marked cell, and bit 16 + i where any cell of its aligned 2³ block is
    marked. ``margins`` float32 (bricks): values nearer to zero than this have no certain sign;
    ``shape`` bricks along z, y, x.
    """

    tops: Any
    cells: Any
    margins: Any
    shape: tuple[int, int, int]


WORDS = types.int32[::1]
BRICKS = record(Bricks, WORDS, WORDS, FLAT, types.UniTuple(types.int64, 3))


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
def mark_brick(voxels, i0, j0, k0, outside, solid, cells, place):
    """Write the masks of a brick to ``place``: cells with not all corners above ``solid`` or all below ``outside``.

    Returns whether there are none.
    """
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
        cells[BRICK * place + k] = word
        empty &= word == 0
        above, below = upper, lower
    return empty


@kernel()
def mark_blocks(cells, first):
    """Add the bits of 2³ blocks to the words of the brick at ``first``."""
    for k in range(0, BRICK, 2):
        pair = cells[first + k] | cells[first + k + 1]
        along_x = (pair | pair >> 1) & 0x5555
        both = (along_x | along_x >> BRICK) & 0x0505
        block = both | both << 1
        block |= block << BRICK
        cells[first + k] |= block << 16
        cells[first + k + 1] |= block << 16


@kernel(types.int64(VOXELS, FLAT, FLAT, FLAT, types.float64, types.float64, WORDS, WORDS))
def fill_bricks(voxels, low, high, margins, iso_low, iso_high, tops, cells):
    """Fill ``tops`` and ``cells`` for isovalues ``iso_low`` … ``iso_high``; the rest is from ``fill_ranges``.

    Returns how many bricks are marked; ``cells`` has room for all that their range may let be.
    """
    nz, ny, nx = voxels.shape
    bz, by, bx = -(-(nz - 1) // BRICK), -(-(ny - 1) // BRICK), -(-(nx - 1) // BRICK)
    empty = np.ones((bz, by, bx), np.bool_)
    marked = 0
    for k in range(bz):
        for j in range(by):
            for i in range(bx):
                b = (k * by + j) * bx + i
                solid, outside = iso_high + margins[b], iso_low - margins[b]
                if low[b] > solid or high[b] < outside:
                    continue
                empty[k, j, i] = mark_brick(voxels, i * BRICK, j * BRICK, k * BRICK, outside, solid, cells, marked)
                if not empty[k, j, i]:
                    mark_blocks(cells, BRICK * marked)
                    tops[b] = marked
                    marked += 1
    fill_leaps(empty, tops)
    return marked


def brick_ranges(voxels):
    """Smallest and largest voxel in and around each brick, and the margins: what serves every isovalue."""
    low, high, margins = np.empty((3, math.prod(brick_shape(voxels.shape))), np.float32)
    fill_ranges(voxels, low, high, margins)
    return low, high, margins


def make_bricks(voxels, ranges, lowest, highest):
    """The Bricks of isovalues from ``lowest`` to ``highest``; ``ranges`` are the volume's ``brick_ranges``."""
    low, high, margins = ranges
    tops = np.empty(len(margins), np.int32)
    room = np.count_nonzero((low <= highest + margins) & (high >= lowest - margins)) + 1
    cells = np.empty(BRICK * room, np.int32)
    marked = fill_bricks(voxels, low, high, margins, lowest, highest, tops, cells)
    return Bricks(tops, cells[: BRICK * max(marked, 1)].copy(), margins, brick_shape(voxels.shape))
