"""Glow: parts of the volume that give off light and stop none, and what a ray gathers on its way
through them.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from isogi_core.kernels._jit import REAL_ARRAY, REAL_ROWS, kernel, record
from isogi_core.kernels.tracing.field import FIELD_RECORD, value
from isogi_core.kernels.tracing.vec import column, dot, length, madd, scale, sub

VALUE_STEP = 0.5
"""Steps in which a range of values is looked for along a ray, in voxels of the least spacing."""

NO_WAY = (0.0, -math.inf)
"""The way of a ray that misses a region."""


class Glows(NamedTuple):
    """k >= 0 regions that give off light, in the world; all float64.

    Boxes about ``centres`` (3, k) with half edges ``halves`` (3, k), or balls where ``round`` (k,)
    is 1: then their radius, thrice. ``radii`` (k,) are of the balls about them. Of each it is the
    part whose voxels are from ``lows`` to ``highs`` (k,), which are infinite where all of it glows.
    A ray gathers the radiance ``rates`` (k,) on each unit of its way. Where ``masked`` (k,) is 1
    voxels whose ``bits`` lack number k do not glow: uint8 of the shape of the field, or none where
    there is no mask. The ``lows`` of such are finite.
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
    """Part (near, far) of a ray along the unit vector ``w`` within a ball whose middle is ``away``
    from its start.

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
    """Part (near, far) of a ray along the unit vector ``w`` in a box with half edges ``half`` that
    is ``away``.
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
    """Part (near, far) of the ray from the world point ``p`` along the unit vector ``w`` within
    region ``k``.
    """
    away = sub(column(glows.centres, k), p)
    half = column(glows.halves, k)
    if glows.round[k] > 0.0:
        return way_through_ball(away, half[0], w)
    return way_through_box(away, half, w)


@kernel()
def share_between(low, high, before, after):
    """Share of a way on which a value is from ``low`` to ``high`` that goes evenly from ``before``
    to ``after``.
    """
    if before == after:
        return 1.0 if low <= before <= high else 0.0
    enters = (low - before) / (after - before)
    leaves = (high - before) / (after - before)
    return max(min(max(enters, leaves), 1.0) - max(min(enters, leaves), 0.0), 0.0)


@kernel()
def value_on(field, p, t, w):
    """The value of the field at ``t`` along a ray from the world point ``p``."""
    sx, sy, sz = field.spacing
    x, y, z = madd(p, t, w)
    return value(field.voxels, (x / sx, y / sy, z / sz))


@kernel()
def share_within(field, low, high, p, w, near, far):
    """Share of the way from ``near`` to ``far`` along a ray on which the field is from ``low`` to
    ``high``.

    In steps of at most STEP voxels, between which values go evenly: so thin layers are as bright as
    they are thick.
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
    """Whether the voxel that is nearest to a place in index space is in the mask of region
    ``k``.
    """
    nz, ny, nx = glows.bits.shape
    a = min(max(int(x + 0.5), 0), nx - 1)
    b = min(max(int(y + 0.5), 0), ny - 1)
    c = min(max(int(z + 0.5), 0), nz - 1)
    return (int(glows.bits[c, b, a]) >> k) & 1 == 1


@kernel()
def share_in_mask(field, glows, k, p, w, near, far):
    """Share of the way from ``near`` to ``far`` along a ray that is in the mask and the range of
    region ``k``.

    By the steps of ``share_within``, each of which is in the mask where its middle is.
    """
    sx, sy, sz = field.spacing
    steps = int(math.ceil((far - near) / (VALUE_STEP * min(sx, sy, sz))))
    length = (far - near) / steps
    inside = 0.0
    before = value_on(field, p, near, w)
    for i in range(steps):
        x, y, z = madd(p, near + (i + 0.5) * length, w)
        after = value_on(field, p, near + (i + 1) * length, w)
        if in_mask(glows, k, x / sx, y / sy, z / sz):
            inside += share_between(glows.lows[k], glows.highs[k], before, after)
        before = after
    return inside / steps


@kernel()
def gather_on_way(field, glows, k, p, w, reach):
    """Radiance that the ray from the world point ``p`` along the unit vector ``w`` gathers of
    region ``k``, which has radiance 1, before ``reach``: the rate times the way in it. Emission
    without absorption is exact to integrate.
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
    """Fill ``light`` (n, k) with what rays from the ``eye`` gather of each of k regions, which have
    radiance 1.

    The eye and the ``directions`` (3, n) are in index space; rays go ``reaches`` (n,) times their
    direction.
    """
    sx, sy, sz = field.spacing
    start = eye[0] * sx, eye[1] * sy, eye[2] * sz
    for m in range(reaches.shape[0]):
        x, y, z = column(directions, m)
        way = x * sx, y * sy, z * sz
        size = length(way)
        for k in range(glows.rates.shape[0]):
            light[m, k] = gather_on_way(
                field, glows, k, start, scale(way, 1.0 / size), size * reaches[m]
            )
