import numpy as np
import pytest

from isogi_core.bake.light import SAMPLES, VOID, Light
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.record import TEXELS
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.plan import ScenePlan

PLANS = (ScenePlan(2, 1, 1), ScenePlan(3, 3, 0))


def filled(plan: ScenePlan, offsets: np.ndarray) -> Chunk:
    planes = np.random.default_rng(1).random((len(offsets), len(plan.planes)), np.float32)
    planes[:, SAMPLES] = 16.0
    return Chunk((1, 0, 2), offsets.astype(np.int32), Light(plan, planes))


@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("offsets", [[], [0], [TEXELS - 1], [3, 17, 255, 256, 4095], range(TEXELS)])
def test_a_block_gives_back_the_chunk_that_it_was_made_of(plan: ScenePlan, offsets: list[int]) -> None:
    chunk = filled(plan, np.array(offsets, np.int32))
    again = Chunk.from_block(chunk.index, plan, chunk.block())
    assert again.index == (1, 0, 2)
    np.testing.assert_array_equal(again.offsets, chunk.offsets)
    np.testing.assert_array_equal(again.light.planes, chunk.light.planes)


def test_a_block_is_nan_but_where_a_texel_is_baked() -> None:
    chunk = filled(PLANS[0], np.array([5, 300]))
    block = chunk.block()
    assert block.shape == (CHUNK, CHUNK, CHUNK, len(PLANS[0].planes))
    assert block.dtype == np.float32
    baked = ~np.isnan(block).any(axis=-1)
    assert np.argwhere(baked).tolist() == [[0, 0, 5], [1, 2, 12]]
    assert np.isnan(block[~baked]).all()


def test_dark_and_void_texels_are_baked_texels() -> None:
    chunk = filled(PLANS[0], np.array([7, 8]))
    chunk.light.planes[0] = 0.0
    chunk.light.samples[1] = VOID
    again = Chunk.from_block(chunk.index, PLANS[0], chunk.block())
    assert again.offsets.tolist() == [7, 8]
    assert again.light.samples.tolist() == [0.0, VOID]


def test_new_texels_come_dark_beside_the_old_ones() -> None:
    chunk = filled(PLANS[0], np.array([10, 20, 30]))
    grown = chunk.with_texels(np.array([20, 5, 40], np.int32))
    assert grown.offsets.tolist() == [5, 10, 20, 30, 40]
    assert grown.offsets.dtype == np.int32
    np.testing.assert_array_equal(grown.light.planes[[1, 2, 3]], chunk.light.planes)
    assert not grown.light.planes[[0, 4]].any()
    assert chunk.offsets.tolist() == [10, 20, 30]


def test_rows_are_found_by_offset() -> None:
    chunk = filled(PLANS[0], np.array([2, 9, 11, 4000]))
    assert chunk.rows_of(np.array([4000, 2])).tolist() == [3, 0]


def test_positions_are_lattice_indices() -> None:
    chunk = Chunk.empty((2, 0, 1), PLANS[0])
    offsets = np.array([0, 1, CHUNK, CHUNK * CHUNK, TEXELS - 1])
    expected = [[32, 0, 16], [32, 0, 17], [32, 1, 16], [33, 0, 16], [47, 15, 31]]
    assert chunk.positions(offsets).tolist() == expected
    assert chunk.positions(offsets).dtype == np.int32
