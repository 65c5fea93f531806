"""Light in memory: when it is written, and what becomes of it where it cannot be."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.texel_light import Light
from isogi_core.cache.chunk_record import Chunk
from isogi_core.cache.fresh_light import FreshLight
from isogi_core.errors import StoreAwayError
from isogi_core.prepared.prepared_scene import Index
from isogi_worker import writer as writing
from isogi_worker.errors import LostWorkerError
from isogi_worker.pool import WriteDone
from isogi_worker.tasks import BakeResult, BakeTask, WriteTask, Written, bake, open_spec, write_all
from isogi_worker.writer import LightWriter
from tests.worker.pools import SCENE, SPEC, TEXELS, tasks_for

INDEX = (0, 0, 0)
DONE = BakeResult(0, 0.0, *([None] * 2))  # type: ignore[arg-type]


class FakePool:
    """Writes nothing before the test says so."""

    def __init__(self) -> None:
        self.tasks: list[tuple[WriteTask, WriteDone]] = []

    def write(self, task: WriteTask, done: WriteDone) -> None:
        self.tasks.append((task, done))

    def end(self, *outcomes: Written, error: BaseException | None = None) -> list[Index]:
        """End the first task; the chunks that it had."""
        task, done = self.tasks.pop(0)
        done(list(outcomes) if error is None else None, error)
        return [each.chunk.index for each in task.chunks]


class Bench:
    """A writer with a clock that stands still, and a note of the chunks where others were met."""

    def __init__(self, task: BakeTask) -> None:
        self.now = 100.0
        self.task = task
        self.pool = FakePool()
        self.met: list[Index] = []
        self.recovered = 0
        self.light = FreshLight(lambda: self.now)
        self.writer = LightWriter(
            self.pool,  # type: ignore[arg-type]
            lambda _, index: self.met.append(index),
            self._recovered,
        )

    def _recovered(self) -> None:
        self.recovered += 1

    def take(self, *indices: Index) -> None:
        """New light of some chunks."""
        for index in indices:
            chunk = Chunk(index, TEXELS, Light.dark(SPEC.plan, len(TEXELS)))
            self.writer.take(
                "scene", self.light, self.task, replace(DONE, chunk=chunk, changed=(True, True))
            )

    def write_due(self, *wanted: Index) -> None:
        self.writer.write_due(lambda _: {*wanted})


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    bench = Bench(tasks_for(tmp_path)[0])
    monkeypatch.setattr(writing, "time", bench)
    monkeypatch.setattr(Bench, "monotonic", lambda self: self.now, raising=False)
    return bench


def test_light_that_rests_is_written_once(bench: Bench) -> None:
    bench.take(INDEX, (0, 0, 1))
    bench.write_due()
    assert bench.pool.tasks == []
    bench.now += 2.0
    bench.write_due((0, 0, 1))
    bench.write_due((0, 0, 1))
    assert bench.pool.end(False) == [INDEX] and bench.pool.tasks == []
    assert bench.met == [] and bench.writer.unwritten == 1
    bench.write_due()
    assert bench.pool.end(True) == [(0, 0, 1)]
    assert bench.met == [(0, 0, 1)] and bench.writer.unwritten == 0
    bench.now += 20.0
    bench.writer.sweep(lambda *_: False)
    assert len(bench.light) == 0


def test_a_store_that_takes_nothing_is_tried_again(bench: Bench) -> None:
    """Nothing is lost, and what was asked for goes on as soon as it takes light."""
    bench.take(INDEX)
    bench.now += 2.0
    for seconds in (1.0, 2.0, 4.0, 8.0, 8.0):
        bench.write_due()
        bench.pool.end(StoreAwayError("The store is full."))
        assert bench.writer.reason == "The store is full."
        bench.now += 0.9 * seconds
        bench.write_due()
        assert bench.pool.tasks == []
        bench.now += seconds
    assert bench.recovered == 0
    bench.write_due()
    bench.pool.end(False)
    assert (bench.writer.reason, bench.writer.unwritten, bench.recovered) == ("", 0, 1)


def test_light_that_kills_its_writers_is_dropped(bench: Bench) -> None:
    bench.take(INDEX)
    bench.now += 2.0
    tries = 0
    while bench.writer.unwritten:
        bench.write_due()
        bench.pool.end(error=LostWorkerError("It died."))
        tries += 1
        assert tries <= 10
    bench.write_due()
    assert bench.pool.tasks == [] and tries >= 3


def result_of(task: BakeTask) -> BakeResult:
    result = bake(task)
    assert result.chunk is not None
    return result


def bytes_in(task: BakeTask) -> list[bytes | None]:
    """The objects of a task's chunk."""
    store = open_spec(task.source, task.plan, task.digest, task.store_url)[1]
    return [layer.read(task.index) for layer in store.layers]


def test_light_kept_through_its_rungs_has_the_same_bytes(tmp_path: Path) -> None:
    """Texels that came before are read once; each further task has their light with it."""
    plain, kept = (tasks_for(tmp_path / name)[0] for name in ("plain", "kept"))
    half = TEXELS[::2]
    for each in (plain, kept):
        bake(replace(each, offsets=half, footprints=np.ones(len(half), np.float32), until=32))
    bake(plain)
    light = FreshLight()
    before = bytes_in(kept)
    for until in (16, 32, 64):
        task = replace(kept, until=until, keeps=True, light=light.some(kept.index, TEXELS))
        result = result_of(task)
        assert result.chunk is not None
        assert result.duplicate == (not any(result.changed))
        light.put(result.chunk, result.changed)
    assert bytes_in(kept) == before, "nothing is written yet"
    (fresh,) = light.unwritten()
    place = (kept.source, kept.plan, kept.digest, kept.store_url, None, None)
    assert write_all(WriteTask(*place, (fresh,))) == [False]  # type: ignore[arg-type]
    assert bytes_in(kept) == bytes_in(plain) != before
    assert SCENE.source == kept.source


def failing(error: Exception) -> Callable[..., bool]:
    def save(*_: Sequence[object]) -> bool:
        raise error

    return save


def test_one_chunk_that_cannot_be_written_harms_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = [replace(each, keeps=True) for each in tasks_for(tmp_path)[:2]]
    light = FreshLight()
    for task in tasks:
        result = result_of(task)
        assert result.chunk is not None
        light.put(result.chunk, result.changed)
    first = tasks[0]
    place = (first.source, first.plan, first.digest, first.store_url, None, None)
    store = open_spec(*place)[1]
    save = store.save
    broken = failing(OSError("a bad block"))
    monkeypatch.setattr(
        store, "save", lambda chunk, *more: (broken if chunk.index == INDEX else save)(chunk, *more)
    )
    one, other = write_all(WriteTask(*place, tuple(light.unwritten())))  # type: ignore[arg-type]
    assert isinstance(one, OSError) and other is False
    assert bytes_in(tasks[0]) == [None, None] and None not in bytes_in(tasks[1])
