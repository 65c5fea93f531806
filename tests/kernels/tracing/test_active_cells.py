"""Maps of empty space against plain loops: macrocells, active cells, and the skips of empty
bricks.
"""

import itertools
from itertools import product

import numpy as np
import pytest

from isogi_core.kernels.tracing.active_cells import (
    BRICK_CELLS,
    block_ranges,
    brick_shape,
    make_active_cells,
    number_bricks,
)
from isogi_core.kernels.tracing.macrocells import MACROCELL_SIDE, blocks_along, macrocell_shape
from isogi_core.kernels.tracing.skips import LONGEST_SKIP, SKIP_BITS
from tests.kernels.fields import field_of


def blocks(shape):
    """Index of each macrocell and the slices of the voxels that its cells touch, both faces
    included.
    """
    for index in np.ndindex(macrocell_shape(shape)):
        yield (
            index,
            tuple(
                slice(i * MACROCELL_SIDE, i * MACROCELL_SIDE + MACROCELL_SIDE + 1) for i in index
            ),
        )


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
        if index in touched:
            expected = (-np.inf, np.inf)
        else:
            expected = (1.0, 1.0)
        assert (field.low[index], field.high[index]) == expected


BALL = 12.0 - np.linalg.norm(np.indices((41, 41, 41)) - 20.0, axis=0)


def marked_cells(cells):
    """Which cells are marked and which lie in a 2³ block with a marked one; (z, y, x, cells filled
    up) each.
    """
    near = (cells.tops >> 28) == 0
    words = np.zeros((len(near), BRICK_CELLS), np.int32)
    words[near] = cells.cells.reshape(-1, BRICK_CELLS)[cells.tops[near]]
    bits = (
        words.reshape(*cells.shape, BRICK_CELLS)[..., None, None]
        >> np.arange(32).reshape(2, 1, 1, 1, 1, 4, 4)
    ) & 1
    z, y, x = (n * BRICK_CELLS for n in cells.shape)
    return bits.transpose(0, 1, 4, 2, 5, 3, 6).reshape(2, z, y, x).astype(bool)


@pytest.mark.parametrize("shape", [(2, 2, 2), (5, 9, 17), (21, 18, 30)])
def test_active_cells_hold_the_surface_and_few_more_do(shape):
    voxels = np.random.default_rng(15).normal(size=shape).astype(np.float32)
    low, high = 1.5, 1.6
    cells = make_active_cells(voxels, block_ranges(voxels), low, high)
    corners = [
        voxels[c : shape[0] - 1 + c, b : shape[1] - 1 + b, a : shape[2] - 1 + a]
        for c, b, a in np.ndindex(2, 2, 2)
    ]
    least, most = np.minimum.reduce(corners), np.maximum.reduce(corners)
    marked, blocks = marked_cells(cells)
    inner = marked[: shape[0] - 1, : shape[1] - 1, : shape[2] - 1]
    holds = (least <= high) & (most > low)
    assert not (holds & ~inner).any()
    assert (inner & ~holds).sum() <= 0.01 * holds.sum() + 1
    pairs = marked.reshape(-1, 2, marked.shape[1] // 2, 2, marked.shape[2] // 2, 2).any(
        axis=(1, 3, 5)
    )
    bricked = marked.reshape(cells.shape[0], 4, cells.shape[1], 4, cells.shape[2], 4).any(
        axis=(1, 3, 5)
    )
    assert np.array_equal(blocks, pairs.repeat(2, 0).repeat(2, 1).repeat(2, 2))
    assert np.array_equal((cells.tops >> 28) == 0, bricked.ravel())


@pytest.mark.parametrize("holes", [0.0, 0.002])
@pytest.mark.parametrize("shape", [(2, 2, 2), (5, 9, 17), (21, 18, 38)])
@pytest.mark.parametrize("fine", [0, 1 << 20], ids=["macrocells", "bricks"])
def test_ranges_are_of_the_cells_in_and_around_a_block(shape, holes, fine):
    rng = np.random.default_rng(16)
    voxels = rng.normal(size=shape).astype(np.float32)
    voxels[rng.random(shape) < holes] = np.nan
    ranges = block_ranges(voxels, fine)
    size = BRICK_CELLS if fine else MACROCELL_SIDE
    low, high, margins = (values.reshape(blocks_along(shape, size)) for values in ranges[:3])
    of_bricks = ranges.of_bricks.reshape(brick_shape(shape))
    for brick in np.ndindex(of_bricks.shape):
        assert of_bricks[brick] == margins[tuple(i * BRICK_CELLS // size for i in brick)]
    for index in np.ndindex(low.shape):
        around = voxels[tuple(slice(max(size * i - 1, 0), size * i + size + 2) for i in index)]
        hole = np.isnan(around).any()
        assert (low[index], high[index]) == (
            (-np.inf, np.inf) if hole else (around.min(), around.max())
        )
        assert (
            margins[index] == np.inf
            if hole
            else 0 < margins[index] < 1e-4 * max(shape) * np.abs(around).max()
        )


def test_ranges_of_macrocells_mark_a_little_more_at_most():
    voxels = np.random.default_rng(5).normal(size=(33, 41, 70)).astype(np.float32)
    fine, coarse = (
        make_active_cells(voxels, block_ranges(voxels, most), -0.2, 0.1) for most in (1 << 20, 0)
    )
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


def largest_cubes(marked: np.ndarray) -> np.ndarray:
    """Side of the largest cube with no marked brick that begins at each brick and ascends along all
    axes.
    """
    sums = np.pad(marked.astype(int), [(1, LONGEST_SKIP)] * 3).cumsum(0).cumsum(1).cumsum(2)
    found = np.zeros(marked.shape, int)
    for side in range(1, LONGEST_SKIP + 1):
        inside = np.zeros(marked.shape, int)
        for corner in product((0, side), repeat=3):
            at = tuple(
                slice(first, first + n) for first, n in zip(corner, marked.shape, strict=True)
            )
            inside += (-1) ** corner.count(0) * sums[at]
        found += inside == 0
    return found


def check(tops: np.ndarray, marked: np.ndarray) -> None:
    """Each empty brick has its skip, in each octant."""
    for octant in range(8):
        turned = tuple(slice(None, None, -1 if octant >> axis & 1 else 1) for axis in (2, 1, 0))
        skips = (tops.reshape(marked.shape) >> (SKIP_BITS * octant)) & LONGEST_SKIP
        assert np.array_equal(skips[~marked], largest_cubes(marked[turned])[turned][~marked])


@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (17, 18, 19), (3, 2, 63), (2, 4, 64), (2, 3, 65), (18, 20, 130)]
)
@pytest.mark.parametrize("share", [0.0, 0.0005, 0.01, 0.2])
def test_skips_are_the_largest_empty_cubes_ahead(shape: tuple[int, ...], share: float) -> None:
    """Also across the words that rows of bricks are cut into, and beyond the volume, where nothing
    stops a ray.
    """
    marked = np.random.default_rng(1).random(shape) < share
    tops = np.empty(marked.size, np.int32)
    number_bricks(~marked.ravel(), shape, tops)
    check(tops, marked)
    assert tops[marked.ravel()].tolist() == list(range(marked.sum())), (
        "a marked brick has its number"
    )


def test_maps_of_volumes_hold_them() -> None:
    voxels = np.zeros((70, 50, 90), np.float32)
    voxels[10, 40, 7] = voxels[60, 5, 80] = 1.0
    cells = make_active_cells(voxels, block_ranges(voxels), 0.5, 0.5)
    assert cells.shape == brick_shape(voxels.shape)
    marked = ((cells.tops >> 28) == 0).reshape(cells.shape)
    assert marked.any()
    check(cells.tops, marked)
