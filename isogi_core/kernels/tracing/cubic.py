"""The trilinear field along a ray through one cell: a cubic, its turning points and first zero.

Each kernel takes numbers or SIMD vectors and gives the same bits for both; truth values are masks
then. The method follows three steps: split the cubic at the roots of its derivative, bracket a
crossing, refine it (Marmitt et al. 2004).
"""

import math

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.maths import any_of, divide, not_, where

REFINEMENTS = 48
"""Largest number of Newton steps."""


@kernel(exact=True)
def cubic_along(c, a, d):
    """Return the coefficients (A, B, C, D) of f(t) = A t³ + B t² + C t + D along a + t·d in the
    unit cell.

    ``c`` = (c000, c100, c010, c110, c001, c101, c011, c111) are corner values, x first.
    """
    # Write the trilinear field as a polynomial in x, y, z with differences of corners as
    # coefficients.
    x, y, z = c[1] - c[0], c[2] - c[0], c[4] - c[0]
    xy, xz, yz = c[3] - c[2] - x, c[5] - c[4] - x, c[6] - c[4] - y
    xyz = c[7] - c[6] - c[5] + c[4] - (c[3] - c[2] - c[1] + c[0])
    # Insert the ray, and sort by powers of t.
    dxy = d[0] * d[1]
    dxz = d[0] * d[2]
    dyz = d[1] * d[2]
    A = xyz * dxy * d[2]
    B = xy * dxy + xz * dxz + yz * dyz + xyz * (a[0] * dyz + a[1] * dxz + a[2] * dxy)
    C = (x + xy * a[1] + xz * a[2] + xyz * a[1] * a[2]) * d[0]
    C += (y + xy * a[0] + yz * a[2] + xyz * a[0] * a[2]) * d[1]
    C += (z + xz * a[0] + yz * a[1] + xyz * a[0] * a[1]) * d[2]
    D = c[0] + x * a[0] + (y + xy * a[0]) * a[1] + (z + xz * a[0] + (yz + xyz * a[0]) * a[1]) * a[2]
    return A, B, C, D


@kernel(exact=True)
def horner(q, t):
    """Evaluate the cubic ``q`` = (A, B, C, D) at ``t``."""
    return ((q[0] * t + q[1]) * t + q[2]) * t + q[3]


@kernel(exact=True)
def turning_points(q):
    """Return the roots of the slope 3A t² + 2B t + C, ascending, clamped to [0, 1]; (1, 1) if there
    are none.

    The stable quadratic formula avoids cancellation, and stays finite for A = 0 and for A = B = 0.
    """
    a = 3.0 * q[0]
    b = q[1]
    c = q[2]
    disc = b * b - a * c
    turns = disc > 0.0
    s = -(b + math.copysign(math.sqrt(where(turns, disc, 0.0)), b))
    # Take one root from the sum without cancellation, and the other from the product of the roots.
    r1, r2 = where(a != 0.0, divide(s, a), 1.0), where(s != 0.0, divide(c, s), 1.0)
    r1, r2 = min(max(r1, 0.0), 1.0), min(max(r2, 0.0), 1.0)
    return where(turns, min(r1, r2), 1.0), where(turns, max(r1, r2), 1.0)


@kernel(exact=True)
def refine(q, lo, hi, solid, wanted):
    """Return the zero of the cubic ``q`` in [lo, hi], in which it is monotone and leaves the side
    ``solid``.

    Newton's method starts from the chord's root and is kept in a shrinking bracket, so that it ends
    even if the values at both ends have one sign: a root that rounding lost is at ``lo`` then. The
    iteration ends once all lanes that are ``wanted`` have converged; a lane that has converged
    stays as it is, so that its bits do not depend on the other lanes.
    """
    # Start at the root of the chord, or at the middle if rounding puts that outside.
    first, last = horner(q, lo), horner(q, hi)
    t = lo + (hi - lo) * divide(first, first - last)
    t = where((lo < t) & (t < hi), t, 0.5 * (lo + hi))
    for _ in range(REFINEMENTS):
        # Shrink the bracket by the side of the value, then take a Newton step or halve.
        f = horner(q, t)
        stays = (f > 0.0) == solid
        lo, hi = where(stays, t, lo), where(stays, hi, t)
        slope = (3.0 * q[0] * t + 2.0 * q[1]) * t + q[2]
        step = where(slope != 0.0, t - divide(f, slope), math.inf)
        following = where((lo <= step) & (step <= hi), step, 0.5 * (lo + hi))
        moved = abs(following - t)
        t = where(wanted, following, t)
        wanted = wanted & not_(moved < 1e-9)
        if not any_of(wanted):
            break
    return t


@kernel(exact=True)
def ends_solid(q):
    """Return True if the cubic is above 0 at t = 1."""
    return q[0] + q[1] + q[2] + q[3] > 0.0


@kernel(exact=True)
def beyond(f, solid, blur):
    """Return True if the values ``f`` lie on the other side than ``solid``
    by more than ``blur``.
    """
    return where(solid, -f, f) > blur


@kernel(exact=True)
def first_crossing(q, solid, blur, wanted):
    """Return the smallest t in [0, 1] at which the cubic leaves the side ``solid``, and True if
    there is one.

    Lanes that are not ``wanted`` have none; t means nothing if there is no crossing. A cubic that
    turns within ``blur`` of 0 only touches the surface, and does not leave its side. The value at
    t = 1 is compared without blur: its sign is also the side on which the ray enters the next cell,
    and a surface between two cells that disagreed would be lost.
    """
    # Reject cubics whose Bernstein coefficients all lie on the starting side: they have no zero.
    across = ends_solid(q) != solid
    b1 = q[3] + q[2] / 3.0
    b2 = q[3] + (2.0 * q[2] + q[1]) / 3.0
    leaves = wanted & (across | ((b1 > 0.0) != solid) | ((b2 > 0.0) != solid))
    if not any_of(leaves):
        return q[3], leaves
    # Split at the turning points into monotone pieces: [0, r1], [r1, r2] and [r2, 1]. Take the
    # first one that ends on the other side, in which the zero is the only one. A piece that has no
    # length is left out.
    r1, r2 = turning_points(q)
    has_first = r1 > 0.0
    one = has_first & beyond(horner(q, r1), solid, blur)
    after = where(has_first, r1, 0.0)
    has_second = r2 > after
    two = has_second & beyond(horner(q, r2), solid, blur)
    lo = where(one, 0.0, where(two, after, where(has_second, r2, after)))
    hi = where(one, r1, where(two, r2, 1.0))
    crosses = leaves & (one | two | across)
    return refine(q, lo, hi, solid, crosses), crosses
