"""Workers of a Dask scheduler, which is joined by its address."""

import logging
import os
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import dask.config
from distributed import Client, Future, WorkerPlugin
from distributed.scheduler import KilledWorker

from isogi_worker.errors import LostWorkerError, WorkersAwayError, WorkersError
from isogi_worker.niceness import stand_behind, worker_niceness
from isogi_worker.pool import MAX_TASK_TEXELS, TASKS_AHEAD, AllDone, Done, WriteDone, all_ended
from isogi_worker.tasks import BakeTask, WriteTask, bake, bake_all, write_all


def show_certificate(authority: str, certificate: str, key: str) -> "dask.config.set":
    """Present a certificate to each scheduler that this process joins, and trust those signed by
    ``authority``; all are PEM files.

    It holds from now on, or until the end of a ``with`` block of the returned object.
    """
    tls = "distributed.comm.tls"
    own = {f"{tls}.client.cert": certificate, f"{tls}.client.key": key}
    return dask.config.set(
        {f"{tls}.ca-file": authority, **own, "distributed.comm.require-encryption": True}
    )


CLIENT_CLOSE_SECONDS = 1.0
"""Most seconds that closing a client takes if it found no scheduler."""


class OwnClient(Client):
    """A Dask client that only the code that made it closes; the garbage collector never does.

    Dask's own client closes itself when it is collected, and takes a lock for that. If this happens
    in a thread that is just making a client, and so holds the lock, the thread waits for ever. A
    client that found no scheduler would be collected: it is closed as soon as joining has failed.
    """

    def __init__(self, address: str, timeout: str) -> None:
        """Join a scheduler by its ``address``.

        Raises OSError if none is found within the ``timeout``.
        """
        try:
            super().__init__(address, timeout=timeout, set_as_default=False)  # type: ignore[no-untyped-call]
        except BaseException:
            # The caller gets no client to close, so close it here: its thread would go on.
            with suppress(Exception):
                self.close(timeout=CLIENT_CLOSE_SECONDS)  # type: ignore[no-untyped-call]
            raise

    def __del__(self) -> None:
        """Do nothing, in place of Dask's closing."""


SETTINGS: dict[str, object] = {
    "distributed.admin.low-level-log-length": 100,
    "distributed.admin.tick.interval": "500ms",
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.http.routes": ["distributed.http.health"],
    "distributed.worker.http.routes": ["distributed.http.health"],
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": False,
    "distributed.worker.profile.enabled": False,
}
"""Settings of Dask. A worker's death ends all its tasks, and the queue tries each of them again.

By default Dask observes itself a hundred times a second, which takes 5 % of a core with one idle
worker. With these settings it takes 1 %.
"""

CHECK_SECONDS = 1.0
"""Seconds between two checks of the scheduler, and the most that closing a client may take."""

REJOIN_SECONDS = 5.0
"""Seconds within which the scheduler must be found when it is joined again."""

SCHEDULER_AWAY = (
    "The scheduler at {scheduler} cannot be reached at the moment: baking goes on "
    "when it is there again."
)
NO_WORKER_JOINED = (
    "No worker has joined the scheduler at {scheduler}: start one with 'dask "
    "worker', see docs/cluster.md."
)

log = logging.getLogger("isogi.worker")


class Nice(WorkerPlugin):
    """A plugin of Dask that names a worker process, and gives it lower priority than the server."""

    name = "nice"

    def __init__(self) -> None:
        """Note the priority of this process, the server, below which workers stay."""
        self.niceness = worker_niceness()

    def setup(self, worker: Any) -> None:
        """Name the process, and lower its priority unless it is as low already."""
        stand_behind(self.niceness)


class DaskPool:
    """Worker processes of a scheduler, which may run on other machines.

    They load kernels when they start: see ``isogi_worker.tasks.dask_setup``. Workers and their
    scheduler may come and go; a thread of the pool keeps track of them.
    """

    together = MAX_TASK_TEXELS
    preparing = ""
    keeps_light = False
    here = False

    def __init__(self, scheduler: str) -> None:
        """Join the ``scheduler`` by its address, such as ``tcp://host:8786``.

        Raises WorkersAwayError if it does not answer within 30 seconds, and WorkersError if joining
        fails for another reason.
        """
        self._scheduler = scheduler
        # The addresses of the present workers, the id of the scheduler that was joined, by which a
        # restarted one is recognised, and the number of workers that were lost.
        self._addresses: frozenset[str] = frozenset()
        self._joined = ""
        self._deaths = 0
        # Called when workers have come or gone; ``on_workers_changed`` sets it.
        self._workers_changed: Callable[[], None] = lambda: None
        # ``_notified`` wakes the pool's thread when the scheduler says that workers have come or
        # gone; ``_closing`` ends it.
        self._notified = threading.Event()
        self._closing = threading.Event()
        # Tasks in flight by Dask's key, and those that had ended at the last check.
        self._open: dict[Any, tuple[Future[Any], Done]] = {}
        self._ended: set[Any] = set()
        # Connect, which lists the workers; then start the thread that keeps track of them.
        try:
            with dask.config.set(SETTINGS):
                self._client = self._connect("30s")
        except Exception as error:
            kind = WorkersAwayError if isinstance(error, OSError) else WorkersError
            raise kind(f"Cannot start or reach the workers: {error}") from error
        self._thread = threading.Thread(target=self._run, name="workers", daemon=True)
        self._thread.start()

    @property
    def workers(self) -> int:
        """Number of workers, at least 1, as tasks may wait for the first one."""
        return max(len(self._addresses), 1)

    @property
    def deaths(self) -> int:
        """Number of workers that were lost."""
        return self._deaths

    @property
    def room(self) -> int:
        """Most tasks in flight; none while the scheduler is away."""
        if self.connected:
            return TASKS_AHEAD * self.workers
        return 0

    @property
    def connected(self) -> bool:
        """True if the scheduler can be reached."""
        return bool(self._client.status == "running")

    @property
    def trouble(self) -> str:
        """The reason if nothing can be baked at the moment, else empty."""
        if not self.connected:
            return SCHEDULER_AWAY.format(scheduler=self._scheduler)
        if not self._addresses:
            return NO_WORKER_JOINED.format(scheduler=self._scheduler)
        return ""

    def on_workers_changed(self, callback: Callable[[], None]) -> None:
        """Call ``callback``, from another thread, whenever workers have come or gone."""
        self._workers_changed = callback

    def submit(self, task: BakeTask, done: Done) -> None:
        """Hand a task over; ``done`` is called from another thread with its result or its error."""
        self._send(bake, task, done)

    def submit_all(self, tasks: Sequence[BakeTask], done: AllDone) -> None:
        """Hand over tasks of one bake, to be done together."""
        self._send(bake_all, tasks, all_ended(tasks, done))

    def write(self, task: WriteTask, done: WriteDone) -> None:
        """Hand over a task that writes light.

        The baker gives none, as these workers write the light that they bake.
        """
        self._send(write_all, task, done)

    def prepare(self, work: Callable[[], object]) -> None:
        """Do nothing, as joined workers prepare when they start."""

    def pids(self) -> list[int]:
        """Return the process ids of the workers, on their machines."""
        return list(self._client.run(os.getpid).values())

    def close(self) -> None:
        """Leave the scheduler and its workers."""
        self._closing.set()
        self._notified.set()
        self._thread.join()
        # The scheduler may be away; else it would tell a client that leaves of its leaving.
        with suppress(Exception):
            self._client.unsubscribe_topic("all")
        self._client.close()

    def _send(
        self, work: Callable[[Any], Any], what: Any, done: Callable[[Any, Any], None]
    ) -> None:
        """Have a worker call ``work`` with ``what``;
        ``done`` is called with the result or the error.
        """
        try:
            future = self._client.submit(work, what, pure=False)
        except Exception as error:  # the client closed at this moment
            away = WorkersAwayError(f"The workers cannot be reached: {error}")
            threading.Thread(target=done, args=(None, away), daemon=True).start()
        else:
            self._open[future.key] = future, done
            future.add_done_callback(lambda ended: self._end(ended.key))

    def _connect(self, timeout: str) -> Client:
        """Return a client that is notified of workers that come and go; list the workers that are
        there.

        Raises OSError if the scheduler is not found within the ``timeout``.
        """
        client: Client = OwnClient(self._scheduler, timeout)
        try:
            client.register_plugin(Nice())
            client.subscribe_topic("all", self._on_event)
            self._addresses = addresses(client)
            self._joined = str(client.scheduler_info(n_workers=0)["id"])
        except BaseException:
            client.close(timeout=CHECK_SECONDS)
            raise
        return client

    def _on_event(self, event: tuple[float, Any]) -> None:
        """Wake the pool's thread if an event of the scheduler says that workers came or went."""
        if isinstance(event[1], dict) and event[1].get("action") in ("add-worker", "remove-worker"):
            self._notified.set()

    def _run(self) -> None:
        """Keep the list of workers up to date until the pool is closed, and join the scheduler
        again after it was lost. Runs in a thread.

        Events of the scheduler may be lost, so its number of workers is asked for every
        CHECK_SECONDS, too.
        """
        while not self._closing.is_set():
            notified = self._notified.wait(CHECK_SECONDS)
            self._notified.clear()
            try:
                self._report_unnoticed_ends()
                info = self._client.scheduler_info(n_workers=0) if self.connected else {}
                # A restarted scheduler has a new id, and one that is away has none.
                if info.get("id") != self._joined:
                    self._join_again()
                elif notified or info["n_workers"] != len(self._addresses):
                    self._list_workers()
            except Exception as error:
                # The next check tries again.
                log.debug("the scheduler is away: %s", error)

    def _end(self, key: Any) -> None:
        """Report the end of a task to its submitter, once."""
        if (entry := self._open.pop(key, None)) is not None:
            hand_on_result(*entry)

    def _report_unnoticed_ends(self) -> None:
        """Report tasks that had already ended at the last check,
        but for which Dask's callback has not come.
        """
        # The callback of a task may still be on its way, so leave it the time until the next check.
        ended = {key for key, (future, _) in list(self._open.items()) if future.status != "pending"}
        for key in ended & self._ended:
            log.info("a task had ended unnoticed: %s", key)
            self._end(key)
        self._ended = ended

    def _join_again(self) -> None:
        """Join the scheduler with a new client, as a restarted one knows neither the old client nor
        its tasks. Do nothing if the pool is closing.

        A Dask client that reconnects by itself loses its subscription to events, so it is replaced,
        too. Closing the old client cancels its tasks: ``hand_on_result`` reports each of them by
        WorkersAwayError, and the baker has them done again. Raises OSError if the scheduler is not
        found within REJOIN_SECONDS.
        """
        if self._closing.is_set():
            return
        with suppress(Exception):  # one that looks for its scheduler may not close in time
            self._client.close(timeout=CHECK_SECONDS)
        with dask.config.set(SETTINGS):
            self._client = self._connect(f"{REJOIN_SECONDS:g}s")
        log.warning(
            "the scheduler at %s is back, with %d workers", self._scheduler, len(self._addresses)
        )
        self._workers_changed()

    def _list_workers(self) -> None:
        """Count the present workers, by a request to the scheduler."""
        found = addresses(self._client)
        self._deaths += len(self._addresses - found)
        self._addresses = found
        self._workers_changed()


def addresses(client: Client) -> frozenset[str]:
    """Return the addresses of the workers of a client's scheduler."""
    return frozenset(client.scheduler_info(n_workers=-1)["workers"])


def hand_on_result(ended: "Future[Any]", done: Done) -> None:
    """Call ``done`` with the result or the error of a future.

    A result stays with its worker until it is fetched here. If that worker dies in between, Dask
    runs the task again; fetching waits for that, or raises its error.
    """
    try:
        result = ended.result()
    except KilledWorker:
        done(None, LostWorkerError("the process that was to bake it died."))
    except Exception as error:
        # An error of the task itself is passed on; any other means that the worker or the scheduler
        # is gone.
        own = ended.status == "error"
        done(None, error if own else WorkersAwayError(f"The workers were lost: {error}"))
    else:
        done(result, None)
