"""Macrocells: the smallest and largest voxel of each block of cells,
and the cells that hold an isovalue.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, plain
from isogi_core.kernels.tracing.field import VOXEL_ARRAY

MACROCELL_SIDE = 8
"""Cells along each side of a macrocell."""

SINGLE_INFINITY = np.float32(np.inf)

RANGES = types.float32[:, :, ::1]


@plain
def blocks_along(shape, size):
    """Return the number of blocks of ``size``³ cells along (z, y, x) for a volume
    of ``shape`` voxels.
    """
    nz, ny, nx = shape
    return (-(-(nz - 1) // size), -(-(ny - 1) // size), -(-(nx - 1) // size))


@kernel()
def take_planes(voxels, first, last, low, high):
    """Fill ``low`` and ``high`` (ny, nx) with the range of the voxels in planes ``first`` to
    ``last`` - 1.

    A NaN among them opens the range to (-inf, inf).
    """
    _, ny, nx = voxels.shape
    for j in range(ny):
        least, most = low[j], high[j]
        least[:] = SINGLE_INFINITY
        most[:] = -SINGLE_INFINITY
        for k in range(first, last):
            row = voxels[k, j]
            for i in range(nx):
                # NaN counts as -inf for the minimum, and as inf for the maximum.
                whole = row[i] == row[i]
                v = row[i] if whole else -SINGLE_INFINITY
                w = row[i] if whole else SINGLE_INFINITY
                least[i] = v if v < least[i] else least[i]
                most[i] = w if w > most[i] else most[i]


@kernel()
def take_rows(low, high, first, last, least, most):
    """Fill ``least`` and ``most`` (nx,) with the range of rows ``first`` to ``last`` - 1 of
    ``low`` and ``high``.
    """
    least[:] = SINGLE_INFINITY
    most[:] = -SINGLE_INFINITY
    for j in range(first, last):
        v, w = low[j], high[j]
        for i in range(least.shape[0]):
            least[i] = v[i] if v[i] < least[i] else least[i]
            most[i] = w[i] if w[i] > most[i] else most[i]


@kernel()
def window(block, size, apron, n):
    """Return the first voxel, and one past the last, of a block and ``apron`` cells around it,
    along an axis of ``n`` voxels.
    """
    return max(block * size - apron, 0), min((block + 1) * size + apron + 1, n)


@kernel()
def find_ranges(voxels, size, apron, low, high):
    """Fill ``low`` and ``high`` (blocks along z, y, x) with the range of the voxels of each block
    of ``size``³ cells.

    ``apron`` cells around the block count too. A block with a NaN gets (-inf, inf).
    """
    nz, ny, nx = voxels.shape
    planes = np.empty((2, ny, nx), np.float32)
    rows = np.empty((2, nx), np.float32)
    # Reduce the voxels along z, then y, then x: minimum and maximum are separable.
    for k in range(low.shape[0]):
        first, last = window(k, size, apron, nz)
        take_planes(voxels, first, last, planes[0], planes[1])
        for j in range(low.shape[1]):
            first, last = window(j, size, apron, ny)
            take_rows(planes[0], planes[1], first, last, rows[0], rows[1])
            for i in range(low.shape[2]):
                first, last = window(i, size, apron, nx)
                least = SINGLE_INFINITY
                most = -SINGLE_INFINITY
                for x in range(first, last):
                    least, most = min(least, rows[0, x]), max(most, rows[1, x])
                low[k, j, i] = least
                high[k, j, i] = most


@kernel(types.void(RANGES, RANGES, RANGES))
def fill_macrocells(voxels, low, high):
    """Fill ``low`` and ``high`` (mz, my, mx) from ``voxels`` (nz, ny, nx), mz = ceil((nz - 1) /
    MACROCELL_SIDE) and so on.

    A macrocell includes the voxels on all of its faces, shared ones too. One with a NaN in it gets
    (-inf, +inf), so that it is never skipped: its cells decide one by one.
    """
    find_ranges(voxels, MACROCELL_SIDE, 0, low, high)


def macrocell_shape(shape):
    """Return the number of macrocells along (z, y, x) for a volume of ``shape`` voxels."""
    return blocks_along(shape, MACROCELL_SIDE)


CELL_MARKS = types.boolean[:, :, ::1]


@kernel(types.void(VOXEL_ARRAY, types.float32, types.float32, CELL_MARKS))
def mark_cells(voxels, lowest, highest, cells):
    """Fill ``cells`` (nz - 1, ny - 1, nx - 1) with True for cells that hold an isovalue from
    ``lowest`` to ``highest``.

    Isovalues are normalised, and count from the least to the greatest corner, both included. A cell
    whose corners agree, or with a NaN, holds none.
    """
    for k in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            near = voxels[k, j]
            far = voxels[k, j + 1]
            upper = voxels[k + 1, j]
            over = voxels[k + 1, j + 1]
            row = cells[k, j]
            for i in range(row.shape[0]):
                # Take the range of the eight corners.
                a = near[i]
                b = near[i + 1]
                c = far[i]
                d = far[i + 1]
                e = upper[i]
                f = upper[i + 1]
                g = over[i]
                h = over[i + 1]
                least, most = min(a, b, c, d, e, f, g, h), max(a, b, c, d, e, f, g, h)
                # The sum is NaN if any corner is.
                total = a + b + c + d + e + f + g + h
                row[i] = (
                    (least <= highest) & (most >= lowest) & (least < most) & (not math.isnan(total))
                )
