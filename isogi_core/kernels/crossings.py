"""Crossings in lanes: ``clip_box`` and ``cross_cell`` of ``intersect`` for many rays at once, to the same bits.

What is plain arithmetic there (``cubic_along``, ``horner``) is the same function here; what branches is
written with masks, each lane going the way that the scalar code goes.
"""

import math

import numpy as np

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.intersect import BLUR, REFINEMENTS, SLIVER, cubic_along, horner
from isogi_core.kernels.lane_memory import gather_pair
from isogi_core.kernels.lanes import (
    bits,
    copysign,
    doubles,
    ints,
    least,
    magnitude,
    most,
    root,
    select,
)


@kernel()
def clip_lanes(o, d, n, near, far):
    """``clip`` for lanes: the part of [near, far] in which o + t·d is within 0 … n - 1 along one axis."""
    a, b = -o / d, (n - 1 - o) / d
    still = d == 0.0
    within = (o >= 0.0) & (o <= n - 1.0)
    first = select(still, select(within, near, math.inf), most(near, least(a, b)))
    return first, select(still, select(within, far, -math.inf), least(far, most(a, b)))


@kernel()
def clip_box_lanes(shape, o, d):
    """``clip_box`` for lanes."""
    nz, ny, nx = shape
    near, far = clip_lanes(o[0], d[0], nx, doubles(0.0), doubles(math.inf))
    near, far = clip_lanes(o[1], d[1], ny, near, far)
    return clip_lanes(o[2], d[2], nz, near, far)


@kernel()
def longest_of(d):
    """The largest component's magnitude of a direction."""
    return most(most(magnitude(d[0]), magnitude(d[1])), magnitude(d[2]))


@kernel()
def cut_slab_lanes(o, d, i, near, far):
    """``cut_slab`` for lanes, with the direction's component for its reciprocal."""
    inv = 1.0 / d
    still = ~(magnitude(inv) < math.inf)
    a, b = (i - o) * inv, (i + 1.0 - o) * inv
    return select(still, near, most(near, least(a, b))), select(still, far, least(far, most(a, b)))


@kernel()
def cut_cell_lanes(o, d, cell, near, far):
    """``cut_cell`` for lanes; ``cell`` as doubles."""
    near, far = cut_slab_lanes(o[0], d[0], cell[0], near, far)
    near, far = cut_slab_lanes(o[1], d[1], cell[1], near, far)
    return cut_slab_lanes(o[2], d[2], cell[2], near, far)


@kernel()
def corners_of(flat, place, stride, iso):
    """The eight corner values less the isovalue, x fastest, of cells whose lowest corner is at ``place``."""
    sy, sz = stride
    a, b = gather_pair(flat, place)
    c, d = gather_pair(flat, place + sy)
    e, f = gather_pair(flat, place + sz)
    g, h = gather_pair(flat, place + (sy + sz))
    near = doubles(a) - iso, doubles(b) - iso, doubles(c) - iso, doubles(d) - iso
    return (*near, doubles(e) - iso, doubles(f) - iso, doubles(g) - iso, doubles(h) - iso)


@kernel()
def unknown(value):
    """Whether lanes are not a number."""
    return ~((value <= 0.0) | (value > 0.0))


@kernel()
def mixed(c):
    """Whether corner values lie on both sides, solid being above 0, all of them numbers; and the largest magnitude."""
    highest = most(most(most(c[0], c[1]), most(c[2], c[3])), most(most(c[4], c[5]), most(c[6], c[7])))
    lowest = least(least(least(c[0], c[1]), least(c[2], c[3])), least(least(c[4], c[5]), least(c[6], c[7])))
    total = c[0] + c[1] + c[2] + c[3] + c[4] + c[5] + c[6] + c[7]
    return (highest > 0.0) & ~(lowest > 0.0) & ~unknown(total), most(highest, -lowest)


@kernel()
def turning_points_lanes(q):
    """``turning_points`` for lanes."""
    a, b, c = 3.0 * q[0], q[1], q[2]
    disc = b * b - a * c
    none = ~(disc > 0.0)
    s = -(b + copysign(root(disc), b))
    r1, r2 = select(a != 0.0, s / a, 1.0), select(s != 0.0, c / s, 1.0)
    r1, r2 = least(most(r1, 0.0), 1.0), least(most(r2, 0.0), 1.0)
    return select(none, 1.0, least(r1, r2)), select(none, 1.0, most(r1, r2))


@kernel()
def refine_lanes(q, lo, hi, solid, wanted):
    """``refine`` for the ``wanted`` lanes, which leave the side ``solid``."""
    first, last = horner(q, lo), horner(q, hi)
    t = lo + (hi - lo) * (first / (first - last))
    t = select((lo < t) & (t < hi), t, 0.5 * (lo + hi))
    open_ = wanted
    for _ in range(REFINEMENTS):
        f = horner(q, t)
        stays = ~((f > 0.0) ^ solid)
        lo, hi = select(stays, t, lo), select(stays, hi, t)
        slope = (3.0 * q[0] * t + 2.0 * q[1]) * t + q[2]
        step = select(slope != 0.0, t - f / slope, math.inf)
        following = select((lo <= step) & (step <= hi), step, 0.5 * (lo + hi))
        moved = magnitude(following - t)
        t = select(open_, following, t)
        open_ = open_ & ~(moved < 1e-9)
        if bits(open_) == 0:
            break
    return t


@kernel()
def beyond(f, solid, blur):
    """Whether the values ``f`` lie on the other side than ``solid`` by more than ``blur``."""
    return select(solid, -f, f) > blur


@kernel()
def first_crossing_lanes(q, solid, blur, wanted):
    """``first_crossing`` for lanes on the side ``solid``: (t, whether there is one)."""
    end = q[0] + q[1] + q[2] + q[3] > 0.0
    b1, b2 = q[3] + q[2] / 3.0, q[3] + (2.0 * q[2] + q[1]) / 3.0
    leaves = wanted & ((end ^ solid) | ((b1 > 0.0) ^ solid) | ((b2 > 0.0) ^ solid))
    r1, r2 = turning_points_lanes(q)
    turns = r1 > 0.0
    one = turns & beyond(horner(q, r1), solid, blur)
    after = select(turns, r1, 0.0)
    turns = r2 > after
    two = turns & beyond(horner(q, r2), solid, blur)
    lo = select(one, 0.0, select(two, after, select(turns, r2, after)))
    hi = select(one, r1, select(two, r2, 1.0))
    crosses = leaves & (one | two | (end ^ solid))
    return refine_lanes(q, lo, hi, solid, crosses), crosses


@kernel()
def at_home(o, middle, d, cell, n):
    """Whether the ray's point at ``middle`` has the cell ``cell`` along one axis of ``n`` voxels."""
    return least(most(ints(o + middle * d), 0), n - 2) == cell


@kernel()
def cross_cells(flat, shape, o, d, place, span, iso, solid):
    """The first crossings in the cells at ``place`` by rays that enter them ``solid`` or not.

    ``span`` (near, far) as ``clip_box`` gives it. Returns (t, where it enters the cell, sure): where
    ``sure``, t is what ``cross_cell`` gives; elsewhere that must be asked.
    """
    nz, ny, nx = shape
    layer = ints((doubles(place) + 0.5) / np.float64(nx))
    plane = ints((doubles(layer) + 0.5) / np.float64(ny))
    cell = place - layer * nx, layer - plane * ny, plane
    corner = doubles(cell[0]), doubles(cell[1]), doubles(cell[2])
    near, far = cut_cell_lanes(o, d, corner, span[0], span[1])
    through = far - near
    middle = 0.5 * (near + far)
    sure = at_home(o[0], middle, d[0], cell[0], nx) & at_home(o[1], middle, d[1], cell[1], ny)
    sure = sure & at_home(o[2], middle, d[2], cell[2], nz) & (through * longest_of(d) >= SLIVER)
    c = corners_of(flat, place, (nx, nx * ny), iso)
    holds, size = mixed(c)
    sure = sure & holds
    a = o[0] + near * d[0] - corner[0], o[1] + near * d[1] - corner[1], o[2] + near * d[2] - corner[2]
    q = cubic_along(c, a, (d[0] * through, d[1] * through, d[2] * through))
    t, crosses = first_crossing_lanes(q, solid, BLUR * max(shape) * size, sure)
    return near + t * through, near, sure & crosses
