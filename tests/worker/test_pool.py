import gc
import logging
import os
import re
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, cast

import dask.config
import httpx
import numba
import numpy as np
import psutil
import pytest
from distributed import Future, LocalCluster
from distributed.client import FutureCancelledError
from distributed.scheduler import KilledWorker
from distributed.utils import LoopRunner

from isogi_core.bake.bake_spec import spec_for
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.kernels._compilation import warm, with_callees
from isogi_core.plan.assembly import load_scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.store import Store
from tests.server.sockets import wait_for
from worker.baker import Baker
from worker.errors import LostWorkerError, WorkersAwayError, WorkersError
from worker.niceness import BACK_NICENESS, FORWARD_NICENESS, WORKER_NICENESS
from worker.pool import CLUSTER_SETTINGS, TASKS_AHEAD, OwnClient, WorkerPool, hand_on_result
from worker.tasks import (
    OPENING_KERNELS,
    PLAIN_LAYER_KINDS,
    BakeResult,
    BakeTask,
    bake_kernels,
    open_spec,
)

pytestmark = pytest.mark.cluster
SCENE = load_scene("demo:orbital", order=2, lattice=0.4, bounces=1, target_error=0.5)
SPEC = spec_for(PreparedScene(SCENE), "gi")
BAKE = bake_kernels(PLAIN_LAYER_KINDS)
TEXELS = np.arange(0, 4096, 40, dtype=np.int32)
METHOD = "distributed.worker.multiprocessing-method"
WORKERS = 2
LONG = 240.0
"""Seconds within which workers have come, baked or gone, also on a slow machine."""

ROOT = Path(__file__).resolve().parent.parent.parent
IRRADIANCE = bake_kernels(["irradiance"])
CALLED = (*bake_kernels(["direct", "indirect"]), *OPENING_KERNELS)


def kernel_cache() -> dict[str, tuple[int, int]]:
    folder = Path(numba.config.CACHE_DIR)
    return {
        path.name: (path.stat().st_size, path.stat().st_mtime_ns) for path in folder.rglob("*.nb*")
    }


@pytest.fixture(scope="module")
def compiled() -> dict[str, tuple[int, int]]:
    """The kernels that were compiled before there were workers: all that baking takes."""
    warm((*BAKE, *OPENING_KERNELS))
    return kernel_cache()


@pytest.fixture(scope="module")
def pool(compiled: dict[str, tuple[int, int]]) -> Iterator[WorkerPool]:
    pool = WorkerPool(WORKERS)
    yield pool
    pids = pool.pids()
    pool.close()
    assert not psutil.wait_procs(
        [psutil.Process(pid) for pid in pids if psutil.pid_exists(pid)], timeout=LONG
    )[1]


def bake_all(pool: WorkerPool, tasks: list[BakeTask]) -> list[BakeResult]:
    """Results of the tasks, handed over together."""
    results: list[BakeResult] = []
    errors: list[BaseException | None] = []
    ended = threading.Semaphore(0)

    def done(result: BakeResult | None, error: BaseException | None) -> None:
        results.append(result) if result is not None else errors.append(error)
        ended.release()

    for task in tasks:
        pool.submit(task, done)
    for _ in tasks:
        assert ended.acquire(timeout=LONG)
    if errors:
        raise errors[0] or AssertionError("a task ended without a result and without an error")
    return results


def made(root: Path) -> StoreUrl:
    """The place of a store that a server has made."""
    Store(root).open()
    return StoreUrl(str(root))


def tasks_for(store: Path, digest: str = SPEC.digest) -> list[BakeTask]:
    indices = [(z, y, 0) for z in (0, 1) for y in (0, 1)]
    what = (SCENE.source, SPEC.plan, digest, made(store))
    seen = np.ones(len(TEXELS), np.float32)
    return [BakeTask(*what, index, TEXELS, seen, 64, 0.5) for index in indices]


def test_workers_are_processes_of_their_own(pool: WorkerPool) -> None:
    pids = pool.pids()
    assert len(set(pids)) == WORKERS
    assert os.getpid() not in pids
    children = {child.pid for child in psutil.Process().children(recursive=True)}
    assert children.issuperset(pids)
    assert pool.room == TASKS_AHEAD * WORKERS


def test_tasks_leave_their_chunks_in_the_store(pool: WorkerPool, tmp_path: Path) -> None:
    tasks = tasks_for(tmp_path)
    results = bake_all(pool, tasks)
    assert all(result.cost.seconds > 0 for result in results)
    store: ChunkStore = open_spec(SCENE.source, SPEC.plan, SPEC.digest, made(tmp_path))[1]
    for task in tasks:
        np.testing.assert_array_equal(store.load(task.index).offsets, TEXELS)


def test_a_task_that_fails_gives_its_own_error(pool: WorkerPool, tmp_path: Path) -> None:
    with pytest.raises(Exception, match="have changed since the server began") as caught:
        bake_all(pool, tasks_for(tmp_path, digest="another"))
    assert type(caught.value).__name__ == "SceneError"


def test_baking_stands_behind_the_server(pool: WorkerPool) -> None:
    before = os.getpriority(os.PRIO_PROCESS, 0)
    expected = min(before + WORKER_NICENESS, 19)
    assert WORKER_NICENESS == 10
    assert [psutil.Process(pid).nice() for pid in pool.pids()] == [expected] * WORKERS
    where_tasks_run = pool._client.submit(lambda: os.getpriority(os.PRIO_PROCESS, 0), pure=False)
    assert where_tasks_run.result() == expected
    assert os.getpriority(os.PRIO_PROCESS, 0) == before


def in_autogroup() -> bool:
    """Whether sessions share the cores here. A process in a control group of its own has an empty
    file instead.
    """
    own = Path("/proc/self/autogroup")
    return own.exists() and bool(own.read_text().strip())


needs_autogroups = pytest.mark.skipif(not in_autogroup(), reason="no autogroups here")


def session_niceness(pid: int) -> int:
    return int(Path(f"/proc/{pid}/autogroup").read_text().split()[-1])


def reach(pids: list[int], niceness: int) -> None:
    """Wait until the sessions of all these processes have a niceness."""
    assert wait_for(lambda: [session_niceness(pid) for pid in pids] == [niceness] * len(pids), LONG)


@needs_autogroups
def test_worker_sessions_have_low_priority_while_a_view_moves(pool: WorkerPool) -> None:
    pids = pool.pids()
    own = session_niceness(os.getpid())
    assert [os.getsid(pid) for pid in pids] == pids
    reach(pids, FORWARD_NICENESS)
    baker = Baker()
    baker.employ(pool)
    baker.make_way()
    reach(pids, BACK_NICENESS)
    assert session_niceness(os.getpid()) == own
    reach(pids, FORWARD_NICENESS)


def test_all_listen_on_loopback_only(pool: WorkerPool) -> None:
    listening = [
        connection.laddr.ip
        for pid in (os.getpid(), *pool.pids())
        for connection in psutil.Process(pid).net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert len(listening) >= WORKERS
    assert set(listening) == {"127.0.0.1"}


def test_nothing_but_health_is_served(pool: WorkerPool) -> None:
    assert pool._cluster is not None
    workers = pool._client.scheduler_info(n_workers=-1)["workers"].values()
    ports = [
        pool._cluster.scheduler.http_server.port,
        *(worker["services"]["dashboard"] for worker in workers),
    ]
    assert len(ports) == 1 + WORKERS
    for port in ports:
        assert httpx.get(f"http://127.0.0.1:{port}/health").text == "ok"
        for path in ("/status", "/info/main/workers.html", "/json/counts.json", "/metrics"):
            assert httpx.get(f"http://127.0.0.1:{port}{path}").status_code == 404


def kernels_of_this_process() -> dict[str, bool]:
    """The entry kernels that this process has loaded, by name, and whether it had to compile
    them.
    """
    import sys

    from isogi_core.kernels._jit import Entry

    modules = [
        module
        for name, module in sys.modules.copy().items()
        if name.startswith("isogi_core.kernels.")
    ]
    entries = {
        x.name: x
        for module in modules
        for x in vars(module).copy().values()
        if isinstance(x, Entry)
    }
    return {name: bool(x.ready.stats.cache_misses) for name, x in entries.items() if x.loaded}


def named(kernels: Iterable[Any]) -> set[str]:
    """The names of entry kernels, and of those that they call."""
    return {kernel.name for kernel in with_callees(kernels)}


def test_kernels_are_loaded_and_not_compiled_again(
    compiled: dict[str, tuple[int, int]], pool: WorkerPool, tmp_path: Path
) -> None:
    bake_all(pool, tasks_for(tmp_path))
    for kernels in pool._client.run(kernels_of_this_process).values():
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
    missing = set(PLAIN_LAYER_KINDS)
    monkeypatch.setattr("worker.pool.kernels_missing", lambda kinds: bool(missing & set(kinds)))
    monkeypatch.setitem(CLUSTER_SETTINGS, METHOD, "spawn")  # none that were stored before
    with closing(WorkerPool(1, kinds=("irradiance",))) as fresh:
        assert fresh.preparing == "The workers compile their kernels."
        assert wait_for(
            lambda: set(*fresh._client.run(kernels_of_this_process).values()) == named(IRRADIANCE),
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


def test_joined_workers_have_loaded_kernels_and_stay_as_nice(
    compiled: dict[str, tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Started with the preload of docker-compose.yml; nothing is sent to one of them, and its
    session is its own.
    """
    preload = re.findall(r'"--preload", "([\w.]+)"', (ROOT / "docker-compose.yml").read_text())
    monkeypatch.setattr("worker.pool.kernels_missing", lambda kinds: True)
    monkeypatch.setattr("worker.pool.fire_and_forget", lambda future: pytest.fail("a job was sent"))
    kwargs: dict[str, Any] = {
        "host": "127.0.0.1",
        "dashboard_address": "127.0.0.1:0",
        "preload": preload,
    }
    spawned = dask.config.set({METHOD: "spawn"})  # as on another machine
    with (
        spawned,
        LocalCluster(n_workers=1, threads_per_worker=1, silence_logs=50, **kwargs) as others,
    ):
        joined = WorkerPool(1, others.scheduler_address)
        kernels = list(joined._client.run(kernels_of_this_process).values())
        joined.step_back(1e-3)
        sessions = [os.getsid(pid) for pid in joined.pids()]
        joined.close()
    assert kernels == [dict.fromkeys(named(BAKE), False)]
    assert sessions == [os.getsid(0)]


def test_a_killed_worker_is_replaced_and_its_tasks_are_lost(
    pool: WorkerPool, tmp_path: Path
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


def test_tasks_whose_end_dask_does_not_report_are_noticed(
    pool: WorkerPool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Future, "add_done_callback", lambda *_: None)
    assert len(bake_all(pool, tasks_for(tmp_path))) == 4


class Ended:
    """A future that seems to have ended, and whose result cannot be fetched."""

    def __init__(self, status: str, error: BaseException) -> None:
        self.status = status
        self.error = error

    def result(self) -> None:
        raise self.error


@pytest.mark.parametrize(
    ("status", "error", "kind"),
    [
        ("finished", KilledWorker("bake", None, 0), LostWorkerError),
        ("error", KilledWorker("bake", None, 0), LostWorkerError),
        ("error", OSError("the disk is full"), OSError),
        ("finished", OSError("the connection is gone"), WorkersAwayError),
        ("cancelled", FutureCancelledError("bake", "the scheduler is gone"), WorkersAwayError),
    ],
)
def test_a_result_that_is_lost_on_its_way_is_an_error(
    status: str, error: Exception, kind: type[Exception]
) -> None:
    """Its worker may die before it is fetched: the error then came out of the callback, and nobody
    was told.
    """
    reported: list[tuple[BakeResult | None, BaseException | None]] = []
    hand_on_result(
        cast("Future[Any]", Ended(status, error)), lambda *outcome: reported.append(outcome)
    )
    ((result, why),) = reported
    assert result is None
    assert type(why) is kind


def known_to(cluster: LocalCluster) -> Any:
    """A context in which this process shows the certificate of a cluster."""
    made = cluster.security
    tls = "distributed.comm.tls"
    own = {f"{tls}.client.cert": made.tls_client_cert, f"{tls}.client.key": made.tls_client_key}
    return dask.config.set({f"{tls}.ca-file": made.tls_ca_file, **own})


def test_workers_of_others_are_joined_and_left_alone(pool: WorkerPool, tmp_path: Path) -> None:
    assert pool._cluster is not None
    with known_to(pool._cluster):
        joined = WorkerPool(1, pool._cluster.scheduler_address)
    assert sorted(joined.pids()) == sorted(pool.pids())
    assert joined.room == TASKS_AHEAD * WORKERS
    assert joined.connected
    assert len(bake_all(joined, tasks_for(tmp_path))) == 4
    joined.close()
    assert not joined.connected
    assert len(bake_all(pool, tasks_for(tmp_path))) == 4


def test_a_pool_that_leaves_a_scheduler_leaves_no_error_there(pool: WorkerPool) -> None:
    assert pool._cluster is not None
    scheduler = pool._cluster.scheduler
    reported = list[logging.LogRecord]()
    handler = logging.Handler()
    handler.emit = reported.append  # type: ignore[method-assign]
    logging.getLogger("distributed.scheduler").addHandler(handler)
    clients = set(scheduler.clients)
    with known_to(pool._cluster):
        joined = WorkerPool(1, pool._cluster.scheduler_address)
    joined.close()
    assert wait_for(lambda: set(scheduler.clients) == clients, LONG)
    logging.getLogger("distributed.scheduler").removeHandler(handler)
    assert [each.getMessage() for each in reported if each.levelno >= logging.ERROR] == []


@pytest.mark.parametrize("address", ["carrier-pigeon://somewhere", "tcp://127.0.0.1:notaport"])
def test_a_scheduler_that_cannot_be_reached_is_an_error(address: str) -> None:
    with pytest.raises(WorkersError, match="Cannot start or reach the workers"):
        WorkerPool(1, address)


def lone_scheduler(port: int = 0) -> LocalCluster:
    """A scheduler on loopback that no worker has joined."""
    return LocalCluster(
        n_workers=0,
        host="127.0.0.1",
        scheduler_port=port,
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    )


def test_a_scheduler_that_was_restarted_unnoticed_is_joined_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Dask's client may find it before the pool has seen that it was away, and is not told of its
    workers then.
    """
    first = lone_scheduler()
    joined = WorkerPool(1, first.scheduler_address)
    try:
        assert "No worker has joined" in joined.trouble
        monkeypatch.setattr("worker.pool.CHECK_SECONDS", LONG)
        time.sleep(1.5)
        client = joined._client
        port = int(first.scheduler_address.rpartition(":")[2])
        first.close()
        with lone_scheduler(port) as second:
            assert wait_for(lambda: client.scheduler_info().get("id") == second.scheduler.id, LONG)
            monkeypatch.setattr("worker.pool.CHECK_SECONDS", 0.1)
            joined._moved.set()
            assert wait_for(lambda: joined._client is not client and joined.connected, LONG)
            second.scale(1)
            assert wait_for(lambda: joined.trouble == "", LONG)
    finally:
        joined.close()
        first.close()


def test_workers_are_counted_without_events(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WorkerPool, "_on_event", lambda *_: None)
    with lone_scheduler() as alone, closing(WorkerPool(1, alone.scheduler_address)) as joined:
        alone.scale(1)
        assert wait_for(lambda: joined.trouble == "", LONG)


def test_clients_without_a_scheduler_block_no_new_client() -> None:
    """The garbage collector may come while a thread holds the lock that closing a client takes."""
    for _ in range(2):
        with pytest.raises(OSError, match=r"."):
            OwnClient("tcp://127.0.0.1:9", "200ms")
    threads = threading.active_count()
    with LoopRunner._lock:  # type: ignore[attr-defined]
        gc.collect()
    assert threading.active_count() <= threads


def test_a_worker_that_dies_again_and_again_comes_back_each_time() -> None:
    """Dask looks a while after each death whether the worker is back, and here it never is."""
    patient = dask.config.set({"distributed.deploy.lost-worker-timeout": "1 ms"})
    with patient, closing(WorkerPool(1)) as fresh:
        dead: set[int] = set()

        def replaced() -> bool:
            with suppress(OSError):
                pids = set(fresh.pids())
                return bool(pids) and pids.isdisjoint(dead)
            return False

        for _ in range(2):
            (pid,) = fresh.pids()
            psutil.Process(pid).kill()
            dead.add(pid)
            assert wait_for(replaced, LONG)
