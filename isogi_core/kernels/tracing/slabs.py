"""Rays against boxes: the part of a ray in a volume or a cell, and the face by which it leaves a
block.

All but the step from block to block takes numbers and vectors, and gives the same bits for both.
"""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import divide, where


@kernel()
def longest(d):
    """Return the magnitude of the largest component of a direction."""
    return max(max(abs(d[0]), abs(d[1])), abs(d[2]))


@kernel()
def clip(o, d, n, near, far):
    """Return the part of [near, far] in which o + t·d is in [0, n - 1] along one axis; it is
    empty if near > far.
    """
    still = d == 0.0
    a = divide(-o, d)
    b = divide(n - 1 - o, d)
    within = (o >= 0.0) & (o <= n - 1.0)
    first = where(still, where(within, near, math.inf), max(near, min(a, b)))
    return first, where(still, where(within, far, -math.inf), min(far, max(a, b)))


@kernel()
def clip_box(shape, o, d):
    """Return the part (near, far) of the ray o + t·d, t ≥ 0,
    in the box of ``shape`` (nz, ny, nx) voxels.
    """
    nz, ny, nx = shape
    near, far = clip(o[0], d[0], nx, 0.0, math.inf)
    near, far = clip(o[1], d[1], ny, near, far)
    return clip(o[2], d[2], nz, near, far)


@kernel(exact=True)
def reciprocal(d):
    """Return 1 / d of a direction's component; 0 if it is 0 or too small to leave a cell by."""
    inverse = divide(1.0, d)
    return where(abs(inverse) < math.inf, inverse, 0.0)


@kernel(exact=True)
def reciprocals(d):
    """Return ``reciprocal`` of each component of a direction."""
    return reciprocal(d[0]), reciprocal(d[1]), reciprocal(d[2])


@kernel(exact=True)
def cut_slab(o, inv, i, near, far):
    """Return the part of [near, far] in which the ray is in cell ``i`` along one axis; ``inv``
    is the ``reciprocal``.
    """
    still = inv == 0.0
    a = (i - o) * inv
    b = (i + 1.0 - o) * inv
    return where(still, near, max(near, min(a, b))), where(still, far, min(far, max(a, b)))


@kernel(exact=True)
def cut_cell(o, inv, cell, near, far):
    """Return the part of [near, far] in which the ray is in ``cell``; its bits do not depend on
    how the ray got there.
    """
    near, far = cut_slab(o[0], inv[0], cell[0], near, far)
    near, far = cut_slab(o[1], inv[1], cell[1], near, far)
    return cut_slab(o[2], inv[2], cell[2], near, far)


@kernel()
def next_face(o, inv, i, size):
    """Return the ray parameter at which the ray leaves block ``i`` of ``size`` cells along one
    axis; infinite if it never does.
    """
    if inv > 0.0:
        return ((i + 1) * size - o) * inv
    if inv < 0.0:
        return (i * size - o) * inv
    return math.inf


@kernel()
def leave_block(o, inv, block, size):
    """Return the exit of the ray from a cubic block: (t, steps along x, y, z to the next
    block); one step is ±1, the others are 0.
    """
    tx = next_face(o[0], inv[0], block[0], size)
    ty = next_face(o[1], inv[1], block[1], size)
    tz = next_face(o[2], inv[2], block[2], size)
    if tx <= ty and tx <= tz:
        return tx, 1 if inv[0] > 0.0 else -1, 0, 0
    if ty <= tz:
        return ty, 0, 1 if inv[1] > 0.0 else -1, 0
    return tz, 0, 0, 1 if inv[2] > 0.0 else -1
