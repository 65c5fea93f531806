"""Chunks and their records: what goes in comes out, bit by bit, also without isogi."""

import numpy as np
import pytest

from isogi_core.bake.texel_light import VOID, Light, Part, round_light
from isogi_core.cache.chunk_record import Chunk, Chunks, pack, record_type, unpack
from isogi_core.model.scene_plan import Layer
from tests.bake.texels import COLUMNS, same
from tests.cache.chunks import CONSTANT, PLAN, TEXELS, baked, spec_of

BAKE = "0123456789abcdef0123"
INDEX = (4, 0, 17)
LAYERS = (
    Layer("direct"),
    Layer("whole", channels=3),
    Layer("indirect", 3, 3, scale=2.0**-7),
    Layer("direct", 5, half=False, scale=4.0),
    Layer("direct", 6, coarse=3),
    Layer("indirect", 3, 3, coarse=1, scale=2.0**-7),
)


def part_of(layer: Layer, texels: int, seed: int = 1) -> Part:
    """A part of random light, as rounded as what is baked."""
    rng = np.random.default_rng(seed)
    part = Part.dark(layer, texels)
    part.samples[:] = 16 << rng.integers(0, 9, texels)
    part.noise[:] = layer.scale * 2.0 ** rng.integers(-20, 4, part.noise.shape)
    part.coefficients[:] = round_light(
        0.3 * layer.scale * rng.normal(size=part.coefficients.shape), layer
    )
    return part


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize("offsets", [[], [0], [TEXELS - 1], [3, 17, 255, 256, 4095], range(TEXELS)])
def test_a_record_gives_back_the_part_that_it_was_made_of(layer: Layer, offsets: list[int]) -> None:
    places = np.array(offsets, np.int32)
    part = part_of(layer, len(places))
    found = unpack(pack(part, places, TEXELS, BAKE, INDEX), layer, TEXELS, BAKE, INDEX)
    assert found is not None
    np.testing.assert_array_equal(found[0], places)
    for name in COLUMNS:
        own = getattr(part, name)
        again = getattr(found[1], name)
        assert again.dtype == own.dtype and again.shape == own.shape
        np.testing.assert_array_equal(again, own)


@pytest.mark.parametrize("rounded", [True, False])
def test_light_beyond_half_floats_is_cut_alike_in_the_store(rounded: bool) -> None:
    layer = Layer("irradiance", channels=3, scale=2.0**-7)
    part = Part.dark(layer, 2)
    part.samples[:] = 64
    light = np.array([1e6, 511.9, -1e9, 0.5, 511.75, 511.74], np.float32).reshape(2, 3, 1)
    if rounded:
        part.coefficients[:] = round_light(light, layer)
    else:
        part.coefficients[:] = light
    found = unpack(
        pack(part, np.array([1, 5], np.int32), TEXELS, BAKE, INDEX), layer, TEXELS, BAKE, INDEX
    )
    assert found is not None and np.isfinite(found[1].coefficients).all()
    np.testing.assert_array_equal(found[1].coefficients, round_light(light, layer))


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"precision": "single"},
        {"lights": [CONSTANT]},
        {"albedo": [0.2, 0.5, 0.8], "order": 4, "indirect_order": 1},
    ],
)
def test_what_was_just_baked_is_read_back_bit_by_bit(settings: dict[str, object]) -> None:
    spec = spec_of(**settings)  # type: ignore[arg-type]
    chunk = baked(spec, (1, 1, 1), samples=128)
    for part in chunk.light.parts:
        found = unpack(
            pack(part, chunk.offsets, TEXELS, BAKE, INDEX), part.layer, TEXELS, BAKE, INDEX
        )
        assert found is not None
        for name in COLUMNS:
            assert np.array_equal(getattr(found[1], name), getattr(part, name)), name


@pytest.mark.parametrize("layer", LAYERS)
def test_a_texel_takes_as_many_bytes_as_the_plan_says(layer: Layer) -> None:
    head = 20 + 3 * 4 + 4
    assert record_type(layer, TEXELS).itemsize == head + TEXELS * layer.bytes_per_texel
    empty = pack(Part.dark(layer, 0), np.empty(0, np.int32), TEXELS, BAKE, INDEX)
    assert empty.shape == (record_type(layer, TEXELS).itemsize,)


def test_texels_that_are_not_lit_are_left_out_and_void_ones_kept() -> None:
    layer = LAYERS[0]
    part = part_of(layer, 4)
    part.samples[:] = [0, 16, VOID, 32]
    record = pack(part, np.array([1, 2, 3, 9], np.int32), TEXELS, BAKE, INDEX).view(
        record_type(layer, TEXELS)
    )[0]
    assert np.flatnonzero(record["rung"]).tolist() == [2, 3, 9]
    assert record["rung"][[2, 3, 9]].tolist() == [1, 255, 2]
    assert not record["light"][..., 1].any() and not record["noise"][:, 1].any()
    offsets, again = unpack(record.reshape(1).view(np.uint8), layer, TEXELS, BAKE, INDEX) or (
        None,
        None,
    )
    assert offsets is not None and again is not None
    assert offsets.tolist() == [2, 3, 9] and again.samples.tolist() == [16, VOID, 32]


def test_dark_texels_are_baked_texels() -> None:
    part = Part.dark(LAYERS[1], 1)
    part.samples[:] = 64
    found = unpack(
        pack(part, np.array([7], np.int32), TEXELS, BAKE, INDEX), LAYERS[1], TEXELS, BAKE, INDEX
    )
    assert found is not None
    assert (
        found[0].tolist() == [7]
        and found[1].samples.tolist() == [64]
        and not found[1].coefficients.any()
    )


@pytest.mark.parametrize(
    ("bake", "index"),
    [("f" * 20, INDEX), (BAKE, (4, 0, 16)), (BAKE[:-1], INDEX), (BAKE, (0, 4, 17))],
)
def test_a_record_knows_whose_it_is(bake: str, index: tuple[int, int, int]) -> None:
    record = pack(part_of(LAYERS[0], 3), np.arange(3, dtype=np.int32), TEXELS, BAKE, INDEX)
    assert unpack(record, LAYERS[0], TEXELS, bake, index) is None


def test_the_same_part_makes_the_same_bytes_whatever_lay_there() -> None:
    part = part_of(LAYERS[2], 50)
    places = np.arange(50, dtype=np.int32)
    assert np.array_equal(
        pack(part, places, TEXELS, BAKE, INDEX), pack(part, places, TEXELS, BAKE, INDEX)
    )
    order = np.random.default_rng(1).permutation(50)
    turned = pack(part.rows(order), places[order], TEXELS, BAKE, INDEX)
    assert np.array_equal(turned, pack(part, places, TEXELS, BAKE, INDEX))


# --- chunks in memory
# -------------------------------------------------------------------------------------------------


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
    chunk = Chunk.of_parts((0, 1, 2), found)
    assert (
        chunk.index == (0, 1, 2)
        and chunk.offsets.tolist() == [2, 3, 8, 11, 40]
        and chunk.offsets.dtype == np.int32
    )
    for (own, part), whole in zip(found, chunk.light.parts, strict=True):
        rows = chunk.rows_of(own)
        assert same(Light((whole.rows(rows),)), Light((part,)))
        others = np.setdiff1d(np.arange(5), rows)
        assert same(Light((whole.rows(others),)), Light((Part.dark(part.layer, 2),)))
    assert chunk.light.samples.tolist() == [0, 0, VOID, 0, 0]


def test_layers_without_texels_make_an_empty_chunk() -> None:
    nothing = np.empty(0, np.int32)
    found = [(nothing, part) for part in Light.dark(PLAN, 0).parts]
    chunk = Chunk.of_parts((0, 0, 0), found)
    assert chunk.offsets.size == 0 and len(chunk.light) == 0
    assert same(chunk.light, Chunk.empty((0, 0, 0), PLAN).light)


def test_texels_of_many_chunks_are_sorted_by_their_places() -> None:
    """Places count chunks of 64 texels; the second chunk has none, and one layer lacks the
    third.
    """
    direct, indirect = filled([3, 8, 2 * 64 + 1, 3 * 64]).light.parts
    found = [
        (np.array([3, 8, 129, 192], np.int32), direct),
        (np.array([3, 9, 192, 255], np.int32), indirect),
    ]
    indices = ((0, 0, 0), (0, 0, 1), (0, 0, 2), (5, 4, 3))
    chunks = Chunks.of_parts(indices, 64, found)
    assert chunks.indices == ((0, 0, 0), (0, 0, 2), (5, 4, 3))
    assert chunks.bounds.tolist() == [0, 3, 4, 6] and chunks.bounds.dtype == np.int64
    assert chunks.offsets.tolist() == [3, 8, 9, 1, 0, 63] and chunks.offsets.dtype == np.int32
    assert same(Light(chunks.light.parts[:1]).rows(np.array([0, 1, 3, 4])), Light((direct,)))
    assert same(Light(chunks.light.parts[1:]).rows(np.array([0, 2, 4, 5])), Light((indirect,)))
    assert chunks.light.parts[0].samples.tolist() == [16, 16, 0, 16, 16, 0]
    nothing = [(np.empty(0, np.int32), part) for part in Light.dark(PLAN, 0).parts]
    none = Chunks.of_parts(indices, 64, nothing)
    assert none.indices == () and none.bounds.tolist() == [0] and len(none.light) == 0


def test_rows_are_found_by_offset() -> None:
    assert filled([2, 9, 11, 4000]).rows_of(np.array([4000, 2])).tolist() == [3, 0]
