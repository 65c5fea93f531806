"""Levels: isovalues at which the light of pinned surfaces is kept while another surface slides;
views between two levels mix their light.

From one level to the next the sliding surface moves by LEVEL_VOXELS on average, so that the shadow
it casts changes no faster than the lattice can hold. As the isovalue grows by dc, the surface moves
by dc / |∇f|; the sum over the range gives the number of levels. Source: Beason et al. 2006 (S3) mix
the light of walls between levels; the measure of the distance is ours.
"""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from isogi_core.model.volume import Volume
from isogi_core.plan.projection import RANGE_BINS, edges_between, extremes_between

LEVEL_VOXELS = 1.0
"""Distance in voxels that a surface moves on average from one level to the next."""

MAX_READ_VOXELS = 1 << 26
"""Voxels that are read of a volume, about; of a larger one layers are skipped evenly."""

CELLS_PER_VOXEL = 1.5
"""Cells that a surface meets per voxel of its area: the mean of |nx| + |ny| + |nz| over all
unit normals n.
"""


def find_levels(
    volume: Volume, isovalues: tuple[float, float], named: Iterable[float]
) -> tuple[float, ...]:
    """Return the levels of a range of ``isovalues``, ascending in the units of the volume's file.

    The ends of the range are levels, and so are the isovalues that are ``named``: a view of a level
    needs no mixing.
    """
    first, last = sorted(isovalues)
    span = float(volume.normalise_isovalue(first)), float(volume.normalise_isovalue(last))
    if span[0] == span[1]:
        return (first,)
    # Sum the distance that the surface moves, from the first isovalue to each edge of the range's
    # parts.
    each = mean_ways(volume, (min(span), max(span)))
    ways = np.append(0.0, np.cumsum(each if span[0] < span[1] else each[::-1]))
    edges = np.linspace(first, last, RANGE_BINS + 1)
    found = {first, last}
    found |= {level for level in named if first <= level <= last}
    # Divide each gap between fixed levels so that the surface moves equally far from level to
    # level. Parts without any surface are left out, as distance cannot be inverted there.
    onward = np.append(True, np.diff(ways) > 0.0)
    for one, other in pairwise(sorted(found)):
        near, far = np.interp([one, other], edges, ways)
        steps = max(round((far - near) / LEVEL_VOXELS), 1)
        found |= {
            *np.interp(
                np.linspace(near, far, steps + 1)[1:-1], ways[onward], edges[onward]
            ).tolist()
        }
    return tuple(sorted(found))


def mean_ways(volume: Volume, span: tuple[float, float]) -> np.ndarray:
    """Return the distance in voxels that the surface moves through each of RANGE_BINS even parts of
    a ``span`` of normalised isovalues; (RANGE_BINS,) float64.

    From a cell's least corner to its greatest the surface moves |nx| + |ny| + |nz| voxels along its
    normal n, CELLS_PER_VOXEL on average, at an even speed. The result is the mean over the cells
    that each part meets.
    """
    # Count the cells that each part meets and sum their speeds, by differences at both ends of a
    # cell's range.
    sums = np.zeros((2, RANGE_BINS + 1))
    step = -(-volume.voxels.size // MAX_READ_VOXELS)
    for z in range(0, len(volume.voxels) - 1, step):
        low, high = extremes_between(edges_between(volume.voxels[z], volume.voxels[z + 1]))
        met = (high > span[0]) & (low < span[1]) & (high > low)
        low, high = (
            (each[met].astype(np.float64) - span[0]) / (span[1] - span[0]) * RANGE_BINS
            for each in (low, high)
        )
        width = np.maximum(high - low, 1.0)
        first = np.clip(np.floor(low), 0, RANGE_BINS - 1).astype(np.int64)
        last = np.clip(np.maximum(np.ceil(high), first + 1), 1, RANGE_BINS).astype(np.int64)
        for row, counts in enumerate((np.ones_like(width), 1.0 / width)):
            sums[row] += np.bincount(first, counts, RANGE_BINS + 1) - np.bincount(
                last, counts, RANGE_BINS + 1
            )
    # Integrate the differences; parts without a cell have no surface that could move.
    cells, speeds = np.cumsum(sums, axis=1)[:, :RANGE_BINS]
    return np.where(cells > 0.5, CELLS_PER_VOXEL * speeds / np.maximum(cells, 1.0), 0.0)


def levels_around(
    levels: Sequence[float], pinned: Iterable[float], shown: float
) -> tuple[tuple[float, float], ...]:
    """Return the ``levels`` around an isovalue ``shown`` with the weight of each: one level, or the
    two that it lies between.

    If a ``pinned`` surface lies between these two as well, the isovalue itself is returned: light
    jumps where one surface passes another, and must not be mixed across.
    """
    k = bisect_left(levels, shown)
    if k in (0, len(levels)) or levels[k] == shown:
        return ((shown, 1.0),)
    low, high = levels[k - 1 : k + 1]
    if any(low <= each <= high for each in pinned):
        return ((shown, 1.0),)
    share = (shown - low) / (high - low)
    return (low, 1.0 - share), (high, share)
