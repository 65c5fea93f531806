"""The scalar field: trilinear values, gradients and the smoothed normal.

Positions are in index space (voxel units, x first); arrays are indexed [z, y, x]. A voxel above the
isovalue is solid, so that the outward normal is minus the gradient.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.vec import length, scale

VOXELS = types.float32[:, :, ::1]


class Field(NamedTuple):
    """What a ray needs of a volume.

    ``voxels`` float32 (nz, ny, nx); ``low`` and ``high`` float32 (mz, my, mx), the smallest and
    largest voxel of each macrocell; ``spacing`` world length of a voxel step along x, y, z.
    """

    voxels: Any
    low: Any
    high: Any
    spacing: tuple[float, float, float]


FIELD = record(Field, VOXELS, VOXELS, VOXELS, types.UniTuple(types.float64, 3))


@kernel()
def clamp_cell(x, n):
    """Index of the cell along one axis of ``n`` voxels that holds coordinate ``x``; the last face belongs to it."""
    return min(max(int(math.floor(x)), 0), n - 2)


@kernel()
def value(voxels, p):
    """Trilinear value at ``p`` (index space), float64. Source: S1, section 4.1, the field ρ(x)."""
    nz, ny, nx = voxels.shape
    i, j, k = clamp_cell(p[0], nx), clamp_cell(p[1], ny), clamp_cell(p[2], nz)
    x, y, z = p[0] - i, p[1] - j, p[2] - k
    total = 0.0
    for c in range(2):
        wz = z if c else 1.0 - z
        for b in range(2):
            wy = y if b else 1.0 - y
            v0, v1 = np.float64(voxels[k + c, j + b, i]), np.float64(voxels[k + c, j + b, i + 1])
            total += wz * wy * (v0 + x * (v1 - v0))
    return total


@kernel()
def gradient(voxels, p):
    """Gradient of the trilinear field at ``p``, per voxel step along x, y, z. Source: S1, figure 5, 'gradient'."""
    nz, ny, nx = voxels.shape
    i, j, k = clamp_cell(p[0], nx), clamp_cell(p[1], ny), clamp_cell(p[2], nz)
    x, y, z = p[0] - i, p[1] - j, p[2] - k
    gx, gy, gz = 0.0, 0.0, 0.0
    for c in range(2):
        wz, sz = (z, 1.0) if c else (1.0 - z, -1.0)
        for b in range(2):
            wy, sy = (y, 1.0) if b else (1.0 - y, -1.0)
            v0, v1 = np.float64(voxels[k + c, j + b, i]), np.float64(voxels[k + c, j + b, i + 1])
            along = v0 + x * (v1 - v0)
            gx += wz * wy * (v1 - v0)
            gy += wz * sy * along
            gz += sz * wy * along
    return (gx, gy, gz)


@kernel()
def bspline(f):
    """The four cubic B-spline weights at fraction ``f`` in [0, 1], for voxels -1, 0, 1, 2. They sum to 1."""
    g = 1.0 - f
    return (
        g * g * g / 6.0,
        (4.0 + f * f * (3.0 * f - 6.0)) / 6.0,
        (4.0 + g * g * (3.0 * g - 6.0)) / 6.0,
        f * f * f / 6.0,
    )


@kernel()
def bspline_slope(f):
    """Derivatives of the four cubic B-spline weights at fraction ``f``. They sum to 0."""
    g = 1.0 - f
    return (-0.5 * g * g, f * (1.5 * f - 2.0), -g * (1.5 * g - 2.0), 0.5 * f * f)


@kernel()
def smooth_gradient(voxels, p):
    """Gradient of the field smoothed with the tricubic B-spline over 4×4×4 voxels, per voxel step.

    Voxels beyond the border repeat the border's. Source: S1, section 4.1.1 and figure 5.
    """
    nz, ny, nx = voxels.shape
    i, j, k = clamp_cell(p[0], nx), clamp_cell(p[1], ny), clamp_cell(p[2], nz)
    wx, wy, wz = bspline(p[0] - i), bspline(p[1] - j), bspline(p[2] - k)
    sx, sy, sz = bspline_slope(p[0] - i), bspline_slope(p[1] - j), bspline_slope(p[2] - k)
    i0, i3 = max(i - 1, 0), min(i + 2, nx - 1)
    gx, gy, gz = 0.0, 0.0, 0.0
    for c in range(4):
        slab = voxels[min(max(k + c - 1, 0), nz - 1)]
        px, py, pz = 0.0, 0.0, 0.0
        for b in range(4):
            row = slab[min(max(j + b - 1, 0), ny - 1)]
            v0, v1, v2, v3 = np.float64(row[i0]), np.float64(row[i]), np.float64(row[i + 1]), np.float64(row[i3])
            along = wx[0] * v0 + wx[1] * v1 + wx[2] * v2 + wx[3] * v3
            px += wy[b] * (sx[0] * v0 + sx[1] * v1 + sx[2] * v2 + sx[3] * v3)
            py += sy[b] * along
            pz += wy[b] * along
        gx += wz[c] * px
        gy += wz[c] * py
        gz += sz[c] * pz
    return (gx, gy, gz)


@kernel()
def to_world_normal(g, spacing):
    """Unit outward normal of a gradient given per voxel step; (0, 0, 0) where the gradient says nothing."""
    n = (-g[0] / spacing[0], -g[1] / spacing[1], -g[2] / spacing[2])
    size = length(n)
    if not (size > 0.0 and size < math.inf):
        return (0.0, 0.0, 0.0)
    return scale(n, 1.0 / size)


@kernel()
def normal(field, p):
    """Unit outward world normal of the isosurface through ``p`` from the smoothed gradient.

    Falls back to the cell's own gradient where the smoothed one is zero or not a number, and is
    (0, 0, 0) where that is zero too: on a plateau there is no surface.
    """
    n = to_world_normal(smooth_gradient(field.voxels, p), field.spacing)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        n = to_world_normal(gradient(field.voxels, p), field.spacing)
    return n
