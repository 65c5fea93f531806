"""Rays against an isosurface of the trilinear field, one at a time.

Along a ray a cell's field is a cubic. Four rules keep the surface closed (references: reliability,
section 4): solid is value > isovalue, half-open; a cell whose corners agree has no surface; the
side on which a ray leaves a cell is the side on which it enters the next; and a ray that starts on
its own surface is given its side, it does not ask the value.
"""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import where
from isogi_core.kernels.simd.voxels import cube
from isogi_core.kernels.tracing.cubic import cubic_along, ends_solid, first_crossing
from isogi_core.kernels.tracing.field import clamp_cell, normal, to_index, value
from isogi_core.kernels.tracing.macrocells import MACROCELL_SIDE
from isogi_core.kernels.tracing.slabs import clip_box, cut_cell, leave_block, longest, reciprocals
from isogi_core.kernels.tracing.vec import length, madd, scale

OUTSIDE_SIGN = 1
SOLID_SIGN = -1
UNKNOWN_SIDE = 0

SLIVER = 1e-5
"""Way through a cell, in voxels, below which values are rounding: more than a root's own error.

That is the cubic root of rounding where the field hardly leaves the isovalue, at the edge of a
mask.
"""

CUBIC_ROUNDING = 2e-15
"""Rounding of a cubic's values, over the largest corner value and for each voxel of the volume's
longest side.

A turn that is nearer to 0 only touches it. Three roundings of a place lie between the ray and its
cell, each of them of half a bit of a coordinate, and six times the largest corner is what the field
changes by at most in a voxel.
"""

SKIN = 2.0 * SLIVER
"""Voxels along a ray, whose side is not known, that it may begin behind the surface and still be
outside.

So a surface that lies in a face of the box is met from outside, wherever rounding or a sliver lets
rays begin.
"""


@kernel(exact=True)
def less(c, iso):
    """Eight corner values less the isovalue."""
    near = c[0] - iso, c[1] - iso, c[2] - iso, c[3] - iso
    return near[0], near[1], near[2], near[3], c[4] - iso, c[5] - iso, c[6] - iso, c[7] - iso


@kernel(exact=True)
def extent(c):
    """The least and the greatest of eight corner values, numbers or vectors, and their sum."""
    low = min(min(min(c[0], c[1]), min(c[2], c[3])), min(min(c[4], c[5]), min(c[6], c[7])))
    high = max(max(max(c[0], c[1]), max(c[2], c[3])), max(max(c[4], c[5]), max(c[6], c[7])))
    return low, high, c[0] + c[1] + c[2] + c[3] + c[4] + c[5] + c[6] + c[7]


@kernel(exact=True)
def cross_cell(volume, ray, cell, box, side):
    """First crossing in ``cell`` by a ray: (t, side it came from), or (inf, side at the exit).

    ``volume`` (voxels, isovalue), ``ray`` (origin, direction, its reciprocals), ``box`` the part of
    it that is in the volume's box. The sliver of a cell that a ray cuts off at an edge says
    nothing: the side is carried past it.
    """
    voxels, iso = volume
    o, d, inv = ray
    near, far = cut_cell(o, inv, cell, box[0], box[1])
    through = (far - near) * longest(d)
    if not through >= SLIVER:
        return math.inf, side
    c = less(cube(voxels, cell[2], cell[1], cell[0]), iso)
    low, high, total = extent(c)
    if math.isnan(total):
        return math.inf, UNKNOWN_SIDE
    if low > 0.0 or not high > 0.0:
        return carry_side(near, side, SOLID_SIGN if low > 0.0 else OUTSIDE_SIGN)
    a = (o[0] + near * d[0] - cell[0], o[1] + near * d[1] - cell[1], o[2] + near * d[2] - cell[2])
    span = far - near
    q = cubic_along(c, a, (d[0] * span, d[1] * span, d[2] * span))
    if side == UNKNOWN_SIDE:
        if q[3] * through > SKIN * abs(q[2]):
            side = SOLID_SIGN
        else:
            side = OUTSIDE_SIGN
    t, crosses = first_crossing(
        q, side == SOLID_SIGN, CUBIC_ROUNDING * max(voxels.shape) * max(high, -low), True
    )
    if crosses:
        return (near + t * span, side)
    return (math.inf, SOLID_SIGN if ends_solid(q) else OUTSIDE_SIGN)


@kernel()
def carry_side(near, side, agreed):
    """A block whose voxels all lie on the side ``agreed``: no surface, unless one was lost at its
    entry ``near``.
    """
    if side == -agreed:
        return (near, side)
    return (math.inf, agreed)


@kernel()
def cross_macrocell(volume, ray, block, box, part, side):
    """Walk the cells of macrocell ``block`` through the ``part`` (near, far) of a ray; arguments
    and result are those of ``cross_cell``.
    """
    voxels, _ = volume
    o, d, inv = ray
    near, far = part
    nz, ny, nx = voxels.shape
    p = madd(o, near, d)
    i0 = block[0] * MACROCELL_SIDE
    j0 = block[1] * MACROCELL_SIDE
    k0 = block[2] * MACROCELL_SIDE
    i1 = min(i0 + MACROCELL_SIDE, nx - 1)
    j1 = min(j0 + MACROCELL_SIDE, ny - 1)
    k1 = min(k0 + MACROCELL_SIDE, nz - 1)
    i = min(max(clamp_cell(p[0], nx), i0), i1 - 1)
    j = min(max(clamp_cell(p[1], ny), j0), j1 - 1)
    k = min(max(clamp_cell(p[2], nz), k0), k1 - 1)
    while i0 <= i < i1 and j0 <= j < j1 and k0 <= k < k1:
        face, si, sj, sk = leave_block(o, inv, (i, j, k), 1)
        leave = max(near, min(face, far))
        t, side = cross_cell(volume, ray, (i, j, k), box, side)
        if t < math.inf or leave >= far:
            return t, side
        i = i + si
        j = j + sj
        k = k + sk
        near = leave
    return math.inf, side


@kernel()
def cast(field, iso, o, d, side):
    """First crossing of the isosurface by the ray o + t·d, t ≥ 0: (t, side it came from), or (inf,
    UNKNOWN).

    ``o`` and ``d`` are in index space, ``d`` of any length; ``side`` is OUTSIDE_SIGN or SOLID_SIGN
    where the start is known (a ray that leaves a surface), UNKNOWN where the value at the start
    decides. Macrocells whose voxels all lie on one side are passed at once (empty-space skipping).
    """
    box = clip_box(field.voxels.shape, o, d)
    near, far = box
    if not near < far:
        return math.inf, UNKNOWN_SIDE
    t = math.inf
    most = longest(d)
    nz, ny, nx = field.voxels.shape
    mz, my, mx = field.low.shape
    p = madd(o, near, d)
    i = clamp_cell(p[0], nx) // MACROCELL_SIDE
    j = clamp_cell(p[1], ny) // MACROCELL_SIDE
    k = clamp_cell(p[2], nz) // MACROCELL_SIDE
    if near > 0.0:
        side = UNKNOWN_SIDE
    inv = reciprocals(d)
    volume = (field.voxels, iso)
    ray = (o, d, inv)
    while 0 <= i < mx and 0 <= j < my and 0 <= k < mz:
        face, si, sj, sk = leave_block(o, inv, (i, j, k), MACROCELL_SIDE)
        leave = max(near, min(face, far))
        solid = field.low[k, j, i] > iso
        if not (solid or field.high[k, j, i] <= iso):
            t, side = cross_macrocell(volume, ray, (i, j, k), box, (near, leave), side)
        elif (leave - near) * most >= SLIVER:
            t, side = carry_side(near, side, SOLID_SIGN if solid else OUTSIDE_SIGN)
        if t < math.inf:
            return t, side
        if leave >= far:
            break
        i = i + si
        j = j + sj
        k = k + sk
        near = leave
    return math.inf, UNKNOWN_SIDE


@kernel(exact=True)
def launch(field, iso, p, n, side):
    """Where a ray starts that leaves the surface at ``p`` along the world normal ``n`` on ``side``.

    The field's offset off the surface; ``p`` itself where that point is on the other side, in a
    crease or in noise: the ray is given its side and cannot hit what it starts on. Takes vectors of
    points too.
    """
    x, y, z = to_index(n, field.spacing)
    rise = field.offset / math.sqrt(x * x + y * y + z * z)
    x, y, z = p[0] + rise * x, p[1] + rise * y, p[2] + rise * z
    nz, ny, nx = field.voxels.shape
    within = (x >= 0.0) & (x <= nx - 1) & (y >= 0.0) & (y <= ny - 1) & (z >= 0.0) & (z <= nz - 1)
    there = where(value(field.voxels, (x, y, z)) > iso, float(SOLID_SIGN), float(OUTSIDE_SIGN))
    astray = within & (there * side < 0.0)
    return where(astray, p[0], x), where(astray, p[1], y), where(astray, p[2], z)


@kernel()
def shading_normal(field, p, side, d):
    """Unit world normal at a hit, towards the ``side`` that the ray came from; -d where the field
    is flat.
    """
    n = normal(field, p)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        return scale(d, -1.0 / length(d))
    if side == OUTSIDE_SIGN:
        return n
    return scale(n, -1.0)
