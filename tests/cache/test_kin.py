"""A plan that changes: what an earlier one left serves, is shown, or is none of its business."""

import logging
import shutil
import uuid
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.light import Part
from isogi_core.bake.look import Look, look_for
from isogi_core.bake.precision import VOID
from isogi_core.bake.recipe import Recipe
from isogi_core.cache.kin import DIRECTED, adopt, former, larger, smaller
from isogi_core.cache.layer import LayerStore
from isogi_core.cache.store import ChunkStore
from isogi_core.errors import DamagedChunkError, StoreError
from isogi_core.kernels.harmonics import MAX_ORDER
from isogi_core.model.plan import Layer
from isogi_core.model.scene import load_scene
from tests.cache.chunks import CONSTANT, assert_equal, baked, file_of, look_of, shown

INDEX = (1, 1, 1)
DIRECT, INDIRECT = 0, 1


def look(order: int, **settings: Any) -> Look:
    """Direct light of an order, and indirect light of order 2, in half floats unless told otherwise."""
    return look_of(**{"order": order, "indirect_order": 2, "precision": "half", **settings})


def planned(shading: str = "gi", **settings: Any) -> Look:
    """A look at the same texels by the plan's own choice of all that is not told."""
    return look_for(Recipe(load_scene("demo:orbital", **{"lattice": 0.4, "bounces": 1, **settings})), shading)


def make(root: Path, look: Look, **changes: Any) -> Layer:
    """Put a chunk into the place of the look's direct layer, changed, and return that layer."""
    layer = replace(look.plan.layers[DIRECT], **changes)
    LayerStore(root, look.recipe, layer).save(INDEX, np.empty(0, np.int32), Part.dark(layer, 0))
    return layer


# --- larger, smaller -----------------------------------------------------------------------------------------------


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
    return halves + [replace(layer, order=order, half=False, coarse=None) for order in range(1, MAX_ORDER + 1)]


def serves(kin: Layer, layer: Layer) -> bool:
    """Whether one layer holds all of another."""
    n = layer.order**2
    return kin.order >= layer.order and bool((ranks(kin)[:n] >= ranks(layer)).all())


TURNING = [
    Layer("direct", 5),
    Layer("direct", 6, coarse=3),
    Layer("direct", MAX_ORDER, half=False),
    Layer("direct", 1),
    Layer("indirect", 3, 3, coarse=1),
]


@pytest.mark.parametrize("layer", TURNING, ids=str)
def test_larger_layers_are_those_that_hold_every_coefficient_as_precisely(layer: Layer) -> None:
    found = list(larger(layer))
    assert set(found) == {kin for kin in all_like(layer) if kin != layer and serves(kin, layer)}
    assert len(found) == len(set(found))


@pytest.mark.parametrize("layer", TURNING, ids=str)
def test_smaller_layers_hold_the_first_bands_or_all_of_them_less_precisely(layer: Layer) -> None:
    found = list(smaller(layer))
    least = DIRECTED if layer.kind == "direct" else 1
    fewer = {kin for kin in all_like(layer) if least <= kin.order < layer.order}
    rounder = {kin for kin in all_like(layer) if kin.order == layer.order and not serves(kin, layer)}
    assert set(found) == fewer | rounder
    assert [kin.order for kin in found] == sorted((kin.order for kin in found), reverse=True)


@pytest.mark.parametrize("kind", ["whole", "irradiance"])
def test_light_without_harmonics_has_kin_of_its_own_order_alone(kind: str) -> None:
    half, single = Layer(kind, channels=3), Layer(kind, channels=3, half=False)
    assert (list(larger(half)), list(smaller(half))) == ([single], [])
    assert (list(larger(single)), list(smaller(single))) == ([], [half])


# --- what serves ---------------------------------------------------------------------------------------------------


def test_the_least_larger_layer_that_is_there_is_taken_on(tmp_path: Path) -> None:
    small = look(3)
    assert adopt(small.plan, small.recipe, tmp_path) == small.plan
    for changes in ({"order": 6}, {"order": 5}, {"order": 5, "half": False}, {"order": 2}):
        make(tmp_path, small, **changes)
    adopted = adopt(small.plan, small.recipe, tmp_path)
    assert adopted == replace(small.plan, layers=(replace(small.plan.layers[0], order=5), small.plan.layers[1]))
    make(tmp_path, small)
    assert adopt(small.plan, small.recipe, tmp_path) == small.plan


@pytest.mark.parametrize("root", ["folder", "memory://"])
def test_a_place_without_light_is_neither_taken_on_nor_shown(tmp_path: Path, root: str) -> None:
    """An array is made when a scene is opened; until it is baked, what holds light is worth more."""
    place = str(tmp_path) if root == "folder" else f"{root}{uuid.uuid4().hex}"
    small, large = look(3), look(5)
    for scene in (small, large):
        ChunkStore(place, scene).open()
    assert adopt(small.plan, small.recipe, place) == small.plan
    assert former(large.plan.layers[DIRECT], large.recipe, place) is None
    ChunkStore(place, large).save(baked(large, INDEX))
    assert adopt(small.plan, small.recipe, place).layers[DIRECT] == large.plan.layers[DIRECT]
    ChunkStore(place, small).save(baked(small, INDEX))
    assert adopt(small.plan, small.recipe, place) == small.plan
    assert former(large.plan.layers[DIRECT], large.recipe, place) is not None


def test_a_store_that_cannot_be_read_is_told_and_not_taken_for_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = LayerStore(tmp_path, look(3).recipe, look(3).plan.layers[DIRECT])
    assert not store.exists

    def refuse(*arguments: Any, **named: Any) -> None:
        raise PermissionError("Access denied.")

    monkeypatch.setattr("isogi_core.cache.folder.Folder.names", refuse)
    with pytest.raises(StoreError, match=r"Cannot list all in the store at .*: Access denied"):
        adopt(look(3).plan, look(3).recipe, tmp_path)


def test_smaller_layers_are_looked_for_once_when_the_store_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small, large = look(3), look(5)
    ChunkStore(tmp_path, small).save(baked(small, INDEX))
    store = ChunkStore(tmp_path, large)
    store.open()
    monkeypatch.setattr("isogi_core.cache.store.former", None)
    assert shown(store, INDEX).indices == (INDEX,)


def test_layers_in_bytes_serve_those_whose_bands_they_keep_as_floats(tmp_path: Path) -> None:
    small, large = look(3), look(6)
    make(tmp_path, large, coarse=2)
    assert adopt(small.plan, small.recipe, tmp_path) == small.plan
    kept = make(tmp_path, large, coarse=3)
    assert adopt(small.plan, small.recipe, tmp_path).layers[DIRECT] == kept
    near = planned("vicinity", lights=[CONSTANT])
    assert adopt(near.plan, near.recipe, tmp_path).layers == (replace(kept, coarse=2),)


def test_a_larger_layer_serves_bit_for_bit(tmp_path: Path) -> None:
    """The first bands of a texel after as many samples, read by the plan that asks for no more."""
    small, large = look(3), look(5)
    ChunkStore(tmp_path, large).save(baked(large, INDEX))
    served = ChunkStore(tmp_path, replace(small, plan=adopt(small.plan, small.recipe, tmp_path))).load(INDEX)
    own = baked(small, INDEX)
    np.testing.assert_array_equal(served.offsets, own.offsets)
    for mine, part in zip(served.light.parts, own.light.parts, strict=True):
        n = part.layer.order**2
        np.testing.assert_array_equal(mine.samples, part.samples)
        np.testing.assert_array_equal(mine.coefficients[:, :, :n], part.coefficients)


# --- what is shown meanwhile ---------------------------------------------------------------------------------------


def test_the_largest_of_the_smaller_layers_that_are_there_is_shown(tmp_path: Path) -> None:
    large = look(6)
    layer = large.plan.layers[DIRECT]
    assert former(layer, large.recipe, tmp_path) is None
    found = []
    for changes in ({"order": 1}, {"order": 2}, {"order": 4, "coarse": 2}, {"order": 4}, {"coarse": 3}, {"order": 7}):
        make(tmp_path, large, **changes)
        store = former(layer, large.recipe, tmp_path)
        found.append(None if store is None else store.layer)
    half = [replace(layer, order=2), replace(layer, order=4, coarse=2), replace(layer, order=4)]
    assert found == [None, *half, replace(layer, coarse=3), replace(layer, coarse=3)]


@pytest.mark.parametrize("precision", ["half", "bytes"])
def test_what_is_not_baked_is_shown_as_the_former_layer_knows_it(tmp_path: Path, precision: str) -> None:
    """Texels of order 3, some of which are baked to order 5 too."""
    small, large = look(3, precision=precision), look(5, precision=precision)
    old, new = baked(small, INDEX, 40), baked(large, INDEX, 40, seed=1)
    old.light.parts[DIRECT].samples[7] = VOID
    before, after = ChunkStore(tmp_path, small), ChunkStore(tmp_path, large)
    before.save(old)
    kept = [file_of(layer, INDEX).read_bytes() for layer in before.layers]
    after.layers[DIRECT].save(INDEX, new.offsets, new.light.parts[DIRECT])
    found, own = shown(after, INDEX), new.light.parts[DIRECT]
    assert found.indices == (INDEX,) and [file_of(layer, INDEX).read_bytes() for layer in before.layers] == kept
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
            np.testing.assert_array_equal(direct.coefficients[row, :, :9], old.light.parts[DIRECT].coefficients[t])
            assert not direct.coefficients[row, :, 9:].any()


def test_what_is_only_shown_is_neither_loaded_nor_saved(tmp_path: Path) -> None:
    small, large = look(3), look(5)
    ChunkStore(tmp_path, small).layers[DIRECT].save(INDEX, *direct_of(small))
    store = ChunkStore(tmp_path, large)
    assert shown(store, INDEX).indices == (INDEX,)
    assert store.read(INDEX) is None and len(store.load(INDEX).offsets) == 0
    store.save(store.load(INDEX).with_texels(np.array([5, 9], np.int32)))
    loaded = store.layers[DIRECT].decode(INDEX, store.layers[DIRECT].read(INDEX) or b"")
    assert len(loaded[0]) == 0


def direct_of(look: Look) -> tuple[np.ndarray, Any]:
    """Offsets and direct part of a baked chunk."""
    chunk = baked(look, INDEX)
    return chunk.offsets, chunk.light.parts[DIRECT]


# --- what is shared, and what never is -----------------------------------------------------------------------------


def test_coloured_albedo_takes_the_direct_light_that_is_there(tmp_path: Path) -> None:
    grey, coloured = look(3), look(3, albedo=[0.7, 0.5, 0.3])
    old = baked(grey, INDEX)
    ChunkStore(tmp_path, grey).save(old)
    chunk = ChunkStore(tmp_path, coloured).load(INDEX)
    assert grey.plan.layers[DIRECT] == coloured.plan.layers[DIRECT]
    np.testing.assert_array_equal(chunk.light.parts[DIRECT].coefficients, old.light.parts[DIRECT].coefficients)
    np.testing.assert_array_equal(chunk.light.parts[DIRECT].samples, old.light.parts[DIRECT].samples)
    assert not chunk.light.parts[INDIRECT].samples.any()


def digests(look: Look, number: int) -> set[str]:
    """Names of every layer that a look may read or show in place of one of its own."""
    layer = look.plan.layers[number]
    return {LayerStore("", look.recipe, kin).digest for kin in (layer, *larger(layer), *smaller(layer))}


@pytest.mark.parametrize(
    "other",
    [{"target": "demo:casting"}, {"lattice": 0.3}, {"albedo": 0.5}, {"albedo": [0.7, 0.6, 0.7]}, {"bounces": 2}],
    ids=str,
)
def test_another_scenes_light_is_never_read(tmp_path: Path, other: dict[str, Any]) -> None:
    """Other texels share nothing, other reflections their direct light."""
    mine, theirs = look(3), look(3, **other)
    shared = [bool(digests(mine, number) & digests(theirs, number)) for number in (DIRECT, INDIRECT)]
    assert shared == [other.keys() <= {"albedo", "bounces"}, False]
    store = ChunkStore(tmp_path, mine)
    store.save(baked(mine, INDEX))
    found = shown(ChunkStore(tmp_path, theirs), INDEX)
    assert bool(found.indices) == shared[DIRECT]
    assert not found.light.parts[INDIRECT].coefficients.any()


def test_other_lights_share_all_but_irradiance() -> None:
    lights = [[{"type": "sky", "sun_azimuth": azimuth}] for azimuth in (30.0, 40.0)]
    turning, fixed = ([planned(lights=light, rotating=turns) for light in lights] for turns in (True, False))
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
    theirs, mine = look(**{"order": 2, **source}), look(**{"order": 2, **target})
    stores = ChunkStore(tmp_path / "theirs", theirs), ChunkStore(tmp_path / "mine", mine)
    stores[0].save(baked(theirs, INDEX))
    chunk = baked(mine, INDEX)
    stores[1].save(chunk)
    layer = stores[1].layers[other]
    whole = file_of(layer, INDEX).read_bytes()
    shutil.copy(file_of(stores[0].layers[one], INDEX), file_of(layer, INDEX))
    with pytest.raises(DamagedChunkError, match=r"baked for another place|does not unpack to a record"):
        layer.decode(INDEX, layer.read(INDEX) or b"")
    with caplog.at_level(logging.WARNING, "isogi.cache"):
        found = stores[1].load(INDEX)
    assert "it is baked again" in caplog.text
    assert not found.light.parts[other].samples.any()
    np.testing.assert_array_equal(found.light.parts[1 - other].samples, chunk.light.parts[1 - other].samples)
    stores[1].save(chunk)
    assert file_of(layer, INDEX).read_bytes() == whole
    assert_equal(stores[1].load(INDEX), chunk)
