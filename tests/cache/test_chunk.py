import numpy as np

from isogi_core.bake.texel_light import VOID, Light, Part
from isogi_core.cache.chunk_record import Chunk, Chunks
from tests.bake.texels import same
from tests.cache.chunks import PLAN


def filled(offsets: list[int]) -> Chunk:
    """A chunk of random light, 16 samples a texel."""
    rng = np.random.default_rng(1)
    light = Light.dark(PLAN, len(offsets))
    for part in light.parts:
        part.samples[:] = 16
        part.noise[:] = rng.random(part.noise.shape)
        part.coefficients[:] = rng.random(part.coefficients.shape)
    return Chunk((1, 0, 2), np.array(offsets, np.int32), light)


def test_new_texels_come_dark_beside_the_old_ones() -> None:
    chunk = filled([10, 20, 30])
    grown = chunk.with_texels(np.array([20, 5, 40], np.int32))
    assert grown.index == chunk.index
    assert grown.offsets.tolist() == [5, 10, 20, 30, 40]
    assert grown.offsets.dtype == np.int32
    assert same(grown.light.rows(np.array([1, 2, 3])), chunk.light)
    assert same(grown.light.rows(np.array([0, 4])), Light.dark(PLAN, 2))
    assert chunk.offsets.tolist() == [10, 20, 30]


def test_layers_meet_texel_by_texel() -> None:
    """Each layer has texels of its own; where one lacks a texel, it is dark in that."""
    direct, indirect = filled([3, 8, 11]).light.parts
    indirect.samples[1] = VOID
    found = [(np.array([3, 8, 11]), direct), (np.array([2, 8, 40]), indirect)]
    chunk = Chunk.of_parts((0, 1, 2), PLAN.layers, found)
    assert chunk.index == (0, 1, 2) and chunk.offsets.tolist() == [2, 3, 8, 11, 40] and chunk.offsets.dtype == np.int32
    for (own, part), whole in zip(found, chunk.light.parts, strict=True):
        rows = chunk.rows_of(own)
        assert same(Light((whole.rows(rows),)), Light((part,)))
        others = np.setdiff1d(np.arange(5), rows)
        assert same(Light((whole.rows(others),)), Light((Part.dark(part.layer, 2),)))
    assert chunk.light.samples.tolist() == [0, 0, VOID, 0, 0]


def test_layers_without_texels_make_an_empty_chunk() -> None:
    nothing = np.empty(0, np.int32)
    found = [(nothing, part) for part in Light.dark(PLAN, 0).parts]
    chunk = Chunk.of_parts((0, 0, 0), PLAN.layers, found)
    assert chunk.offsets.size == 0 and len(chunk.light) == 0
    assert same(chunk.light, Chunk.empty((0, 0, 0), PLAN).light)


def test_texels_of_many_chunks_are_sorted_by_their_places() -> None:
    """Places count chunks of 64 texels; the second chunk has none, and one layer lacks the third."""
    direct, indirect = filled([3, 8, 2 * 64 + 1, 3 * 64]).light.parts
    found = [(np.array([3, 8, 129, 192], np.int32), direct), (np.array([3, 9, 192, 255], np.int32), indirect)]
    indices = ((0, 0, 0), (0, 0, 1), (0, 0, 2), (5, 4, 3))
    chunks = Chunks.of_parts(indices, 64, PLAN.layers, found)
    assert chunks.indices == ((0, 0, 0), (0, 0, 2), (5, 4, 3))
    assert chunks.bounds.tolist() == [0, 3, 4, 6] and chunks.bounds.dtype == np.int64
    assert chunks.offsets.tolist() == [3, 8, 9, 1, 0, 63] and chunks.offsets.dtype == np.int32
    assert same(Light(chunks.light.parts[:1]).rows(np.array([0, 1, 3, 4])), Light((direct,)))
    assert same(Light(chunks.light.parts[1:]).rows(np.array([0, 2, 4, 5])), Light((indirect,)))
    assert chunks.light.parts[0].samples.tolist() == [16, 16, 0, 16, 16, 0]
    nothing = [(np.empty(0, np.int32), part) for part in Light.dark(PLAN, 0).parts]
    none = Chunks.of_parts(indices, 64, PLAN.layers, nothing)
    assert none.indices == () and none.bounds.tolist() == [0] and len(none.light) == 0


def test_rows_are_found_by_offset() -> None:
    assert filled([2, 9, 11, 4000]).rows_of(np.array([4000, 2])).tolist() == [3, 0]
