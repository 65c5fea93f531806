"""The path integrator: diffuse paths that wander over one isosurface until they leave the volume.

One path serves two ends: the bake projects its last direction onto spherical harmonics (S1, eqs. 6
and 8), the reference looks the environment up in that direction.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.bricks import BRICKS
from isogi_core.kernels.field import FIELD, normal, value
from isogi_core.kernels.harmonics import accumulate
from isogi_core.kernels.intersect import OUTSIDE, SOLID, cast
from isogi_core.kernels.packets import cast_batch
from isogi_core.kernels.rng import mix, point_2d
from isogi_core.kernels.sampling import sample_cosine_hemisphere
from isogi_core.kernels.vec import column, length, madd, orthonormal_basis, put_column, row, scale

VECTOR = types.float64[::1]
POINTS = types.float64[:, ::1]
TEXELS = types.int32[:, ::1]

OFFSET = 0.3
"""Start of illumination rays above the surface, in voxels along the normal (S1, section 4.1.1)."""

WAVE = 8192
"""Paths that are traced together."""

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
def aim(field, iso, p, n, side, seed, index, bounce):
    """Bounce ``bounce`` of a path from ``p``: (start in index space, world direction)."""
    u, v = point_2d(seed, index, bounce)
    return launch(field, iso, p, n, side), about(n, sample_cosine_hemisphere(u, v))


@kernel()
def put(vectors, m, v):
    """Write the vector ``v`` to row ``m`` of an (n, 3) array."""
    vectors[m, 0], vectors[m, 1], vectors[m, 2] = v


@kernel()
def walk_paths(field, bricks, isovalues, points, normals, seeds, samples, bounces, left, ways):
    """``trace_path`` of many paths in waves: all first rays, then all second ones, and so on, to the same bits.

    Path m starts at ``points`` and ``normals`` (m, 3), which are overwritten, and draws sample
    ``samples`` of the sequence ``seeds``. Writes the bounces before it left, or -1, to ``left`` and its
    direction to ``ways`` (m, 3).
    """
    total = points.shape[0]
    left[:] = -1
    alive, count = np.arange(total), total
    sides = np.full(total, OUTSIDE, np.int8)
    room, levels = np.empty(6 * total), np.empty(total)
    t, came = np.empty(total), np.empty(total, np.int8)
    for bounce in range(bounces + 1):
        origins, directions = room[: 3 * count].reshape(3, count), room[3 * count : 6 * count].reshape(3, count)
        for i in range(count):
            m = alive[i]
            o, w = aim(
                field, isovalues[m], row(points, m), row(normals, m), int(sides[i]), seeds[m], samples[m], bounce
            )
            put(ways, m, w)
            put_column(origins, i, o)
            put_column(directions, i, to_index(w, field.spacing))
            levels[i] = isovalues[m]
        cast_batch(field, bricks, levels[:count], origins, directions, sides[:count], t[:count], came[:count])
        hits = 0
        for i in range(count):
            m = alive[i]
            if not t[i] < math.inf:
                left[m] = bounce
            elif bounce < bounces:
                p = madd(column(origins, i), t[i], column(directions, i))
                put(points, m, p)
                put(normals, m, facing_normal(field, p, int(came[i]), row(ways, m)))
                alive[hits], sides[hits] = m, came[i]
                hits += 1
        count = hits


@kernel(types.void(FIELD, VECTOR, TEXELS, POINTS, POINTS, VECTOR, types.boolean[::1]))
def locate_texels(field, step, texels, points, normals, isovalues, void):
    """Where ``texels`` (m, 3; z, y, x) are, ``points`` (m, 3), and the surface through each of them.

    ``step`` (3,) voxels per texel along x, y, z. Writes ``normals`` (m, 3), the voxel-space isovalue each
    texel is lit on (its own value, a float32) and whether it is void (no gradient there, or no number).
    """
    for m in range(texels.shape[0]):
        p = (texels[m, 2] * step[0], texels[m, 1] * step[1], texels[m, 0] * step[2])
        n = normal(field, p)
        put(points, m, p)
        put(normals, m, n)
        isovalues[m] = np.float32(value(field.voxels, p))  # on a plateau exactly its value, which is not solid
        void[m] = math.isnan(isovalues[m]) or (n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0)


@kernel()
def gather_light(left, ways, weights, order, direct, indirect):
    """Add the ends of one randomisation's paths, in their order, to the sums of its texel.

    ``weights`` (bounces + 1, channels) holds R^k; ``direct`` (n²) and ``indirect`` (channels, n²)
    float64 are added to. Source: S1, eq. 8 with cosine sampling: τ_i = Σ R^k Y_i(ω) / N.
    """
    for m in range(left.shape[0]):
        if left[m] == 0:
            accumulate(order, ways[m, 0], ways[m, 1], ways[m, 2], 1.0, direct)
        elif left[m] > 0:
            for c in range(weights.shape[1]):
                accumulate(order, ways[m, 0], ways[m, 1], ways[m, 2], weights[left[m], c], indirect[c])


@kernel()
def bake_wave(field, bricks, place, rows, first, count, weights, order, direct, indirect):
    """``bake_texels`` for a few texels whose paths go together."""
    texels, points, normals, isovalues = place
    paths = rows.shape[0] * 2 * count
    starts, facing, ways = np.empty((paths, 3)), np.empty((paths, 3)), np.empty((paths, 3))
    levels, seeds, samples = np.empty(paths), np.empty(paths, np.uint64), np.empty(paths, np.int64)
    for m in range(paths):
        r, half = rows[m // (2 * count)], m // count % 2
        put(starts, m, row(points, r))
        put(facing, m, row(normals, r))
        levels[m], samples[m] = isovalues[r], first + m % count
        seeds[m] = texel_seed(texels[r, 0], texels[r, 1], texels[r, 2], half)
    left = np.empty(paths, np.int64)
    walk_paths(field, bricks, levels, starts, facing, seeds, samples, weights.shape[0] - 1, left, ways)
    for i in range(2 * rows.shape[0]):
        r, half, own = rows[i // 2], i % 2, slice(i * count, (i + 1) * count)
        gather_light(left[own], ways[own], weights, order, direct[r, half], indirect[r, half])


@kernel(
    types.void(
        FIELD,
        BRICKS,
        types.Tuple((TEXELS, POINTS, POINTS, VECTOR)),
        types.int64[::1],
        types.int64,
        types.int64,
        POINTS,
        types.int64,
        types.float64[:, :, ::1],
        types.float64[:, :, :, ::1],
    )
)
def bake_texels(field, bricks, place, rows, first, count, weights, order, direct, indirect):
    """Sums of ``count`` samples, from sample ``first`` on, for the ``rows`` and each of their two halves.

    ``place`` is what ``locate_texels`` took and wrote: texels, points, normals, isovalues, the latter
    within the range of ``bricks``; ``weights`` (bounces + 1, channels) R^k. Adds to ``direct``
    (m, 2, n²) and ``indirect`` (m, 2, channels, n²). Source: S1, section 4.1, "for all texels".
    """
    together = max(WAVE // (2 * count), 1)
    for i in range(0, rows.shape[0], together):
        bake_wave(field, bricks, place, rows[i : i + together], first, count, weights, order, direct, indirect)
