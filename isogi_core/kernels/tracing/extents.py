"""Extents of an isosurface: where it begins and ends along rows of cells."""

import math

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.field import VOXEL_ARRAY
from isogi_core.kernels.tracing.macrocells import MACROCELL_SIDE

ROW_ENDS = types.int32[:, :, ::1]


@kernel()
def holds_surface(voxels, k, j, i, level):
    """Whether the surface passes the cell at (k, j, i): a corner is above ``level``, another is
    not, and none is NaN.
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
    """The first cell along x of row (k, j) that holds the surface, seen from its low end where
    ``step`` is 1, from its high end where that is -1; -1 where none does.

    ``low`` and ``high`` are ranges of the macrocells along the row: others are skipped.
    """
    cells = voxels.shape[2] - 1
    blocks = low.shape[0]
    for n in range(blocks):
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
    """Fill ``ends`` (2, nz - 1, ny - 1): the first and the last cell along x that hold the surface
    at ``level``, -1 where none of the row does.

    ``low`` and ``high`` are the ranges of macrocells. All points of the surface are between these
    cells, so that they have its convex hull.
    """
    for k in range(ends.shape[1]):
        for j in range(ends.shape[2]):
            least = low[k // MACROCELL_SIDE, j // MACROCELL_SIDE]
            most = high[k // MACROCELL_SIDE, j // MACROCELL_SIDE]
            ends[0, k, j] = first_cell(voxels, least, most, k, j, level, 1)
            ends[1, k, j] = -1
            if ends[0, k, j] >= 0:
                ends[1, k, j] = first_cell(voxels, least, most, k, j, level, -1)
