"""The path integrator: a diffuse path that wanders over one isosurface until it leaves the volume."""

import math

from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import where
from isogi_core.kernels.tracing.cast import ORIGINS, SIDES, VECTOR
from isogi_core.kernels.tracing.field import FIELD, normal, to_index, value
from isogi_core.kernels.tracing.intersect import OUTSIDE, SOLID, cast
from isogi_core.kernels.tracing.vec import column, length, madd, orthonormal_basis, put_column, scale
from isogi_core.kernels.transport.rng import PAIRS, point_2d
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


ROULETTE = 0x7FFF * PAIRS
"""The first of the pairs of random numbers that decide which paths go on."""


@kernel()
def trace_path(field, iso, start, seed, index, tree, way):
    """One diffuse path from a ``start`` (point, normal, side): (bounces before it left, world direction in which).

    Cosine-weighted directions, so that every path carries the same weight R^k; bounce b draws the
    pair b of sample ``index`` of the sequence ``seed``. From the first hit of the ``PathTree`` it goes on in this
    ``way``, one of its branches, and draws from sample ``branches`` · ``index`` + ``way``. Returns -1 bounces when
    after all of its bounces the path is still inside, or has ended by chance: from the second on it goes on from a
    hit with the chance ``survival``. Source: S1, section 4.1; DESIGN section 3.
    """
    p, n, side = start
    for bounce in range(tree.bounces + 1):
        u, v = point_2d(seed, index, bounce)
        w = about(n, sample_cosine_hemisphere(u, v))
        d = to_index(w, field.spacing)
        o = launch(field, iso, p, n, side)
        t, side = cast(field, iso, o, d, side)
        if not t < math.inf:
            return bounce, w
        if bounce == 0:
            index = index * tree.branches + way
        elif not point_2d(seed, index, ROULETTE + bounce)[0] < tree.survival:
            return -1, (0.0, 0.0, 0.0)
        p = madd(o, t, d)
        n = shading_normal(field, p, side, w)
    return -1, (0.0, 0.0, 0.0)


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
