"""Stiffness: how the cells of isosurfaces lie to the plateaus, the noise and the holes of a field,
for many at once.

A cell belongs to all isovalues from its least corner up to its greatest, so that one pass serves
them all: counts are kept as differences, +1 where a range of isovalues begins and -1 behind its
end.

Plateaus: where texels at the edge of one are lit, as their own isosurface is one that no view
shows. A texel that hardly any voxel about it exceeds, while many are as high, is at the edge of a
plateau (a mask, a thin ramp, a terrace, clipped data): above its value next to nothing is solid.
One that hardly any falls below is too: its isosurface is the hull of all that is higher, up to a
voxel too far out. Such a texel is lit half-way between the ends of the values about it, which the
isosurfaces that its cells show lie about. In a wall one voxel thin, whose sides have light of their
own, a texel that is the wall itself has none.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.voxels import cube
from isogi_core.kernels.tracing.field import FIELD_RECORD, normal, value
from isogi_core.kernels.tracing.vec import is_zero

EDGE_SHARE = 0.1
"""Share of the range of the values about a texel within which it is at an end of it."""

FLAT_SHARE = 2 / 7
"""Share of the voxels about a texel that are as it is, at the edge of a plateau: a cube's corner
has 8 of 27.

Without it the texels of noisy fields, many of which are the least or the greatest for a voxel
around, would leave their isosurfaces too, and have a quarter more error.
"""

MAX_SHIFT_VOXELS = 1.5
"""How far from its place, in voxels, a texel is lit at most."""

BEHIND_VOXELS = -0.6
"""How far ahead of a texel, in voxels, a place is at most that is behind it; a cube's corner has
none such.
"""

STEP_VOXELS = 0.0625
"""Voxels between places at which the field is asked for the side that it is on; a power of two."""

HALVINGS = 32
"""Halvings of a stride that find an isosurface in it."""


@kernel(exact=True)
def reach(x, n):
    """First and last of the ``n`` voxels along an axis that the smoothed gradient at ``x`` is made
    of.
    """
    return max(int(math.floor(x)) - 1, 0), min(int(math.ceil(x)) + 1, n - 1)


@kernel(exact=True)
def value_span(voxels, p):
    """The least and the greatest voxel about ``p``, up to two away along each axis, and whether one
    is no number.
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
                low = v if v < low else low
                high = v if v > high else high
                hole = hole | math.isnan(v)
    return low, high, hole


@kernel(exact=True)
def flat(voxels, p, own, edge):
    """Whether a share FLAT_SHARE of the voxels about ``p`` is within ``edge`` of its value
    ``own``.
    """
    nz, ny, nx = voxels.shape
    xs, ys, zs = reach(p[0], nx), reach(p[1], ny), reach(p[2], nz)
    alike = 0
    count = 0
    for k in range(zs[0], zs[1] + 1):
        for j in range(ys[0], ys[1] + 1):
            for i in range(xs[0], xs[1] + 1):
                alike += abs(np.float64(voxels[k, j, i]) - own) <= edge
                count += 1
    return alike >= FLAT_SHARE * count


@kernel(exact=True)
def at_edge(voxels, p, own, low, high):
    """Whether a point ``p`` of value ``own`` is at the edge of a plateau between the values ``low``
    and ``high``.
    """
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
    """How far along ``d`` the isosurface ``level`` is first crossed, MAX_SHIFT_VOXELS at most; inf
    where it is not.

    Known to STEP_VOXELS over 2 to the power of the ``halvings``.
    """
    t = 0.0
    v = value(voxels, p)
    solid = v > level
    while t < MAX_SHIFT_VOXELS and (v > level) == solid and not math.isnan(v):
        t += STEP_VOXELS
        v = value(voxels, point_within(voxels.shape, p, d, t))
    if (v > level) == solid or math.isnan(v):
        return math.inf
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
    """The way from a plateau: along the world normal ``n``, or against it, a voxel long."""
    x, y, z = n[0] * spacing[0], n[1] * spacing[1], n[2] * spacing[2]
    share = sign / math.sqrt(x * x + y * y + z * z)
    return x * share, y * share, z * share


@kernel(exact=True)
def thin(voxels, p, d, level):
    """Whether one of the 26 places a voxel away from ``p`` is open and BEHIND_VOXELS behind it: the
    wall's other side is as near.
    """
    for place in range(27):
        o = (place % 3 - 1.0, place // 3 % 3 - 1.0, place // 9 - 1.0)
        behind = o[0] * d[0] + o[1] * d[1] + o[2] * d[2] < BEHIND_VOXELS
        if behind and value(voxels, point_within(voxels.shape, p, o, 1.0)) <= level:
            return True
    return False


@kernel(exact=True)
def leave_plateau(field, p, n):
    """Where a texel at ``p``, with the normal ``n`` that is not zero, is lit: (point, normal,
    isovalue).

    There and on its own isosurface, a float32, unless it is at the edge of a plateau. Where nothing
    half-way is found near, one at the foot of it stays; one on top has no side, as in a thin wall,
    and its normal is (0, 0, 0).
    """
    own = np.float32(value(field.voxels, p))
    low, high, _ = value_span(field.voxels, p)
    if not at_edge(field.voxels, p, own, low, high):
        return p, n, own
    level = np.float32(0.5 * (np.float64(low) + np.float64(high)))
    top = own > level
    d = downhill(n, field.spacing, 1.0 if top else -1.0)
    if top and thin(field.voxels, p, d, level):
        t = math.inf
    else:
        t = crossing(field.voxels, p, d, level)
    if t < math.inf:
        there = point_within(field.voxels.shape, p, d, t)
        return there, normal(field, there), level
    return p, (0.0, 0.0, 0.0) if top else n, own


EDGE_MARK = 1
VOID_MARK = 2
HOLE_MARK = 4
"""Marks of a voxel: at the edge of a plateau, without a gradient, beside one that is no number.

A texel at the edge of a plateau is not lit on its own isosurface: see ``kernels.tracing.plateaus``.
"""

CELLS_ROW = 0
STEEP_ROW = 1
PLATEAU_ROW = 2
NOISY_ROW = 3
HOLED_ROW = 4
FACES_ROW = 5
"""Rows of counts; the six faces of the box, x = 0, x = 1, y = 0, …, come last."""

COUNTED_ROWS = FACES_ROW + 6

STEEP_CORNERS = 4
"""Corners, half of a cell's, that make it steep where they are at an edge, or part of a plateau
that they lie on.
"""

MIN_MEAN_NORMAL = 0.9
"""Length of the mean of a cell's unit normals below which it counts as noisy: they then stray by
26° or more.

On a ball that is so at a radius of two voxels: finer detail cannot be distinguished from noise.
"""

LEVEL_ARRAY = types.float32[::1]
COUNT_ROWS = types.int64[:, ::1]


@kernel()
def first_at(levels, value):
    """The place of the first of the ascending ``levels`` that is at ``value`` or above; their
    number for NaN.
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
    """Write ``normals`` (ny, nx, 3) and ``marks`` (ny, nx) of the voxels of plane ``k`` that an
    isosurface passes.
    """
    _, ny, nx = field.voxels.shape
    for j in range(ny):
        for i in range(nx):
            p = (float(i), float(j), float(k))
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
    """Count one for the isovalues ``first`` … ``last`` - 1."""
    row[first] += 1
    row[last] -= 1


@kernel()
def passing(levels, corners, bit, side):
    """The isovalues whose surface parts the corners of a cell whose ``bit`` is ``side``: first, one
    past the last.

    All corners where ``bit`` is 0. A corner at the isovalue is outside, as it is for rays.
    """
    low = np.inf
    high = -np.inf
    for c in range(8):
        if c & bit == side:
            low, high = min(low, corners[c]), max(high, corners[c])
    return first_at(levels, np.float32(low)), first_at(levels, np.float32(high))


@kernel()
def corner_of(marks, normals, k, j, i):
    """What the corners of the cell at (k, j, i) are: how many at an edge, all marks, length of the
    mean normal.

    ``marks`` and ``normals`` are of two planes of voxels: those of plane k stand in row k % 2.
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
    """Count the isovalues that at least MANY ``corners`` of a cell have themselves."""
    for level in range(first, last):
        same = 0
        for c in range(8):
            same += corners[c] == levels[level]
        if same >= STEEP_CORNERS:
            count_levels(row, level, level + 1)


@kernel()
def count_faces(levels, corners, place, shape, counts):
    """Count, for each face of the box that the cell at ``place`` (x, y, z) lies on, the surfaces
    that meet it there.
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
    """Count a cell that isovalues ``first`` … ``last`` - 1 pass; ``seen`` is what ``corner_of``
    says of it.
    """
    edges, together, coherence = seen
    count_levels(counts[CELLS_ROW], first, last)
    if edges >= STEEP_CORNERS:
        count_levels(counts[STEEP_ROW], first, last)
    if coherence < MIN_MEAN_NORMAL:
        count_levels(counts[NOISY_ROW], first, last)
    if together & HOLE_MARK:
        count_levels(counts[HOLED_ROW], first, last)
    if together & VOID_MARK:
        count_levels(counts[PLATEAU_ROW], first, last)
    else:
        count_plateaus(levels, corners, first, last, counts[PLATEAU_ROW])


@kernel(types.void(FIELD_RECORD, LEVEL_ARRAY, types.int64, types.int64, COUNT_ROWS))
def count_stiffness(field, levels, begin, end, counts):
    """Add to ``counts`` (ROWS, levels + 1), as differences, the cells of layers ``begin`` … ``end``
    - 1 along z.

    ``levels`` are isovalues, ascending, in voxel units. CELLS_ROW are those that the surface
    passes; STEEP_ROW, NOISY_ROW, HOLED_ROW and PLATEAU_ROW those of them with half of their corners
    at the edge of a plateau, with normals that stray, beside a hole, and with a corner that has no
    gradient or half of the corners at the isovalue itself; a row for each face of the box those
    whose corners on it are parted.
    """
    _, ny, nx = field.voxels.shape
    normals = np.zeros((2, ny, nx, 3))
    marks = np.zeros((2, ny, nx), np.uint8)
    look_at(field, levels, begin, normals[begin & 1], marks[begin & 1])
    for k in range(begin, end):
        look_at(field, levels, k + 1, normals[(k + 1) & 1], marks[(k + 1) & 1])
        for j in range(ny - 1):
            for i in range(nx - 1):
                corners = cube(field.voxels, k, j, i)
                first, last = passing(levels, corners, 0, 0)
                if first < last and not math.isnan(sum(corners)):
                    seen = corner_of(marks, normals, k, j, i)
                    count_cell(levels, corners, first, last, seen, counts)
                    count_faces(levels, corners, (i, j, k), field.voxels.shape, counts)
