"""The path integrator: diffuse paths that wander over one isosurface until they leave the volume.

One path serves two ends: the bake projects its last direction onto spherical harmonics (S1, eqs. 6
and 8), the reference looks the environment up in that direction.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.field import FIELD, normal, value
from isogi_core.kernels.harmonics import accumulate
from isogi_core.kernels.intersect import OUTSIDE, SOLID, cast
from isogi_core.kernels.rng import mix, point_2d
from isogi_core.kernels.sampling import sample_cosine_hemisphere
from isogi_core.kernels.vec import length, madd, orthonormal_basis, scale

OFFSET = 0.3
"""Start of illumination rays above the surface, in voxels along the normal (S1, section 4.1.1)."""

VOID = -1
"""Sample count of a texel without a surface: its gradient is zero, no light can be told."""


@kernel()
def to_index(v, spacing):
    """A world vector in index space."""
    return (v[0] / spacing[0], v[1] / spacing[1], v[2] / spacing[2])


@kernel()
def launch(field, iso, p, n, side):
    """Where a ray starts that leaves the surface at ``p`` along the world normal ``n`` on ``side``.

    OFFSET voxels off the surface; ``p`` itself where that point is on the other side, in a crease
    or in noise: the ray is told its side and cannot hit what it starts on.
    """
    lift = to_index(n, field.spacing)
    start = madd(p, OFFSET / length(lift), lift)
    nz, ny, nx = field.voxels.shape
    within = 0.0 <= start[0] <= nx - 1 and 0.0 <= start[1] <= ny - 1 and 0.0 <= start[2] <= nz - 1
    if within and (value(field.voxels, start) > iso) != (side == SOLID):
        return p
    return start


@kernel()
def about(n, d):
    """The direction ``d``, given about +z, turned so that +z is the unit vector ``n``."""
    s, t = orthonormal_basis(n)
    return madd(madd(scale(n, d[2]), d[0], s), d[1], t)


@kernel()
def facing_normal(field, p, side, d):
    """Unit world normal at a hit, towards the ``side`` that the ray came from; -d where the field is flat."""
    n = normal(field, p)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        return scale(d, -1.0 / length(d))
    return n if side == OUTSIDE else scale(n, -1.0)


@kernel()
def trace_path(field, iso, p, n, side, seed, index, bounces):
    """One diffuse path from the surface point ``p``: (bounces before it left, world direction in which it left).

    Cosine-weighted directions, so that every path carries the same weight R^k; bounce b draws the
    pair b of sample ``index`` of the sequence ``seed``. Returns -1 bounces when after ``bounces``
    surface hits the path is still inside. Source: S1, section 4.1; DESIGN section 3.
    """
    for bounce in range(bounces + 1):
        u, v = point_2d(seed, index, bounce)
        w = about(n, sample_cosine_hemisphere(u, v))
        d = to_index(w, field.spacing)
        o = launch(field, iso, p, n, side)
        t, side = cast(field, iso, o, d, side)
        if not t < math.inf:
            return bounce, w
        p = madd(o, t, d)
        n = facing_normal(field, p, side, w)
    return -1, (0.0, 0.0, 0.0)


@kernel()
def texel_seed(z, y, x, half):
    """The sequence of a lattice texel and one of its two independent randomisations (half = 0 or 1)."""
    return mix(mix(mix(z, y), x), half)


@kernel()
def transfer_half(field, iso, p, n, seed, first, count, weights, order, direct, indirect):
    """Add samples first … first + count of one randomisation to the transfer sums of a texel.

    ``weights`` (bounces + 1, channels) holds R^k; ``direct`` (n²) and ``indirect`` (channels, n²)
    float64 are added to. Source: S1, eq. 8 with cosine sampling: τ_i = Σ R^k Y_i(ω) / N.
    """
    bounces, channels = weights.shape[0] - 1, weights.shape[1]
    for index in range(first, first + count):
        k, w = trace_path(field, iso, p, n, OUTSIDE, seed, index, bounces)
        if k == 0:
            accumulate(order, w[0], w[1], w[2], 1.0, direct)
        elif k > 0:
            for c in range(channels):
                accumulate(order, w[0], w[1], w[2], weights[k, c], indirect[c])


@kernel(
    types.void(
        FIELD,
        types.float64[::1],
        types.int32[:, ::1],
        types.int64,
        types.int64,
        types.float64[:, ::1],
        types.int64,
        types.float64[:, :, ::1],
        types.float64[:, :, :, ::1],
        types.float64[::1],
        types.boolean[::1],
    )
)
def bake_texels(field, step, texels, first, count, weights, order, direct, indirect, isovalues, void):
    """Sums of ``count`` samples, from sample ``first`` on, for each texel and each of its two halves.

    ``texels`` (m, 3) int32 lattice indices z, y, x; ``step`` (3,) voxels per texel along x, y, z;
    ``weights`` (bounces + 1, channels) R^k. Adds to ``direct`` (m, 2, n²) and ``indirect``
    (m, 2, channels, n²); writes the voxel-space isovalue each texel is lit on (its own value, a float32) and
    whether it is void (no gradient there, or no number). Source: S1, section 4.1, "for all texels".
    """
    for m in range(texels.shape[0]):
        z, y, x = texels[m, 0], texels[m, 1], texels[m, 2]
        p = (x * step[0], y * step[1], z * step[2])
        iso = np.float64(np.float32(value(field.voxels, p)))  # on a plateau exactly its value, which is not solid
        n = normal(field, p)
        isovalues[m] = iso
        void[m] = math.isnan(iso) or (n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0)
        if not void[m]:
            for half in range(2):
                seed = texel_seed(z, y, x, half)
                transfer_half(field, iso, p, n, seed, first, count, weights, order, direct[m, half], indirect[m, half])
