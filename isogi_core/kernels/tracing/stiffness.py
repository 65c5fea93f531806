"""Stiffness: how the cells of isosurfaces lie to the plateaus, the noise and the holes of a field, for many at once.

A cell belongs to all isovalues from its least corner up to its greatest, so that one pass serves them all: counts are
kept as differences, +1 where a range of isovalues begins and -1 behind its end.
"""

import math

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel
from isogi_core.kernels.simd.voxels import cube
from isogi_core.kernels.tracing.field import FIELD_RECORD, normal
from isogi_core.kernels.tracing.plateaus import at_edge, value_span
from isogi_core.kernels.tracing.vec import is_zero

EDGE_MARK, VOID_MARK, HOLE_MARK = 1, 2, 4
"""Marks of a voxel: at the edge of a plateau, without a gradient, beside one that is no number.

A texel at the edge of a plateau is not lit on its own isosurface: see ``kernels.tracing.plateaus``.
"""

CELLS_ROW, STEEP_ROW, PLATEAU_ROW, NOISY_ROW, HOLED_ROW, FACES_ROW = 0, 1, 2, 3, 4, 5
"""Rows of counts; the six faces of the box, x = 0, x = 1, y = 0, …, come last."""

COUNTED_ROWS = FACES_ROW + 6

STEEP_CORNERS = 4
"""Corners, half of a cell's, that make it steep where they are at an edge, or part of a plateau that they lie on."""

MIN_MEAN_NORMAL = 0.9
"""Length of the mean of a cell's unit normals below which it counts as noisy: they then stray by 26° or more.

On a ball that is so at a radius of two voxels: finer detail cannot be distinguished from noise.
"""

LEVEL_ARRAY = types.float32[::1]
COUNT_ROWS = types.int64[:, ::1]


@kernel()
def first_at(levels, value):
    """The place of the first of the ascending ``levels`` that is at ``value`` or above; their number for NaN."""
    first, last = 0, levels.shape[0]
    while first < last:
        middle = (first + last) // 2
        if value <= levels[middle]:
            last = middle
        else:
            first = middle + 1
    return first


@kernel()
def look_at(field, levels, k, normals, marks):
    """Write ``normals`` (ny, nx, 3) and ``marks`` (ny, nx) of the voxels of plane ``k`` that an isosurface passes."""
    _, ny, nx = field.voxels.shape
    for j in range(ny):
        for i in range(nx):
            p = (float(i), float(j), float(k))
            low, high, hole = value_span(field.voxels, p)
            if not first_at(levels, low) < first_at(levels, high):
                continue
            n, edge = normal(field, p), at_edge(field.voxels, p, field.voxels[k, j, i], low, high)
            normals[j, i, 0], normals[j, i, 1], normals[j, i, 2] = n
            marks[j, i] = (EDGE_MARK if edge else 0) | (VOID_MARK if is_zero(n) else 0) | (HOLE_MARK if hole else 0)


@kernel()
def count_levels(row, first, last):
    """Count one for the isovalues ``first`` … ``last`` - 1."""
    row[first] += 1
    row[last] -= 1


@kernel()
def passing(levels, corners, bit, side):
    """The isovalues whose surface parts the corners of a cell whose ``bit`` is ``side``: first, one past the last.

    All corners where ``bit`` is 0. A corner at the isovalue is outside, as it is for rays.
    """
    low, high = np.inf, -np.inf
    for c in range(8):
        if c & bit == side:
            low, high = min(low, corners[c]), max(high, corners[c])
    return first_at(levels, np.float32(low)), first_at(levels, np.float32(high))


@kernel()
def corner_of(marks, normals, k, j, i):
    """What the corners of the cell at (k, j, i) are: how many at an edge, all marks, length of the mean normal.

    ``marks`` and ``normals`` are of two planes of voxels: those of plane k stand in row k % 2.
    """
    edges, together, known = 0, 0, 0
    x, y, z = 0.0, 0.0, 0.0
    for c in range(8):
        plane, row, column = (k + (c >> 2)) & 1, j + ((c >> 1) & 1), i + (c & 1)
        mark, n = marks[plane, row, column], normals[plane, row, column]
        edges, together = edges + (mark & EDGE_MARK), together | mark
        if not mark & VOID_MARK:
            x, y, z, known = x + n[0], y + n[1], z + n[2], known + 1
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
    """Count, for each face of the box that the cell at ``place`` (x, y, z) lies on, the surfaces that meet it there."""
    for face in range(6):
        axis, side = face // 2, face % 2
        if place[axis] == (shape[2 - axis] - 2 if side else 0):
            first, last = passing(levels, corners, 1 << axis, side << axis)
            if first < last:
                count_levels(counts[FACES_ROW + face], first, last)


@kernel()
def count_cell(levels, corners, first, last, seen, counts):
    """Count a cell that isovalues ``first`` … ``last`` - 1 pass; ``seen`` is what ``corner_of`` says of it."""
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
    """Add to ``counts`` (ROWS, levels + 1), as differences, the cells of layers ``begin`` … ``end`` - 1 along z.

    ``levels`` are isovalues, ascending, in voxel units. CELLS_ROW are those that the surface passes; STEEP_ROW,
    NOISY_ROW, HOLED_ROW and PLATEAU_ROW those of them with half of their corners at the edge of a plateau, with normals
    that stray, beside a hole, and with a corner that has no gradient or half of the corners at the isovalue itself; a
    row for each face of the box those whose corners on it are parted.
    """
    _, ny, nx = field.voxels.shape
    normals, marks = np.zeros((2, ny, nx, 3)), np.zeros((2, ny, nx), np.uint8)
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
