"""Skips of empty bricks against the largest empty cubes, by counts of what is marked in cubes of each side."""

from itertools import product

import numpy as np
import pytest

from isogi_core.kernels.tracing.active_cells import block_ranges, brick_shape, make_active_cells, number_bricks
from isogi_core.kernels.tracing.skips import LONGEST_SKIP, SKIP_BITS


def largest_cubes(marked: np.ndarray) -> np.ndarray:
    """Side of the largest cube with no marked brick that begins at each brick and ascends along all axes."""
    sums = np.pad(marked.astype(int), [(1, LONGEST_SKIP)] * 3).cumsum(0).cumsum(1).cumsum(2)
    found = np.zeros(marked.shape, int)
    for side in range(1, LONGEST_SKIP + 1):
        inside = np.zeros(marked.shape, int)
        for corner in product((0, side), repeat=3):
            at = tuple(slice(first, first + n) for first, n in zip(corner, marked.shape, strict=True))
            inside += (-1) ** corner.count(0) * sums[at]
        found += inside == 0
    return found


def check(tops: np.ndarray, marked: np.ndarray) -> None:
    """Each empty brick has its skip, in each octant."""
    for octant in range(8):
        turned = tuple(slice(None, None, -1 if octant >> axis & 1 else 1) for axis in (2, 1, 0))
        skips = (tops.reshape(marked.shape) >> (SKIP_BITS * octant)) & LONGEST_SKIP
        assert np.array_equal(skips[~marked], largest_cubes(marked[turned])[turned][~marked])


@pytest.mark.parametrize("shape", [(1, 1, 1), (17, 18, 19), (3, 2, 63), (2, 4, 64), (2, 3, 65), (18, 20, 130)])
@pytest.mark.parametrize("share", [0.0, 0.0005, 0.01, 0.2])
def test_skips_are_the_largest_empty_cubes_ahead(shape: tuple[int, ...], share: float) -> None:
    """Also across the words that rows of bricks are cut into, and beyond the volume, where nothing stops a ray."""
    marked = np.random.default_rng(1).random(shape) < share
    tops = np.empty(marked.size, np.int32)
    number_bricks(~marked.ravel(), shape, tops)
    check(tops, marked)
    assert tops[marked.ravel()].tolist() == list(range(marked.sum())), "a marked brick has its number"


def test_maps_of_volumes_hold_them() -> None:
    voxels = np.zeros((70, 50, 90), np.float32)
    voxels[10, 40, 7] = voxels[60, 5, 80] = 1.0
    cells = make_active_cells(voxels, block_ranges(voxels), 0.5, 0.5)
    assert cells.shape == brick_shape(voxels.shape)
    marked = ((cells.tops >> 28) == 0).reshape(cells.shape)
    assert marked.any()
    check(cells.tops, marked)
