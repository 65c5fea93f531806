"""Workers of a Dask scheduler, as a server joins and leaves them."""

import gc
import logging
import re
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, cast

import dask.config
import pytest
from distributed import Client, Future, LocalCluster
from distributed.client import FutureCancelledError
from distributed.scheduler import KilledWorker
from distributed.utils import LoopRunner

from isogi_core.kernels._compilation import warm
from isogi_worker.dask_pool import DaskPool, OwnClient, hand_on_result
from isogi_worker.errors import LostWorkerError, WorkersAwayError, WorkersError
from isogi_worker.tasks import OPENING_KERNELS, BakeResult, bake_kernels
from tests.server.sockets import wait_for
from tests.worker.pools import LONG, bake_all, kernels_of_this_process, named, tasks_for

pytestmark = pytest.mark.cluster
BAKE = bake_kernels(["direct", "indirect", "irradiance"])
METHOD = "distributed.worker.multiprocessing-method"
ROOT = Path(__file__).resolve().parent.parent.parent
WORKERS = 2


@pytest.fixture(scope="module")
def compiled() -> None:
    """The kernels that baking takes are compiled."""
    warm((*BAKE, *OPENING_KERNELS))


@pytest.fixture(scope="module")
def cluster(compiled: None) -> Iterator[LocalCluster]:
    """A scheduler and workers of others."""
    with LocalCluster(
        n_workers=WORKERS,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as others:
        yield others


@pytest.mark.long
def test_joined_workers_have_loaded_kernels_and_stay_as_nice(
    compiled: None,
) -> None:
    """Started with the preload of docker-compose.yml; nothing is sent to one of them, and its
    session is its own.
    """
    preload = re.findall(r'"--preload", "([\w.]+)"', (ROOT / "docker-compose.yml").read_text())
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
        joined = DaskPool(others.scheduler_address)
        with Client(others, set_as_default=False) as client:
            kernels = list(client.run(kernels_of_this_process).values())
        joined.close()
    assert kernels == [dict.fromkeys(named(BAKE), False)]


@pytest.mark.long
def test_tasks_whose_end_dask_does_not_report_are_noticed(
    cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Future, "add_done_callback", lambda *_: None)
    with closing(DaskPool(cluster.scheduler_address)) as joined:
        assert len(bake_all(joined, tasks_for(tmp_path))) == 4


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


def test_workers_of_others_are_joined_and_left_alone(cluster: LocalCluster, tmp_path: Path) -> None:
    joined = DaskPool(cluster.scheduler_address)
    pids = sorted(joined.pids())
    assert len(set(pids)) == WORKERS
    assert WORKERS <= joined.room <= 4 * WORKERS
    assert joined.connected
    assert len(bake_all(joined, tasks_for(tmp_path))) == 4
    joined.close()
    assert not joined.connected
    with closing(DaskPool(cluster.scheduler_address)) as again:
        assert sorted(again.pids()) == pids


def test_a_pool_that_leaves_a_scheduler_leaves_no_error_there(
    cluster: LocalCluster,
) -> None:
    scheduler = cluster.scheduler
    reported = list[logging.LogRecord]()
    handler = logging.Handler()
    handler.emit = reported.append  # type: ignore[method-assign]
    logging.getLogger("distributed.scheduler").addHandler(handler)
    clients = set(scheduler.clients)
    joined = DaskPool(cluster.scheduler_address)
    joined.close()
    assert wait_for(lambda: set(scheduler.clients) == clients, LONG)
    logging.getLogger("distributed.scheduler").removeHandler(handler)
    assert [each.getMessage() for each in reported if each.levelno >= logging.ERROR] == []


@pytest.mark.parametrize("address", ["carrier-pigeon://somewhere", "tcp://127.0.0.1:notaport"])
def test_a_scheduler_that_cannot_be_reached_is_an_error(address: str) -> None:
    with pytest.raises(WorkersError, match="Cannot start or reach the workers"):
        DaskPool(address)


def lone_scheduler(port: int = 0) -> LocalCluster:
    """A scheduler on loopback that no worker has joined."""
    return LocalCluster(
        n_workers=0,
        host="127.0.0.1",
        scheduler_port=port,
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    )


def of_a_pool(client: str) -> bool:
    """Whether a client that a scheduler knows by this name is that of a pool."""
    return client.startswith("OwnClient-")


@pytest.mark.long
def test_a_scheduler_that_was_restarted_unnoticed_is_joined_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Dask's client may find it before the pool has seen that it was away, and is not told of its
    workers then.
    """
    first = lone_scheduler()
    joined = DaskPool(first.scheduler_address)
    try:
        assert "No worker has joined" in joined.trouble
        monkeypatch.setattr("isogi_worker.dask_pool.CHECK_SECONDS", 8.0)
        time.sleep(1.5)
        joined_again = threading.Event()
        joined.on_workers_changed(joined_again.set)
        port = int(first.scheduler_address.rpartition(":")[2])
        first.close()
        with lone_scheduler(port) as second:
            assert wait_for(lambda: any(map(of_a_pool, second.scheduler.clients)), LONG)
            monkeypatch.setattr("isogi_worker.dask_pool.CHECK_SECONDS", 0.1)
            assert joined_again.wait(LONG) and joined.connected
            second.scale(1)
            assert wait_for(lambda: joined.trouble == "", LONG)
    finally:
        joined.close()
        first.close()


@pytest.mark.long
def test_workers_are_counted_without_events(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OwnClient, "subscribe_topic", lambda *_: None)
    with lone_scheduler() as alone, closing(DaskPool(alone.scheduler_address)) as joined:
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
