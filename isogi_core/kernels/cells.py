"""Cells: which of a volume's cells may show an isosurface of a range of isovalues."""

import math

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import VOXELS

MARKS = types.boolean[:, :, ::1]


@kernel(types.void(VOXELS, types.float32, types.float32, MARKS))
def mark_cells(voxels, lowest, highest, cells):
    """Fill ``cells`` (nz - 1, ny - 1, nx - 1): whether an isovalue lies between the least and greatest corner.

    Both are included, and isovalues go from ``lowest`` to ``highest``, both normalised. A cell whose corners agree, or
    with a NaN, has none.
    """
    for k in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            near, far = voxels[k, j], voxels[k, j + 1]
            upper, over = voxels[k + 1, j], voxels[k + 1, j + 1]
            row = cells[k, j]
            for i in range(row.shape[0]):
                a, b, c, d = near[i], near[i + 1], far[i], far[i + 1]
                e, f, g, h = upper[i], upper[i + 1], over[i], over[i + 1]
                least, most = min(a, b, c, d, e, f, g, h), max(a, b, c, d, e, f, g, h)
                total = a + b + c + d + e + f + g + h
                row[i] = (least <= highest) & (most >= lowest) & (least < most) & (not math.isnan(total))
