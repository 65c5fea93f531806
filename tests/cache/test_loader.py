"""Loading: light in the store comes into memory once, and no damage or delay stops a frame; caches
of a scene.
"""

import hashlib
import itertools
import logging
import shutil
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import SPECS, BakeSpec
from isogi_core.bake.noise import Goal
from isogi_core.bake.refine import refine
from isogi_core.cache import scene_caches as loading
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.page_pool import PagePool
from isogi_core.cache.scene_caches import Caches, Loader, read_ahead
from isogi_core.errors import Cancelled, StoreAwayError, StoreError
from isogi_core.frame.tiles import Tiles
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from tests.cache.chunks import baked, file_of, spec_of
from tests.s3 import Call, S3Server

A, B, C = (0, 1, 1), (1, 1, 1), (2, 1, 1)


class Clock:
    """Seconds that pass when the test says so."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(loading, "time", clock)
    return clock


@pytest.fixture
def loader(tmp_path: Path, spec: BakeSpec, clock: Clock) -> Loader:
    return Loader(ChunkStore(tmp_path, spec), PagePool(spec, 1 << 22))


def bake(loader: Loader, index: Index, texels: int = 20, samples: int = 16) -> str:
    """Do as a worker does; the mark of what is stored."""
    chunk = loader.chunk_store.load(index).with_texels(np.arange(texels, dtype=np.int32))
    spec = loader.chunk_store.spec
    refine(
        chunk.light,
        spec.prepared.lattice.positions(index, chunk.offsets),
        spec,
        samples,
        Goal(1e-4),
    )
    loader.chunk_store.save(chunk)
    return mark(stored(loader, index))


def stored(loader: Loader, index: Index) -> np.ndarray:
    """Light in the store of those texels of a chunk that hold any."""
    light = loader.chunk_store.load(index).light
    return light.columns(loader.chunk_store.spec.terms)[~light.void]


def mark(light: np.ndarray) -> str:
    """What tells light from other light."""
    return hashlib.sha256(light.tobytes()).hexdigest()


def transfer(loader: Loader, index: Index) -> np.ndarray | None:
    """What a frame would read of a chunk."""
    with loader.pool.hold([index]) as (slots, _):
        rows = loader.pool.table[slots[0]]
        if slots[0] >= 0:
            return loader.pool.transfer[rows[rows >= 0]].copy()
        return None


def brought(loader: Loader, *chunks: Index) -> tuple[str, ...]:
    """Marks of the chunks' light in memory after they were asked for together, "" where there is
    none.
    """
    loader.ensure(chunks)
    found = (transfer(loader, index) for index in chunks)
    return tuple("" if light is None else mark(light) for light in found)


def test_light_comes_from_the_store(loader: Loader) -> None:
    marks = bake(loader, A), bake(loader, B)
    assert brought(loader, A, C, B) == (marks[0], "", marks[1])
    np.testing.assert_array_equal(transfer(loader, B), stored(loader, B))
    assert transfer(loader, C) is None


def test_what_is_in_memory_is_not_read_again(
    loader: Loader, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = bake(loader, A)
    loader.ensure([A])
    monkeypatch.setattr(
        loader.chunk_store, "read", lambda index: pytest.fail("the store was asked")
    )
    assert brought(loader, A) == (light,)


def test_an_absent_chunk_is_asked_for_again_after_a_while(loader: Loader, clock: Clock) -> None:
    assert brought(loader, A) == ("",)
    light = bake(loader, A)
    clock.now += 0.5
    assert brought(loader, A) == ("",)
    clock.now += 1.5
    assert brought(loader, A) == (light,)


def test_new_light_is_read_after_refresh(loader: Loader) -> None:
    assert brought(loader, A) == ("",)
    first = bake(loader, A)
    loader.refresh(A)
    assert brought(loader, A) == (first,)
    second = bake(loader, A, samples=64)
    assert brought(loader, A) == (first,)
    loader.refresh(A)
    assert brought(loader, A) == (second,)
    assert second != first
    np.testing.assert_array_equal(transfer(loader, A), stored(loader, A))


@pytest.mark.parametrize("begun", [False, True])
def test_light_that_comes_while_older_is_read_is_read_next(
    begun: bool, loader: Loader, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker writes, and tells so, between the reading of what was there, or of nothing, and its
    use.
    """
    first = bake(loader, A) if begun else ""
    read = loader.chunk_store.objects
    newest = list[str]()

    def objects(index: Index) -> Any:
        found = read(index)
        if not newest:
            newest.append(bake(loader, A, samples=64))
            loader.refresh(A)
        return found

    monkeypatch.setattr(loader.chunk_store, "objects", objects)
    assert brought(loader, A, B) == (first, "")
    assert brought(loader, A, B) == (newest[0], "")


def test_light_that_comes_as_a_call_begins_is_read_next(
    loader: Loader, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the look at what is unwritten and its use, there is newer light."""
    older, newer = (baked(loader.chunk_store.spec, A, samples=samples) for samples in (16, 64))
    layers = (True,) * len(loader.chunk_store.layers)
    fresh = loader.chunk_store.fresh
    fresh.put(older, layers)
    look = fresh.newer

    def overtaken(index: Index) -> Any:
        found = look(index)
        if found is older:
            fresh.put(newer, layers)
            loader.refresh(A)
        return found

    monkeypatch.setattr(fresh, "newer", overtaken)
    first = brought(loader, A)
    assert brought(loader, A) != first
    assert loader.pool.missing([A]) == []


def test_damage_counts_as_absence_and_is_logged(
    loader: Loader, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    light = bake(loader, A)
    paths = [file_of(layer, A) for layer in loader.chunk_store.layers]
    whole = [path.read_bytes() for path in paths]
    for path in paths:
        path.write_bytes(path.read_bytes()[:-1])
    with caplog.at_level(logging.WARNING, "isogi.cache"):
        assert brought(loader, A) == ("",)
        clock.now += 2.0
        assert brought(loader, A) == ("",)
    assert loader.chunk_store.damaged == 4, "it is read anew"
    assert caplog.text.count("checksum") == 2, "and told once"
    assert transfer(loader, A) is None
    assert bake(loader, A) == light
    loader.refresh(A)
    assert brought(loader, A) == (light,)
    assert [path.read_bytes() for path in paths] == whole


def test_deleted_layers_read_as_absent_and_never_as_zeros(loader: Loader) -> None:
    kept = bake(loader, A)
    loader.ensure([A])
    for layer in loader.chunk_store.layers:
        shutil.rmtree(layer.path)
    assert brought(loader, A, B) == (kept, "")
    assert transfer(loader, B) is None
    assert bake(loader, B)
    loader.refresh(B)
    loader.refresh(A)
    loader.ensure([A, B])
    assert loader.pool.missing([A, B]) == [A], (
        "what is in memory is shown, and known to be outdated"
    )
    np.testing.assert_array_equal(transfer(loader, B), stored(loader, B))


def test_of_a_remote_store_many_chunks_are_on_their_way_at_once(
    s3: S3Server, spec: BakeSpec
) -> None:
    """And go into the pool as those of a folder do: all there are, in order; absent ones are asked
    for later.
    """
    loader = Loader(ChunkStore(s3.url, spec), PagePool(spec, 1 << 22))
    marks = {index: bake(loader, index) for index in (A, B, C)}
    together = threading.Barrier(4, timeout=60.0)
    missing = (2, 2, 2)

    chunks = itertools.count()

    def meet(call: Call) -> None:
        if "/c/" in call.key and next(chunks) < together.parties:
            together.wait()

    s3.fault = meet  # type: ignore[assignment]
    assert brought(loader, A, missing, B, C) == (marks[A], "", marks[B], marks[C])
    asked = len(s3.calls)
    s3.fault = lambda call: None
    assert brought(loader, A, missing, B, C) == (marks[A], "", marks[B], marks[C])
    assert len(s3.calls) == asked


def test_a_remote_store_that_fails_half_way_is_an_error(s3: S3Server, spec: BakeSpec) -> None:
    clock = Clock()
    store = Store(StoreUrl(s3.url, retries=0), clock=clock.monotonic)
    loader = Loader(ChunkStore(store, spec), PagePool(spec, 1 << 22))
    for index in (A, B, C):
        bake(loader, index)
    begun = len(s3.calls)
    s3.fault = lambda call: 500 if call.number > begun + 3 else None
    with pytest.raises(StoreAwayError, match="500"):
        loader.ensure([A, B, C])
    s3.fault = lambda call: None
    deadline = time.monotonic() + 30.0
    while loader.pool.missing([A, B, C]):
        assert time.monotonic() < deadline
        clock.now += 2.0
        with suppress(StoreAwayError):  # what was on its way still tells of the fault
            loader.ensure([A, B, C])


def test_damage_among_many_chunks_is_logged_and_others_load(
    loader: Loader, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    marks = {index: bake(loader, index) for index in (A, B, C)}
    file_of(loader.chunk_store.layers[0], B).write_bytes(b"something else")
    file_of(loader.chunk_store.layers[1], B).unlink()
    with caplog.at_level(logging.WARNING, "isogi.cache"):
        assert brought(loader, A, B, C) == (marks[A], "", marks[C])
    assert caplog.text.count("checksum") == 1 and loader.chunk_store.damaged == 1


def test_a_view_that_is_given_up_has_no_more_brought_for_it() -> None:
    """What is under way is finished, what waits is not begun: nobody asks any more."""
    begun: list[int] = []
    go_on = threading.Event()

    def work(item: int) -> int:
        begun.append(item)
        assert item == 0 or go_on.wait(60.0)
        return 2 * item

    with ThreadPoolExecutor(2) as hands:
        found = read_ahead(hands, work, range(100))
        assert next(found) == 0
        found.close()
        go_on.set()
    assert len(begun) <= 3, "the first, and one more for each hand"
    with ThreadPoolExecutor(2) as hands:
        assert list(read_ahead(hands, lambda item: 3 * item, range(100))) == list(range(0, 300, 3))


def test_a_frame_that_nobody_waits_for_stops_loading(
    loader: Loader, monkeypatch: pytest.MonkeyPatch
) -> None:
    marks = [bake(loader, index) for index in (A, B, C)]
    monkeypatch.setattr(loading, "BATCH_BYTES", 1)
    cancelled = threading.Event()
    insert = loader.pool.insert

    def insert_and_leave(*args: Any) -> None:
        insert(*args)
        cancelled.set()

    monkeypatch.setattr(loader.pool, "insert", insert_and_leave)
    with pytest.raises(Cancelled):
        loader.ensure([A, B, C], Tiles(1).cancelled_by(cancelled).check)
    assert loader.pool.missing([A, B, C]) == [B, C]
    assert list(brought(loader, A, B, C)) == marks


def test_no_more_than_a_few_batches_wait_in_memory() -> None:
    begun = 0
    ahead = list[int]()

    def items() -> Iterator[int]:
        nonlocal begun
        for item in range(400):
            begun += 1
            yield item

    with ThreadPoolExecutor(2) as hands:
        found = read_ahead(hands, lambda item: item, items())  # type: ignore[arg-type]
        for done, item in enumerate(found):
            assert item == done
            ahead.append(begun - done)
    assert len(ahead) == 400 and 16 <= max(ahead) <= 64


def test_a_view_that_does_not_fit_the_memory_is_an_error(
    tmp_path: Path, spec: BakeSpec, clock: Clock
) -> None:
    small = Loader(ChunkStore(tmp_path, spec), PagePool(spec, 0))
    bake(small, A, texels=40)
    bake(small, B, texels=40)
    assert all(brought(small, A))
    assert all(brought(small, B))
    with pytest.raises(StoreError, match="does not fit"):
        small.ensure([A, B])


# --- caches of a scene
# ------------------------------------------------------------------------------------------------


BUDGET = 1 << 22


def folders(store: Path) -> set[str]:
    """The layers that were opened."""
    return {path.parent.name for path in store.glob("*/zarr.json")}


def test_nothing_is_opened_before_it_is_read(tmp_path: Path) -> None:
    spec = spec_of()
    caches = Caches(spec.prepared, tmp_path / "light", BUDGET)
    assert not (tmp_path / "light").exists()
    digests = [spec.prepared.scene.layer_digest(layer) for layer in spec.plan.layers]
    caches.of("vicinity")
    assert folders(tmp_path / "light") == {digests[0]}
    caches.of("gi")
    assert folders(tmp_path / "light") == set(digests)


def test_each_spec_is_opened_once_with_a_pool_of_its_own(tmp_path: Path) -> None:
    caches = Caches(spec_of().prepared, tmp_path, BUDGET)
    with ThreadPoolExecutor(8) as threads:
        loaders = set(threads.map(caches.of, ["gi", "vicinity"] * 8))
    assert len(loaders) == 2
    assert caches.of("gi") is caches.of("gi") is not caches.of("vicinity")
    assert {loader.pool.spec.plan.representation for loader in loaders} == {"transfer", "vicinity"}
    assert all(loader.chunk_store.spec is loader.pool.spec for loader in loaders)


def test_specs_share_memory_by_equal_numbers_of_texels(tmp_path: Path) -> None:
    caches = Caches(spec_of().prepared, tmp_path, BUDGET)
    pools = [caches.of(name).pool for name in SPECS]
    sizes = [
        sum(a.nbytes for a in (p.transfer, p.scatter, p.error, p.stamp, p.table)) for p in pools
    ]
    assert 0.95 * BUDGET < sum(sizes) <= BUDGET
    rows = [len(pool.scatter) for pool in pools]
    assert max(rows) - min(rows) <= 64, "but for a page"


def test_projected_light_of_two_isovalues_stays_in_memory(tmp_path: Path) -> None:
    prepared = spec_of().prepared
    caches = Caches(prepared, tmp_path, BUDGET)
    shown = prepared.scene.isovalue
    one, two, three = (prepared.surface(share * shown).isovalue for share in (0.9, 1.0, 1.1))
    first, second = caches.projected(one), caches.projected(two)
    assert caches.projected(one) is first is not second
    caches.projected(three)
    assert caches.projected(one) is first
    assert caches.projected(two) is not second, "it was shown longest ago"


def test_all_scenes_of_a_store_share_its_threads(s3: S3Server) -> None:
    """Each cut, light and material of a scene has a loader of its own."""
    before = set(threading.enumerate())  # other tests' stores may still be there
    store = Store(s3.url)
    specs = [spec_of(albedo=albedo) for albedo in (0.3, 0.5, 0.7)]
    for spec in specs:
        chunk_store = ChunkStore(store, spec)
        for index in (A, B, C):
            chunk_store.save(baked(spec, index))
    for spec in specs:
        caches = Caches(spec.prepared, store, BUDGET)
        for name in SPECS:
            caches.of(name).ensure([*np.ndindex(3, 3, 3)])
    names = [each.name for each in set(threading.enumerate()) - before]
    assert 0 < sum(name.startswith("loader") for name in names) <= 32


def test_a_place_that_cannot_be_opened_is_an_error_each_time(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    caches = Caches(spec_of().prepared, tmp_path / "file", BUDGET)
    for _ in range(2):
        with pytest.raises(StoreError, match="Cannot"):
            caches.of("gi")
