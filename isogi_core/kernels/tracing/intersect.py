"""Intersection of single rays with an isosurface of the trilinear field, in float64.

Within a cell the field along a ray is a cubic. Four rules keep the surface closed:

- Solid is value > isovalue, a half-open condition.
- A cell whose corners agree holds no surface.
- The side on which a ray leaves a cell is the side on which it enters the next.
- A ray that starts on its surface is given its side, and does not evaluate the field for it.
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
"""Shortest way through a cell in voxels that is tested; values on a shorter one are rounding
errors.

A root's error is the cube root of rounding if the field hardly leaves the isovalue, as at the edge
of a mask.
"""

CUBIC_ROUNDING = 2e-15
"""Rounding error of a cubic's values, per largest corner value and voxel of the volume's longest
side.

A turning point nearer to 0 only touches the surface. Three roundings of a position lie between ray
and cell, each of half a bit of a coordinate, and the field changes by at most six times the largest
corner value in a voxel.
"""

SKIN = 2.0 * SLIVER
"""Distance in voxels that a ray of unknown side may begin behind the surface and still count as
outside.

So rays meet a surface that lies in a face of the box from outside, wherever rounding lets them
begin.
"""


@kernel(exact=True)
def less(c, iso):
    """Subtract the isovalue from eight corner values."""
    near = c[0] - iso, c[1] - iso, c[2] - iso, c[3] - iso
    return near[0], near[1], near[2], near[3], c[4] - iso, c[5] - iso, c[6] - iso, c[7] - iso


@kernel(exact=True)
def extent(c):
    """Return the least and the greatest of eight corner values, numbers or vectors,
    and their sum.
    """
    low = min(min(min(c[0], c[1]), min(c[2], c[3])), min(min(c[4], c[5]), min(c[6], c[7])))
    high = max(max(max(c[0], c[1]), max(c[2], c[3])), max(max(c[4], c[5]), max(c[6], c[7])))
    return low, high, c[0] + c[1] + c[2] + c[3] + c[4] + c[5] + c[6] + c[7]


@kernel(exact=True)
def cross_cell(volume, ray, cell, box, side):
    """Intersect a ray with the surface in ``cell``: (t, side it came from), or (inf, side at the
    exit).

    ``volume`` is (voxels, isovalue), ``ray`` (origin, direction, its reciprocals), ``box`` the part
    of the ray in the volume's box. A sliver at the edge of a cell is not tested: the side is
    carried past it.
    """
    voxels, iso = volume
    o, d, inv = ray
    # Clip the ray to the cell; carry the side past a sliver.
    near, far = cut_cell(o, inv, cell, box[0], box[1])
    through = (far - near) * longest(d)
    if not through >= SLIVER:
        return math.inf, side
    # Cells with corners on one side hold no surface, and set the side.
    c = less(cube(voxels, cell[2], cell[1], cell[0]), iso)
    low, high, total = extent(c)
    if math.isnan(total):
        return math.inf, UNKNOWN_SIDE
    if low > 0.0 or not high > 0.0:
        return carry_side(near, side, SOLID_SIGN if low > 0.0 else OUTSIDE_SIGN)
    # Write the field along the ray as a cubic over the clipped part, t in [0, 1].
    a = (o[0] + near * d[0] - cell[0], o[1] + near * d[1] - cell[1], o[2] + near * d[2] - cell[2])
    span = far - near
    q = cubic_along(c, a, (d[0] * span, d[1] * span, d[2] * span))
    # Take the side from the value at the entry, unless the surface is within SKIN before it.
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
    """Return the result for a block whose voxels all lie on the side ``agreed``.

    There is no surface, unless a ray of the other side lost one at its entry ``near``.
    """
    if side == -agreed:
        return (near, side)
    return (math.inf, agreed)


@kernel()
def cross_macrocell(volume, ray, block, box, part, side):
    """Step through the cells of macrocell ``block`` along the ``part`` (near, far) of a ray.

    Arguments and result are those of ``cross_cell``. Source: Amanatides and Woo 1987.
    """
    voxels, _ = volume
    o, d, inv = ray
    near, far = part
    nz, ny, nx = voxels.shape
    # Find the first cell, clamped to the macrocell against rounding.
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
    # Test cell after cell in the order of the ray.
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
    """Return the first intersection of the ray o + t·d, t ≥ 0, with the isosurface: (t, side it
    came from).

    The result is (inf, UNKNOWN_SIDE) if there is none. ``o`` and ``d`` are in index space, ``d`` of
    any length. ``side`` is OUTSIDE_SIGN or SOLID_SIGN if the side of the start is known (a ray that
    leaves a surface), else UNKNOWN_SIDE: the value at the start decides. Macrocells whose voxels
    all lie on one side are skipped.
    """
    # Clip the ray to the volume, and find its first macrocell.
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
    # A given side is that of the start; it says nothing about the place at which a ray from outside
    # enters the box.
    if near > 0.0:
        side = UNKNOWN_SIDE
    inv = reciprocals(d)
    volume = (field.voxels, iso)
    ray = (o, d, inv)
    # Walk the macrocells; look at cells only if voxels of both sides are in one.
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
    """Return the origin of a ray that leaves the surface at ``p`` along the world normal ``n`` on
    ``side``.

    The origin is offset from the surface. If the offset point lies on the other side, as in a
    crease or in noise, the origin is ``p`` itself: such a ray is given its side and cannot hit the
    point that it starts on. Takes vectors of points as well.
    """
    # Offset along the normal by a fixed number of voxels.
    x, y, z = to_index(n, field.spacing)
    rise = field.offset / math.sqrt(x * x + y * y + z * z)
    x, y, z = p[0] + rise * x, p[1] + rise * y, p[2] + rise * z
    # Take the offset back if it crossed the surface.
    nz, ny, nx = field.voxels.shape
    within = (x >= 0.0) & (x <= nx - 1) & (y >= 0.0) & (y <= ny - 1) & (z >= 0.0) & (z <= nz - 1)
    there = where(value(field.voxels, (x, y, z)) > iso, float(SOLID_SIGN), float(OUTSIDE_SIGN))
    astray = within & (there * side < 0.0)
    return where(astray, p[0], x), where(astray, p[1], y), where(astray, p[2], z)


@kernel()
def shading_normal(field, p, side, d):
    """Return the unit world normal at a hit,
    on the ``side`` that the ray came from; -d if the field is flat.
    """
    n = normal(field, p)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        return scale(d, -1.0 / length(d))
    if side == OUTSIDE_SIGN:
        return n
    return scale(n, -1.0)
