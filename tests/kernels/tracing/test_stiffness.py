"""Counts of stiff cells against plain loops over cells and isovalues."""

from itertools import pairwise

import numpy as np
import pytest

from isogi_core.kernels.tracing.field import normal
from isogi_core.kernels.tracing.stiffness import (
    CELLS_ROW,
    COUNTED_ROWS,
    FACES_ROW,
    HOLED_ROW,
    NOISY_ROW,
    PLATEAU_ROW,
    STEEP_ROW,
    count_stiffness,
)
from tests.kernels.fields import field_of
from tests.kernels.interpolation import at_edge


def steps(shape: tuple[int, int, int], seed: int = 1) -> np.ndarray:
    """A field of few values, so that plateaus and corners at an isovalue itself are common, with a
    few holes.
    """
    rng = np.random.default_rng(seed)
    voxels = (rng.integers(0, 5, shape) / 4.0 * (rng.random(shape) < 0.6)).astype(np.float32)
    voxels[rng.random(shape) < 0.01] = np.nan
    return voxels


def counted(field, levels, *cuts):
    """The counts of all layers, taken in pieces between ``cuts``; (ROWS, levels)."""
    counts = np.zeros((COUNTED_ROWS, len(levels) + 1), np.int64)
    ends = [0, *cuts, field.voxels.shape[0] - 1]
    for first, last in pairwise(ends):
        count_stiffness(field, np.asarray(levels, np.float32), first, last, counts)
    return counts.cumsum(axis=1)[:, :-1]


def block(voxels, corner, before, behind):
    """The voxels from ``before`` steps before a place to ``behind`` steps behind it, as far as
    there are any.
    """
    shape = voxels.shape
    return voxels[
        tuple(
            slice(max(c - before, 0), min(c + behind + 1, n))
            for c, n in zip(corner, shape, strict=True)
        )
    ]


def told(field, level, place):
    """What a cell counts as at one isovalue: the rows, in plain words."""
    voxels = field.voxels
    corners = block(voxels, place, 0, 1)
    if np.isnan(corners).any() or not corners.min() <= level < corners.max():
        return set()
    normals = []
    edges = 0
    hole = False
    void = False
    for offset in np.ndindex(2, 2, 2):
        at = tuple(np.add(place, offset))
        around = block(voxels, at, 1, 1)
        edges += bool(at_edge(around, np.float64(voxels[at])))
        hole |= bool(np.isnan(around).any())
        n = normal(field, tuple(float(a) for a in at[::-1]))
        void |= n == (0.0, 0.0, 0.0)
        normals += [n] if n != (0.0, 0.0, 0.0) else []
    if normals:
        straying = np.linalg.norm(np.sum(normals, axis=0)) / len(normals) < 0.9
    else:
        straying = True
    kinds = {STEEP_ROW: edges >= 4, NOISY_ROW: straying, HOLED_ROW: hole}
    kinds[PLATEAU_ROW] = void or np.count_nonzero(corners == level) >= 4
    return (
        {CELLS_ROW}
        | {row for row, is_so in kinds.items() if is_so}
        | faces(corners, level, place, voxels.shape)
    )


def faces(corners, level, place, shape):
    """Rows of the faces of the box at which the cell's corners on them are parted."""
    met = set()
    for axis in range(3):
        along = 2 - axis
        for side in (0, 1):
            on = corners.take(side, along)
            if place[along] == (shape[along] - 2 if side else 0) and on.min() <= level < on.max():
                met.add(FACES_ROW + 2 * axis + side)
    return met


@pytest.mark.parametrize("shape", [(6, 7, 8), (2, 2, 2), (2, 9, 3), (9, 2, 4)])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.5, 1.0, 3.0)])
def test_counts_are_those_of_a_loop_over_cells_and_isovalues(shape, spacing):
    field = field_of(steps(shape), spacing)
    levels = [0.0, 0.1, 0.25, 0.6, 0.75, 1.0]
    expected = np.zeros((COUNTED_ROWS, len(levels)), np.int64)
    for place in np.ndindex(*(n - 1 for n in shape)):
        for i, level in enumerate(np.float32(levels)):
            for row in told(field, level, place):
                expected[row, i] += 1
    np.testing.assert_array_equal(counted(field, levels), expected)
    assert shape != (6, 7, 8) or expected.any(axis=1).all()


def test_layers_may_be_counted_in_pieces():
    field = field_of(steps((12, 9, 10)))
    levels = np.linspace(0.0, 1.0, 9)
    np.testing.assert_array_equal(counted(field, levels, 1, 2, 7), counted(field, levels))


def test_values_that_pass_the_range_of_floats_are_counted():
    largest = np.finfo(np.float32).max
    voxels = np.full((4, 4, 4), largest, np.float32)
    voxels[:2] = -largest
    counts = counted(field_of(voxels), [0.0, 0.5])
    assert counts[CELLS_ROW].tolist() == [9, 9]
    assert counts[FACES_ROW:].sum(axis=1).tolist() == [6, 6, 6, 6, 0, 0]
