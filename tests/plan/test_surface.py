"""Texels of whole isosurfaces, chunk by chunk, are those of the whole lattice at once."""

import numpy as np
import pytest

from isogi_core.plan.reachable_texels import surface_cells, surface_texels
from tests.plan.shown import shown_texels

RANGES = [[(0.5, 0.5)], [(0.2, 0.3), (0.9, 0.95)], [(7.0, 8.0)]]


@pytest.mark.parametrize("shape", [(20, 17, 33), (10, 9, 17), (39, 33, 65), (2, 2, 2), (16, 16, 16)])
@pytest.mark.parametrize("ranges", RANGES)
def test_chunks_together_hold_what_the_lattice_shows(
    shape: tuple[int, int, int], ranges: list[tuple[float, float]]
) -> None:
    voxels = np.random.default_rng(0).random((20, 17, 33)).astype(np.float32).cumsum(axis=0) / 10
    expected = np.logical_or.reduce([shown_texels(surface_cells(voxels, *each), shape) for each in ranges])
    found = np.zeros(shape, np.bool_)
    for index, offsets in surface_texels(voxels, shape, 8, ranges):
        assert len(offsets) > 0 and (np.diff(offsets) > 0).all()
        z, y, x = np.stack(np.unravel_index(offsets, (8, 8, 8))) + 8 * np.array(index)[:, None]
        found[z, y, x] = True
    np.testing.assert_array_equal(found, expected)
