"""Leaps: how far each brick is from the nearest one that holds the surface, one axis after the other.

Any shortest chessboard way between two bricks can take its steps along x first, then those that change
y too, then those that change z: rows, then planes, then the whole are swept once forth and once back.
"""

import numpy as np

from isogi_core.kernels._jit import kernel

FAR = 63
"""Longest leap, in bricks."""


@kernel()
def near_row(row):
    """Make the marks of a ``row`` (0, else FAR) distances along it."""
    for way in range(2):
        before = np.uint8(FAR)
        for ii in range(row.shape[0]):
            i = row.shape[0] - 1 - ii if way else ii
            before = min(row[i], np.uint8(before + np.uint8(1)))
            row[i] = before


@kernel()
def spread_row(row, out):
    """Write the least of each brick of a ``row`` and its neighbours along it."""
    last = row.shape[0] - 1
    out[0], out[last] = row[0], row[last]
    for i in range(1, last):
        out[i] = min(row[i], row[i - 1], row[i + 1])
    if last:
        out[0], out[last] = min(row[0], row[1]), min(row[last], row[last - 1])


@kernel()
def step_row(row, nearest):
    """Let a ``row`` be one farther than its neighbours, of which ``nearest`` has the least."""
    for i in range(row.shape[0]):
        row[i] = min(row[i], np.uint8(nearest[i] + np.uint8(1)))


@kernel()
def near_plane(plane, nearest):
    """Make the distances along the rows of a ``plane`` distances in it."""
    by = plane.shape[0]
    for way in range(2):
        for jj in range(1, by):
            j, before = (by - 1 - jj, by - jj) if way else (jj, jj - 1)
            spread_row(plane[before], nearest)
            step_row(plane[j], nearest)


@kernel()
def step_plane(plane, before, spread):
    """Let a ``plane`` be one farther than the plane ``before``; ``spread`` is room for one more."""
    by = plane.shape[0]
    for j in range(by):
        spread_row(before[j], spread[j])
    for j in range(by):
        for r in range(max(j - 1, 0), min(j + 2, by)):
            step_row(plane[j], spread[r])


@kernel()
def spread_leaps(leaps):
    """Make the marks ``leaps`` (bricks along z, y, x; 0, else FAR) Chebyshev distances to the nearest 0."""
    bz, by, bx = leaps.shape
    spread = np.empty((by, bx), np.uint8)
    for k in range(bz):
        for j in range(by):
            near_row(leaps[k, j])
        near_plane(leaps[k], spread[0])
    for k in range(1, bz):
        step_plane(leaps[k], leaps[k - 1], spread)
    for k in range(bz - 2, -1, -1):
        step_plane(leaps[k], leaps[k + 1], spread)
