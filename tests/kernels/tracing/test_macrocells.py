"""Macrocells against a plain loop over the cells that each of them holds."""

import itertools

import numpy as np
import pytest

from isogi_core.kernels.tracing.macrocells import MACROCELL_SIDE, macrocell_shape
from tests.kernels.fields import field_of


def blocks(shape):
    """Index of each macrocell and the slices of the voxels that its cells touch, both faces included."""
    for index in np.ndindex(macrocell_shape(shape)):
        yield index, tuple(slice(i * MACROCELL_SIDE, i * MACROCELL_SIDE + MACROCELL_SIDE + 1) for i in index)


@pytest.mark.parametrize("shape", [(2, 2, 2), (9, 9, 9), (10, 8, 17), (2, 30, 5), (18, 25, 16)])
def test_low_and_high_are_those_of_voxels_in_and_on_the_block(shape):
    voxels = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    field = field_of(voxels)
    for index, block in blocks(shape):
        assert field.low[index] == voxels[block].min()
        assert field.high[index] == voxels[block].max()


@pytest.mark.parametrize("n", [2, 8, 9, 10, 16, 17, 18, 257])
def test_every_cell_is_in_one_macrocell(n):
    blocks_along = macrocell_shape((n, n, n))[0]
    assert (blocks_along - 1) * MACROCELL_SIDE < n - 1 <= blocks_along * MACROCELL_SIDE


def test_a_hole_opens_the_macrocells_that_touch_it_and_no_other():
    voxels = np.ones((18, 18, 18), np.float32)
    voxels[8, 4, 4] = np.nan
    field = field_of(voxels)
    touched = [index for index, block in blocks(voxels.shape) if np.isnan(voxels[block]).any()]
    assert touched == [(0, 0, 0), (1, 0, 0)]
    for index in itertools.product(range(3), repeat=3):
        expected = (-np.inf, np.inf) if index in touched else (1.0, 1.0)
        assert (field.low[index], field.high[index]) == expected
