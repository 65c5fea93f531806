"""The worker processes: a Dask cluster, of this machine's own or joined by its address."""

import logging
import os
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, cast

import dask.config
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from distributed import Client, Future, LocalCluster, Security, fire_and_forget
from distributed.scheduler import KilledWorker
from distributed.utils import get_mp_context

from isogi_core.model.scene_plan import ScenePlan
from worker.errors import LostWorkerError, WorkersAwayError, WorkersError
from worker.fork_server import START_METHOD, start_fork_server
from worker.niceness import Nice, Sessions, leads_session
from worker.tasks import (
    PLAIN_LAYER_KINDS,
    BakeResult,
    BakeTask,
    Outcome,
    attempt,
    bake,
    bake_all,
    kernels_missing,
    load_kernels,
)

CERTIFICATE_NAME = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "isogi")])

CERTIFICATE_LIFETIME = timedelta(days=36500)
"""How long a certificate is good: longer than any process. Dask's own temporary ones end after a
year.
"""

KEY_ENCODING = (
    serialization.Encoding.PEM,
    serialization.PrivateFormat.PKCS8,
    serialization.NoEncryption(),
)


def temporary_security() -> Security:
    """TLS for both sides of each connection, with a new key whose certificate is its own authority.

    Only who has the key can connect, and only to who has it. Workers have it through the pipe of
    their start.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = own_certificate(key).public_bytes(serialization.Encoding.PEM).decode()
    roles = ("client", "scheduler", "worker")
    return Security(
        require_encryption=True,
        tls_ca_file=certificate,
        **{f"tls_{role}_cert": certificate for role in roles},
        **{f"tls_{role}_key": key.private_bytes(*KEY_ENCODING).decode() for role in roles},
    )


def own_certificate(key: ec.EllipticCurvePrivateKey) -> x509.Certificate:
    """A certificate for a key, signed with that key."""
    begun = datetime.now(UTC) - timedelta(days=1)
    unsigned = x509.CertificateBuilder(
        CERTIFICATE_NAME, CERTIFICATE_NAME, key.public_key(), x509.random_serial_number()
    )
    period = unsigned.not_valid_before(begun).not_valid_after(begun + CERTIFICATE_LIFETIME)
    authority = x509.BasicConstraints(ca=True, path_length=0)
    return period.add_extension(authority, critical=True).sign(key, hashes.SHA256())


def show_certificate(authority: str, certificate: str, key: str) -> "dask.config.set":
    """Show a certificate to each scheduler that this process joins, and trust those of an
    ``authority``: PEM files.

    It is so from now on, or until the end of a ``with`` block of what is returned.
    """
    tls = "distributed.comm.tls"
    own = {f"{tls}.client.cert": certificate, f"{tls}.client.key": key}
    return dask.config.set(
        {f"{tls}.ca-file": authority, **own, "distributed.comm.require-encryption": True}
    )


CLIENT_CLOSE_SECONDS = 1.0
"""Seconds that closing a client may take that could not be made."""


class OwnClient(Client):
    """A client that the garbage collector never closes.

    Dask's own client takes a lock when it is collected. Where the same thread is making a client or
    a cluster then, and holds that lock, it waits for ever. A client that finds no scheduler is such
    garbage.
    """

    def __init__(self, address: "str | LocalCluster | None", timeout: str) -> None:
        """Join a scheduler by its address, or a cluster; OSError where none is found within the
        ``timeout``.
        """
        try:
            super().__init__(address, timeout=timeout, set_as_default=False)  # type: ignore[no-untyped-call]
        except BaseException:
            with suppress(Exception):
                self.close(timeout=CLIENT_CLOSE_SECONDS)  # type: ignore[no-untyped-call]
            raise

    def __del__(self) -> None:
        """Close nothing."""


MAX_TASK_TEXELS = 2048
"""Most texels of a task: at 1024 and more their paths fill whole waves."""

TASKS_AHEAD = 2
"""Tasks in flight per worker: few, as a task in flight can be neither re-ordered nor stopped."""

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
"""Settings of Dask. A worker's death ends all its tasks, and the queue tries each again.

By default Dask observes itself a hundred times a second: 5 % of a core with one idle worker. So set
it takes 1 %.
"""

CLUSTER_SETTINGS = {
    "distributed.deploy.lost-worker-timeout": "10000 days",
    "distributed.worker.multiprocessing-method": START_METHOD,
}
"""Set for the life of the process, as Dask reads them at each death. A cluster dismisses the nanny
of a worker that is missing so long after a death; with the default 15 s also of one that came back
and died once more."""

CHECK_SECONDS = 1.0
REJOIN_SECONDS = 5.0
"""Seconds between two checks of the scheduler, and seconds that a try to join it again may take."""

WORKERS_COMPILE = "The workers compile their kernels."

WORKERS_LOST = "The worker processes are gone: restart the server."
SCHEDULER_AWAY = (
    "The scheduler at {scheduler} cannot be reached at the moment: baking goes on "
    "when it is there again."
)
NO_WORKER_JOINED = (
    "No worker has joined the scheduler at {scheduler}: start one with 'dask "
    "worker', see docs/cluster.md."
)

log = logging.getLogger("isogi.worker")

Done = Callable[[BakeResult | None, BaseException | None], None]
AllDone = Callable[[Sequence[BakeResult | BaseException]], None]


class WorkerPool:
    """Worker processes. Those started here load the kernels of bakes at once, ahead of their first
    task.

    Workers that are joined may run on other machines, and load kernels when they start: see
    ``worker.tasks.dask_setup``. They and their scheduler may come and go: a thread of the pool
    follows that.
    """

    def __init__(
        self, workers: int, scheduler: str | None = None, kinds: Collection[str] = PLAIN_LAYER_KINDS
    ) -> None:
        """Start ``workers`` processes of one thread each, or join the ``scheduler``.

        Raises WorkersError, and WorkersAwayError where the scheduler is not there.

        Workers started here load the kernels that bake layers of these ``kinds`` at once, or
        compile them.
        """
        self._scheduler = scheduler
        self._cluster: LocalCluster | None = None
        self._addresses: frozenset[str] = frozenset()
        self._joined = ""
        self._deaths = 0
        self._sessions = Sessions(self._leaders)
        self._stir: Callable[[], None] = lambda: None
        self._moved = threading.Event()
        self._closing = threading.Event()
        self._open: dict[Any, tuple[Future[Any], Done]] = {}
        self._ended: set[Any] = set()
        self._kinds = set(kinds)
        self._baked = set[str]()
        try:
            with dask.config.set(SETTINGS):
                if scheduler is None:
                    self._cluster = start_cluster(workers)
                self._client = self._connect("30s")
                self.prepare(partial(load_kernels, tuple(kinds)))
        except Exception as error:
            if self._cluster is not None:
                self._cluster.close()
            kind = (
                WorkersAwayError
                if scheduler is not None and isinstance(error, OSError)
                else WorkersError
            )
            raise kind(f"Cannot start or reach the workers: {error}") from error
        self._keeper = threading.Thread(target=self._keep, name="workers", daemon=True)
        self._keeper.start()

    @property
    def workers(self) -> int:
        """Number of workers, at least 1, as tasks may wait for the first one."""
        return max(len(self._addresses), 1)

    @property
    def deaths(self) -> int:
        """Number of workers that were lost; one that is started in its place counts as new."""
        return self._deaths

    @property
    def room(self) -> int:
        """Most tasks in flight; none while the scheduler is away."""
        if self.connected:
            return TASKS_AHEAD * self.workers
        return 0

    @property
    def together(self) -> int:
        """Most texels of a task, of as many chunks as that takes."""
        return MAX_TASK_TEXELS

    @property
    def connected(self) -> bool:
        """Whether the scheduler can be reached."""
        return bool(self._client.status == "running")

    @property
    def trouble(self) -> str:
        """Why nothing is baked at the moment; empty when all is well."""
        if not self.connected:
            if self._scheduler:
                return SCHEDULER_AWAY.format(scheduler=self._scheduler)
            return WORKERS_LOST
        if not self._addresses:
            if self._scheduler:
                return NO_WORKER_JOINED.format(scheduler=self._scheduler)
            return WORKERS_LOST
        return ""

    @property
    def preparing(self) -> str:
        """What workers started here do before they can bake: they compile kernels that this machine
        lacks; else empty.

        Kernels of joined workers are not known here: those load them before they come.
        """
        lacking = self._kinds - self._baked
        if self._cluster is not None and not self.trouble and kernels_missing(lacking):
            return WORKERS_COMPILE
        return ""

    def attend(self, stir: Callable[[], None]) -> None:
        """Call ``stir``, from another thread, whenever workers have come or gone."""
        self._stir = stir

    def submit(self, task: BakeTask, done: Done) -> None:
        """Hand a task over; ``done`` is called from another thread with its result or its error."""
        self._send(bake, task, task.plan, done)

    def submit_all(self, tasks: Sequence[BakeTask], done: AllDone) -> None:
        """Hand tasks of one bake over, to be done together; ``done`` is called with the result or
        error of each.
        """

        def ended(outcomes: Sequence[Outcome] | None, error: BaseException | None) -> None:
            done(outcomes or [error or WorkersError("Nothing came of it.")] * len(tasks))

        self._send(bake_all, tasks, tasks[0].plan, ended)

    def prepare(self, work: Callable[[], object]) -> None:
        """Have each worker started here do some ``work`` ahead of its tasks; what fails then fails
        again with these.
        """
        if self._cluster is not None:
            with suppress(Exception):  # the client closed at this moment
                for address in self._addresses:
                    fire_and_forget(
                        self._client.submit(attempt, work, workers=[address], pure=False)
                    )

    def _send(
        self,
        work: Callable[[Any], Any],
        what: Any,
        plan: ScenePlan,
        done: Callable[[Any, Any], None],
    ) -> None:
        """Have a worker do some ``work`` on ``what``, by a plan."""
        self._kinds |= (kinds := {layer.kind for layer in plan.layers})
        try:
            future = self._client.submit(work, what, pure=False)
        except Exception as error:  # the client closed at this moment
            away = WorkersAwayError(f"The workers cannot be reached: {error}")
            threading.Thread(target=done, args=(None, away), daemon=True).start()
        else:
            self._open[future.key] = future, noting(done, partial(self._baked.update, kinds))
            future.add_done_callback(lambda ended: self._end(ended.key))

    def step_back(self, seconds: float) -> bool:
        """Lower the priority of the workers started here for so many seconds.

        Returns False where workers were joined: these are left as they are.
        """
        if self._cluster is None:
            return False
        self._sessions.step_back(seconds)
        return True

    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return list(self._client.run(os.getpid).values())

    def close(self) -> None:
        """Stop the workers that were started here, and leave those that were joined."""
        self._closing.set()
        self._moved.set()
        self._keeper.join()
        self._sessions.close()
        with suppress(
            Exception
        ):  # the scheduler may be away; else it would tell a client that leaves of its leaving
            self._client.unsubscribe_topic("all")
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def _leaders(self) -> list[int]:
        """The workers started here that lead sessions of their own, as they do soon after they were
        started.
        """
        if self._cluster is None:
            nannies = []
        else:
            nannies = list(self._cluster.workers.values())
        return [pid for pid in map(pid_under, nannies) if pid and leads_session(pid)]

    def _connect(self, timeout: str) -> Client:
        """Connect a client that hears of workers that come and go, and list the present ones;
        raises OSError.
        """
        client: Client = OwnClient(self._cluster or self._scheduler, timeout)
        try:
            client.register_plugin(Nice(apart=self._scheduler is None))
            client.subscribe_topic("all", self._on_event)
            self._addresses = addresses(client)
            self._joined = str(client.scheduler_info(n_workers=0)["id"])
        except BaseException:
            client.close(timeout=CHECK_SECONDS)
            raise
        return client

    def _on_event(self, event: tuple[float, Any]) -> None:
        """Note an event of the scheduler where workers came or went."""
        if isinstance(event[1], dict) and event[1].get("action") in ("add-worker", "remove-worker"):
            self._moved.set()

    def _keep(self) -> None:
        """Follow the workers: count them when some came or went, and join the scheduler again after
        it was lost.

        Events may be lost, so the number of workers is polled too.
        """
        while not self._closing.is_set():
            moved = self._moved.wait(CHECK_SECONDS)
            self._moved.clear()
            try:
                self._look_after()
                info = self._client.scheduler_info(n_workers=0) if self.connected else {}
                if info.get("id") != self._joined:
                    self._join_again()
                elif moved or info["n_workers"] != len(self._addresses):
                    self._count()
            except Exception as error:
                log.debug("the scheduler is away: %s", error)

    def _end(self, key: Any) -> None:
        """Report the end of a task to its submitter, once."""
        if (entry := self._open.pop(key, None)) is not None:
            hand_on_result(*entry)

    def _look_after(self) -> None:
        """Report tasks that had ended at the last check already, where Dask's own callback has not
        come.
        """
        ended = {key for key, (future, _) in list(self._open.items()) if future.status != "pending"}
        for key in ended & self._ended:
            log.info("a task had ended unnoticed: %s", key)
            self._end(key)
        self._ended = ended

    def _join_again(self) -> None:
        """Join the scheduler with a new client: a restarted one knows neither the old client nor
        its tasks.

        A Dask client that reconnects by itself has lost its subscription to events, so it is
        replaced too.
        """
        if self._cluster is not None or self._closing.is_set():
            return
        with suppress(Exception):  # one that looks for its scheduler may not close in time
            self._client.close(timeout=CHECK_SECONDS)
        with dask.config.set(SETTINGS):
            self._client = self._connect(f"{REJOIN_SECONDS:g}s")
        log.warning(
            "the scheduler at %s is back, with %d workers", self._scheduler, len(self._addresses)
        )
        self._stir()

    def _count(self) -> None:
        """Count the present workers; a round trip."""
        found = addresses(self._client)
        self._deaths += len(self._addresses - found)
        self._addresses = found
        self._stir()


def addresses(client: Client) -> frozenset[str]:
    """Addresses of the workers of a client's scheduler."""
    return frozenset(client.scheduler_info(n_workers=-1)["workers"])


def start_cluster(workers: int) -> LocalCluster:
    """Start worker processes on the loopback interface, forked from the fork server, without a
    dashboard.

    They speak TLS with a key of their own, as any user of the machine can reach loopback. Their
    environment is that of now, which may differ from the one that the fork server began with.

    Dask serves a health page all the same, on a free port: two servers must not compete for one.
    """
    dask.config.set(CLUSTER_SETTINGS)
    get_mp_context()  # where it is first called, Dask chooses what a fork server imports
    start_fork_server()
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        security=temporary_security(),
        dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False},
        memory_limit=None,
        silence_logs=50,
        env=dict(os.environ),
    )


def pid_under(nanny: Any) -> int | None:
    """The process id of a nanny's worker; None where it has none, or its worker ends at this
    moment.
    """
    try:
        return cast("int | None", nanny.pid)
    except AttributeError:
        return None


def noting(done: Done, baked: Callable[[], None]) -> Done:
    """``done``, and before it ``baked`` where there is a result."""

    def note(result: BakeResult | None, error: BaseException | None) -> None:
        if result is not None:
            baked()
        done(result, error)

    return note


def hand_on_result(ended: "Future[Any]", done: Done) -> None:
    """Call ``done`` with the result or the error of a future.

    A result stays with its worker until it is fetched here. Where that worker dies in between, Dask
    runs the task again; fetching waits for that, or raises its error.
    """
    try:
        result = ended.result()
    except KilledWorker:
        done(None, LostWorkerError("the process that was to bake it died."))
    except Exception as error:
        own = ended.status == "error"
        done(None, error if own else WorkersAwayError(f"The workers were lost: {error}"))
    else:
        done(result, None)
