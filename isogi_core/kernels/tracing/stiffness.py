"""Stiff cells, in which isosurfaces run along plateaus, through noise, or next to holes; and the
points at which texels on plateaus are lit.

``count_stiffness`` counts such cells for all isovalues in one pass. A cell belongs to the isovalues
from its least corner to its greatest, so that counts are kept as differences: +1 at the first
isovalue of a range, -1 after its last.

A texel is at the edge of a plateau (a mask, a thin ramp, a terrace, clipped data) if hardly any
voxel nearby is greater while many are equal: hardly anything above its value is solid. It is at an
edge as well if hardly any is less: its isosurface is then the hull of all that is greater, up to a
voxel too far out. ``leave_plateau`` lights such a texel half-way between the extremes of the values
nearby, where the isosurfaces of its cells lie. In a wall one voxel thin, whose two sides differ in
light, a texel on the wall itself holds no light.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.voxels import cube
from isogi_core.kernels.tracing.field import FIELD_RECORD, normal, value
from isogi_core.kernels.tracing.vec import is_zero

EDGE_SHARE = 0.1
"""Share of the range of nearby values within which a texel counts as being at an end of it."""

FLAT_SHARE = 2 / 7
"""Share of nearby voxels that equal the texel at the edge of a plateau; at a cube's corner, 8 of 27
do.

Many texels of noisy fields are extremes of their neighbourhood. Without this limit they would leave
their isosurfaces, and have a quarter more error.
"""

MAX_SHIFT_VOXELS = 1.5
"""Largest distance in voxels between a texel and the point at which it is lit."""

BEHIND_VOXELS = -0.6
"""Largest distance ahead of a texel, in voxels, of a place that counts as behind it; a cube's
corner has none.
"""

STEP_VOXELS = 0.0625
"""Step in voxels at which the field is sampled along a way; a power of two."""

HALVINGS = 32
"""Number of bisection steps that refine an isosurface within a step."""


@kernel(exact=True)
def reach(x, n):
    """Return the first and last of the ``n`` voxels along an axis that the smoothed gradient
    at ``x`` uses.
    """
    return max(int(math.floor(x)) - 1, 0), min(int(math.ceil(x)) + 1, n - 1)


@kernel(exact=True)
def value_span(voxels, p):
    """Return the least and the greatest voxel within the support of the smoothed gradient at
    ``p``, and True if one is NaN.
    """
    nz, ny, nx = voxels.shape
    xs, ys, zs = reach(p[0], nx), reach(p[1], ny), reach(p[2], nz)
    low = np.float32(math.inf)
    high = np.float32(-math.inf)
    hole = False
    for k in range(zs[0], zs[1] + 1):
        for j in range(ys[0], ys[1] + 1):
            for i in range(xs[0], xs[1] + 1):
                v = voxels[k, j, i]
                # Comparisons with NaN are false, so that holes change neither bound.
                low = v if v < low else low
                high = v if v > high else high
                hole = hole | math.isnan(v)
    return low, high, hole


@kernel(exact=True)
def flat(voxels, p, here, edge):
    """Return True if at least the share FLAT_SHARE of the voxels around ``p`` is within ``edge``
    of the value ``here`` at ``p``.

    Voxels around are those of the smoothed gradient: see ``reach``.
    """
    nz, ny, nx = voxels.shape
    xs, ys, zs = reach(p[0], nx), reach(p[1], ny), reach(p[2], nz)
    alike = 0
    count = 0
    for k in range(zs[0], zs[1] + 1):
        for j in range(ys[0], ys[1] + 1):
            for i in range(xs[0], xs[1] + 1):
                alike += abs(np.float64(voxels[k, j, i]) - here) <= edge
                count += 1
    return alike >= FLAT_SHARE * count


@kernel(exact=True)
def at_edge(voxels, p, here, low, high):
    """Return True if ``p`` with the value ``here`` is at the edge of a plateau; ``low`` and
    ``high`` are the extremes nearby.

    It is if its value is near one of them, and many voxels nearby have that value.
    """
    edge = EDGE_SHARE * (np.float64(high) - np.float64(low))
    return low < high and not low + edge < here < high - edge and flat(voxels, p, here, edge)


@kernel(exact=True)
def point_within(shape, p, d, t):
    """Return the point p + t·d, or the nearest to it in a box of ``shape`` (nz, ny, nx) voxels."""
    x, y, z = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    return (
        min(max(x, 0.0), shape[2] - 1.0),
        min(max(y, 0.0), shape[1] - 1.0),
        min(max(z, 0.0), shape[0] - 1.0),
    )


@kernel(exact=True)
def crossing(voxels, p, d, level, halvings=HALVINGS):
    """Return the distance along ``d`` at which the isosurface ``level`` is first crossed; infinite
    if it is not within MAX_SHIFT_VOXELS.

    The error is at most STEP_VOXELS over 2 to the power of ``halvings``.
    """
    # Step along the way until the field changes sides.
    t = 0.0
    v = value(voxels, p)
    solid = v > level
    while t < MAX_SHIFT_VOXELS and (v > level) == solid and not math.isnan(v):
        t += STEP_VOXELS
        v = value(voxels, point_within(voxels.shape, p, d, t))
    if (v > level) == solid or math.isnan(v):
        return math.inf
    # Bisect the last step.
    near = t - STEP_VOXELS
    far = t
    for _ in range(halvings):
        middle = 0.5 * (near + far)
        if (value(voxels, point_within(voxels.shape, p, d, middle)) > level) == solid:
            near = middle
        else:
            far = middle
    return far


@kernel(exact=True)
def downhill(n, spacing, sign):
    """Return the way down from a plateau, or up to it: along the world normal ``n`` if ``sign``
    is 1, against it if -1; a voxel long, in index space.
    """
    x, y, z = n[0] * spacing[0], n[1] * spacing[1], n[2] * spacing[2]
    share = sign / math.sqrt(x * x + y * y + z * z)
    return x * share, y * share, z * share


@kernel(exact=True)
def thin(voxels, p, d, level):
    """Return True if one of the 26 places a voxel away from ``p`` lies outside and behind it,
    against ``d``: the wall's other side is then as near.
    """
    for place in range(27):
        o = (place % 3 - 1.0, place // 3 % 3 - 1.0, place // 9 - 1.0)
        behind = o[0] * d[0] + o[1] * d[1] + o[2] * d[2] < BEHIND_VOXELS
        if behind and value(voxels, point_within(voxels.shape, p, o, 1.0)) <= level:
            return True
    return False


@kernel(exact=True)
def leave_plateau(field, p, n):
    """Return the point at which a texel at ``p`` with the normal ``n``, not zero, is lit: (point,
    normal, float32 isovalue).

    Point and normal are ``p`` and ``n``, and the isovalue is the field's value there, unless ``p``
    is at the edge of a plateau. Then the point lies on the isosurface half-way between the extremes
    nearby: from the top of the plateau down the slope, from its foot up.

    If that isosurface is not within MAX_SHIFT_VOXELS, a texel at the foot keeps its place, and one
    on top gets the normal (0, 0, 0), as it has no side. So does one on top of a ``thin`` wall.
    """
    here = np.float32(value(field.voxels, p))
    low, high, _ = value_span(field.voxels, p)
    if not at_edge(field.voxels, p, here, low, high):
        return p, n, here
    # Look for the isosurface half-way between the extremes nearby, down the slope or up.
    level = np.float32(0.5 * (np.float64(low) + np.float64(high)))
    top = here > level
    d = downhill(n, field.spacing, 1.0 if top else -1.0)
    if top and thin(field.voxels, p, d, level):
        t = math.inf
    else:
        t = crossing(field.voxels, p, d, level)
    # Move the texel there, with the normal of that place.
    if t < math.inf:
        there = point_within(field.voxels.shape, p, d, t)
        return there, normal(field, there), level
    # Take the normal from a texel on top, which makes it void; leave one at the foot as it is.
    return p, (0.0, 0.0, 0.0) if top else n, here


EDGE_MARK = 1
VOID_MARK = 2
HOLE_MARK = 4
"""Marks of a voxel: at the edge of a plateau, without a gradient, near a hole (NaN).

A texel at the edge of a plateau is not lit on the isosurface through it: see ``leave_plateau``.
"""

CELLS_ROW = 0
STEEP_ROW = 1
PLATEAU_ROW = 2
NOISY_ROW = 3
HOLED_ROW = 4
FACES_ROW = 5
"""Rows of counts; those from FACES_ROW on belong to the six faces of the box,
x = 0, x = 1, y = 0, ….
"""

COUNTED_ROWS = FACES_ROW + 6

STEEP_CORNERS = 4
"""Number of corners at a plateau's edge, or on a plateau, that make a cell steep:
half of its corners.
"""

MIN_MEAN_NORMAL = 0.9
"""Length of the mean of a cell's unit normals below which the cell is noisy: normals then differ by
26° or more.

On a ball that happens at a radius of two voxels: finer detail cannot be told from noise.
"""

LEVEL_ARRAY = types.float32[::1]
COUNT_ROWS = types.int64[:, ::1]


@kernel()
def first_at(levels, value):
    """Return the place of the first of the ascending ``levels`` that is at least ``value``;
    their number for NaN.
    """
    first = 0
    last = levels.shape[0]
    while first < last:
        middle = (first + last) // 2
        if value <= levels[middle]:
            last = middle
        else:
            first = middle + 1
    return first


@kernel()
def look_at(field, levels, k, normals, marks):
    """Write ``normals`` (ny, nx, 3) and ``marks`` (ny, nx) of the voxels of plane ``k`` that
    are near an isosurface of the ``levels``.
    """
    _, ny, nx = field.voxels.shape
    for j in range(ny):
        for i in range(nx):
            p = (float(i), float(j), float(k))
            # Skip voxels that no isovalue passes nearby: their cells are not counted.
            low, high, hole = value_span(field.voxels, p)
            if not first_at(levels, low) < first_at(levels, high):
                continue
            n = normal(field, p)
            edge = at_edge(field.voxels, p, field.voxels[k, j, i], low, high)
            normals[j, i, 0], normals[j, i, 1], normals[j, i, 2] = n
            marks[j, i] = (
                (EDGE_MARK if edge else 0)
                | (VOID_MARK if is_zero(n) else 0)
                | (HOLE_MARK if hole else 0)
            )


@kernel()
def count_levels(row, first, last):
    """Add 1 to the counts of the isovalues ``first`` to ``last`` - 1, as differences in ``row``."""
    row[first] += 1
    row[last] -= 1


@kernel()
def passing(levels, corners, bit, side):
    """Return the range of isovalues whose surface separates the corners of a cell: first, one past
    the last.

    Only corners whose ``bit`` is ``side`` count, or all if ``bit`` is 0. A corner at the isovalue
    is outside, as it is for rays.
    """
    low = np.inf
    high = -np.inf
    for c in range(8):
        if c & bit == side:
            low, high = min(low, corners[c]), max(high, corners[c])
    return first_at(levels, np.float32(low)), first_at(levels, np.float32(high))


@kernel()
def corner_of(marks, normals, k, j, i):
    """Summarise the corners of the cell at (k, j, i): (corners at an edge, all marks, length of the
    mean normal).

    ``marks`` and ``normals`` hold two planes of voxels; plane k is in row k % 2.
    """
    edges = 0
    together = 0
    known = 0
    x, y, z = 0.0, 0.0, 0.0
    for c in range(8):
        plane = (k + (c >> 2)) & 1
        row = j + ((c >> 1) & 1)
        column = i + (c & 1)
        mark = marks[plane, row, column]
        n = normals[plane, row, column]
        # Count corners at an edge, join the marks, and sum the normals that exist.
        edges = edges + (mark & EDGE_MARK)
        together = together | mark
        if not mark & VOID_MARK:
            x = x + n[0]
            y = y + n[1]
            z = z + n[2]
            known = known + 1
    return edges, together, math.sqrt(x * x + y * y + z * z) / max(known, 1)


@kernel()
def count_plateaus(levels, corners, first, last, row):
    """Count the isovalues that at least STEEP_CORNERS ``corners`` of a cell equal."""
    for level in range(first, last):
        same = 0
        for c in range(8):
            same += corners[c] == levels[level]
        if same >= STEEP_CORNERS:
            count_levels(row, level, level + 1)


@kernel()
def count_faces(levels, corners, place, shape, counts):
    """Count the surfaces that meet a face of the box in the cell at ``place`` (x, y, z), for
    each face that it lies on.
    """
    for face in range(6):
        axis = face // 2
        side = face % 2
        if place[axis] == (shape[2 - axis] - 2 if side else 0):
            first, last = passing(levels, corners, 1 << axis, side << axis)
            if first < last:
                count_levels(counts[FACES_ROW + face], first, last)


@kernel()
def count_cell(levels, corners, first, last, seen, counts):
    """Count a cell that the isovalues ``first`` to ``last`` - 1 pass;
    ``seen`` is its ``corner_of``.
    """
    edges, together, coherence = seen
    count_levels(counts[CELLS_ROW], first, last)
    if edges >= STEEP_CORNERS:
        count_levels(counts[STEEP_ROW], first, last)
    if coherence < MIN_MEAN_NORMAL:
        count_levels(counts[NOISY_ROW], first, last)
    if together & HOLE_MARK:
        count_levels(counts[HOLED_ROW], first, last)
    # A cell with a corner without a gradient is a plateau for all isovalues; others only for
    # isovalues that half of their corners equal.
    if together & VOID_MARK:
        count_levels(counts[PLATEAU_ROW], first, last)
    else:
        count_plateaus(levels, corners, first, last, counts[PLATEAU_ROW])


@kernel(types.void(FIELD_RECORD, LEVEL_ARRAY, types.int64, types.int64, COUNT_ROWS))
def count_stiffness(field, levels, begin, end, counts):
    """Add the cells of layers ``begin`` to ``end`` - 1 along z to ``counts`` (COUNTED_ROWS, levels
    + 1), as differences.

    ``levels`` are ascending isovalues in units of the voxels. CELLS_ROW counts the cells that the
    surface passes. Of these STEEP_ROW counts cells with half of their corners at the edge of a
    plateau, NOISY_ROW cells with normals that differ widely, HOLED_ROW cells next to a hole, and
    PLATEAU_ROW cells with a corner without a gradient or half of their corners at the isovalue
    itself. One row for each face of the box counts cells that the surface leaves there.
    """
    _, ny, nx = field.voxels.shape
    normals = np.zeros((2, ny, nx, 3))
    marks = np.zeros((2, ny, nx), np.uint8)
    look_at(field, levels, begin, normals[begin & 1], marks[begin & 1])
    for k in range(begin, end):
        # Keep normals and marks of two planes of voxels at a time.
        look_at(field, levels, k + 1, normals[(k + 1) & 1], marks[(k + 1) & 1])
        for j in range(ny - 1):
            for i in range(nx - 1):
                corners = cube(field.voxels, k, j, i)
                first, last = passing(levels, corners, 0, 0)
                if first < last and not math.isnan(sum(corners)):
                    seen = corner_of(marks, normals, k, j, i)
                    count_cell(levels, corners, first, last, seen, counts)
                    count_faces(levels, corners, (i, j, k), field.voxels.shape, counts)
