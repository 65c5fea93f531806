"""Plateaus: where texels at the edge of one are lit, as their own isosurface is one that no view shows.

A texel that hardly any voxel about it exceeds, while many are as high, is at the edge of a plateau (a mask, a thin
ramp, a terrace, clipped data): above its value next to nothing is solid. One that hardly any falls below is too: its
isosurface is the hull of all that is higher, up to a voxel too far out. Such a texel is lit half-way between the ends
of the values about it, which the isosurfaces that its cells show lie about. In a wall one voxel thin, whose sides have
light of their own, a texel that is the wall itself has none.
"""

import math

import numpy as np

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.tracing.field import normal, value

EDGE_SHARE = 0.1
"""Share of the range of the values about a texel within which it is at an end of it."""

FLAT_SHARE = 2 / 7
"""Share of the voxels about a texel that are as it is, at the edge of a plateau: a cube's corner has 8 of 27.

Without it the texels of noisy fields, many of which are the least or the greatest for a voxel around, would leave their
isosurfaces too, and have a quarter more error.
"""

MAX_SHIFT_VOXELS = 1.5
"""How far from its place, in voxels, a texel is lit at most."""

BEHIND_VOXELS = -0.6
"""How far ahead of a texel, in voxels, a place is at most that is behind it; a cube's corner has none such."""

STEP_VOXELS = 0.0625
"""Voxels between places at which the field is asked for the side that it is on; a power of two."""

HALVINGS = 32
"""Halvings of a stride that find an isosurface in it."""


@kernel(exact=True)
def reach(x, n):
    """First and last of the ``n`` voxels along an axis that the smoothed gradient at ``x`` is made of."""
    return max(int(math.floor(x)) - 1, 0), min(int(math.ceil(x)) + 1, n - 1)


@kernel(exact=True)
def value_span(voxels, p):
    """The least and the greatest voxel about ``p``, up to two away along each axis, and whether one is no number."""
    nz, ny, nx = voxels.shape
    xs, ys, zs = reach(p[0], nx), reach(p[1], ny), reach(p[2], nz)
    low, high, hole = np.float32(math.inf), np.float32(-math.inf), False
    for k in range(zs[0], zs[1] + 1):
        for j in range(ys[0], ys[1] + 1):
            for i in range(xs[0], xs[1] + 1):
                v = voxels[k, j, i]
                low, high, hole = v if v < low else low, v if v > high else high, hole | math.isnan(v)
    return low, high, hole


@kernel(exact=True)
def flat(voxels, p, own, edge):
    """Whether a share FLAT_SHARE of the voxels about ``p`` is within ``edge`` of its value ``own``."""
    nz, ny, nx = voxels.shape
    xs, ys, zs = reach(p[0], nx), reach(p[1], ny), reach(p[2], nz)
    alike, count = 0, 0
    for k in range(zs[0], zs[1] + 1):
        for j in range(ys[0], ys[1] + 1):
            for i in range(xs[0], xs[1] + 1):
                alike += abs(np.float64(voxels[k, j, i]) - own) <= edge
                count += 1
    return alike >= FLAT_SHARE * count


@kernel(exact=True)
def at_edge(voxels, p, own, low, high):
    """Whether a point ``p`` of value ``own`` is at the edge of a plateau between the values ``low`` and ``high``."""
    edge = EDGE_SHARE * (np.float64(high) - np.float64(low))
    return low < high and not low + edge < own < high - edge and flat(voxels, p, own, edge)


@kernel(exact=True)
def point_within(shape, p, d, t):
    """The point p + t·d, or the nearest to it within a box of ``shape`` (nz, ny, nx) voxels."""
    x, y, z = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    return (
        min(max(x, 0.0), shape[2] - 1.0),
        min(max(y, 0.0), shape[1] - 1.0),
        min(max(z, 0.0), shape[0] - 1.0),
    )


@kernel(exact=True)
def crossing(voxels, p, d, level, halvings=HALVINGS):
    """How far along ``d`` the isosurface ``level`` is first crossed, MAX_SHIFT_VOXELS at most; inf where it is not.

    Known to STEP_VOXELS over 2 to the power of the ``halvings``.
    """
    t, v = 0.0, value(voxels, p)
    solid = v > level
    while t < MAX_SHIFT_VOXELS and (v > level) == solid and not math.isnan(v):
        t += STEP_VOXELS
        v = value(voxels, point_within(voxels.shape, p, d, t))
    if (v > level) == solid or math.isnan(v):
        return math.inf
    near, far = t - STEP_VOXELS, t
    for _ in range(halvings):
        middle = 0.5 * (near + far)
        if (value(voxels, point_within(voxels.shape, p, d, middle)) > level) == solid:
            near = middle
        else:
            far = middle
    return far


@kernel(exact=True)
def downhill(n, spacing, sign):
    """The way from a plateau: along the world normal ``n``, or against it, a voxel long."""
    x, y, z = n[0] * spacing[0], n[1] * spacing[1], n[2] * spacing[2]
    share = sign / math.sqrt(x * x + y * y + z * z)
    return x * share, y * share, z * share


@kernel(exact=True)
def thin(voxels, p, d, level):
    """Whether one of the 26 places a voxel away from ``p`` is open and BEHIND_VOXELS behind it: the wall's other side
    is as near.
    """
    for place in range(27):
        o = (place % 3 - 1.0, place // 3 % 3 - 1.0, place // 9 - 1.0)
        behind = o[0] * d[0] + o[1] * d[1] + o[2] * d[2] < BEHIND_VOXELS
        if behind and value(voxels, point_within(voxels.shape, p, o, 1.0)) <= level:
            return True
    return False


@kernel(exact=True)
def leave_plateau(field, p, n):
    """Where a texel at ``p``, with the normal ``n`` that is not zero, is lit: (point, normal, isovalue).

    There and on its own isosurface, a float32, unless it is at the edge of a plateau. Where nothing half-way is found
    near, one at the foot of it stays; one on top has no side, as in a thin wall, and its normal is (0, 0, 0).
    """
    own = np.float32(value(field.voxels, p))
    low, high, _ = value_span(field.voxels, p)
    if not at_edge(field.voxels, p, own, low, high):
        return p, n, own
    level = np.float32(0.5 * (np.float64(low) + np.float64(high)))
    top = own > level
    d = downhill(n, field.spacing, 1.0 if top else -1.0)
    t = math.inf if top and thin(field.voxels, p, d, level) else crossing(field.voxels, p, d, level)
    if t < math.inf:
        there = point_within(field.voxels.shape, p, d, t)
        return there, normal(field, there), level
    return p, (0.0, 0.0, 0.0) if top else n, own
