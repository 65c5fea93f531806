"""Normals of texels, about which their light arrives. They are computed for the texels of each
view, as no store keeps them.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, kernel
from isogi_core.kernels.shading.surface_points import POINT_ROWS
from isogi_core.kernels.tracing.field import FIELD_RECORD, SIXTH, normal, to_world_normal
from isogi_core.kernels.tracing.stiffness import point_within
from isogi_core.kernels.tracing.vec import is_zero
from isogi_core.kernels.transport.transfer import TEXEL_PLACES, way_to

NEARLY = 8
"""Number of halvings that find the place of a projected texel to 1/4000 of a voxel:
enough for its normal.
"""


@kernel()
def blur_row(voxels, k, j, i0, i, i2):
    """Return value and slope along x, at voxel ``i`` of a row, of the cubic B-spline whose
    coefficients are the voxels; ``i0`` and ``i2`` are the neighbours of ``i``.

    At a voxel its weights are (1, 4, 1)/6, and those of its derivative (-1, 0, 1)/2.
    """
    low = np.float64(voxels[k, j, i0])
    here = np.float64(voxels[k, j, i])
    high = np.float64(voxels[k, j, i2])
    return SIXTH * (low + high) + 4.0 * SIXTH * here, 0.5 * (high - low)


@kernel()
def plane_of(voxels, k, j0, j, j2, i0, i, i2):
    """Return the smoothed value of plane ``k`` at voxel (j, i), and its slopes along y and x."""
    a = blur_row(voxels, k, j0, i0, i, i2)
    b = blur_row(voxels, k, j, i0, i, i2)
    c = blur_row(voxels, k, j2, i0, i, i2)
    return (
        SIXTH * (a[0] + c[0]) + 4.0 * SIXTH * b[0],
        0.5 * (c[0] - a[0]),
        SIXTH * (a[1] + c[1]) + 4.0 * SIXTH * b[1],
    )


@kernel()
def voxel_gradient(voxels, k, j, i):
    """Return ``smooth_gradient`` at voxel (k, j, i), which needs 27 voxels there instead of 64;
    voxels beyond the border repeat the border's.
    """
    nz, ny, nx = voxels.shape
    # Repeat the border's voxels beyond it.
    i0 = max(i - 1, 0)
    i2 = min(i + 1, nx - 1)
    j0 = max(j - 1, 0)
    j2 = min(j + 1, ny - 1)
    # Smooth two axes of each component, and take the slope along the third.
    a = plane_of(voxels, max(k - 1, 0), j0, j, j2, i0, i, i2)
    b = plane_of(voxels, k, j0, j, j2, i0, i, i2)
    c = plane_of(voxels, min(k + 1, nz - 1), j0, j, j2, i0, i, i2)
    return (
        SIXTH * (a[2] + c[2]) + 4.0 * SIXTH * b[2],
        SIXTH * (a[1] + c[1]) + 4.0 * SIXTH * b[1],
        0.5 * (c[0] - a[0]),
    )


@kernel()
def texel_normal(field, step, texels, m):
    """Return the normal at the lattice point of texel ``m``, and that point in index space.

    ``step`` (3,) is voxels per texel along x, y, z.
    """
    p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
    n = (0.0, 0.0, 0.0)
    # At voxels, the smoothed gradient is cheaper: 27 voxels, and weights without fractions.
    if field.smooth and step[0] == 1.0 and step[1] == 1.0 and step[2] == 1.0:
        gradient = voxel_gradient(field.voxels, texels[m, 0], texels[m, 1], texels[m, 2])
        n = to_world_normal(gradient, field.spacing)
    return normal(field, p) if is_zero(n) else n, p


@kernel(exact=True)
def normal_there(field, p, n, level):
    """Return the normal at the place on the isosurface ``level`` that ``p``, whose normal is
    ``n``, is projected to; (0, 0, 0) if it is out of reach.
    """
    if is_zero(n):
        return n
    d, t = way_to(field, p, n, level, NEARLY)
    if t < math.inf:
        return normal(field, point_within(field.voxels.shape, p, d, t))
    return (0.0, 0.0, 0.0)


@kernel(
    types.void(FIELD_RECORD, REAL_ARRAY, types.float64, types.boolean, TEXEL_PLACES, POINT_ROWS)
)
def fill_texel_normals(field, step, level, projected, texels, normals):
    """Fill ``normals`` (m, 3), outward unit world ones, of the ``texels`` (m, 3; z, y, x).

    Normals are those at the texels' lattice points or, if ``projected``, at the places on the
    isosurface ``level`` (a voxel-space isovalue) that ``project_texels`` moves them to; no other
    reason to leave a texel in place is tested. ``step`` (3,) is voxels per texel along x, y, z.
    Normals are (0, 0, 0) if the field has no gradient or the level is out of reach. Texels at the
    edge of a plateau, whose light is computed about a voxel away along the gradient, keep the
    normals of their lattice points.
    """
    for m in range(texels.shape[0]):
        n, p = texel_normal(field, step, texels, m)
        if projected:
            n = normal_there(field, p, n, level)
        normals[m, 0], normals[m, 1], normals[m, 2] = n


KEY_ARRAY = types.uint64[::1]
"""Type of the keys of a hash table: number of a texel plus 1, 0 for a free place. A texel is at
the first free place from its hash on (linear probing).
"""

HASH_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
"""An odd number near 2⁶⁴ over the golden ratio: its multiples scatter consecutive numbers over
all places (Knuth, "The Art of Computer Programming", section 6.4).
"""


@kernel()
def slot_of(number, keys):
    """Return the place of texel ``number`` in a table of ``keys``, whose length is a power of
    two, or the free place where it may be put.

    The table must have a free place, else the search for a texel that it lacks does not end.
    """
    last = np.uint64(keys.shape[0] - 1)
    key = number + np.uint64(1)
    at = ((number * HASH_MULTIPLIER) >> np.uint64(32)) & last
    while keys[at] != key and keys[at] != np.uint64(0):
        at = (at + np.uint64(1)) & last
    return at


@kernel(types.void(KEY_ARRAY, KEY_ARRAY, POINT_ROWS, POINT_ROWS, types.boolean[::1]))
def look_up_normals(numbers, keys, table, normals, found):
    """Fill ``normals`` (m, 3) of those texels ``numbers`` (m,) that a ``table`` holds, and set
    ``found`` (m,) for these.
    """
    for m in range(numbers.shape[0]):
        at = slot_of(numbers[m], keys)
        found[m] = keys[at] != np.uint64(0)
        if found[m]:
            normals[m, 0], normals[m, 1], normals[m, 2] = table[at, 0], table[at, 1], table[at, 2]


@kernel(types.void(KEY_ARRAY, POINT_ROWS, KEY_ARRAY, POINT_ROWS))
def keep_normals(numbers, normals, keys, table):
    """Put the ``normals`` (m, 3) of the texels ``numbers`` (m,) into a ``table``
    that has more free places than these.
    """
    for m in range(numbers.shape[0]):
        at = slot_of(numbers[m], keys)
        keys[at] = numbers[m] + np.uint64(1)
        table[at, 0], table[at, 1], table[at, 2] = normals[m, 0], normals[m, 1], normals[m, 2]
