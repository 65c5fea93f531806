"""Rays against an isosurface of the trilinear field.

Along a ray a cell's field is a cubic. Four rules keep the surface closed (references: reliability,
section 4): solid is value > isovalue, half-open; a cell whose corners agree has no surface; the side
on which a ray leaves a cell is the side on which it enters the next; and a ray that starts on its own
surface is told its side, it does not ask the value.
"""

import math

import numpy as np

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import clamp_cell
from isogi_core.kernels.macrocells import SIZE
from isogi_core.kernels.vec import madd

OUTSIDE = 1
SOLID = -1
UNKNOWN = 0
REFINEMENTS = 48

SLIVER = 1e-5
"""Way through a cell, in voxels, below which values are rounding: more than a root's own error.

That is the cubic root of rounding where the field hardly leaves the isovalue, at the edge of a mask.
"""

BLUR = 2e-15
"""Rounding of a cubic's values, over the largest corner value and for each voxel of the volume's longest side.

A turn that is nearer to 0 only touches it. Three roundings of a place lie between the ray and its cell, each of them
of half a bit of a coordinate, and six times the largest corner is what the field changes by at most in a voxel.
"""

SKIN = 2.0 * SLIVER
"""Voxels along a ray, whose side is not known, that it may begin behind the surface and still be outside.

So a surface that lies in a face of the box is met from outside, wherever rounding or a sliver lets rays begin.
"""


@kernel()
def clip(o, d, n, near, far):
    """Part of [near, far] in which o + t·d is within 0 … n - 1 along one axis; empty when near > far."""
    if d == 0.0:
        return (near, far) if 0.0 <= o <= n - 1 else (math.inf, -math.inf)
    a, b = -o / d, (n - 1 - o) / d
    return max(near, min(a, b)), min(far, max(a, b))


@kernel()
def clip_box(voxels, o, d):
    """Part (near, far) of the ray o + t·d, t ≥ 0, inside the volume's box."""
    nz, ny, nx = voxels.shape
    near, far = clip(o[0], d[0], nx, 0.0, math.inf)
    near, far = clip(o[1], d[1], ny, near, far)
    return clip(o[2], d[2], nz, near, far)


@kernel()
def reciprocal(d):
    """1 / d of a ray direction's component, 0 where the component is 0 or too small to leave a cell by."""
    inverse = 1.0 / d if d != 0.0 else 0.0
    return inverse if abs(inverse) < math.inf else 0.0


@kernel()
def next_face(o, inv, i, size):
    """Ray parameter at which the ray leaves block ``i`` (of ``size`` cells) along one axis; inf if it never does.

    ``inv`` is the reciprocal of the direction's component.
    """
    if inv > 0.0:
        return ((i + 1) * size - o) * inv
    if inv < 0.0:
        return (i * size - o) * inv
    return math.inf


@kernel()
def leave_block(o, inv, block, size):
    """Where the ray leaves a cubic block: (t, steps along x, y, z), one step being ±1 and the others 0."""
    tx = next_face(o[0], inv[0], block[0], size)
    ty = next_face(o[1], inv[1], block[1], size)
    tz = next_face(o[2], inv[2], block[2], size)
    if tx <= ty and tx <= tz:
        return tx, 1 if inv[0] > 0.0 else -1, 0, 0
    if ty <= tz:
        return ty, 0, 1 if inv[1] > 0.0 else -1, 0
    return tz, 0, 0, 1 if inv[2] > 0.0 else -1


@kernel(exact=True)
def cubic_along(c, a, d):
    """Coefficients (A, B, C, D) of f(t) = A t³ + B t² + C t + D along a + t·d in the unit cell.

    ``c`` = (c000, c100, c010, c110, c001, c101, c011, c111) corner values, first index x.
    """
    x, y, z = c[1] - c[0], c[2] - c[0], c[4] - c[0]
    xy, xz, yz = c[3] - c[2] - x, c[5] - c[4] - x, c[6] - c[4] - y
    xyz = c[7] - c[6] - c[5] + c[4] - (c[3] - c[2] - c[1] + c[0])
    dxy, dxz, dyz = d[0] * d[1], d[0] * d[2], d[1] * d[2]
    A = xyz * dxy * d[2]
    B = xy * dxy + xz * dxz + yz * dyz + xyz * (a[0] * dyz + a[1] * dxz + a[2] * dxy)
    C = (x + xy * a[1] + xz * a[2] + xyz * a[1] * a[2]) * d[0]
    C += (y + xy * a[0] + yz * a[2] + xyz * a[0] * a[2]) * d[1]
    C += (z + xz * a[0] + yz * a[1] + xyz * a[0] * a[1]) * d[2]
    D = c[0] + x * a[0] + (y + xy * a[0]) * a[1] + (z + xz * a[0] + (yz + xyz * a[0]) * a[1]) * a[2]
    return A, B, C, D


@kernel(exact=True)
def horner(q, t):
    """Value of the cubic ``q`` = (A, B, C, D) at ``t``."""
    return ((q[0] * t + q[1]) * t + q[2]) * t + q[3]


@kernel(exact=True)
def turning_points(q):
    """Where the cubic's slope 3A t² + 2B t + C vanishes, ascending, clamped to [0, 1]; (1, 1) where it does not.

    The stable quadratic formula: no cancellation, and A = 0 or A = B = 0 fall through.
    """
    a, b, c = 3.0 * q[0], q[1], q[2]
    disc = b * b - a * c
    if not disc > 0.0:
        return 1.0, 1.0
    s = -(b + math.copysign(math.sqrt(disc), b))
    r1 = s / a if a != 0.0 else 1.0
    r2 = c / s if s != 0.0 else 1.0
    r1, r2 = min(max(r1, 0.0), 1.0), min(max(r2, 0.0), 1.0)
    return min(r1, r2), max(r1, r2)


@kernel(exact=True)
def refine(q, lo, hi, side):
    """The crossing of the cubic ``q`` in [lo, hi], where it is monotone and leaves ``side``.

    Newton's method from the chord's root, kept inside a shrinking bracket, so it ends even where the
    values at the ends do not change sign (a root lost to rounding is at ``lo`` then).
    """
    first, last = horner(q, lo), horner(q, hi)
    t = lo + (hi - lo) * (first / (first - last))
    if not lo < t < hi:
        t = 0.5 * (lo + hi)
    for _ in range(REFINEMENTS):
        f = horner(q, t)
        if (f > 0.0) == (side == SOLID):
            lo = t
        else:
            hi = t
        slope = (3.0 * q[0] * t + 2.0 * q[1]) * t + q[2]
        step = t - f / slope if slope != 0.0 else math.inf
        following = step if lo <= step <= hi else 0.5 * (lo + hi)
        if abs(following - t) < 1e-9:
            return following
        t = following
    return t


@kernel(exact=True)
def first_crossing(q, side, blur):
    """Smallest t in [0, 1] at which the cubic leaves ``side``, and the side at t = 1: (t or inf, side).

    Where it turns within ``blur`` of 0 it only touches the surface, and stays on its side.
    """
    last = SOLID if q[0] + q[1] + q[2] + q[3] > 0.0 else OUTSIDE
    b1, b2 = q[3] + q[2] / 3.0, q[3] + (2.0 * q[2] + q[1]) / 3.0
    solid = side == SOLID
    if last == side and (b1 > 0.0) == solid and (b2 > 0.0) == solid:
        return math.inf, last
    r1, r2 = turning_points(q)
    lo = 0.0
    if r1 > lo:
        if horner(q, r1) * side > blur:
            return refine(q, lo, r1, side), last
        lo = r1
    if r2 > lo:
        if horner(q, r2) * side > blur:
            return refine(q, lo, r2, side), last
        lo = r2
    if last != side:
        return refine(q, lo, 1.0, side), last
    return math.inf, last


@kernel(exact=True)
def corners(voxels, i, j, k, iso):
    """The eight corner values of cell (i, j, k) less the isovalue, float64, x fastest."""
    return (
        np.float64(voxels[k, j, i]) - iso,
        np.float64(voxels[k, j, i + 1]) - iso,
        np.float64(voxels[k, j + 1, i]) - iso,
        np.float64(voxels[k, j + 1, i + 1]) - iso,
        np.float64(voxels[k + 1, j, i]) - iso,
        np.float64(voxels[k + 1, j, i + 1]) - iso,
        np.float64(voxels[k + 1, j + 1, i]) - iso,
        np.float64(voxels[k + 1, j + 1, i + 1]) - iso,
    )


@kernel(exact=True)
def cut_slab(o, inv, i, near, far):
    """Part of [near, far] in which the ray is within cell ``i`` along one axis."""
    if inv == 0.0:
        return near, far
    a, b = (i - o) * inv, (i + 1 - o) * inv
    return max(near, min(a, b)), min(far, max(a, b))


@kernel(exact=True)
def cut_cell(o, inv, cell, near, far):
    """Part of [near, far] in which the ray is within ``cell``: the same bits however the ray got there."""
    near, far = cut_slab(o[0], inv[0], cell[0], near, far)
    near, far = cut_slab(o[1], inv[1], cell[1], near, far)
    return cut_slab(o[2], inv[2], cell[2], near, far)


@kernel(exact=True)
def cross_cell(voxels, iso, o, d, inv, cell, near, far, side):
    """First crossing in ``cell`` by a ray that is in the box from ``near`` to ``far``.

    (t, side it came from), or (inf, side at the exit). The sliver of a cell that a ray cuts off at an
    edge says nothing: the side is carried past it.
    """
    near, far = cut_cell(o, inv, cell, near, far)
    through = (far - near) * max(abs(d[0]), abs(d[1]), abs(d[2]))
    if not through >= SLIVER:
        return math.inf, side
    c = corners(voxels, cell[0], cell[1], cell[2], iso)
    if math.isnan(c[0] + c[1] + c[2] + c[3] + c[4] + c[5] + c[6] + c[7]):
        return math.inf, UNKNOWN
    solid, size = 0, 0.0
    for corner in c:
        solid += corner > 0.0
        size = max(size, abs(corner))
    if solid == 0 or solid == 8:
        return settle(near, side, SOLID if solid else OUTSIDE)
    a = (o[0] + near * d[0] - cell[0], o[1] + near * d[1] - cell[1], o[2] + near * d[2] - cell[2])
    span = far - near
    q = cubic_along(c, a, (d[0] * span, d[1] * span, d[2] * span))
    if side == UNKNOWN:
        side = SOLID if q[3] * through > SKIN * abs(q[2]) else OUTSIDE
    t, last = first_crossing(q, side, BLUR * max(voxels.shape) * size)
    return (near + t * span, side) if t < math.inf else (math.inf, last)


@kernel()
def settle(near, side, agreed):
    """A block whose voxels all lie on the side ``agreed``: no surface, unless one was lost at its entry ``near``."""
    return (near, side) if side == -agreed else (math.inf, agreed)


@kernel()
def cross_macrocell(voxels, iso, o, d, inv, block, box, near, far, side):
    """Walk the cells of macrocell ``block`` from ``near`` to ``far``; returns as ``cross_cell`` does.

    ``box`` is the part of the ray inside the volume's box.
    """
    nz, ny, nx = voxels.shape
    p = madd(o, near, d)
    i0, j0, k0 = block[0] * SIZE, block[1] * SIZE, block[2] * SIZE
    i1, j1, k1 = min(i0 + SIZE, nx - 1), min(j0 + SIZE, ny - 1), min(k0 + SIZE, nz - 1)
    i = min(max(clamp_cell(p[0], nx), i0), i1 - 1)
    j = min(max(clamp_cell(p[1], ny), j0), j1 - 1)
    k = min(max(clamp_cell(p[2], nz), k0), k1 - 1)
    while i0 <= i < i1 and j0 <= j < j1 and k0 <= k < k1:
        face, si, sj, sk = leave_block(o, inv, (i, j, k), 1)
        leave = max(near, min(face, far))
        t, side = cross_cell(voxels, iso, o, d, inv, (i, j, k), box[0], box[1], side)
        if t < math.inf or leave >= far:
            return t, side
        i, j, k, near = i + si, j + sj, k + sk, leave
    return math.inf, side


@kernel()
def cast(field, iso, o, d, side):
    """First crossing of the isosurface by the ray o + t·d, t ≥ 0: (t, side it came from), or (inf, UNKNOWN).

    ``o`` and ``d`` are in index space, ``d`` of any length; ``side`` is OUTSIDE or SOLID where the
    start is known (a ray that leaves a surface), UNKNOWN where the value at the start decides.
    Macrocells whose voxels all lie on one side are leapt over.
    """
    near0, far = clip_box(field.voxels, o, d)
    if not near0 < far:
        return math.inf, UNKNOWN
    near, t, longest = near0, math.inf, max(abs(d[0]), abs(d[1]), abs(d[2]))
    nz, ny, nx = field.voxels.shape
    mz, my, mx = field.low.shape
    p = madd(o, near, d)
    i, j, k = clamp_cell(p[0], nx) // SIZE, clamp_cell(p[1], ny) // SIZE, clamp_cell(p[2], nz) // SIZE
    if near > 0.0:
        side = UNKNOWN
    inv = (reciprocal(d[0]), reciprocal(d[1]), reciprocal(d[2]))
    while 0 <= i < mx and 0 <= j < my and 0 <= k < mz:
        face, si, sj, sk = leave_block(o, inv, (i, j, k), SIZE)
        leave = max(near, min(face, far))
        solid = field.low[k, j, i] > iso
        if not (solid or field.high[k, j, i] <= iso):
            t, side = cross_macrocell(field.voxels, iso, o, d, inv, (i, j, k), (near0, far), near, leave, side)
        elif (leave - near) * longest >= SLIVER:
            t, side = settle(near, side, SOLID if solid else OUTSIDE)
        if t < math.inf:
            return t, side
        if leave >= far:
            break
        i, j, k, near = i + si, j + sj, k + sk, leave
    return math.inf, UNKNOWN
