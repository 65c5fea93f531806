import hashlib
import logging
import shutil
from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.look import Look
from isogi_core.bake.recipe import Index
from isogi_core.bake.refine import refine
from isogi_core.cache import loader as loading
from isogi_core.cache.loader import ASK_AGAIN, Loader
from isogi_core.cache.pages import PagePool
from isogi_core.cache.store import ChunkStore
from isogi_core.errors import StoreError
from tests.cache.chunks import file_of

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
def loader(tmp_path: Path, look: Look, clock: Clock) -> Loader:
    return Loader(ChunkStore(tmp_path, look), PagePool(look, 1 << 22))


def bake(loader: Loader, index: Index, texels: int = 20, samples: int = 16) -> str:
    """Do as a worker does; the mark of what is stored."""
    chunk = loader.store.load(index).with_texels(np.arange(texels, dtype=np.int32))
    refine(chunk.light, chunk.positions(chunk.offsets), loader.store.look, samples, 1e-4)
    loader.store.save(chunk)
    return mark(loader.store.load(index).light.transfer)


def mark(light: np.ndarray) -> str:
    """What tells light from other light."""
    return hashlib.sha256(light.tobytes()).hexdigest()


def transfer(loader: Loader, index: Index) -> np.ndarray | None:
    """What a frame would read of a chunk."""
    with loader.pool.hold([index]) as (slots, _):
        rows = loader.pool.table[slots[0]]
        return loader.pool.transfer[rows[rows >= 0]].copy() if slots[0] >= 0 else None


def brought(loader: Loader, *chunks: Index) -> tuple[str, ...]:
    """Marks of the chunks' light in memory after they were asked for together, "" where there is none."""
    loader.ensure(chunks)
    found = (transfer(loader, index) for index in chunks)
    return tuple("" if light is None else mark(light) for light in found)


def test_light_comes_from_the_store(loader: Loader) -> None:
    marks = bake(loader, A), bake(loader, B)
    assert brought(loader, A, C, B) == (marks[0], "", marks[1])
    chunk = loader.store.load(B)
    np.testing.assert_array_equal(transfer(loader, B), chunk.light.transfer)
    assert transfer(loader, C) is None


def test_what_is_in_memory_is_not_read_again(loader: Loader, monkeypatch: pytest.MonkeyPatch) -> None:
    light = bake(loader, A)
    loader.ensure([A])
    monkeypatch.setattr(loader.store, "read", lambda index: pytest.fail("the store was asked"))
    assert brought(loader, A) == (light,)


def test_an_absent_chunk_is_asked_for_again_after_a_while(loader: Loader, clock: Clock) -> None:
    assert brought(loader, A) == ("",)
    light = bake(loader, A)
    clock.now += ASK_AGAIN / 2
    assert brought(loader, A) == ("",)
    clock.now += ASK_AGAIN / 2
    assert brought(loader, A) == (light,)


def test_new_light_is_read_as_soon_as_it_is_told(loader: Loader) -> None:
    assert brought(loader, A) == ("",)
    first = bake(loader, A)
    loader.refresh(A)
    assert brought(loader, A) == (first,)
    second = bake(loader, A, samples=64)
    assert brought(loader, A) == (first,)
    loader.refresh(A)
    assert brought(loader, A) == (second,)
    assert second != first
    np.testing.assert_array_equal(transfer(loader, A), loader.store.load(A).light.transfer)


def test_damage_is_absence_and_is_told(loader: Loader, clock: Clock, caplog: pytest.LogCaptureFixture) -> None:
    light = bake(loader, A)
    paths = [file_of(layer, A) for layer in loader.store.layers]
    whole = [path.read_bytes() for path in paths]
    for path in paths:
        path.write_bytes(path.read_bytes()[:-1])
    with caplog.at_level(logging.WARNING, "isogi.cache"):
        assert brought(loader, A) == ("",)
    assert caplog.text.count("checksum") == 2
    assert transfer(loader, A) is None
    assert bake(loader, A) == light
    loader.refresh(A)
    assert brought(loader, A) == (light,)
    assert [path.read_bytes() for path in paths] == whole


def test_light_of_the_layers_that_are_there_is_shown(loader: Loader) -> None:
    bake(loader, A)
    file_of(loader.store.layers[1], A).unlink()
    loader.ensure([A])
    direct, indirect = loader.store.load(A).light.parts
    assert direct.coefficients.any() and not indirect.samples.any()
    np.testing.assert_array_equal(transfer(loader, A), direct.coefficients)


def test_a_chunk_under_another_name_is_absent(loader: Loader) -> None:
    bake(loader, A)
    bake(loader, C)
    for layer in loader.store.layers:
        shutil.copyfile(file_of(layer, C), file_of(layer, A))
    assert brought(loader, A) == ("",)
    assert transfer(loader, A) is None


def test_a_deleted_store_reads_as_absent_and_never_as_zeros(loader: Loader) -> None:
    kept = bake(loader, A)
    loader.ensure([A])
    shutil.rmtree(loader.store.layers[0].root)
    assert brought(loader, A, B) == (kept, "")
    assert transfer(loader, B) is None
    assert bake(loader, B)
    loader.refresh(B)
    loader.refresh(A)
    loader.ensure([A, B])
    assert loader.pool.missing([A, B]) == [A], "what is in memory is shown, and known to be outdated"
    np.testing.assert_array_equal(transfer(loader, B), loader.store.load(B).light.transfer)


def test_a_view_that_does_not_fit_the_memory_is_an_error(tmp_path: Path, look: Look, clock: Clock) -> None:
    small = Loader(ChunkStore(tmp_path, look), PagePool(look, 0))
    bake(small, A, texels=40)
    bake(small, B, texels=40)
    assert all(brought(small, A))
    assert all(brought(small, B))
    with pytest.raises(StoreError, match="does not fit"):
        small.ensure([A, B])


def test_a_store_that_cannot_be_read_is_an_error(loader: Loader) -> None:
    bake(loader, A)
    layer = loader.store.layers[1]
    Path(layer.path, "zarr.json").write_text("{")
    look = loader.store.look
    again = Loader(ChunkStore(layer.root, look), PagePool(look, 1 << 22))
    with pytest.raises(StoreError, match="move that folder away"):
        again.ensure([A])
