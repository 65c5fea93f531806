"""A plan that changes: what an earlier one left serves, is shown, or is none of its business."""

import logging
import shutil
import uuid
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec, spec_for
from isogi_core.bake.texel_light import VOID, Part
from isogi_core.cache.chunk_store import (
    ChunkStore,
    adopt,
    find_fallback,
    larger_layers,
    smaller_layers,
)
from isogi_core.cache.layer import LayerStore
from isogi_core.errors import DamagedChunkError, StoreError
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.scene_plan import Layer
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.cache.chunks import CONSTANT, assert_equal, baked, file_of, shown, spec_of
from tests.loaded import load_scene

INDEX = (1, 1, 1)
DIRECT = 0
INDIRECT = 1


def spec(order: int, **settings: Any) -> BakeSpec:
    """Direct light of an order, and indirect light of order 2, in half floats unless told
    otherwise.
    """
    return spec_of(**{"order": order, "indirect_order": 2, "precision": "half", **settings})


def planned(shading: str = "gi", **settings: Any) -> BakeSpec:
    """A look at the same texels by the plan's own choice of all that is not told."""
    return spec_for(
        PreparedScene(load_scene("demo:orbital", **{"lattice": 0.4, "bounces": 1, **settings})),
        shading,
    )


def make(store: Path, spec: BakeSpec, **changes: Any) -> Layer:
    """Put a chunk into the place of the look's direct layer, changed, and return that layer."""
    layer = replace(spec.plan.layers[DIRECT], **changes)
    LayerStore(store, spec.prepared, layer).save(INDEX, np.empty(0, np.int32), Part.dark(layer, 0))
    return layer


# --- larger, smaller
# -----------------------------------------------------------------------------------------------


def ranks(layer: Layer) -> np.ndarray:
    """How precisely each coefficient is kept: as a byte, a half or a single float; (n²,)."""
    return np.where(np.arange(layer.order**2) < layer.floats, 1 if layer.half else 2, 0)


def all_like(layer: Layer) -> list[Layer]:
    """Every layer of its kind and channels."""
    halves = [
        replace(layer, order=order, half=True, coarse=coarse)
        for order in range(1, MAX_ORDER + 1)
        for coarse in (None, *range(1, order))
    ]
    return halves + [
        replace(layer, order=order, half=False, coarse=None) for order in range(1, MAX_ORDER + 1)
    ]


def serves(other: Layer, layer: Layer) -> bool:
    """Whether one layer holds all of another."""
    n = layer.order**2
    return other.order >= layer.order and bool((ranks(other)[:n] >= ranks(layer)).all())


TURNING = [
    Layer("direct", 5),
    Layer("direct", 6, coarse=3),
    Layer("direct", MAX_ORDER, half=False),
    Layer("direct", 1),
    Layer("indirect", 3, 3, coarse=1),
]


@pytest.mark.parametrize("layer", TURNING, ids=str)
def test_larger_layers_hold_every_coefficient_as_precisely(layer: Layer) -> None:
    found = list(larger_layers(layer))
    assert set(found) == {
        other for other in all_like(layer) if other != layer and serves(other, layer)
    }
    assert len(found) == len(set(found))


@pytest.mark.parametrize("layer", TURNING, ids=str)
def test_smaller_layers_hold_fewer_bands_or_less_precise_ones(layer: Layer) -> None:
    found = list(smaller_layers(layer))
    if layer.kind == "direct":
        least = 2  # band 0 alone does not depend on the normal
    else:
        least = 1
    fewer = {other for other in all_like(layer) if least <= other.order < layer.order}
    rounder = {
        other
        for other in all_like(layer)
        if other.order == layer.order and not serves(other, layer)
    }
    assert set(found) == fewer | rounder
    assert [other.order for other in found] == sorted(
        (other.order for other in found), reverse=True
    )


@pytest.mark.parametrize("kind", ["whole", "irradiance"])
def test_light_without_harmonics_is_compatible_in_its_order(kind: str) -> None:
    half = Layer(kind, channels=3)
    single = Layer(kind, channels=3, half=False)
    assert (list(larger_layers(half)), list(smaller_layers(half))) == ([single], [])
    assert (list(larger_layers(single)), list(smaller_layers(single))) == ([], [half])


# --- what serves
# --------------------------------------------------------------------------------------------------


def test_the_least_larger_layer_that_is_there_is_taken_on(tmp_path: Path) -> None:
    small = spec(3)
    assert adopt(small.plan, small.prepared, tmp_path) == small.plan
    for changes in ({"order": 6}, {"order": 5}, {"order": 5, "half": False}, {"order": 2}):
        make(tmp_path, small, **changes)
    adopted = adopt(small.plan, small.prepared, tmp_path)
    assert adopted == replace(
        small.plan, layers=(replace(small.plan.layers[0], order=5), small.plan.layers[1])
    )
    make(tmp_path, small)
    assert adopt(small.plan, small.prepared, tmp_path) == small.plan


@pytest.mark.parametrize("store", ["folder", "memory://"])
def test_layers_without_light_are_neither_adopted_nor_shown(tmp_path: Path, store: str) -> None:
    """An array is made when a scene is opened; until it is baked, what holds light is worth
    more.
    """
    if store == "folder":
        place = str(tmp_path)
    else:
        place = f"{store}{uuid.uuid4().hex}"
    small = spec(3)
    large = spec(5)
    for scene in (small, large):
        ChunkStore(place, scene).open()
    assert adopt(small.plan, small.prepared, place) == small.plan
    assert find_fallback(large.plan.layers[DIRECT], large.prepared, place) is None
    ChunkStore(place, large).save(baked(large, INDEX))
    assert adopt(small.plan, small.prepared, place).layers[DIRECT] == large.plan.layers[DIRECT]
    ChunkStore(place, small).save(baked(small, INDEX))
    assert adopt(small.plan, small.prepared, place) == small.plan
    assert find_fallback(large.plan.layers[DIRECT], large.prepared, place) is not None


def test_an_unreadable_store_is_not_taken_for_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = LayerStore(tmp_path, spec(3).prepared, spec(3).plan.layers[DIRECT])
    assert not store.exists

    def refuse(*arguments: Any, **named: Any) -> None:
        raise PermissionError("Access denied.")

    monkeypatch.setattr("isogi_core.storage.folder.Folder.folders", refuse)
    with pytest.raises(StoreError, match=r"Cannot list all in the store at .*: Access denied"):
        adopt(spec(3).plan, spec(3).prepared, tmp_path)


def test_fallback_layers_are_found_once_when_the_store_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = spec(3)
    large = spec(5)
    ChunkStore(tmp_path, small).save(baked(small, INDEX))
    store = ChunkStore(tmp_path, large)
    store.open()
    monkeypatch.setattr("isogi_core.cache.chunk_store.find_fallback", None)
    assert shown(store, INDEX).indices == (INDEX,)


def test_layers_in_bytes_serve_bands_that_they_keep_as_floats(tmp_path: Path) -> None:
    small = spec(3)
    large = spec(6)
    make(tmp_path, large, coarse=2)
    assert adopt(small.plan, small.prepared, tmp_path) == small.plan
    kept = make(tmp_path, large, coarse=3)
    assert adopt(small.plan, small.prepared, tmp_path).layers[DIRECT] == kept
    near = planned("vicinity", lights=[CONSTANT])
    assert adopt(near.plan, near.prepared, tmp_path).layers == (replace(kept, coarse=2),)


def test_a_larger_layer_serves_bit_for_bit(tmp_path: Path) -> None:
    """The first bands of a texel after as many samples, read by the plan that asks for no more."""
    small = spec(3)
    large = spec(5)
    ChunkStore(tmp_path, large).save(baked(large, INDEX))
    served = ChunkStore(
        tmp_path, replace(small, plan=adopt(small.plan, small.prepared, tmp_path))
    ).load(INDEX)
    own = baked(small, INDEX)
    np.testing.assert_array_equal(served.offsets, own.offsets)
    for mine, part in zip(served.light.parts, own.light.parts, strict=True):
        n = part.layer.order**2
        np.testing.assert_array_equal(mine.samples, part.samples)
        np.testing.assert_array_equal(mine.coefficients[:, :, :n], part.coefficients)


# --- what is shown meanwhile
# ---------------------------------------------------------------------------------------


def test_the_largest_smaller_layer_in_the_store_is_shown(tmp_path: Path) -> None:
    large = spec(6)
    layer = large.plan.layers[DIRECT]
    assert find_fallback(layer, large.prepared, tmp_path) is None
    found = []
    for changes in (
        {"order": 1},
        {"order": 2},
        {"order": 4, "coarse": 2},
        {"order": 4},
        {"coarse": 3},
        {"order": 7},
    ):
        make(tmp_path, large, **changes)
        store = find_fallback(layer, large.prepared, tmp_path)
        found.append(None if store is None else store.layer)
    half = [replace(layer, order=2), replace(layer, order=4, coarse=2), replace(layer, order=4)]
    assert found == [None, *half, replace(layer, coarse=3), replace(layer, coarse=3)]


@pytest.mark.parametrize("precision", ["half", "bytes"])
def test_unbaked_texels_are_shown_by_the_fallback_layer(tmp_path: Path, precision: str) -> None:
    """Texels of order 3, some of which are baked to order 5 too."""
    small = spec(3, precision=precision)
    large = spec(5, precision=precision)
    old = baked(small, INDEX, 40)
    new = baked(large, INDEX, 40, seed=1)
    old.light.parts[DIRECT].samples[7] = VOID
    before, after = ChunkStore(tmp_path, small), ChunkStore(tmp_path, large)
    before.save(old)
    kept = [file_of(layer, INDEX).read_bytes() for layer in before.layers]
    after.layers[DIRECT].save(INDEX, new.offsets, new.light.parts[DIRECT])
    found = shown(after, INDEX)
    own = new.light.parts[DIRECT]
    assert (
        found.indices == (INDEX,)
        and [file_of(layer, INDEX).read_bytes() for layer in before.layers] == kept
    )
    np.testing.assert_array_equal(found.offsets, np.union1d(old.offsets, new.offsets))
    direct = found.light.parts[DIRECT]
    for row, offset in enumerate(found.offsets):
        if offset in new.offsets:
            t = int(np.searchsorted(new.offsets, offset))
            assert direct.samples[row] == own.samples[t] > 0
            np.testing.assert_array_equal(direct.coefficients[row], own.coefficients[t])
        else:
            t = int(np.searchsorted(old.offsets, offset))
            assert direct.samples[row] == (VOID if t == 7 else 0)
            np.testing.assert_array_equal(
                direct.coefficients[row, :, :9], old.light.parts[DIRECT].coefficients[t]
            )
            assert not direct.coefficients[row, :, 9:].any()


def test_what_is_only_shown_is_neither_loaded_nor_saved(tmp_path: Path) -> None:
    small = spec(3)
    large = spec(5)
    ChunkStore(tmp_path, small).layers[DIRECT].save(INDEX, *direct_of(small))
    store = ChunkStore(tmp_path, large)
    assert shown(store, INDEX).indices == (INDEX,)
    assert store.read(INDEX) is None and len(store.load(INDEX).offsets) == 0
    store.save(store.load(INDEX).with_texels(np.array([5, 9], np.int32)))
    loaded = store.layers[DIRECT].decode(INDEX, store.layers[DIRECT].read(INDEX) or b"")
    assert len(loaded[0]) == 0


def direct_of(spec: BakeSpec) -> tuple[np.ndarray, Any]:
    """Offsets and direct part of a baked chunk."""
    chunk = baked(spec, INDEX)
    return chunk.offsets, chunk.light.parts[DIRECT]


# --- what is shared, and what never is
# -----------------------------------------------------------------------------


def digests(spec: BakeSpec, number: int) -> set[str]:
    """Names of every layer that a look may read or show in place of one of its own."""
    layer = spec.plan.layers[number]
    return {
        LayerStore("", spec.prepared, other).digest
        for other in (layer, *larger_layers(layer), *smaller_layers(layer))
    }


@pytest.mark.parametrize(
    "other",
    [
        {"target": "demo:casting"},
        {"lattice": 0.3},
        {"albedo": 0.5},
        {"albedo": [0.7, 0.6, 0.7]},
        {"bounces": 2},
    ],
    ids=str,
)
def test_another_scenes_light_is_never_read(tmp_path: Path, other: dict[str, Any]) -> None:
    """Other texels share nothing, other reflections their direct light."""
    mine = spec(3)
    theirs = spec(3, **other)
    shared = [
        bool(digests(mine, number) & digests(theirs, number)) for number in (DIRECT, INDIRECT)
    ]
    assert shared == [other.keys() <= {"albedo", "bounces"}, False]
    store = ChunkStore(tmp_path, mine)
    store.save(baked(mine, INDEX))
    found = shown(ChunkStore(tmp_path, theirs), INDEX)
    assert bool(found.indices) == shared[DIRECT]
    assert not found.light.parts[INDIRECT].coefficients.any()


def test_other_lights_share_all_but_irradiance() -> None:
    lights = [[{"type": "sky", "sun_azimuth": azimuth}] for azimuth in (30.0, 40.0)]
    turning, fixed = (
        [planned(lights=light, rotating=turns) for light in lights] for turns in (True, False)
    )
    assert turning[0].digest == turning[1].digest
    assert not digests(fixed[0], 0) & digests(fixed[1], 0)


COPIES = {
    "another kind": ({}, DIRECT, {}, INDIRECT),
    "another albedo": ({}, INDIRECT, {"albedo": 0.5}, INDIRECT),
    "another order": ({"order": 5}, DIRECT, {}, DIRECT),
    "bytes": ({"precision": "bytes", "order": 3}, DIRECT, {"order": 3}, DIRECT),
}


@pytest.mark.parametrize(("source", "one", "target", "other"), COPIES.values(), ids=COPIES)
def test_a_record_in_another_layers_folder_is_refused(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    source: dict[str, Any],
    one: int,
    target: dict[str, Any],
    other: int,
) -> None:
    theirs = spec(**{"order": 2, **source})
    mine = spec(**{"order": 2, **target})
    stores = ChunkStore(tmp_path / "theirs", theirs), ChunkStore(tmp_path / "mine", mine)
    stores[0].save(baked(theirs, INDEX))
    chunk = baked(mine, INDEX)
    stores[1].save(chunk)
    layer = stores[1].layers[other]
    whole = file_of(layer, INDEX).read_bytes()
    shutil.copy(file_of(stores[0].layers[one], INDEX), file_of(layer, INDEX))
    with pytest.raises(
        DamagedChunkError, match=r"baked for another place|does not unpack to a record"
    ):
        layer.decode(INDEX, layer.read(INDEX) or b"")
    with caplog.at_level(logging.WARNING, "isogi.cache"):
        found = stores[1].load(INDEX)
    assert "it is baked again" in caplog.text
    assert not found.light.parts[other].samples.any()
    np.testing.assert_array_equal(
        found.light.parts[1 - other].samples, chunk.light.parts[1 - other].samples
    )
    stores[1].save(chunk)
    assert file_of(layer, INDEX).read_bytes() == whole
    assert_equal(stores[1].load(INDEX), chunk)
