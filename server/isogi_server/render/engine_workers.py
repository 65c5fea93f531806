"""The workers of an engine: started in a thread, with the reason if there are none."""

import logging
import threading
from collections.abc import Collection

from isogi_core.errors import IsogiError
from isogi_core.storage.backend import StoreUrl
from isogi_server.settings import Settings
from isogi_worker import pool
from isogi_worker.baker import Baker
from isogi_worker.errors import WorkersAwayError, WorkersError

log = logging.getLogger("isogi.server")


MEMORY_STORE_UNSEEN = (
    "A store in memory is seen by no worker process: name a folder or an object store."
)

WORKERS_STARTING = "The workers are starting."

SCHEDULER_RETRY_SECONDS = 2.0
"""Seconds after which a scheduler that cannot be reached is tried again."""


def scheduler_of(settings: Settings) -> str | None:
    """Return the address of the scheduler to join, if any, and register the certificates that
    the settings name for it.
    """
    authority, certificate, key = settings.certificates
    if authority and certificate and key:
        from isogi_worker.dask_pool import show_certificate  # noqa: PLC0415 (loads Dask)

        show_certificate(str(authority), str(certificate), str(key))
    return settings.scheduler


class EngineWorkers:
    """The workers of an engine: a pool that is started once, in a thread, and handed to the
    ``baker``. Safe to use from many threads.
    """

    def __init__(self, baker: Baker, store: StoreUrl, workers: int, scheduler: str | None) -> None:
        """Keep what ``start`` needs; no worker is started yet.

        The workers will be those of the ``scheduler`` with this address or, if it is None, as many
        processes of this machine as ``workers`` says. They bake light into the ``store``.
        """
        self._baker = baker
        self._store = store
        self._workers = workers
        self._scheduler = scheduler
        self._pool: pool.WorkerPool | None = None
        self._starting: threading.Thread | None = None
        self._stopped = threading.Event()
        self._error: IsogiError | None = None
        self.after_kernels = False
        """True if the workers are started only once kernels are compiled. Before they have started,
        pictures without light are drawn, and ``trouble`` does not report that there are no workers.
        """

    @property
    def joins(self) -> bool:
        """Return True if the workers are those of a scheduler, which may lack the scenes' files."""
        return self._scheduler is not None

    def start(self, kinds: Collection[str]) -> None:
        """Start the workers in a thread, once. Kernels that bake layers of these ``kinds`` are
        loaded first.
        """
        if self._starting is None:
            self._starting = threading.Thread(
                target=self._start_with_retries, args=[kinds], name="workers", daemon=True
            )
            self._starting.start()

    def wait(self, seconds: float) -> bool:
        """Return True if the workers have started, or failed to, after at most this many
        seconds.
        """
        if self._starting is not None:
            self._starting.join(seconds)
        return self._starting is None or not self._starting.is_alive()

    @property
    def missing(self) -> str:
        """Return the reason why the workers did not start; empty if they did or still may."""
        if self._error is None:
            return ""
        return str(self._error)

    @property
    def trouble(self) -> str:
        """Return the reason why nothing is baked at the moment; empty if all is well."""
        if self._pool is None:
            return self.missing or ("" if self.after_kernels else WORKERS_STARTING)
        return self.missing or self._pool.trouble

    @property
    def preparing(self) -> str:
        """Return a sentence if the workers still start or compile kernels before they can bake;
        else an empty text.
        """
        if self._pool is None:
            if self._starting is not None and self._error is None:
                return WORKERS_STARTING
            return ""
        return self._pool.preparing

    def close(self) -> None:
        """Stop the workers. A start that is in progress is awaited, and not tried again."""
        self._stopped.set()
        # Wait for the start first: a pool that it makes after this would never be closed.
        if self._starting is not None:
            self._starting.join()
        if self._pool is not None:
            self._pool.close()

    def _start_with_retries(self, kinds: Collection[str]) -> None:
        """Start the workers. Try again while a scheduler cannot be reached; any other error is
        final.
        """
        while not self._stopped.is_set():
            try:
                self._start_pool(kinds)
                self._error = None
                return
            except IsogiError as error:
                # A start that was stopped is no trouble.
                if self._stopped.is_set():
                    return
                self._error = error
                log.error("%s", error)
            except Exception as error:
                self._error = WorkersError(f"Cannot start the workers: {error}")
                log.exception("%s", self._error)
            # Only a scheduler that is not there yet is worth waiting for.
            if not isinstance(self._error, WorkersAwayError):
                return
            self._stopped.wait(SCHEDULER_RETRY_SECONDS)

    def _start_pool(self, kinds: Collection[str]) -> None:
        """Start the pool, and hand it to the baker. Raises WorkersError if the store is in
        memory, which other processes cannot see.
        """
        if self._store.scheme == "memory":
            raise WorkersError(MEMORY_STORE_UNSEEN)
        self._pool = pool.start_pool(self._workers, self._scheduler, kinds, self._stopped)
        # The pool calls the baker when workers come or return.
        self._pool.on_workers_changed(self._baker.dispatch)
        self._baker.use_pool(self._pool)
        self._baker.prepare()
