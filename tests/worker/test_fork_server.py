"""The fork server: what workers have of it, and what happens when it dies."""

import os
import sys
from collections.abc import Iterator

import psutil
import pytest

from isogi_core.kernels._jit import entries_of
from isogi_worker.fork_server import START_METHOD, WORKER_PROCESS_NAME
from isogi_worker.local_pool import LocalPool
from isogi_worker.tasks import bake_kernels
from tests.server.sockets import wait_for
from tests.worker.pools import run

pytestmark = pytest.mark.skipif(
    START_METHOD != "forkserver", reason="workers are spawned on this system"
)

LONG = 60.0
"""Seconds that workers may take to come."""


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalPool]:
    monkeypatch.setenv("ISOGI_LATE", "set after the fork server began")
    made = LocalPool(2, kinds=["direct"])
    yield made
    made.close()


def parents(pool: LocalPool) -> set[int]:
    """The processes that the workers were forked from."""
    return set(run(pool, os.getppid))


CLUSTER_MODULES = {"distributed", "dask", "cryptography"}
"""Modules that only those load who join a cluster."""


def modules() -> set[str]:
    return set(sys.modules)


def kernels_loaded() -> list[bool]:
    return [entry.loaded for entry in entries_of(bake_kernels(["direct"]))]


@pytest.mark.slow
def test_workers_share_what_one_process_has_loaded(pool: LocalPool) -> None:
    (parent,) = parents(pool)
    assert psutil.Process(parent).ppid() == os.getpid()
    assert {psutil.Process(pid).name() for pid in pool.pids()} == {WORKER_PROCESS_NAME}
    assert all(all(loaded) for loaded in run(pool, kernels_loaded))
    for names in run(pool, modules):
        assert "isogi_worker.tasks" in names
        assert names.isdisjoint(CLUSTER_MODULES)


def test_workers_have_the_environment_of_when_they_were_hired(pool: LocalPool) -> None:
    assert set(run(pool, os.getenv, "ISOGI_LATE")) == {"set after the fork server began"}


def test_workers_outlive_their_fork_server_and_another_comes(pool: LocalPool) -> None:
    (parent,) = parents(pool)
    former = pool.pids()
    psutil.Process(parent).kill()
    assert run(pool, sum, [1, 2]) == [3, 3] and pool.pids() == former
    psutil.Process(former[0]).kill()
    assert wait_for(lambda: pool.deaths == 1 and len(pool.pids()) == 2, LONG)
    (new,) = set(pool.pids()) - set(former)
    other = psutil.Process(new).ppid()
    assert other != parent and psutil.Process(other).ppid() == os.getpid()
    assert run(pool, sum, [1, 2]) == [3, 3]
