"""How rays leave an isosurface: from where, about which normal, and in which direction."""

import math

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import where
from isogi_core.kernels.tracing.cast import ORIGINS, SIDES, VECTOR
from isogi_core.kernels.tracing.field import FIELD, normal, to_index, value
from isogi_core.kernels.tracing.intersect import OUTSIDE, SOLID
from isogi_core.kernels.tracing.vec import column, length, madd, orthonormal_basis, put_column, scale
from isogi_core.kernels.transport.sampling import sample_cosine_hemisphere


@kernel(exact=True)
def launch(field, iso, p, n, side):
    """Where a ray starts that leaves the surface at ``p`` along the world normal ``n`` on ``side``.

    The field's offset off the surface; ``p`` itself where that point is on the other side, in a crease
    or in noise: the ray is given its side and cannot hit what it starts on. Takes vectors of points
    too.
    """
    x, y, z = to_index(n, field.spacing)
    rise = field.offset / math.sqrt(x * x + y * y + z * z)
    x, y, z = p[0] + rise * x, p[1] + rise * y, p[2] + rise * z
    nz, ny, nx = field.voxels.shape
    within = (x >= 0.0) & (x <= nx - 1) & (y >= 0.0) & (y <= ny - 1) & (z >= 0.0) & (z <= nz - 1)
    there = where(value(field.voxels, (x, y, z)) > iso, float(SOLID), float(OUTSIDE))
    astray = within & (there * side < 0.0)
    return where(astray, p[0], x), where(astray, p[1], y), where(astray, p[2], z)


@kernel(exact=True)
def about(n, d):
    """The direction ``d``, given about +z, turned so that +z is the unit vector ``n``."""
    s, t = orthonormal_basis(n)
    return (
        n[0] * d[2] + s[0] * d[0] + t[0] * d[1],
        n[1] * d[2] + s[1] * d[0] + t[1] * d[1],
        n[2] * d[2] + s[2] * d[0] + t[2] * d[1],
    )


@kernel()
def shading_normal(field, p, side, d):
    """Unit world normal at a hit, towards the ``side`` that the ray came from; -d where the field is flat."""
    n = normal(field, p)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        return scale(d, -1.0 / length(d))
    return n if side == OUTSIDE else scale(n, -1.0)


@kernel(types.void(FIELD, VECTOR, ORIGINS, ORIGINS, VECTOR, SIDES, ORIGINS))
def bounce_rays(field, isovalues, origins, directions, t, came, numbers):
    """Turn rays ``origins`` + t · ``directions`` (3, n) that hit, in place, into cosine rays from there.

    ``isovalues`` (n,) of the surfaces; ``t`` and ``came`` (n,) as ``cast_batch`` writes them; ``numbers``
    (2, n) in [0, 1). They start off the surface as a path's do. Source: S1, section 4.1.
    """
    for m in range(origins.shape[1]):
        d = column(directions, m)
        p = madd(column(origins, m), t[m], d)
        n = shading_normal(field, p, int(came[m]), d)
        w = about(n, sample_cosine_hemisphere(numbers[0, m], numbers[1, m]))
        put_column(origins, m, launch(field, isovalues[m], p, n, int(came[m])))
        put_column(directions, m, to_index(w, field.spacing))
