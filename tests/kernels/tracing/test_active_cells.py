"""The active-cell map against plain loops: marks and ranges."""

import numpy as np
import pytest

from isogi_core.kernels.tracing.active_cells import (
    BRICK_CELLS,
    MAX_FINE_BRICKS,
    block_ranges,
    brick_shape,
    make_active_cells,
)
from isogi_core.kernels.tracing.macrocells import MACROCELL_SIDE, blocks_along

BALL = 12.0 - np.linalg.norm(np.indices((41, 41, 41)) - 20.0, axis=0)


def marked_cells(cells):
    """Which cells are marked and which lie in a 2³ block with a marked one; (z, y, x, cells filled up) each."""
    near = (cells.tops >> 28) == 0
    words = np.zeros((len(near), BRICK_CELLS), np.int32)
    words[near] = cells.cells.reshape(-1, BRICK_CELLS)[cells.tops[near]]
    bits = (words.reshape(*cells.shape, BRICK_CELLS)[..., None, None] >> np.arange(32).reshape(2, 1, 1, 1, 1, 4, 4)) & 1
    z, y, x = (n * BRICK_CELLS for n in cells.shape)
    return bits.transpose(0, 1, 4, 2, 5, 3, 6).reshape(2, z, y, x).astype(bool)


@pytest.mark.parametrize("shape", [(2, 2, 2), (5, 9, 17), (21, 18, 30)])
def test_active_cells_hold_the_surface_and_few_more_do(shape):
    voxels = np.random.default_rng(15).normal(size=shape).astype(np.float32)
    low, high = 1.5, 1.6
    cells = make_active_cells(voxels, block_ranges(voxels), low, high)
    corners = [
        voxels[c : shape[0] - 1 + c, b : shape[1] - 1 + b, a : shape[2] - 1 + a] for c, b, a in np.ndindex(2, 2, 2)
    ]
    least, most = np.minimum.reduce(corners), np.maximum.reduce(corners)
    marked, blocks = marked_cells(cells)
    inner = marked[: shape[0] - 1, : shape[1] - 1, : shape[2] - 1]
    holds = (least <= high) & (most > low)
    assert not (holds & ~inner).any()
    assert (inner & ~holds).sum() <= 0.01 * holds.sum() + 1
    pairs = marked.reshape(-1, 2, marked.shape[1] // 2, 2, marked.shape[2] // 2, 2).any(axis=(1, 3, 5))
    bricked = marked.reshape(cells.shape[0], 4, cells.shape[1], 4, cells.shape[2], 4).any(axis=(1, 3, 5))
    assert np.array_equal(blocks, pairs.repeat(2, 0).repeat(2, 1).repeat(2, 2))
    assert np.array_equal((cells.tops >> 28) == 0, bricked.ravel())


@pytest.mark.parametrize("holes", [0.0, 0.002])
@pytest.mark.parametrize("shape", [(2, 2, 2), (5, 9, 17), (21, 18, 38)])
@pytest.mark.parametrize("fine", [0, MAX_FINE_BRICKS], ids=["macrocells", "bricks"])
def test_ranges_are_of_the_cells_in_and_around_a_block(shape, holes, fine):
    rng = np.random.default_rng(16)
    voxels = rng.normal(size=shape).astype(np.float32)
    voxels[rng.random(shape) < holes] = np.nan
    ranges, size = block_ranges(voxels, fine), BRICK_CELLS if fine else MACROCELL_SIDE
    low, high, margins = (values.reshape(blocks_along(shape, size)) for values in ranges[:3])
    of_bricks = ranges.of_bricks.reshape(brick_shape(shape))
    for brick in np.ndindex(of_bricks.shape):
        assert of_bricks[brick] == margins[tuple(i * BRICK_CELLS // size for i in brick)]
    for index in np.ndindex(low.shape):
        around = voxels[tuple(slice(max(size * i - 1, 0), size * i + size + 2) for i in index)]
        hole = np.isnan(around).any()
        assert (low[index], high[index]) == ((-np.inf, np.inf) if hole else (around.min(), around.max()))
        assert margins[index] == np.inf if hole else 0 < margins[index] < 1e-4 * max(shape) * np.abs(around).max()


def test_ranges_of_macrocells_mark_a_little_more_at_most():
    voxels = np.random.default_rng(5).normal(size=(33, 41, 70)).astype(np.float32)
    fine, coarse = (make_active_cells(voxels, block_ranges(voxels, most), -0.2, 0.1) for most in (MAX_FINE_BRICKS, 0))
    (own, _), (other, _) = map(marked_cells, (fine, coarse))
    assert (other >= own).all() and other.sum() <= own.sum() + 5
    assert (coarse.margins >= fine.margins).all()


def test_pieces_make_the_same_map():
    ranges = block_ranges(BALL.astype(np.float32))
    whole = make_active_cells(BALL.astype(np.float32), ranges, 0.0, 1.0)

    def run(piece, total):
        for first in reversed(range(total)):
            piece(first, first + 1)

    pieces = make_active_cells(BALL.astype(np.float32), ranges, 0.0, 1.0, run)
    assert np.array_equal(pieces.tops, whole.tops)
    assert np.array_equal(pieces.cells, whole.cells)
