"""Glowing regions: parts of the volume that emit light and block none, and the light that a ray
gathers in them.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record
from isogi_core.kernels.tracing.field import FIELD_RECORD, value
from isogi_core.kernels.tracing.vec import column, dot, length, madd, scale, sub

VALUE_STEP = 0.5
"""Step at which values are sampled along a ray, in voxels of the least spacing."""

NO_WAY = (0.0, -math.inf)
"""The interval of a ray that misses a region."""


class Glows(NamedTuple):
    """k ≥ 0 glowing regions in world space; all float64.

    - ``centres``, ``halves`` (3, k): boxes by centre and half edges; balls, with the radius thrice,
      if ``round`` (k,) is 1.
    - ``radii`` (k,): radii of the bounding balls.
    - ``lows``, ``highs`` (k,): the voxels' values that glow, infinite if all of the region does.
    - ``rates`` (k,): radiance gathered per unit of length.
    - ``masked`` (k,): if 1, voxels whose ``bits`` lack number k do not glow; bits are uint8 of the
      field's shape, or empty. The ``lows`` of such regions are finite.
    """

    centres: Any
    halves: Any
    round: Any
    radii: Any
    lows: Any
    highs: Any
    rates: Any
    masked: Any
    bits: Any


NO_BITS = np.zeros((0, 0, 0), np.uint8)
GLOWS = record(Glows, REAL_ROWS, REAL_ROWS, *[REAL_ARRAY] * 6, types.uint8[:, :, ::1])


@kernel()
def way_through_ball(away, radius, w):
    """Return the part (near, far) of a ray along the unit vector ``w`` in a ball whose centre is
    ``away`` from its start.

    It begins at the start, 0, at the earliest.
    """
    middle = dot(away, w)
    across = madd(away, -middle, w)
    square = radius * radius - dot(across, across)
    if not square > 0.0:
        return NO_WAY
    half = math.sqrt(square)
    return max(middle - half, 0.0), middle + half


@kernel()
def way_through_box(away, half, w):
    """Return the part (near, far) of a ray along the unit vector ``w`` in a box with half edges
    ``half`` whose centre is ``away``.
    """
    near = 0.0
    far = math.inf
    for c in range(3):
        if w[c] != 0.0:
            middle = away[c] / w[c]
            reach = abs(half[c] / w[c])
            near = max(near, middle - reach)
            far = min(far, middle + reach)
        elif abs(away[c]) > half[c]:
            far = -math.inf
    return (near, far) if near < far else NO_WAY


@kernel()
def way_through(glows, k, p, w):
    """Return the part (near, far) of the ray from the world point ``p`` along the unit vector
    ``w`` in region ``k``.
    """
    away = sub(column(glows.centres, k), p)
    half = column(glows.halves, k)
    if glows.round[k] > 0.0:
        return way_through_ball(away, half[0], w)
    return way_through_box(away, half, w)


@kernel()
def share_between(low, high, before, after):
    """Return the share of an interval on which a value, linear from ``before`` to ``after``,
    lies from ``low`` to ``high``.
    """
    if before == after:
        return 1.0 if low <= before <= high else 0.0
    enters = (low - before) / (after - before)
    leaves = (high - before) / (after - before)
    return max(min(max(enters, leaves), 1.0) - max(min(enters, leaves), 0.0), 0.0)


@kernel()
def value_on(field, p, t, w):
    """Return the value of the field at ``t`` along a ray from the world point ``p``."""
    sx, sy, sz = field.spacing
    x, y, z = madd(p, t, w)
    return value(field.voxels, (x / sx, y / sy, z / sz))


@kernel()
def share_within(field, low, high, p, w, near, far):
    """Return the share of the ray from ``near`` to ``far`` on which the field lies from ``low`` to
    ``high``.

    Values are linear between steps of at most VALUE_STEP voxels, so that a thin layer is as bright
    as it is thick.
    """
    sx, sy, sz = field.spacing
    steps = int(math.ceil((far - near) / (VALUE_STEP * min(sx, sy, sz))))
    length = (far - near) / steps
    inside = 0.0
    before = value_on(field, p, near, w)
    for i in range(steps):
        after = value_on(field, p, near + (i + 1) * length, w)
        inside += share_between(low, high, before, after)
        before = after
    return inside / steps


@kernel()
def in_mask(glows, k, x, y, z):
    """Return True if the voxel nearest to (x, y, z) in index space is in the mask
    of region ``k``.
    """
    nz, ny, nx = glows.bits.shape
    a = min(max(int(x + 0.5), 0), nx - 1)
    b = min(max(int(y + 0.5), 0), ny - 1)
    c = min(max(int(z + 0.5), 0), nz - 1)
    return (int(glows.bits[c, b, a]) >> k) & 1 == 1


@kernel()
def share_in_mask(field, glows, k, p, w, near, far):
    """Return the share of the ray from ``near`` to ``far`` in the mask and in the range of region
    ``k``.

    Steps are those of ``share_within``; a step is in the mask if its middle is.
    """
    sx, sy, sz = field.spacing
    steps = int(math.ceil((far - near) / (VALUE_STEP * min(sx, sy, sz))))
    length = (far - near) / steps
    inside = 0.0
    before = value_on(field, p, near, w)
    for i in range(steps):
        x, y, z = madd(p, near + (i + 0.5) * length, w)
        after = value_on(field, p, near + (i + 1) * length, w)
        # Count the part of the step on which the value glows, if its middle is in the mask.
        if in_mask(glows, k, x / sx, y / sy, z / sz):
            inside += share_between(glows.lows[k], glows.highs[k], before, after)
        before = after
    return inside / steps


@kernel()
def gather_on_way(field, glows, k, p, w, reach):
    """Return the radiance that the ray from the world point ``p`` along the unit vector ``w``
    gathers of region ``k`` before ``reach``.

    The region has radiance 1. Emission without absorption integrates exactly to rate times length.
    """
    near, far = way_through(glows, k, p, w)
    far = min(far, reach)
    if not near < far:
        return 0.0
    way = glows.rates[k] * (far - near)
    if glows.lows[k] == -math.inf and glows.highs[k] == math.inf:
        return way
    if glows.masked[k] > 0.0:
        return way * share_in_mask(field, glows, k, p, w, near, far)
    return way * share_within(field, glows.lows[k], glows.highs[k], p, w, near, far)


RAY_ROWS = types.float64[:, ::1]
LIGHT_ROWS = types.float64[:, ::1]
EYE = types.UniTuple(types.float64, 3)


@kernel(types.void(FIELD_RECORD, GLOWS, EYE, RAY_ROWS, REAL_ARRAY, LIGHT_ROWS))
def gather_from_eye(field, glows, eye, directions, reaches, light):
    """Fill ``light`` (n, k) with the light of each of k regions of radiance 1 along rays from the
    ``eye``.

    The eye and the ``directions`` (3, n) are in index space; rays end at ``reaches`` (n,) times
    their direction.
    """
    sx, sy, sz = field.spacing
    start = eye[0] * sx, eye[1] * sy, eye[2] * sz
    for m in range(reaches.shape[0]):
        # Convert the ray to world space, in which regions are given.
        x, y, z = column(directions, m)
        way = x * sx, y * sy, z * sz
        size = length(way)
        for k in range(glows.rates.shape[0]):
            light[m, k] = gather_on_way(
                field, glows, k, start, scale(way, 1.0 / size), size * reaches[m]
            )
