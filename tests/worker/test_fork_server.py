"""The fork server: what workers have of it, and what happens when it dies."""

import os
import sys
from collections.abc import Iterator
from contextlib import suppress

import psutil
import pytest

from isogi_core.kernels._jit import entries_of
from tests.server.sockets import wait_for
from worker.fork_server import START_METHOD, WORKER_PROCESS_NAME
from worker.pool import WorkerPool
from worker.tasks import bake_kernels

pytestmark = pytest.mark.skipif(
    START_METHOD != "forkserver", reason="workers are spawned on this system"
)

LONG = 60.0
"""Seconds that workers may take to come."""


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> Iterator[WorkerPool]:
    monkeypatch.setenv("ISOGI_LATE", "set after the fork server began")
    made = WorkerPool(2, kinds=["direct"])
    yield made
    made.close()


def parents(pool: WorkerPool) -> set[int]:
    """The processes that the workers were forked from."""
    return set(pool._client.run(os.getppid).values())


def replaced(pool: WorkerPool, former: set[int]) -> bool:
    """Whether two workers have come in place of the ``former`` ones; those that just end may not
    answer.
    """
    with suppress(Exception):
        pids = set(pool.pids())
        return len(pids) == 2 and not former & pids
    return False


def kernels_loaded() -> list[bool]:
    return [entry.loaded for entry in entries_of(bake_kernels(["direct"]))]


@pytest.mark.slow
def test_workers_share_what_one_process_has_loaded(pool: WorkerPool) -> None:
    (parent,) = parents(pool)
    assert psutil.Process(parent).ppid() == os.getpid()
    assert {psutil.Process(pid).name() for pid in pool.pids()} == {WORKER_PROCESS_NAME}
    assert all(all(loaded) for loaded in pool._client.run(kernels_loaded).values())
    assert all(
        "worker.tasks" in names for names in pool._client.run(lambda: list(sys.modules)).values()
    )


def test_workers_have_the_environment_of_when_they_were_hired(pool: WorkerPool) -> None:
    assert set(pool._client.run(os.environ.get, "ISOGI_LATE").values()) == {
        "set after the fork server began"
    }


def test_another_fork_server_takes_the_place_of_a_dead_one(pool: WorkerPool) -> None:
    (parent,) = parents(pool)
    former = set(pool.pids())
    psutil.Process(parent).kill()
    assert wait_for(lambda: replaced(pool, former), LONG)
    (other,) = parents(pool)
    assert other != parent and psutil.Process(other).ppid() == os.getpid()
    assert pool._client.submit(sum, [1, 2], pure=False).result(timeout=LONG) == 3
    _, left = psutil.wait_procs(
        [psutil.Process(pid) for pid in former if psutil.pid_exists(pid)], timeout=LONG
    )
    assert left == []
