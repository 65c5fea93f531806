"""Skips of empty bricks against the largest empty cubes, found one by one."""

import numpy as np
import pytest

from isogi_core.kernels.tracing.active_cells import block_ranges, brick_shape, make_active_cells, number_bricks
from isogi_core.kernels.tracing.skips import BITS, LONGEST

WAYS = [(1 - 2 * (octant >> 2 & 1), 1 - 2 * (octant >> 1 & 1), 1 - 2 * (octant & 1)) for octant in range(8)]
"""The directions of the octants along z, y, x."""


def largest_cube(marked: np.ndarray, corner: np.ndarray, way: tuple[int, ...]) -> int:
    """Side of the largest cube with no marked brick that goes from ``corner`` in the directions ``way``."""
    for side in range(1, LONGEST + 1):
        spans = []
        for c, w in zip(corner, way, strict=True):
            spans.append(slice(c, c + side) if w > 0 else slice(max(c - side + 1, 0), c + 1))
        if marked[tuple(spans)].any():
            return side - 1
    return LONGEST


def check(tops: np.ndarray, marked: np.ndarray) -> None:
    """Each empty brick has its skip, in each octant."""
    for octant, way in enumerate(WAYS):
        skips = (tops.reshape(marked.shape) >> (BITS * octant)) & LONGEST
        expected = [largest_cube(marked, corner, way) for corner in np.argwhere(~marked)]
        assert skips[~marked].tolist() == expected


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 17, 3), (18, 1, 5), (3, 2, 63), (2, 4, 64), (2, 3, 65), (3, 2, 130)])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.2])
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
