"""The path integrator: a diffuse path that wanders over one isosurface until it leaves the volume.

One path serves two ends: the bake projects its last direction onto spherical harmonics (S1, eqs. 6
and 8), the reference looks the environment up in that direction. ``waves`` walks many at once.
"""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import normal, to_index, value
from isogi_core.kernels.intersect import OUTSIDE, SOLID, cast
from isogi_core.kernels.reals import where
from isogi_core.kernels.rng import PAIRS, point_2d
from isogi_core.kernels.sampling import sample_cosine_hemisphere
from isogi_core.kernels.vec import length, madd, orthonormal_basis, scale


@kernel(exact=True)
def launch(field, iso, p, n, side):
    """Where a ray starts that leaves the surface at ``p`` along the world normal ``n`` on ``side``.

    The field's offset off the surface; ``p`` itself where that point is on the other side, in a crease
    or in noise: the ray is told its side and cannot hit what it starts on. Takes points side by side
    too (see ``reals``).
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
def facing_normal(field, p, side, d):
    """Unit world normal at a hit, towards the ``side`` that the ray came from; -d where the field is flat."""
    n = normal(field, p)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        return scale(d, -1.0 / length(d))
    return n if side == OUTSIDE else scale(n, -1.0)


ROULETTE = 0x7FFF * PAIRS
"""The first of the pairs of random numbers that decide which paths go on."""


@kernel()
def trace_path(field, iso, p, n, side, seed, index, bounces, survival):
    """One diffuse path from the surface point ``p``: (bounces before it left, world direction in which it left).

    Cosine-weighted directions, so that every path carries the same weight R^k; bounce b draws the
    pair b of sample ``index`` of the sequence ``seed``. Returns -1 bounces when after ``bounces``
    surface hits the path is still inside, or has ended by chance: from the second on it goes on from a
    hit with the chance ``survival``. Source: S1, section 4.1; DESIGN section 3.
    """
    for bounce in range(bounces + 1):
        u, v = point_2d(seed, index, bounce)
        w = about(n, sample_cosine_hemisphere(u, v))
        d = to_index(w, field.spacing)
        o = launch(field, iso, p, n, side)
        t, side = cast(field, iso, o, d, side)
        if not t < math.inf:
            return bounce, w
        if bounce > 0 and not point_2d(seed, index, ROULETTE + bounce)[0] < survival:
            return -1, (0.0, 0.0, 0.0)
        p = madd(o, t, d)
        n = facing_normal(field, p, side, w)
    return -1, (0.0, 0.0, 0.0)
