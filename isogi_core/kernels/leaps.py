"""Leaps: how far a ray may go from an empty brick without meeting one that is marked.

A ray whose direction lies in an octant sees only the bricks ahead of it. The leap of a brick in an octant
is the side, in bricks, of the largest cube of empty bricks with that brick at its near corner: rays leave
a surface in long leaps, where a distance in all directions would keep them to small ones.
"""

import numpy as np

from isogi_core.kernels._jit import kernel

LONGEST = 15
"""Longest leap, in bricks: what four bits hold."""

BITS = 4
"""Bits of a leap; a word holds those of the octants 0 … 7, bit a of an octant set where axis a is descended.

No leap is 0, so that words of leaps are those whose uppermost four bits are not.
"""


@kernel()
def nearest_ahead(leaps, j, k, dy, dz, nearest):
    """Write to ``nearest`` (row of x) the least leap of the three rows ahead of (j, k), which are as long."""
    bz, by, bx = leaps.shape
    nearest[:] = LONGEST - 1
    for rows in ((j + dy, k), (j, k + dz), (j + dy, k + dz)):
        if 0 <= rows[0] < by and 0 <= rows[1] < bz:
            row = leaps[rows[1], rows[0]]
            for i in range(bx):
                nearest[i] = min(nearest[i], row[i])


@kernel()
def sweep_octant(empty, octant, leaps, nearest):
    """Fill ``leaps`` (z, y, x) of one octant: 1 + the least leap of the seven bricks ahead, 0 where marked."""
    bz, by, bx = empty.shape
    dx, dy, dz = (-1 if octant & 1 else 1), (-1 if octant & 2 else 1), (-1 if octant & 4 else 1)
    for kk in range(bz):
        k = kk if dz < 0 else bz - 1 - kk
        for jj in range(by):
            j = jj if dy < 0 else by - 1 - jj
            nearest_ahead(leaps, j, k, dy, dz, nearest)
            row, before, beside = leaps[k, j], LONGEST - 1, LONGEST - 1
            for ii in range(bx):
                i = ii if dx < 0 else bx - 1 - ii
                here = int(nearest[i])
                before = min(here, beside, before) + 1 if empty[k, j, i] else 0
                row[i] = before
                before, beside = min(before, LONGEST - 1), here


@kernel()
def fill_leaps(empty, tops):
    """Write the leaps of bricks that are ``empty`` (z, y, x) to ``tops`` (bricks,); the others keep their word."""
    leaps = np.empty(empty.shape, np.uint8)
    flat, hollow, words = leaps.reshape(leaps.size), empty.reshape(empty.size), np.zeros(empty.size, np.uint32)
    nearest = np.empty(empty.shape[2], np.uint8)
    for octant in range(8):
        sweep_octant(empty, octant, leaps, nearest)
        for b in range(words.size):
            words[b] |= np.uint32(flat[b]) << np.uint32(BITS * octant)
    for b in range(words.size):
        if hollow[b]:
            tops[b] = np.int32(words[b])
