"""Light that is newer than the store: what frames see of it, and when it is written."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.cache.chunk_record import Chunk
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.fresh_light import FreshLight, fresh_light
from isogi_core.cache.page_pool import PagePool
from isogi_core.cache.scene_caches import Loader
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.store import Store
from tests.cache.chunks import baked

A, B = (0, 1, 1), (1, 1, 1)
BOTH = (True, True)
FEW = np.arange(5, dtype=np.int32)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def light(clock: Clock) -> FreshLight:
    return FreshLight(clock)


def some_of(chunk: Chunk, offsets: np.ndarray) -> Chunk:
    rows = chunk.rows_of(offsets)
    return Chunk(chunk.index, offsets, chunk.light.rows(rows))


def same_light(one: Chunk, other: Chunk) -> bool:
    """Whether two chunks have the same texels with the same light."""
    pairs = zip(one.light.parts, other.light.parts, strict=True)
    return np.array_equal(one.offsets, other.offsets) and all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for a, b in pairs
        for name in ("samples", "noise", "coefficients")
    )


def indices(light: FreshLight, *open_now: Index) -> list[Index]:
    """The chunks that are due."""
    return [each.chunk.index for each in light.due({*open_now}.__contains__)]


def test_light_of_some_texels_joins_the_rest(spec: BakeSpec, light: FreshLight) -> None:
    """A chunk that somebody reads meanwhile stays as it was."""
    first, later = baked(spec, A, samples=16), baked(spec, A, samples=64)
    light.put(first, BOTH)
    read = light.newer(A)
    light.put(some_of(later, FEW), BOTH)
    now = light.newer(A)
    assert read is not None and now is not None
    assert same_light(read, first) and not same_light(now, first)
    assert same_light(some_of(now, FEW), some_of(later, FEW))
    assert same_light(some_of(now, first.offsets[5:]), some_of(first, first.offsets[5:]))
    sent = light.some(A, np.append(FEW, np.int32(4000)))
    assert sent is not None and same_light(sent, some_of(later, FEW))
    assert light.some(B, FEW) is None and light.newer(B) is None


def test_light_is_written_once_it_rests_or_has_waited(
    spec: BakeSpec, light: FreshLight, clock: Clock
) -> None:
    light.put(baked(spec, A), BOTH)
    light.put(baked(spec, B), (True, False))
    assert indices(light) == []
    clock.now += 0.4
    assert indices(light) == [], "more may come at once"
    clock.now += 1.6
    assert indices(light, A) == [B], "more of the other is asked for"
    light.put(baked(spec, B, samples=64), BOTH)
    assert indices(light, A) == []
    clock.now += 6.0
    assert indices(light, A, B) == [A, B], "light that came later waits no longer for that"
    assert [each.changed for each in light.unwritten()] == [BOTH, BOTH]


def test_light_that_comes_while_it_is_written_is_written_too(
    spec: BakeSpec, light: FreshLight, clock: Clock
) -> None:
    light.put(baked(spec, A), BOTH)
    (before,) = light.unwritten()
    light.put(baked(spec, A, samples=64), BOTH)
    light.written(before)
    (after,) = light.unwritten()
    light.written(after)
    assert light.unwritten() == [] and light.newer(A) is None
    assert light.some(A, FEW) is not None, "the next task need not read it"
    clock.now += 5.0
    light.sweep(lambda _: False)
    assert len(light) == 1, "a task may follow"
    clock.now += 15.0
    light.sweep(lambda index: index == A)
    assert len(light) == 1, "a task is at it"
    light.sweep(lambda _: False)
    assert len(light) == 0


def shown_by(loader: Loader, index: Index) -> bytes:
    """What a frame reads of a chunk."""
    loader.ensure([index])
    with loader.pool.hold([index]) as held:
        rows = loader.pool.table[held.slots[0]]
        lit = rows[rows >= 0]
        arrays = (rows < 0, *(each[lit] for each in loader.pool.rows))
        return b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)


@pytest.mark.parametrize("make", [baked])
def test_frames_read_the_same_from_memory_and_store(
    spec: BakeSpec, tmp_path: Path, make: Callable[..., Chunk]
) -> None:
    chunk = make(spec, A, samples=64)
    stored, kept = (ChunkStore(Store(tmp_path / name), spec) for name in ("stored", "kept"))
    stored.save(chunk)
    fresh = fresh_light(kept.store, spec.digest)
    fresh.put(chunk, BOTH)
    loaders = [Loader(each, PagePool(spec, 1 << 22)) for each in (stored, kept)]
    assert shown_by(loaders[0], A) == shown_by(loaders[1], A)
    assert kept.made and kept.read(A) is chunk
    assert fresh is kept.fresh is fresh_light(kept.store, spec.digest)
    assert [layer.read(A) for layer in kept.layers] == [None, None]


def test_newer_light_replaces_what_was_read(spec: BakeSpec, tmp_path: Path) -> None:
    store = ChunkStore(Store(tmp_path), spec)
    store.save(baked(spec, A, samples=16))
    loader = Loader(store, PagePool(spec, 1 << 22))
    before = shown_by(loader, A)
    store.fresh.put(baked(spec, A, samples=64), BOTH)
    loader.refresh(A)
    assert shown_by(loader, A) != before
    (fresh,) = store.fresh.unwritten()
    store.save(fresh.chunk, fresh.changed)
    in_memory = shown_by(loader, A)
    store.fresh.written(fresh)
    loader.refresh(A)
    assert shown_by(loader, A) == in_memory
