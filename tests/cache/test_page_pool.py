"""The page pool: chunks that come and go among readers, and rows of light against plain NumPy."""

import threading
from bisect import bisect_left
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import (
    deviations,
    path_deviation,
    relative_error,
    scatter,
    standard_error,
)
from isogi_core.bake.texel_light import VOID, Light
from isogi_core.cache.chunk_record import Chunk, Chunks
from isogi_core.cache.page_pool import PagePool, fewest_samples, fill_rows, new_rows
from isogi_core.errors import StoreError
from isogi_core.kernels.shading.lattice import BURIED_ROW, UNLIT_ROW, VOID_ROW
from isogi_core.kernels.shading.texel_table import Rows
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.plan.scene import CHUNK_SIDES
from isogi_core.prepared.prepared_scene import Index
from tests.bake.texels import plan_of
from tests.bake.texels import spec_of as look_of
from tests.cache.chunks import CONSTANT, TEXELS, spec_of


def chunk_of(spec: BakeSpec, index: Index, level: float, texels: int = 192) -> Chunks:
    """A chunk alone whose every number is ``level``, but for the 16 samples of each texel and
    layer.
    """
    offsets = np.sort(np.random.default_rng(int(level)).choice(TEXELS, texels, replace=False))
    chunk = Chunk.empty(index, spec.plan).with_texels(offsets)
    for part in chunk.light.parts:
        part.samples[:] = 16
        part.noise[:] = level
        part.coefficients[:] = level
    return Chunks.of_one(chunk)


def empty(spec: BakeSpec, index: Index) -> Chunks:
    """A chunk alone in which nothing is baked."""
    return Chunks.of_one(Chunk.empty(index, spec.plan))


def pool_of(spec: BakeSpec, texels: int) -> PagePool:
    """A pool with room for so many texels: whole pages, as those of all chunks here."""
    budgets = range(0, 1 << 24, 1024)
    enough = bisect_left(budgets, texels, key=lambda n: len(PagePool(spec, n).stamp))
    pool = PagePool(spec, budgets[enough])
    assert len(pool.stamp) == texels
    return pool


def rows_of(pool: PagePool, slot: int) -> np.ndarray:
    rows = pool.table[slot]
    return rows[rows >= 0]


def levels(pool: PagePool, slot: int) -> set[float]:
    """The different levels that a reader of a slot finds."""
    return {*pool.transfer[rows_of(pool, slot)].ravel().tolist()}


def test_the_table_leads_each_texel_to_its_light(spec: BakeSpec) -> None:
    pool = PagePool(spec, 1 << 22)
    chunk = chunk_of(spec, (1, 0, 2), 1.0, texels=150)
    rng = np.random.default_rng(0)
    for part in chunk.light.parts:
        part.noise[:] = rng.random(part.noise.shape)
        part.coefficients[:] = rng.random(part.coefficients.shape)
        part.samples[[3, 77]] = VOID
    for part in chunk.light.parts:
        part.samples[50] = 64
        part.coefficients[50] = 0.0
    pool.insert(chunk)
    with pool.hold([(1, 0, 2)]) as (slots, _):
        table = pool.table[slots[0]]
        assert (table[np.setdiff1d(np.arange(TEXELS), chunk.offsets)] == UNLIT_ROW).all()
        assert table[chunk.offsets[[3, 50, 77]]].tolist() == [VOID_ROW, BURIED_ROW, VOID_ROW]
        lit = np.setdiff1d(np.arange(150), [3, 50, 77])
        rows = table[chunk.offsets[lit]]
        assert len(set(rows.tolist())) == 147
        np.testing.assert_array_equal(pool.transfer[rows], chunk.light.columns(spec.terms)[lit])
        noise = np.sqrt((deviations(chunk.light, spec) ** 2).sum(axis=0))
        scatter = noise[lit] / path_deviation(chunk.light, spec)[lit]
        np.testing.assert_allclose(pool.scatter[rows], scatter, rtol=1e-6)
        np.testing.assert_allclose(
            pool.error[rows], relative_error(chunk.light, spec)[lit], rtol=1e-6
        )
        assert (fewest_samples(pool.stamp[rows], 2) == 16).all()


@pytest.mark.parametrize(
    ("settings", "shape"),
    [
        ({}, (1, 8)),
        ({"albedo": [0.1, 0.2, 0.3]}, (3, 8)),
        ({"lights": [CONSTANT]}, (1, 1)),
        ({"shading": "vicinity"}, (1, 1)),
        ({"lobes": 1}, (1, 8)),
        ({"lobes": 1, "order": 3, "albedo": [0.1, 0.2, 0.3]}, (3, 13)),
    ],
)
def test_a_pool_keeps_what_frames_of_its_spec_read_alone(
    settings: dict[str, Any], shape: tuple[int, int]
) -> None:
    """Vicinity shading reads band 0 alone, out of a layer that has more; layers stand side by
    side.
    """
    spec = spec_of(**settings)
    pool = PagePool(spec, 1 << 22)
    chunk = chunk_of(spec, (0, 0, 0), 1.0, texels=20)
    for part in chunk.light.parts:
        part.coefficients[:] = np.random.default_rng(1).random(part.coefficients.shape)
    pool.insert(chunk)
    assert pool.transfer.shape[1:] == shape
    with pool.hold([(0, 0, 0)]) as (slots, _):
        np.testing.assert_array_equal(
            pool.transfer[rows_of(pool, slots[0])], chunk.light.columns(spec.terms)
        )


def test_an_absent_chunk_has_no_slot_and_an_empty_one_is_unlit(spec: BakeSpec) -> None:
    pool = PagePool(spec, 1 << 22)
    pool.insert(empty(spec, (0, 0, 1)))
    with pool.hold([(0, 0, 0), (0, 0, 1)]) as (slots, _):
        assert slots.dtype == np.int32 and slots[0] == -1
        assert (pool.table[slots[1]] == UNLIT_ROW).all()


@pytest.mark.parametrize("order", [2, 5])
@pytest.mark.parametrize("chunk", CHUNK_SIDES)
@pytest.mark.parametrize("budget", [1 << 21, 10_000_000, 1 << 26])
def test_the_arrays_stay_within_the_budget(order: int, chunk: int, budget: int) -> None:
    pool = PagePool(spec_of(order=order, lattice=0.25, chunk=chunk), budget)
    arrays = (pool.transfer, pool.scatter, pool.error, pool.stamp, pool.table)
    assert 0.9 * budget < sum(array.nbytes for array in arrays) <= budget


def test_absent_and_outdated_chunks_are_missing(spec: BakeSpec) -> None:
    pool = PagePool(spec, 1 << 22)
    assert pool.missing([(0, 0, 0)])
    pool.outdate((0, 0, 0))
    pool.insert(chunk_of(spec, (0, 0, 0), 1.0))
    assert not pool.missing([(0, 0, 0)])
    pool.outdate((0, 0, 0))
    assert pool.missing([(0, 0, 0)])
    with pool.hold([(0, 0, 0)]) as (slots, _):
        assert levels(pool, slots[0]) == {1.0}
    pool.insert(chunk_of(spec, (0, 0, 0), 2.0))
    assert not pool.missing([(0, 0, 0)])
    with pool.hold([(0, 0, 0)]) as (slots, _):
        assert levels(pool, slots[0]) == {2.0}


def test_pages_are_filled_upwards_also_when_they_are_used_again(spec: BakeSpec) -> None:
    pool = PagePool(spec, 1 << 22)
    for level in range(5):
        pool.insert(chunk_of(spec, (0, 0, 0), level))
        pool.insert(chunk_of(spec, (0, 0, 1), level))
        with pool.hold([(0, 0, 0), (0, 0, 1)]) as (slots, _):
            assert all((np.diff(rows_of(pool, slot)) == 1).all() for slot in slots)


def test_the_longest_unused_chunk_makes_room(spec: BakeSpec) -> None:
    pool = pool_of(spec, 576)
    for i in range(3):
        pool.insert(chunk_of(spec, (0, 0, i), i))
    with pool.hold([(0, 0, 0)]):
        pass
    pool.insert(chunk_of(spec, (1, 1, 1), 9.0))
    assert pool.missing([(0, 0, i) for i in range(3)]) == [(0, 0, 1)]


def test_few_slots_are_shared_too(spec: BakeSpec) -> None:
    pool = pool_of(spec, 576)
    slots = len(pool.table)
    assert 4 <= slots <= 16, "small as the memory is"
    for i in range(slots + 1):
        pool.insert(empty(spec, (0, 0, i)))
    assert pool.missing([(0, 0, 0)])
    assert not pool.missing([(0, 0, i) for i in range(1, slots + 1)])


def test_held_chunks_are_not_evicted(spec: BakeSpec) -> None:
    pool = pool_of(spec, 576)
    for i in range(3):
        pool.insert(chunk_of(spec, (0, 0, i), i))
    with pool.hold([(0, 0, 0), (0, 0, 2)]) as (slots, _):
        for i in range(3, 8):
            pool.insert(chunk_of(spec, (0, 0, i), i))
        assert levels(pool, slots[0]) == {0.0}
        assert levels(pool, slots[1]) == {2.0}
        assert not pool.missing([(0, 0, 0)])
    assert pool.missing([(0, 0, 1)])


def test_holding_pins_the_rows_while_newer_versions_come(spec: BakeSpec) -> None:
    pool = pool_of(spec, 576)
    pool.insert(chunk_of(spec, (0, 0, 0), 1.0))
    with pool.hold([(0, 0, 0)]) as (first, _):
        rows = rows_of(pool, first[0])
        for level in range(2, 20):
            pool.insert(chunk_of(spec, (0, 0, 0), level))
        assert levels(pool, first[0]) == {1.0}
        np.testing.assert_array_equal(rows_of(pool, first[0]), rows)
        with pool.hold([(0, 0, 0)]) as (second, _):
            assert levels(pool, second[0]) == {19.0}
    pool.insert(chunk_of(spec, (1, 1, 1), 5.0, texels=384))
    assert not pool.missing([(0, 0, 0)])


def test_held_twice_is_freed_once(spec: BakeSpec) -> None:
    pool = pool_of(spec, 256)
    pool.insert(chunk_of(spec, (0, 0, 0), 1.0, texels=128))
    with pool.hold([(0, 0, 0)]) as (outer, _):
        with pool.hold([(0, 0, 0)]):
            pool.insert(chunk_of(spec, (0, 0, 0), 2.0, texels=128))
        with pytest.raises(StoreError):
            pool.insert(chunk_of(spec, (1, 0, 0), 3.0, texels=256))
        assert levels(pool, outer[0]) == {1.0}
    pool.insert(chunk_of(spec, (1, 0, 0), 4.0, texels=256))
    assert not pool.missing([(1, 0, 0)])


def test_a_view_that_cannot_fit_is_an_error(spec: BakeSpec) -> None:
    pool = pool_of(spec, 384)
    wanted: list[Index] = [(0, 0, 0), (0, 0, 1), (0, 0, 2)]
    pool.insert(chunk_of(spec, (2, 2, 2), 7.0))
    pool.insert(chunk_of(spec, wanted[0], 1.0), wanted)
    pool.insert(chunk_of(spec, wanted[1], 2.0), wanted)
    assert pool.missing([(2, 2, 2)])
    with pytest.raises(
        StoreError,
        match=r"does not fit the memory for 384 texels: ask for .* or give light more memory\.$",
    ):
        pool.insert(chunk_of(spec, wanted[2], 3.0), wanted)
    assert pool.missing(wanted) == [wanted[2]]
    pool.insert(chunk_of(spec, wanted[1], 4.0), wanted)
    assert not pool.missing([wanted[1]])


def test_a_chunk_that_cannot_fit_drops_nothing(spec: BakeSpec) -> None:
    pool = pool_of(spec, 384)
    spare: list[Index] = [(0, 0, 0), (0, 0, 1)]
    for index in spare:
        pool.insert(chunk_of(spec, index, 1.0, texels=64))
    with pytest.raises(StoreError):
        pool.insert(chunk_of(spec, (1, 1, 1), 2.0, texels=448))
    assert not pool.missing(spare)


def test_readers_among_writers_see_whole_versions(spec: BakeSpec) -> None:
    pool = pool_of(spec, 4096)
    indices: list[Index] = [(0, 0, i) for i in range(6)]
    versions = [chunk_of(spec, (0, 0, 0), level, texels=64) for level in range(1, 9)]
    wrong: list[set[float]] = []
    seen: set[float] = set()
    stop = threading.Event()

    def write(seed: int) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(400):
            chunk = versions[rng.integers(len(versions))]
            pool.insert(replace(chunk, indices=(indices[rng.integers(6)],)))

    def read(seed: int) -> None:
        rng = np.random.default_rng(seed)
        while not stop.is_set():
            with pool.hold([indices[i] for i in rng.permutation(6)[:3]]) as (slots, _):
                for slot in slots[slots >= 0]:
                    found = levels(pool, slot) | levels(pool, slot)
                    if len(found) != 1 or len(rows_of(pool, slot)) != 64:
                        wrong.append(found)
                    seen.update(found)

    readers = [threading.Thread(target=read, args=(10 + i,)) for i in range(3)]
    writers = [threading.Thread(target=write, args=(i,)) for i in range(2)]
    for thread in (*readers, *writers):
        thread.start()
    for thread in writers:
        thread.join()
    stop.set()
    for thread in readers:
        thread.join()
    assert not wrong
    assert len(seen) > 1
    with ExitStack() as held:
        pool.insert(chunk_of(spec, (1, 1, 1), 3.0, texels=TEXELS))  # all pages are free again
        held.enter_context(pool.hold([(1, 1, 1)]))
        with pytest.raises(StoreError):
            pool.insert(versions[0])


def test_the_age_tells_when_what_was_looked_up_may_have_changed(spec: BakeSpec) -> None:
    pool = PagePool(spec, 1 << 22)
    index = (0, 0, 0)
    assert pool.missing([index]) == [index]
    ages = []
    for changed in (True, False, True):
        if changed:
            pool.insert(empty(spec, index))
        with pool.hold([index]) as held:
            ages.append(held.age)
    assert ages[0] == ages[1] < ages[2]
    assert pool.missing([index, (0, 0, 1)]) == [(0, 0, 1)]
    pool.outdate(index)
    assert pool.missing([index]) == [index]


def test_a_pool_that_is_made_anew_has_no_age_of_the_former(spec: BakeSpec) -> None:
    """Pictures are kept by ages: light of a pool that was dropped may have grown meanwhile."""
    ages = []
    for _ in range(2):
        pool = PagePool(spec, 1 << 22)
        ages.append(pool.age)
        pool.insert(empty(spec, (0, 0, 0)))
        ages.append(pool.age)
    assert len({*ages}) == len(ages)


# --- rows
# --------------------------------------------------------------------------------------------------


PLANS = (
    plan_of(Layer("direct", 3), Layer("indirect", 2, 3, half=False)),
    plan_of(Layer("direct", 6, coarse=3), Layer("indirect", 2)),
    plan_of(Layer("indirect", 2), Layer("direct", 4)),
    plan_of(Layer("whole", 2, 3)),
    plan_of(Layer("whole"), representation="constant"),
    plan_of(Layer("irradiance", channels=3), representation="irradiance"),
    ScenePlan("vicinity", (Layer("direct", 3),), 1, 0, 1.0, 4096),
    replace(plan_of(Layer("direct", 3), Layer("indirect", 5)), lobes=1),
    replace(plan_of(Layer("indirect", 2, 3), Layer("direct", 4)), lobes=1),
    plan_of(Layer("direct", 3), Layer("indirect", 2, 3, nodes=(0.4, 0.7, 0.9))),
    replace(plan_of(Layer("direct", 2), Layer("indirect", 4, 2, nodes=(0.5, 0.8))), lobes=1),
)
LOOKS = [look_of(plan) for plan in PLANS]
SPEC = LOOKS[0]
THREE = look_of(plan_of(Layer("direct", 2), Layer("indirect", 2), Layer("whole")))


def light_of(samples: list[list[int]], spec: BakeSpec = SPEC) -> Light:
    """Light with these samples, a list for each part, that is dark all over."""
    light = Light.dark(spec.plan, len(samples[0]))
    for part, own in zip(light.parts, samples, strict=True):
        part.samples[:] = own
    return light


def random_light(spec: BakeSpec, texels: int) -> Light:
    """Light of every kind of texel: void, without samples or with few in any part, and dark in
    any.
    """
    rng = np.random.default_rng(7)
    light = Light.dark(spec.plan, texels)
    for part in light.parts:
        part.samples[:] = rng.choice([VOID, 0, 16, 32, 64, 512], texels)
        part.noise[:] = rng.random(part.noise.shape) ** 4
        part.coefficients[:] = rng.normal(size=part.coefficients.shape) * 0.1
        part.coefficients[:, :, 0] = rng.random(part.coefficients.shape[:2])
        part.coefficients[rng.random(texels) < 0.5] = 0.0
    return light


def filled(light: Light, spec: BakeSpec = SPEC) -> tuple[Rows, np.ndarray]:
    """The rows of texels' light, and where each is looked up."""
    rows = new_rows(spec, len(light))
    return rows, fill_rows(rows, np.arange(len(light), dtype=np.int32), light, spec)


def places_of(light: Light) -> np.ndarray:
    """Where each texel is looked up, in NumPy."""
    none = np.array([~part.coefficients.any(axis=(1, 2)) for part in light.parts])
    straight = np.array([part.layer.kind != "indirect" for part in light.parts])
    unlit = (none & [part.samples == 0 for part in light.parts])[straight].any(axis=0)
    dark = none.all(axis=0) & all(part.layer.kind != "irradiance" for part in light.parts)
    buried = np.where(dark & (light.samples >= 64), BURIED_ROW, np.arange(len(light)))
    return np.where(light.void, VOID_ROW, np.where(unlit, UNLIT_ROW, buried))


@pytest.mark.parametrize("spec", LOOKS, ids=[f"{plan.layers}{plan.lobes}" for plan in PLANS])
def test_rows_are_what_numpy_makes_of_the_light(spec: BakeSpec) -> None:
    light = random_light(spec, 2000)
    rows, places = filled(light, spec)
    np.testing.assert_array_equal(rows.transfer, light.columns(spec.terms))
    np.testing.assert_allclose(rows.error, relative_error(light, spec), rtol=1e-6)
    np.testing.assert_allclose(
        rows.scatter, scatter(standard_error(light, spec), light, spec), rtol=2e-6
    )
    fewest = fewest_samples(rows.stamp, len(light.parts))
    np.testing.assert_array_equal(fewest, np.where(light.void, 0, light.samples))
    np.testing.assert_array_equal(places, places_of(light))
    assert {UNLIT_ROW, VOID_ROW} <= {*places.tolist()} and (places >= 0).any()


def test_only_the_given_rows_are_written() -> None:
    light = random_light(SPEC, 50)
    rows = new_rows(SPEC, 120)
    for column in rows:
        column[:] = -7.0
    numbers = np.random.default_rng(3).permutation(120)[:50].astype(np.int32)
    places = fill_rows(rows, numbers, light, SPEC)
    expected, lit = filled(light)
    others = np.setdiff1d(np.arange(120), numbers)
    for column, own in zip(rows, expected, strict=True):
        np.testing.assert_array_equal(column[numbers], own)
        assert (column[others] == -7.0).all()
    assert np.array_equal(places, np.where(lit >= 0, numbers, lit))


def test_no_texels_are_no_rows() -> None:
    rows, places = filled(Light.dark(SPEC.plan, 0))
    assert len(rows.transfer) == 0 and places.size == 0 and places.dtype == np.int32


# --- stamps
# --------------------------------------------------------------------------------------------------


def test_stamps_tell_any_two_states_of_a_texel_apart() -> None:
    ladder = [0, *(16 << level for level in range(27))]
    direct, indirect = np.array(list(product(ladder, repeat=2))).T
    stamps = filled(light_of([direct.tolist(), indirect.tolist()]))[0].stamp
    assert stamps.dtype == np.float32 and (stamps >= 0).all()
    assert len(set(stamps.tolist())) == len(ladder) ** 2
    assert np.array_equal(fewest_samples(stamps, 2), np.minimum(direct, indirect))


@pytest.mark.parametrize("spec", [SPEC, THREE], ids=["two parts", "three parts"])
def test_stamps_change_with_light_that_is_shown_without_samples(spec: BakeSpec) -> None:
    """Frames of an earlier plan's light, which may grow, must not pass for the same."""
    parts = len(spec.plan.layers)
    light = light_of([[0, 0, 0, 64], *[[64, 0, 0, 64]] * (parts - 1)], spec)
    dark = filled(light, spec)[0].stamp
    rng = np.random.default_rng(1)
    seen = [dark[:3]]
    for part in light.parts * 10:
        part.coefficients[:] = rng.normal(size=part.coefficients.shape).astype(np.float16)
        seen.append(filled(light, spec)[0].stamp[:3])
    assert (
        all((one != other).any() for one, other in pairwise(seen))
        and len(set(np.ravel(seen).tolist())) > 30
    )
    assert (
        np.array_equal(fewest_samples(seen[-1], parts), [0, 0, 0])
        and filled(light, spec)[0].stamp[3] == dark[3]
    )
    assert np.max(seen) < 2**24, "single floats count no further"


def test_texels_without_a_row_have_no_samples() -> None:
    marks = np.array([UNLIT_ROW, VOID_ROW, BURIED_ROW], np.float32)
    assert fewest_samples(marks, 2).tolist() == [0, 0, 0]


# --- texels without a row
# -----------------------------------------------------------------------------------------


def test_buried_are_texels_from_which_no_path_of_any_part_left() -> None:
    light = light_of(
        [
            [64, 64, 64, 64, 16, VOID, 256],
            [64, 64, 64, 0, 64, 0, 64],
        ]
    )
    light.parts[0].coefficients[1, 0, 0] = 1e-6
    light.parts[1].coefficients[2, 2, 0] = 1e-6
    assert filled(light)[1].tolist() == [BURIED_ROW, 1, 2, 3, 4, VOID_ROW, BURIED_ROW]


def test_dark_irradiance_is_not_buried() -> None:
    """Lights that do not move may leave a side of the surface black, which light would reach."""
    spec = look_of(plan_of(Layer("irradiance"), representation="irradiance"))
    assert filled(light_of([[64, VOID]], spec), spec)[1].tolist() == [0, VOID_ROW]


def test_reflected_light_alone_is_not_shown() -> None:
    """Direct light may be known of another layer, and then has no samples here."""
    light = light_of([[0, 0, 64, 64], [64, 64, 0, 64]])
    for part, lit in zip(light.parts, ([1, 2, 3], [0, 1, 3]), strict=True):
        part.coefficients[lit, 0, 0] = 0.5
    assert filled(light)[1].tolist() == [UNLIT_ROW, 1, 2, 3]
