"""Macrocells: the smallest and largest voxel of each block of cells, for leaping over empty space.

They hold no isovalue, so one set serves every isosurface of the volume (Parker et al. 1998).
"""

import math

from isogi_core.kernels._jit import kernel

SIZE = 8
"""Cells along each side of a macrocell."""


@kernel()
def block_range(voxels, i0, j0, k0):
    """Smallest and largest voxel of the macrocell that begins at voxel (i0, j0, k0)."""
    nz, ny, nx = voxels.shape
    low, high = math.inf, -math.inf
    for k in range(k0, min(k0 + SIZE + 1, nz)):
        for j in range(j0, min(j0 + SIZE + 1, ny)):
            for i in range(i0, min(i0 + SIZE + 1, nx)):
                v = voxels[k, j, i]
                if math.isnan(v):
                    return -math.inf, math.inf
                low, high = min(low, v), max(high, v)
    return low, high


@kernel("void(float32[:, :, ::1], float32[:, :, ::1], float32[:, :, ::1])")
def fill_macrocells(voxels, low, high):
    """Fill ``low`` and ``high`` (mz, my, mx) from ``voxels`` (nz, ny, nx), mz = ceil((nz - 1) / SIZE) and so on.

    A macrocell takes in the voxels on all its faces, shared ones too. One with a NaN in it gets
    (-inf, +inf), so that it is never leapt over: its cells decide one by one.
    """
    nz, ny, nx = voxels.shape
    for k in range(low.shape[0]):
        for j in range(low.shape[1]):
            for i in range(low.shape[2]):
                low[k, j, i], high[k, j, i] = block_range(voxels, i * SIZE, j * SIZE, k * SIZE)


def macrocell_shape(shape):
    """Macrocells along (z, y, x) for a volume of ``shape`` voxels."""
    nz, ny, nx = shape
    return (-(-(nz - 1) // SIZE), -(-(ny - 1) // SIZE), -(-(nx - 1) // SIZE))
