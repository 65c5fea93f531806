"""Extents of an isosurface: the first and the last cell that it passes in each row of cells."""

import math

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.field import VOXEL_ARRAY
from isogi_core.kernels.tracing.macrocells import MACROCELL_SIDE

ROW_ENDS = types.int32[:, :, ::1]


@kernel()
def holds_surface(voxels, k, j, i, level):
    """Return True if the surface passes the cell at (k, j, i): a corner is above ``level``,
    another is not, and none is NaN.
    """
    above = 0
    total = 0.0
    for n in range(8):
        corner = voxels[k + n // 4, j + n // 2 % 2, i + n % 2]
        total += corner
        above += corner > level
    return 0 < above < 8 and not math.isnan(total)


@kernel()
def first_cell(voxels, low, high, k, j, level, step):
    """Return the first cell along x of row (k, j) that holds the surface, from the low end if
    ``step`` is 1, from the high end if it is -1; -1 if none does.

    ``low`` and ``high`` are ranges of the macrocells along the row, of which those that exclude the
    level are skipped.
    """
    cells = voxels.shape[2] - 1
    blocks = low.shape[0]
    for n in range(blocks):
        # Visit macrocells in the order of the step, and the cells of those that may hold the
        # surface.
        block = n if step > 0 else blocks - 1 - n
        if low[block] <= level < high[block]:
            first = block * MACROCELL_SIDE
            last = min(first + MACROCELL_SIDE, cells)
            for m in range(last - first):
                i = first + m if step > 0 else last - 1 - m
                if holds_surface(voxels, k, j, i, level):
                    return i
    return -1


@kernel(types.void(VOXEL_ARRAY, VOXEL_ARRAY, VOXEL_ARRAY, types.float64, ROW_ENDS))
def fill_row_ends(voxels, low, high, level, ends):
    """Fill ``ends`` (2, nz - 1, ny - 1) with the first and the last cell along x that hold the
    surface at ``level``; -1 in rows without it.

    ``low`` and ``high`` are the ranges of macrocells. All points of the surface lie between these
    cells, which therefore have its convex hull.
    """
    for k in range(ends.shape[1]):
        for j in range(ends.shape[2]):
            least = low[k // MACROCELL_SIDE, j // MACROCELL_SIDE]
            most = high[k // MACROCELL_SIDE, j // MACROCELL_SIDE]
            ends[0, k, j] = first_cell(voxels, least, most, k, j, level, 1)
            ends[1, k, j] = -1
            if ends[0, k, j] >= 0:
                ends[1, k, j] = first_cell(voxels, least, most, k, j, level, -1)
