"""Colours by data: the albedo of an isosurface from a grid of codes and a table, and how codes are sampled."""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.tracing.field import VOXELS, clamp_cell, smooth_gradient, value
from isogi_core.kernels.tracing.vec import length

NO_VALUE = 0
"""The code of a place without a value."""

LAST = 255
"""The code of the highest value; 1 is that of the lowest."""

SLACK = 1e-6
"""Voxels by which a place may lie outside of a volume and count as on its border."""


class Colours(NamedTuple):
    """The ``codes`` uint8 (nz, ny, nx) of places ``step`` (3,) voxels apart along x, y, z; no codes where none are.

    ``table`` (256, 3) float64 holds the albedo of each code, linear RGB; its first row is that of NO_VALUE.
    """

    codes: Any
    step: Any
    table: Any


NO_COLOURS = Colours(np.zeros((0, 0, 0), np.uint8), np.ones(3), np.zeros((0, 3)))
COLOURS = record(Colours, types.uint8[:, :, ::1], types.float64[::1], types.float64[:, ::1])


@kernel()
def known_code(codes, p):
    """The trilinear code at ``p``, in steps of the grid, of the corners that have a value; and the share of these."""
    nz, ny, nx = codes.shape
    i, j, k = clamp_cell(p[0], nx), clamp_cell(p[1], ny), clamp_cell(p[2], nz)
    x, y, z = min(max(p[0] - i, 0.0), 1.0), min(max(p[1] - j, 0.0), 1.0), min(max(p[2] - k, 0.0), 1.0)
    known, total = 0.0, 0.0
    for c in range(2):
        for b in range(2):
            for a in range(2):
                code = codes[k + c, j + b, i + a]
                weight = (x if a else 1.0 - x) * (y if b else 1.0 - y) * (z if c else 1.0 - z)
                if code != NO_VALUE:
                    known, total = known + weight, total + weight * code
    return (total / known if known > 0.0 else 1.0), known


@kernel()
def albedo_at(colours, p):
    """The albedo, linear RGB, of the surface at ``p`` in index space: the table between the codes around."""
    table, step = colours.table, colours.step
    code, known = known_code(colours.codes, (p[0] / step[0], p[1] / step[1], p[2] / step[2]))
    low = min(max(int(code), 1), LAST - 1)
    share = code - low
    r = known * (table[low, 0] + share * (table[low + 1, 0] - table[low, 0])) + (1.0 - known) * table[0, 0]
    g = known * (table[low, 1] + share * (table[low + 1, 1] - table[low, 1])) + (1.0 - known) * table[0, 1]
    b = known * (table[low, 2] + share * (table[low + 1, 2] - table[low, 2])) + (1.0 - known) * table[0, 2]
    return r, g, b


@kernel(types.void(COLOURS, types.float32[:, ::1], types.float32[:, ::1]))
def fill_albedos(colours, points, albedos):
    """Fill ``albedos`` (m, 3), linear RGB, of surface ``points`` (m, 3) in index space."""
    for m in range(points.shape[0]):
        p = (np.float64(points[m, 0]), np.float64(points[m, 1]), np.float64(points[m, 2]))
        albedos[m, 0], albedos[m, 1], albedos[m, 2] = albedo_at(colours, p)


@kernel(types.void(VOXELS, types.float64[:, ::1], types.float64, types.float64[::1], types.float32[:, ::1]))
def sample_layer(voxels, matrix, z, step, values):
    """Sample ``voxels`` at places of a layer ``z`` of another volume, ``step`` (3,) of whose voxels apart: trilinear.

    ``matrix`` (3, 4) is from voxel indices x, y, z of that volume to those of ``voxels``. Fills ``values`` (ny, nx),
    NaN outside.
    """
    nz, ny, nx = voxels.shape
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            x, y = column * step[0], row * step[1]
            a = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]
            b = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]
            c = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
            inside = a >= -SLACK and b >= -SLACK and c >= -SLACK
            inside = inside and a <= nx - 1 + SLACK and b <= ny - 1 + SLACK and c <= nz - 1 + SLACK
            values[row, column] = value(voxels, (a, b, c)) if inside else np.nan


@kernel(types.void(VOXELS, types.float64[::1], types.float64, types.float64[::1], types.float32[:, ::1]))
def slope_layer(voxels, spacing, z, step, values):
    """Fill ``values`` (ny, nx) with |∇ρ|, per unit of the world, at places of layer ``z`` that lie ``step`` apart.

    The gradient is smoothed with the tricubic B-spline, as normals are. ``spacing`` (3,) is that of the ``voxels``.
    """
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            g = smooth_gradient(voxels, (column * step[0], row * step[1], z))
            values[row, column] = length((g[0] / spacing[0], g[1] / spacing[1], g[2] / spacing[2]))
