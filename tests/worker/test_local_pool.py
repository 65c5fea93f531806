"""The worker processes of this machine: what they do, and how they come and go."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.kernels._compilation import warm
from isogi_worker.errors import LostWorkerError, WorkersAwayError, WorkersError
from isogi_worker.fork_server import WORKER_PROCESS_NAME
from isogi_worker.local_pool import LocalPool
from isogi_worker.niceness import worker_niceness
from isogi_worker.tasks import OPENING_KERNELS, bake_kernels, open_spec
from tests.server.sockets import wait_for
from tests.worker.pools import (
    LONG,
    SCENE,
    SPEC,
    TEXELS,
    bake_all,
    kernel_cache,
    kernels_of_this_process,
    made,
    named,
    run,
    sleep_for_ever,
    tasks_for,
)

BAKE = bake_kernels(["direct", "indirect", "irradiance"])
WORKERS = 2
IRRADIANCE = bake_kernels(["irradiance"])
CALLED = (*bake_kernels(["direct", "indirect"]), *OPENING_KERNELS)


@pytest.fixture(scope="module")
def compiled() -> dict[str, tuple[int, int]]:
    """The kernels that were compiled before there were workers: all that baking takes."""
    warm((*BAKE, *OPENING_KERNELS))
    return kernel_cache()


@pytest.fixture(scope="module")
def pool(compiled: dict[str, tuple[int, int]]) -> Iterator[LocalPool]:
    pool = LocalPool(WORKERS)
    yield pool
    pids = pool.pids()
    pool.close()
    assert not psutil.wait_procs(
        [psutil.Process(pid) for pid in pids if psutil.pid_exists(pid)], timeout=LONG
    )[1]


def test_workers_are_processes_of_their_own(pool: LocalPool) -> None:
    pids = pool.pids()
    assert len(set(pids)) == WORKERS
    assert os.getpid() not in pids
    children = {child.pid for child in psutil.Process().children(recursive=True)}
    assert children.issuperset(pids)
    assert WORKERS <= pool.room <= 4 * WORKERS, "few: what is in flight cannot be re-ordered"


def test_tasks_leave_their_chunks_in_the_store(pool: LocalPool, tmp_path: Path) -> None:
    tasks = tasks_for(tmp_path)
    results = bake_all(pool, tasks)
    assert all(result.cost.seconds > 0 for result in results)
    store: ChunkStore = open_spec(SCENE.source, SPEC.plan, SPEC.digest, made(tmp_path))[1]
    for task in tasks:
        np.testing.assert_array_equal(store.load(task.index).offsets, TEXELS)


def test_a_task_that_fails_gives_its_own_error(pool: LocalPool, tmp_path: Path) -> None:
    with pytest.raises(Exception, match="have changed since the server began") as caught:
        bake_all(pool, tasks_for(tmp_path, digest="another"))
    assert type(caught.value).__name__ == "SceneError"


def test_baking_stands_behind_the_server(pool: LocalPool) -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    expected = min(before + 10, 19)  # docs/operation.md
    assert [psutil.Process(pid).nice() for pid in pool.pids()] == [expected] * WORKERS
    assert run(pool, os.getpriority, os.PRIO_PROCESS, 0) == [expected] * WORKERS
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


@pytest.mark.parametrize(("server", "workers"), [(0, 10), (5, 15), (15, 19)])
def test_workers_are_ten_nicer_than_their_server(
    monkeypatch: pytest.MonkeyPatch, server: int, workers: int
) -> None:
    """As docs/operation.md says, and at most 19, the highest that there is."""
    monkeypatch.setattr(os, "getpriority", lambda *_: server)
    assert worker_niceness() == workers


def test_kernels_are_loaded_and_not_compiled_again(
    compiled: dict[str, tuple[int, int]], pool: LocalPool, tmp_path: Path
) -> None:
    bake_all(pool, tasks_for(tmp_path))
    for kernels in run(pool, kernels_of_this_process):
        assert set(kernels) >= {kernel.name for kernel in CALLED}
        assert not any(kernels.values())
    assert compiled
    after = kernel_cache()
    assert {name: after[name] for name in compiled} == compiled


def test_missing_kernels_are_compiled_by_a_worker_meanwhile(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Those of the kinds that a pool is made for at once, others with the first task that needs
    them.
    """
    missing = {"direct", "indirect", "irradiance"}
    monkeypatch.setattr(
        "isogi_worker.local_pool.kernels_missing", lambda kinds: bool(missing & set(kinds))
    )
    monkeypatch.setattr(
        "isogi_worker.local_pool.START_METHOD", "spawn"
    )  # none that were stored before
    with closing(LocalPool(1, kinds=("irradiance",))) as fresh:
        assert fresh.preparing == "The workers compile their kernels."
        assert wait_for(
            lambda: set(*run(fresh, kernels_of_this_process)) == named(IRRADIANCE),
            LONG,
        )
        missing.remove("irradiance")
        assert fresh.preparing == ""
        assert {layer.kind for layer in SPEC.plan.layers} <= missing
        tasks = tasks_for(tmp_path)
        ended = threading.Semaphore(0)
        fresh.submit(tasks[0], lambda *_: ended.release())
        assert fresh.preparing == "The workers compile their kernels."
        assert ended.acquire(timeout=LONG)
        assert fresh.preparing == "", "a task has baked: kernels are there, whatever the cache says"


def test_a_killed_worker_is_replaced_and_its_tasks_are_lost(
    pool: LocalPool, tmp_path: Path
) -> None:
    before = pool.pids()
    psutil.Process(before[0]).kill()
    with suppress(
        LostWorkerError
    ):  # where the death was known before, all tasks go to the other worker
        bake_all(pool, tasks_for(tmp_path))
    assert len(bake_all(pool, tasks_for(tmp_path))) == 4
    assert wait_for(lambda: len(pool.pids()) == WORKERS, LONG)
    pids = pool.pids()
    assert len(set(pids) - set(before)) == 1


def listening(*pids: int) -> set[tuple[str, int]]:
    """Addresses that processes listen at."""
    connections = [each for pid in pids for each in psutil.Process(pid).net_connections("inet")]
    return {tuple(each.laddr) for each in connections if each.status == psutil.CONN_LISTEN}


def test_no_process_of_a_pool_listens_at_a_port() -> None:
    before = listening(os.getpid())  # servers of other tests in this process
    with closing(LocalPool(1)) as fresh:
        assert listening(os.getpid(), *fresh.pids()) <= before


class Odd:
    """A task of a pool in whose place a worker finds some other work."""

    plan = SPEC.plan

    def __init__(self, work: Callable[..., Any], *what: Any) -> None:
        self.work = work
        self.what = what

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.work, self.what


def never_end(begun: Path) -> None:
    begun.touch()
    sleep_for_ever()


def test_the_tasks_behind_a_lost_one_are_done_by_others(tmp_path: Path) -> None:
    """A worker that dies at a job loses that job alone; those that wait behind it are done."""
    with closing(LocalPool(1)) as fresh:
        ended: list[BaseException | None] = []
        all_ended = threading.Semaphore(0)

        def done(result: Any, error: BaseException | None) -> None:
            ended.append(error)
            all_ended.release()

        (pid,) = fresh.pids()
        begun = tmp_path / "begun"
        for task in (Odd(never_end, begun), *tasks_for(tmp_path / "store")[:3]):
            fresh.submit(task, done)  # type: ignore[arg-type]
        assert wait_for(begun.exists, LONG)
        os.kill(pid, signal.SIGKILL)
        for _ in range(4):
            assert all_ended.acquire(timeout=LONG)
        assert [type(error) for error in ended] == [LostWorkerError, *[type(None)] * 3]
        assert fresh.deaths == 1 and fresh.pids() != [pid]


def test_a_worker_that_dies_again_and_again_comes_back_each_time() -> None:
    with closing(LocalPool(1)) as fresh:
        stirred = threading.Semaphore(0)
        fresh.on_workers_changed(stirred.release)
        dead = set[int]()
        for deaths in (1, 2, 3):
            (pid,) = fresh.pids()
            dead.add(pid)
            psutil.Process(pid).kill()
            assert wait_for(lambda n=deaths: fresh.deaths == n and bool(fresh.pids()), LONG)
            assert dead.isdisjoint(fresh.pids()) and fresh.trouble == ""
            assert stirred.acquire(timeout=LONG)


def test_a_worker_that_is_told_to_end_works_on_for_a_while() -> None:
    """So long that a server which is told at the same moment can have its light written."""
    with closing(LocalPool(1)) as fresh:
        (pid,) = fresh.pids()
        os.kill(pid, signal.SIGTERM)
        assert run(fresh, os.getpid) == [pid]
        assert wait_for(lambda: fresh.deaths == 1 and fresh.pids() not in ([], [pid]), LONG)


class Unpackable(Exception):
    """An error that can be pickled, and not read again."""

    def __init__(self, one: int, other: int) -> None:
        super().__init__("two numbers are needed")


def fail(error: type[Exception], *what: Any) -> None:
    raise error(*what)


def test_an_error_that_cannot_be_sent_is_told_in_words(pool: LocalPool) -> None:
    with pytest.raises(WorkersError, match="two numbers are needed"):
        bake_all(pool, [Odd(fail, Unpackable, 1, 2)])  # type: ignore[list-item]
    assert run(pool, sum, [1, 2]) == [3] * WORKERS


def test_a_callback_that_fails_harms_no_other_task(pool: LocalPool, tmp_path: Path) -> None:
    pool.submit(tasks_for(tmp_path)[0], lambda *_: fail(ValueError, "in a callback"))
    assert len(bake_all(pool, tasks_for(tmp_path))) == 4


def test_a_pool_that_cannot_start_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "isogi_worker.local_pool.start_fork_server", lambda: fail(OSError, 11, "no room")
    )
    with pytest.raises(WorkersError, match="Cannot start the workers: "):
        LocalPool(1)


def test_tasks_of_a_closed_pool_are_put_off(tmp_path: Path) -> None:
    """Those at hand and later ones end with an error that has them tried again."""
    fresh = LocalPool(1)
    os.kill(*fresh.pids(), signal.SIGSTOP)
    told: list[BaseException | None] = []
    for task in tasks_for(tmp_path):
        fresh.submit(task, lambda _, error: told.append(error))
    fresh.close()
    fresh.submit(tasks_for(tmp_path)[0], lambda _, error: told.append(error))
    assert wait_for(lambda: len(told) == 5, LONG)
    assert {type(error) for error in told} == {WorkersAwayError}


def test_a_pool_that_is_stopped_waits_for_no_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """If it waited for workers that still load kernels, a command would end seconds late."""
    monkeypatch.setattr("isogi_worker.local_pool.run_worker", sleep_for_ever)
    stopped = threading.Event()
    threading.Timer(0.2, stopped.set).start()
    before = set(psutil.Process().children(recursive=True))
    with pytest.raises(WorkersError, match="stopped before they came"):
        LocalPool(1, stopped=stopped)
    made = set(psutil.Process().children(recursive=True)) - before
    assert not [each for each in made if each.name() == WORKER_PROCESS_NAME]
