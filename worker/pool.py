"""The worker processes: a Dask cluster, of this machine's own or joined by its address."""

import os
from collections.abc import Callable, Collection
from typing import Any

import dask.config
from distributed import Client, Future, LocalCluster, fire_and_forget

from worker.errors import WorkersError
from worker.nice import Nice
from worker.tasks import KINDS, BakeResult, BakeTask, bake, kernels_missing, load_kernels

AHEAD = 2
"""Tasks in flight per worker: a task handed over can be neither re-ordered nor stopped, so few are."""

SETTINGS = {
    "distributed.admin.low-level-log-length": 100,
    "distributed.scheduler.allowed-failures": 10,
    "distributed.scheduler.http.routes": ["distributed.http.health"],
    "distributed.worker.http.routes": ["distributed.http.health"],
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": False,
}

Done = Callable[[BakeResult | None, BaseException | None], None]


class WorkerPool:
    """Processes that bake. Those started here load the kernels of the bake with their first task.

    Those joined may stand on other machines, and load them when they start: see ``worker.tasks.dask_setup``.
    """

    def __init__(self, workers: int, scheduler: str | None = None, kinds: Collection[str] = KINDS) -> None:
        """Start ``workers`` processes of one thread each, or join the ``scheduler``. Raises WorkersError.

        Kernels that bake layers of these ``kinds`` are compiled at once where they are missing.
        """
        self._cluster: LocalCluster | None = None
        try:
            with dask.config.set(SETTINGS):
                if scheduler is None:
                    self._cluster = start_cluster(workers)
                self._client = Client(self._cluster or scheduler, timeout="30s", set_as_default=False)
                self._client.register_plugin(Nice())
                self._workers = self._count()
                if scheduler is None and kernels_missing(kinds):
                    fire_and_forget(self._client.submit(load_kernels, tuple(kinds), pure=False))
        except Exception as error:
            if self._cluster is not None:
                self._cluster.close()
            raise WorkersError(f"Cannot start or reach the workers: {error}") from error

    @property
    def workers(self) -> int:
        """How many workers there are."""
        return self._workers

    @property
    def room(self) -> int:
        """How many tasks may be in flight."""
        return AHEAD * self._workers

    @property
    def connected(self) -> bool:
        """Whether the scheduler can be reached; when it is lost, tasks wait until it is there again."""
        return bool(self._client.status == "running")

    def submit(self, task: BakeTask, done: Done) -> None:
        """Hand a task over; ``done`` is called from another thread with its result or its error."""
        self._client.submit(bake, task, pure=False).add_done_callback(lambda ended: self._ended(ended, done))

    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return list(self._client.run(os.getpid).values())

    def close(self) -> None:
        """Stop the workers that were started here, and leave those that were joined."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def _ended(self, future: "Future[Any]", done: Done) -> None:
        """Pass on how a task ended; workers may have come or gone meanwhile."""
        report(future, done)
        if self.connected:
            self._workers = self._count()

    def _count(self) -> int:
        """The workers that there are, at least 1: tasks wait for the first to come. A round trip."""
        return max(len(self._client.scheduler_info(n_workers=-1)["workers"]), 1)


def start_cluster(workers: int) -> LocalCluster:
    """Worker processes on the loopback interface, started afresh and not forked, without a dashboard.

    Dask serves a health page all the same: on a free port, for two servers must not quarrel over one.
    """
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False},
        memory_limit=None,
        silence_logs=50,
    )


def report(ended: "Future[Any]", done: Done) -> None:
    """Tell ``done`` how a future ended."""
    if ended.status == "finished":
        done(ended.result(), None)
    else:
        done(None, ended.exception() if ended.status == "error" else WorkersError("The workers were stopped."))
