"""Grids on right angles: what cancels becomes 0, and what is infinite does not."""

from dataclasses import replace

import numpy as np
import pytest

from isogi_core.files.grid import Affine, Grid, cancelled, on_right_angles


def test_sums_cancel_if_they_are_finite() -> None:
    sums = np.array([1e-17, -1e-17, 1e-3, np.inf, -np.inf, np.nan])
    parts = [np.array([1.0, -1.0, 1.0, np.inf, 1.0, np.nan]), np.full(6, -1.0)]
    parts[1][4] = -np.inf
    expected = [0.0, 0.0, 1e-3, np.inf, -np.inf, np.nan]
    np.testing.assert_array_equal(cancelled(sums, parts), expected)


def test_an_infinite_voxel_of_a_skewed_grid_makes_no_zeros() -> None:
    voxels = np.ones((2, 3, 4), np.float32)
    voxels[1, 0, 1] = np.inf
    # Each layer is moved by half a voxel along x, so that layer 1 has means of two voxels.
    skewed = Affine.of([[1.0, 0.0, 0.5, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    straight = on_right_angles(replace(Grid.of(voxels), affine=skewed)).whole()
    assert straight.shape == (2, 3, 5)
    np.testing.assert_array_equal(straight[1, 0], [np.nan, np.inf, np.inf, 1.0, np.nan])
    assert set(straight[np.isfinite(straight)].tolist()) == {1.0}


@pytest.mark.parametrize("hole", [np.nan, np.inf])
def test_a_hole_of_a_skewed_grid_grows_by_no_voxel(hole: float) -> None:
    voxels = np.ones((2, 4, 4), np.float32)
    voxels[0, 2, 2] = hole
    skewed = Affine.of([[1.0, 0.0, 0.5, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    straight = on_right_angles(replace(Grid.of(voxels), affine=skewed)).whole()
    np.testing.assert_array_equal(straight[0, :, :4], voxels[0], "layer 0 is not moved")
