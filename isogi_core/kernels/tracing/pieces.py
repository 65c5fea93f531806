"""Area opening: small pieces are removed from a volume at every level at once.

Source: Vincent, "Grayscale area openings and closings", 1993; by union-find as in Meijster and
Wilkinson, "A comparison of algorithms for connected set openings and closings", 2002.
"""

import numpy as np
from numba import types

from isogi_core.kernels._jit import kernel

NOT_SEEN = np.int64(1) << np.int64(62)
"""Parent of a voxel that was not reached yet, or is a hole."""

PLACES = types.int64[::1]
RANKS = types.int32[::1]


@kernel()
def root_of(parents, place):
    """Return the root of the piece that holds ``place``, and shorten the way there."""
    root = place
    while parents[root] >= 0:
        root = parents[root]
    # Path compression: let all voxels on the way point to the root.
    while parents[place] >= 0:
        ahead = parents[place]
        parents[place] = root
        place = ahead
    return root


@kernel()
def join(parents, ranks, place, other, least):
    """Join the piece of ``other`` to that of its neighbour ``place``, a root.

    The level has fallen to ``place``; ``other`` was reached before, so that it is as high or
    higher. All voxels of a piece that is still too small, or on the same level, take the value of
    ``place``. A higher piece of ``least`` voxels or more keeps its level; the piece that meets it
    then counts as large enough too, as both are connected on this level.
    """
    root = root_of(parents, other)
    if root == place:
        return
    if ranks[root] == ranks[place] or -parents[root] < least:
        parents[place] += parents[root]
        parents[root] = place
    else:
        parents[place] = min(parents[place], -least)


@kernel(types.void(RANKS, PLACES, types.UniTuple(types.int64, 3), types.int64, PLACES))
def open_by_size(ranks, order, shape, least, parents):
    """Fill ``parents`` with the place of the voxel whose value each voxel takes, so that each
    connected piece above any level has at least ``least`` voxels.

    ``order`` lists the places of the voxels that are no holes, flat, the highest first. High means
    solid: if values below the isovalue are solid, the voxel of the lowest value comes first.
    ``ranks`` fall along ``order``, and are equal for equal values.

    Voxels are joined as the level falls: a piece that is still too small when it meets another
    takes the value at which both together are large enough. Voxels that share a corner are
    neighbours. Meanwhile the parent of a root is minus the number of voxels of its piece.
    """
    nz, ny, nx = shape
    parents[:] = NOT_SEEN
    # Flood from the highest voxel down, and join each voxel with the neighbours above it.
    for n in range(order.shape[0]):
        place = order[n]
        parents[place] = -1
        k, j, i = place // (ny * nx), place // nx % ny, place % nx
        for c in range(max(k - 1, 0), min(k + 2, nz)):
            for b in range(max(j - 1, 0), min(j + 2, ny)):
                for a in range(max(i - 1, 0), min(i + 2, nx)):
                    other = (c * ny + b) * nx + a
                    if other != place and parents[other] != NOT_SEEN:
                        join(parents, ranks, place, other, least)
    # Resolve parents to values. They come later in the order, so go through it from its end.
    for n in range(order.shape[0] - 1, -1, -1):
        place = order[n]
        parents[place] = place if parents[place] < 0 else parents[parents[place]]
