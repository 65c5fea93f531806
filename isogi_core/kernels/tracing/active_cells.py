"""The active-cell map: cells that may hold the surface of a range of isovalues, and how far rays
may skip empty space.

The volume is divided into bricks of BRICK_CELLS³ cells. A brick without active cells has a skip
distance for each octant of directions (see ``skips``); any other has a bit for each cell.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import SINGLE_ARRAY, kernel, plain, record
from isogi_core.kernels.simd.memory import prefetch
from isogi_core.kernels.tracing.field import VOXEL_ARRAY
from isogi_core.kernels.tracing.macrocells import (
    MACROCELL_SIDE,
    RANGES,
    SINGLE_INFINITY,
    blocks_along,
    find_ranges,
)
from isogi_core.kernels.tracing.skips import fill_skips

BRICK_CELLS = 4
POSITION_ERROR = 2.0**-20
"""Largest deviation of a float32 ray from the true one, over the longest side of the volume;
twice the rounding error.
"""

VALUE_ERROR = 2.0**-19
"""Rounding error of a float32 trilinear value, over the largest magnitude of its corners."""

WORD_ARRAY = types.int32[::1]
EMPTY = types.boolean[::1]


class ActiveCells(NamedTuple):
    """The bricks of one volume for one range of isovalues; arrays are flat, x fastest.

    - ``tops`` int32 (bricks): the place of a brick with active cells in ``cells`` / BRICK_CELLS,
      less than 2²⁸; else its skip distances (see ``fill_skips``).
    - ``cells`` int32: one word for each layer of such a brick along z. Bit i = y % 4 * 4 + x % 4
      marks an active cell, bit 16 + i a cell whose aligned 2³ block has one.
    - ``margins`` float32 (bricks): values nearer to 0 have no certain sign in float32.
    - ``shape``: bricks along z, y, x.
    """

    tops: Any
    cells: Any
    margins: Any
    shape: tuple[int, int, int]

    @property
    def nbytes(self) -> int:
        """Bytes that belong to this range of isovalues alone."""
        return self.tops.nbytes + self.cells.nbytes


ACTIVE_CELLS = record(
    ActiveCells, WORD_ARRAY, WORD_ARRAY, SINGLE_ARRAY, types.UniTuple(types.int64, 3)
)


@plain
def brick_shape(shape):
    """Return the bricks along (z, y, x) of a volume of ``shape`` voxels."""
    return blocks_along(shape, BRICK_CELLS)


@kernel(types.void(VOXEL_ARRAY, types.int64, RANGES, RANGES, RANGES))
def fill_ranges(voxels, size, low, high, margins):
    """Fill ``low``, ``high`` and ``margins`` (blocks of ``size``³ cells along z, y, x); they
    serve every isovalue.
    """
    nz, ny, nx = voxels.shape
    # A float32 position may lie in a neighbouring cell, so that ranges take in one cell around each
    # block.
    stray = 3.0 * POSITION_ERROR * max(nx, ny, nz)
    find_ranges(voxels, size, 1, low, high)
    least = low.reshape(low.size)
    most = high.reshape(high.size)
    margin = margins.reshape(margins.size)
    # The margin bounds the error of a float32 value by those of its position and of its rounding.
    for b in range(margin.shape[0]):
        largest = max(abs(least[b]), abs(most[b]))
        margin[b] = stray * (most[b] - least[b]) + VALUE_ERROR * largest


GROUP = 4
"""Bricks along x that are marked together,
so that loops have a fixed length and become SIMD code.
"""

GROUP_CELLS = GROUP * BRICK_CELLS
"""Cells along x in a group."""

MAX_FINE_BRICKS = 1 << 21
"""Number of bricks up to which each has its own ranges, 24 MB;
larger volumes have ranges of macrocells.
"""


@kernel()
def below(level):
    """Return the largest float32 that is not above ``level``.

    A float32 voxel is above the one if it is above the other, so that bounds in float64 can be
    compared in float32 without error. -below(-level) is the least that is not below it.
    """
    near = np.float32(level)
    if near > level:
        return np.nextafter(near, -SINGLE_INFINITY)
    return near


@kernel()
def copy_voxels(voxels, i0, j0, k0, block):
    """Copy the voxels of a group's cells into the flat ``block``, the volume's faces repeated."""
    nz, ny, nx = voxels.shape
    place = 0
    for c in range(BRICK_CELLS + 1):
        for r in range(BRICK_CELLS + 1):
            for i in range(GROUP_CELLS + 1):
                block[place] = voxels[min(k0 + c, nz - 1), min(j0 + r, ny - 1), min(i0 + i, nx - 1)]
                place += 1


@kernel()
def at(flat, place):
    """Return ``flat[place]`` without a check for negative places."""
    return flat[np.uint64(place)]


@kernel()
def mark_layer(flat, place, row, plane, levels, marks):
    """Write the ``marks`` (GROUP_CELLS,) of a layer of cells whose first voxel is ``flat[place]``.

    ``row`` and ``plane`` are the steps to the next voxel along y and z. Bit 4 y + x % 4 of a mark
    is set unless all corners of the cell are above ``levels[0]`` or all below ``levels[1]``.
    """
    marks[:] = 0
    for r in range(BRICK_CELLS):
        for i in range(GROUP_CELLS):
            # Read the eight corners of the cell, and compare their range with the levels of its
            # block.
            p = place + r * row + i
            q = p + plane
            a = at(flat, p)
            b = at(flat, p + 1)
            c = at(flat, p + row)
            d = at(flat, p + row + 1)
            e = at(flat, q)
            f = at(flat, q + 1)
            g = at(flat, q + row)
            h = at(flat, q + row + 1)
            least, most = min(a, b, c, d, e, f, g, h), max(a, b, c, d, e, f, g, h)
            certain = (least > levels[0, i]) | (most < levels[1, i])
            marks[i] |= np.int32(0 if certain else 1) << np.int32(BRICK_CELLS * r + i % BRICK_CELLS)


@kernel()
def mark_group(block, levels, marks, words, empty, b, count):
    """Write the words of the ``count`` bricks from ``b`` on, and clear ``empty`` of those with
    active cells; ``block`` is (flat, place, row, plane) of ``mark_layer``.
    """
    flat, place, row, plane = block
    for c in range(BRICK_CELLS):
        mark_layer(flat, place + c * plane, row, plane, levels, marks)
        for g in range(count):
            first = BRICK_CELLS * g
            word = marks[first] | marks[first + 1] | marks[first + 2] | marks[first + 3]
            words[BRICK_CELLS * (b + g) + c] = word
            if word:
                empty[b + g] = False


@kernel()
def set_levels(margins, first, count, side, iso_low, iso_high, levels):
    """Write the ``levels`` (2, cells along x) beyond which cells are certainly solid or
    outside, for ``count`` blocks of ``side``³ bricks from ``first`` on.
    """
    for m in range(count):
        solid = below(iso_high + margins[first + m])
        outside = -below(margins[first + m] - iso_low)
        for i in range(BRICK_CELLS * side * m, BRICK_CELLS * side * (m + 1)):
            levels[0, i], levels[1, i] = solid, outside


@kernel()
def find_groups(ranges, side, iso_low, iso_high, k, shape, groups):
    """List the first bricks (j * bx + i) of the groups of layer ``k`` that may hold the surface
    in ``groups``; return their number.
    """
    low, high, margins = ranges
    _, by, bx = shape
    count = 0
    for j in range(by):
        for i in range(0, bx, GROUP):
            # A group may hold the surface if the range of one of its blocks, with its margin, does.
            holds = False
            first = block_at(k, j, i, side, shape)
            for m in range(first, first + across(i, side, bx)):
                holds |= (low[m] <= iso_high + margins[m]) & (high[m] >= iso_low - margins[m])
            # Write each group, and keep it if it may hold the surface: this needs no branch.
            groups[count] = j * bx + i
            count += holds
    # ``mark_bricks`` prefetches one group past the last.
    groups[count] = 0
    return count


@kernel()
def block_at(k, j, i, side, shape):
    """Return the place of the block of ``side``³ bricks that holds brick (k, j, i), of
    ``shape`` bricks along z, y, x.
    """
    _, by, bx = shape
    return ((k // side) * (-(-by // side)) + j // side) * (-(-bx // side)) + i // side


@kernel()
def across(i, side, bx):
    """Return the blocks along x in the group of bricks that begins at ``i``, of ``bx`` bricks."""
    return -(-min(GROUP, bx - i) // side)


@kernel()
def prefetch_group(flat, place, row, plane):
    """Prefetch the voxels of a group into the cache; the first is at ``place``."""
    last = flat.shape[0] - 1
    for c in range(BRICK_CELLS + 1):
        for r in range(BRICK_CELLS + 1):
            p = place + c * plane + r * row
            prefetch(flat, min(p, last))
            prefetch(flat, min(p + GROUP_CELLS, last))


BLOCK_RANGES = types.UniTuple(SINGLE_ARRAY, 3)
INTEGER = types.int64
REAL_NUMBER = types.float64


@kernel(
    types.void(
        VOXEL_ARRAY,
        BLOCK_RANGES,
        INTEGER,
        types.UniTuple(REAL_NUMBER, 2),
        INTEGER,
        INTEGER,
        WORD_ARRAY,
        EMPTY,
    )
)
def mark_bricks(voxels, ranges, side, isovalues, first, last, words, empty):
    """Write the ``words`` of the bricks in layers ``first`` to ``last`` - 1 along z, and set
    ``empty`` of those without active cells.

    Only bricks whose ``ranges`` (low, high, margins), of blocks of ``side``³ bricks, meet the
    ``isovalues`` (lowest, highest) are visited; the words of the others keep their values.
    """
    iso_low, iso_high = isovalues
    nz, ny, nx = voxels.shape
    bz, by, bx = shape = brick_shape(voxels.shape)
    flat = voxels.reshape(voxels.size)
    block = np.empty((BRICK_CELLS + 1) ** 2 * (GROUP_CELLS + 1), np.float32)
    levels = np.empty((2, GROUP_CELLS), np.float32)
    marks = np.empty(GROUP_CELLS, np.int32)
    groups = np.empty(by * (bx // GROUP + 1) + 1, np.int64)
    empty[:] = True
    for k in range(first, last):
        # Skip groups of bricks whose ranges exclude the surface.
        for n in range(find_groups(ranges, side, iso_low, iso_high, k, shape, groups)):
            j = groups[n] // bx
            i = groups[n] % bx
            i0 = i * BRICK_CELLS
            j0 = j * BRICK_CELLS
            k0 = k * BRICK_CELLS
            b = (k - first) * by * bx + groups[n]
            # Prefetch the voxels of the next group while this one is marked.
            ahead = groups[n + 1]
            prefetch_group(
                flat,
                (k0 * ny + ahead // bx * BRICK_CELLS) * nx + ahead % bx * BRICK_CELLS,
                nx,
                ny * nx,
            )
            block_first = block_at(k, j, i, side, shape)
            count = across(i, side, bx)
            set_levels(ranges[2], block_first, count, side, iso_low, iso_high, levels)
            source = flat
            place = (k0 * ny + j0) * nx + i0
            row = nx
            plane = ny * nx
            # Copy groups at the volume's faces, with the faces repeated, so that loops need no
            # bounds.
            if i0 + GROUP_CELLS >= nx or j0 + BRICK_CELLS >= ny or k0 + BRICK_CELLS >= nz:
                copy_voxels(voxels, i0, j0, k0, block)
                source = block
                place = 0
                row = GROUP_CELLS + 1
                plane = (BRICK_CELLS + 1) * (GROUP_CELLS + 1)
            mark_group(
                (source, place, row, plane), levels, marks, words, empty, b, min(GROUP, bx - i)
            )


@kernel()
def mark_blocks(cells, first):
    """Set the upper bits of the words of the brick at ``first``: cells whose aligned 2³ block
    has an active cell.
    """
    for k in range(0, BRICK_CELLS, 2):
        pair = cells[first + k] | cells[first + k + 1]
        along_x = (pair | pair >> 1) & 0x5555
        both = (along_x | along_x >> BRICK_CELLS) & 0x0505
        block = both | both << 1
        block |= block << BRICK_CELLS
        cells[first + k] |= block << 16
        cells[first + k + 1] |= block << 16


@kernel(types.void(WORD_ARRAY, EMPTY, WORD_ARRAY))
def pack_bricks(words, empty, cells):
    """Copy the ``words`` of bricks that are not ``empty`` to ``cells``, one after the other."""
    first = 0
    for b in range(empty.shape[0]):
        if not empty[b]:
            for i in range(BRICK_CELLS):
                cells[first + i] = words[BRICK_CELLS * b + i]
            mark_blocks(cells, first)
            first += BRICK_CELLS


@kernel(types.void(EMPTY, types.UniTuple(types.int64, 3), WORD_ARRAY))
def number_bricks(empty, shape, tops):
    """Write the places of bricks that are not ``empty`` in ``cells`` to ``tops``, and the skip
    distances of the others.
    """
    marked = 0
    for b in range(empty.shape[0]):
        if not empty[b]:
            tops[b] = marked
            marked += 1
    fill_skips(empty.reshape(shape), tops)


class BlockRanges(NamedTuple):
    """Ranges of the blocks of a volume, of ``side``³ bricks each; they serve every isovalue.

    ``low``, ``high`` and ``margins`` (blocks,) float32 belong to the voxels in and around each
    block; ``of_bricks`` (bricks,) are the margins of each brick's block.
    """

    low: np.ndarray
    high: np.ndarray
    margins: np.ndarray
    of_bricks: np.ndarray
    side: int


def measure_ranges(voxels, fine=MAX_FINE_BRICKS):
    """Return low, high and margins (3; blocks along z, y, x) of the bricks of a volume, or of
    its macrocells if it has more than ``fine`` bricks.
    """
    if math.prod(brick_shape(voxels.shape)) <= fine:
        size = BRICK_CELLS
    else:
        size = MACROCELL_SIDE
    found = np.empty((3, *blocks_along(voxels.shape, size)), np.float32)
    fill_ranges(voxels, size, *found)
    return found


def block_ranges(voxels, fine=MAX_FINE_BRICKS, take=np.empty, measured=None):
    """Return the BlockRanges of a volume, from the result of ``measure_ranges`` if it is given as
    ``measured``.

    ``take(count, dtype)`` allocates the margins of bricks if the ranges are of macrocells; those of
    bricks are shared.
    """
    bz, by, bx = shape = brick_shape(voxels.shape)
    if measured is None:
        low, high, margins = measure_ranges(voxels, fine)
    else:
        low, high, margins = measured
    # Ranges are of bricks, or of macrocells.
    if margins.shape == shape:
        side = 1
    else:
        side = MACROCELL_SIDE // BRICK_CELLS
    # Spread the margins of macrocells to their bricks, which the traversal reads.
    of_bricks = margins
    if side > 1:
        of_bricks = take(bz * by * bx, np.float32).reshape(shape)
        y, x = np.arange(by) // side, np.arange(bx) // side
        for z, layer in enumerate(of_bricks):
            layer[:] = margins[z // side][y[:, None], x]
    return BlockRanges(low.ravel(), high.ravel(), margins.ravel(), of_bricks.ravel(), side)


def make_active_cells(voxels, ranges, lowest, highest, run=None, take=np.empty):
    """Make the map of isovalues from ``lowest`` to ``highest``; ``ranges`` are the volume's
    ``block_ranges``.

    ``run(piece, total)`` may call ``piece(first, last)`` for parts of the work on many threads.
    Words of empty bricks take memory for one part only. ``take(count, dtype)`` allocates the arrays
    that are kept.
    """
    bz, by, bx = shape = brick_shape(voxels.shape)
    empty = np.empty(bz * by * bx, np.bool_)
    layer = by * bx
    packed = {}
    ends = (float(lowest), float(highest))

    # Mark the layers of a part, and keep only the words of bricks with active cells.
    def _mark(first, last):
        part = empty[first * layer : last * layer]
        words = np.zeros(BRICK_CELLS * len(part), np.int32)
        mark_bricks(voxels, ranges[:3], ranges.side, ends, first, last, words, part)
        packed[first] = take(BRICK_CELLS * (len(part) - np.count_nonzero(part)), np.int32)
        pack_bricks(words, part, packed[first])

    # Mark all parts, join them, and number the bricks.
    run(_mark, bz) if run else _mark(0, bz)
    cells = joined(packed, take)
    tops = take(len(empty), np.int32)
    number_bricks(empty, shape, tops)
    return ActiveCells(tops, cells, ranges.of_bricks, shape)


def joined(packed, take):
    """Join the ``packed`` words of parts in the order of their first layers; each part is freed
    once it is copied.

    There is at least one brick of zeros, which idle SIMD lanes read.
    """
    cells = take(max(sum(map(len, packed.values())), BRICK_CELLS), np.int32)
    end = 0
    cells[:BRICK_CELLS] = 0
    for first in sorted(packed):
        part = packed.pop(first)
        cells[end : end + len(part)] = part
        end += len(part)
    return cells
