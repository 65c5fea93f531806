"""The scalar field: trilinear values, gradients and the smoothed normal.

Positions are in index space (voxel units, x first); arrays are indexed [z, y, x]. A voxel above the
isovalue is solid, so that the outward normal is minus the gradient.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel, record
from isogi_core.kernels.simd.maths import floor_within, where
from isogi_core.kernels.simd.memory import store
from isogi_core.kernels.simd.voxels import cube, four
from isogi_core.kernels.tracing.vec import column, is_zero, load_columns, put_column

VOXEL_ARRAY = types.float32[:, :, ::1]
SIXTH = 1.0 / 6.0

RAY_OFFSET_VOXELS = 0.3
"""Default offset of illumination rays above the surface,
in voxels along the normal (S1, section 4.1.1).
"""


class Field(NamedTuple):
    """A volume as rays need it.

    - ``voxels`` float32 (nz, ny, nx).
    - ``low``, ``high`` float32 (mz, my, mx): smallest and largest voxel of each macrocell.
    - ``spacing``: world length of a voxel step along x, y, z.
    - ``smooth``: True if normals come from the smoothed gradient, False for the plain one.
    - ``offset``: voxels above the surface at which rays start.
    """

    voxels: Any
    low: Any
    high: Any
    spacing: tuple[float, float, float]
    smooth: bool = True
    offset: float = RAY_OFFSET_VOXELS


FIELD_RECORD = record(
    Field,
    VOXEL_ARRAY,
    VOXEL_ARRAY,
    VOXEL_ARRAY,
    types.UniTuple(types.float64, 3),
    types.boolean,
    types.float64,
)


@kernel()
def clamp_cell(x, n):
    """Return the cell along an axis of ``n`` voxels that holds coordinate ``x``; the last face
    belongs to the last cell.
    """
    return floor_within(x, n - 2)


@kernel(exact=True)
def value(voxels, p):
    """Return the trilinear value at ``p`` (index space), float64: the field ρ(x) of S1, section
    4.1. Takes vectors of points as well.
    """
    nz, ny, nx = voxels.shape
    i = floor_within(p[0], nx - 2)
    j = floor_within(p[1], ny - 2)
    k = floor_within(p[2], nz - 2)
    x, y, z = p[0] - i, p[1] - j, p[2] - k
    c = cube(voxels, k, j, i)
    near = (1.0 - z) * (1.0 - y) * (c[0] + x * (c[1] - c[0])) + (1.0 - z) * y * (
        c[2] + x * (c[3] - c[2])
    )
    far = z * (1.0 - y) * (c[4] + x * (c[5] - c[4])) + z * y * (c[6] + x * (c[7] - c[6]))
    return near + far


@kernel(exact=True)
def gradient(voxels, p):
    """Return the gradient of the trilinear field at ``p``, per voxel step along x, y, z (S1,
    figure 5, "gradient").
    """
    nz, ny, nx = voxels.shape
    i, j, k = clamp_cell(p[0], nx), clamp_cell(p[1], ny), clamp_cell(p[2], nz)
    x, y, z = p[0] - i, p[1] - j, p[2] - k
    gx, gy, gz = 0.0, 0.0, 0.0
    # Sum over the cell's four edges along x: trilinear weights, or slopes along the axis of a
    # component.
    for c in range(2):
        wz, sz = (z, 1.0) if c else (1.0 - z, -1.0)
        for b in range(2):
            wy, sy = (y, 1.0) if b else (1.0 - y, -1.0)
            v0 = np.float64(voxels[k + c, j + b, i])
            v1 = np.float64(voxels[k + c, j + b, i + 1])
            along = v0 + x * (v1 - v0)
            gx += wz * wy * (v1 - v0)
            gy += wz * sy * along
            gz += sz * wy * along
    return (gx, gy, gz)


@kernel(exact=True)
def bspline(f):
    """Return the four cubic B-spline weights at fraction ``f`` in [0, 1], for voxels -1, 0, 1,
    2. They sum to 1.
    """
    g = 1.0 - f
    return (
        SIXTH * (g * g * g),
        SIXTH * (4.0 + f * f * (3.0 * f - 6.0)),
        SIXTH * (4.0 + g * g * (3.0 * g - 6.0)),
        SIXTH * (f * f * f),
    )


@kernel(exact=True)
def bspline_slope(f):
    """Return the derivatives of the four cubic B-spline weights at fraction ``f``.
    They sum to 0.
    """
    g = 1.0 - f
    return (-0.5 * g * g, f * (1.5 * f - 2.0), -g * (1.5 * g - 2.0), 0.5 * f * f)


@kernel(exact=True)
def blend(w, a, b, c, d):
    """Return the sum of four numbers, or of four tuples, with weights ``w``."""
    return w[0] * a + w[1] * b + (w[2] * c + w[3] * d)


@kernel(exact=True)
def blend_cube(voxels, cell, weights, slopes):
    """Return the gradient of the tricubic B-spline over 4×4×4 voxels around ``cell`` (i, j, k).

    ``weights`` and ``slopes`` hold the four spline weights and their derivatives along x, y and z.
    A component has the slopes along its axis, and the weights along the other two. Voxels beyond
    the border repeat the border's.
    """
    (i, j, k) = cell
    (wx, wy, wz) = weights
    (sx, sy, sz) = slopes
    nz, ny, _ = voxels.shape
    j0 = max(j - 1, 0)
    j2 = j + 1
    j3 = min(j + 2, ny - 1)
    k0 = max(k - 1, 0)
    k2 = k + 1
    k3 = min(k + 2, nz - 1)
    # Blend rows along y, in each of four planes: values and slopes.
    a = four(voxels, k0, j0, i)
    b = four(voxels, k0, j, i)
    c = four(voxels, k0, j2, i)
    d = four(voxels, k0, j3, i)
    v0, s0 = blend(wy, a, b, c, d), blend(sy, a, b, c, d)
    a = four(voxels, k, j0, i)
    b = four(voxels, k, j, i)
    c = four(voxels, k, j2, i)
    d = four(voxels, k, j3, i)
    v1, s1 = blend(wy, a, b, c, d), blend(sy, a, b, c, d)
    a = four(voxels, k2, j0, i)
    b = four(voxels, k2, j, i)
    c = four(voxels, k2, j2, i)
    d = four(voxels, k2, j3, i)
    v2, s2 = blend(wy, a, b, c, d), blend(sy, a, b, c, d)
    a = four(voxels, k3, j0, i)
    b = four(voxels, k3, j, i)
    c = four(voxels, k3, j2, i)
    d = four(voxels, k3, j3, i)
    v3, s3 = blend(wy, a, b, c, d), blend(sy, a, b, c, d)
    # Blend the planes along z, then the four columns along x.
    x = blend(wz, v0, v1, v2, v3)
    y = blend(wz, s0, s1, s2, s3)
    z = blend(sz, v0, v1, v2, v3)
    return (
        blend(sx, x[0], x[1], x[2], x[3]),
        blend(wx, y[0], y[1], y[2], y[3]),
        blend(wx, z[0], z[1], z[2], z[3]),
    )


@kernel(exact=True)
def smooth_gradient(voxels, p):
    """Return the gradient of the smoothed field at ``p`` (index space), per voxel step along x, y,
    z (S1, section 4.1.1 and figure 5).

    The smoothed field is the tricubic B-spline with the voxels, 4×4×4 of them at each point, as its
    coefficients. It does not pass through their values.
    """
    nz, ny, nx = voxels.shape
    i, j, k = clamp_cell(p[0], nx), clamp_cell(p[1], ny), clamp_cell(p[2], nz)
    x, y, z = p[0] - i, p[1] - j, p[2] - k
    weights = (bspline(x), bspline(y), bspline(z))
    slopes = (bspline_slope(x), bspline_slope(y), bspline_slope(z))
    return blend_cube(voxels, (i, j, k), weights, slopes)


@kernel(exact=True)
def put_weights(p, n, out):
    """Write the B-spline weights (rows 0 to 3), slopes (4 to 7) and cells (8) of a vector of N
    coordinates ``p`` along an axis of ``n`` voxels to ``out`` (9, N).
    """
    i = floor_within(p, n - 2)
    for a, w in enumerate(bspline(p - i)):
        store(out[a], 0, w)
    for a, s in enumerate(bspline_slope(p - i)):
        store(out[4 + a], 0, s)
    store(out[8], 0, i)


@kernel()
def four_at(rows, first, lane):
    """Return element ``lane`` of four rows."""
    return rows[first, lane], rows[first + 1, lane], rows[first + 2, lane], rows[first + 3, lane]


@kernel()
def smooth_gradients(voxels, points, first, lanes, w, out):
    """Write ``smooth_gradient`` at ``lanes`` columns of ``points`` (3, n), from ``first`` on, to
    the same columns of ``out``.

    n is a multiple of the vector width; ``w`` (3, 9, PATH_WIDTH) is scratch space for cells,
    weights and slopes.
    """
    nz, ny, nx = voxels.shape
    p = load_columns(points, first)
    put_weights(p[0], nx, w[0])
    put_weights(p[1], ny, w[1])
    put_weights(p[2], nz, w[2])
    for lane in range(lanes):
        i, j, k = int(w[0, 8, lane]), int(w[1, 8, lane]), int(w[2, 8, lane])
        wx, wy, wz = four_at(w[0], 0, lane), four_at(w[1], 0, lane), four_at(w[2], 0, lane)
        sx, sy, sz = four_at(w[0], 4, lane), four_at(w[1], 4, lane), four_at(w[2], 4, lane)
        put_column(out, first + lane, blend_cube(voxels, (i, j, k), (wx, wy, wz), (sx, sy, sz)))


@kernel()
def gradients(field, points, first, lanes, w, out):
    """Write the gradients that normals derive from: ``smooth_gradients``, or plain gradients if
    ``field.smooth`` is False.
    """
    if field.smooth:
        smooth_gradients(field.voxels, points, first, lanes, w, out)
    else:
        for m in range(first, first + lanes):
            put_column(out, m, gradient(field.voxels, column(points, m)))


@kernel(exact=True)
def to_index(v, spacing):
    """Convert a world vector to index space."""
    return (v[0] / spacing[0], v[1] / spacing[1], v[2] / spacing[2])


@kernel(exact=True)
def to_world_normal(g, spacing):
    """Return the unit outward world normal of a gradient per voxel step; (0, 0, 0) if the
    gradient is 0 or NaN. Takes vectors as well.
    """
    x, y, z = -g[0] / spacing[0], -g[1] / spacing[1], -g[2] / spacing[2]
    size = math.sqrt(x * x + y * y + z * z)
    known = (size > 0.0) & (size < math.inf)
    share = 1.0 / where(known, size, 1.0)
    return where(known, x * share, 0.0), where(known, y * share, 0.0), where(known, z * share, 0.0)


@kernel()
def normal(field, p):
    """Return the unit outward world normal of the isosurface through ``p``.

    It comes from the smoothed gradient, or from the plain one if ``field.smooth`` is False or the
    smoothed one is 0 or NaN. It is (0, 0, 0) if both are: a plateau has no surface.
    """
    n = (0.0, 0.0, 0.0)
    if field.smooth:
        n = to_world_normal(smooth_gradient(field.voxels, p), field.spacing)
    if is_zero(n):
        n = to_world_normal(gradient(field.voxels, p), field.spacing)
    return n
