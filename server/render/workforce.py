"""The workforce: hired workers, the kernels that they wait for, and what the machine gives; why
none of them bakes.
"""

import logging
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from isogi_core.cache.chunk_store import default_store
from isogi_core.errors import IsogiError, StoreError, StoreReadOnlyError
from isogi_core.frame.entry_kernels import first_kernels, frame_kernels, other_kernels
from isogi_core.kernels._cache_folder import prune_folders
from isogi_core.kernels._compilation import COMPILER_NICENESS, Compilation, KernelProgress, warm
from isogi_core.kernels._jit import KERNEL_FOLDER, READ_ONLY_FOLDER, load
from isogi_core.plan.scene import Scene
from isogi_core.storage.backend import StoreUrl
from isogi_core.storage.folder import Copies
from isogi_core.storage.store import Store, StoreLike
from server.progress import about_left
from server.settings import Settings
from worker import pool
from worker.baker import Baker
from worker.errors import WorkersAwayError, WorkersError
from worker.fork_server import START_METHOD, start_fork_server
from worker.tasks import bake_kernels

log = logging.getLogger("isogi.server")

MEMORY_STORE_UNSEEN = (
    "A store in memory is seen by no worker process: name a folder or an object store."
)

WORKERS_STARTING = "The workers are starting."

SCHEDULER_RETRY_SECONDS = 2.0
"""Seconds after which a scheduler that was not there when the server began is tried again."""


def scheduler_of(settings: Settings) -> str | None:
    """The address of the scheduler to join, which from now on is shown the certificate that the
    settings name.
    """
    authority, certificate, key = settings.certificates
    if authority and certificate and key:
        from worker.dask_pool import show_certificate  # noqa: PLC0415 (loads Dask)

        show_certificate(str(authority), str(certificate), str(key))
    return settings.scheduler


class Workforce:
    """The workers that a ``baker`` works with. Safe to use from many threads."""

    def __init__(self, baker: Baker, store: StoreUrl, workers: int, scheduler: str | None) -> None:
        """Hire none yet: ``workers`` processes of this machine, or those of a ``scheduler``, for
        light in a store.
        """
        self._baker = baker
        self._store = store
        self._workers = workers
        self._scheduler = scheduler
        self._pool: pool.WorkerPool | None = None
        self._hiring: threading.Thread | None = None
        self._stopped = threading.Event()
        self._error: IsogiError | None = None
        self.late = False
        """Whether they come after kernels are compiled: pictures are drawn before that, and they
        are not missed.
        """

    @property
    def joins(self) -> bool:
        """Whether the workers are those of a scheduler, which may lack the scenes' files."""
        return self._scheduler is not None

    def hire(self, kinds: Collection[str]) -> None:
        """Have the workers come, once, in a thread; kernels that bake layers of these ``kinds``
        come first.
        """
        if self._hiring is None:
            self._hiring = threading.Thread(
                target=self._hire, args=[kinds], name="hiring", daemon=True
            )
            self._hiring.start()

    def wait(self, seconds: float) -> bool:
        """Whether the workers have come, or cannot, after so many seconds at most."""
        if self._hiring is not None:
            self._hiring.join(seconds)
        return self._hiring is None or not self._hiring.is_alive()

    @property
    def missing(self) -> str:
        """Why there are no workers; empty where they are here, or may still come."""
        if self._error is None:
            return ""
        return str(self._error)

    @property
    def trouble(self) -> str:
        """Why nothing is baked at the moment; empty when all is well."""
        if self._pool is None:
            return self.missing or ("" if self.late else WORKERS_STARTING)
        return self.missing or self._pool.trouble

    @property
    def preparing(self) -> str:
        """What the workers do before they can bake, where they do: they start, or compile kernels;
        else empty.
        """
        if self._pool is None:
            if self._hiring is not None and self._error is None:
                return WORKERS_STARTING
            return ""
        return self._pool.preparing

    def close(self) -> None:
        """Stop hiring, and the workers."""
        self._stopped.set()
        if self._hiring is not None:
            self._hiring.join()
        if self._pool is not None:
            self._pool.close()

    def _hire(self, kinds: Collection[str]) -> None:
        """Have the workers come; a scheduler that is not there yet is waited for."""
        while not self._stopped.is_set():
            try:
                self._employ(kinds)
                self._error = None
                return
            except IsogiError as error:
                if self._stopped.is_set():
                    return
                self._error = error
                log.error("%s", error)
            except Exception as error:
                self._error = WorkersError(f"Cannot start the workers: {error}")
                log.exception("%s", self._error)
            if not isinstance(self._error, WorkersAwayError):
                return
            self._stopped.wait(SCHEDULER_RETRY_SECONDS)

    def _employ(self, kinds: Collection[str]) -> None:
        if self._store.scheme == "memory":
            raise WorkersError(MEMORY_STORE_UNSEEN)
        self._pool = pool.start_pool(self._workers, self._scheduler, kinds, self._stopped)
        self._pool.attend(self._baker.stir)
        self._baker.employ(self._pool)
        self._baker.prepare()


FINER = 5
"""How many times less memory finer texels have: few views ask for them, and those that find no room
do without.
"""


class Memory(NamedTuple):
    """Bytes of decoded ``light``, of ``views`` (surfaces, and where the light in them is) and of
    ``maps``.
    """

    light: int
    views: int
    maps: int

    @property
    def finer(self) -> "Memory":
        """Memory of the scene with finer texels, which has the same maps: all steps together take a
        quarter more.
        """
        return Memory(self.light // FINER, self.views // FINER, self.maps)


def shared(total: int) -> Memory:
    """A memory of ``total`` bytes: half of it for light, and a quarter each for views and for
    maps.
    """
    quarter = total // 4
    return Memory(total - 2 * quarter, quarter, quarter)


FINDING_SECONDS = 5.0
"""Seconds for which a finding stands: probes come often, and from many."""

PROBE_SECONDS = 0.5
"""Seconds that a probe waits for the store: it answers whatever the store does."""


class StoreProbe:
    """Looks for a store's sentinel, and tries whether it could be written. Safe to use from many
    threads.
    """

    def __init__(self, store: StoreLike, clock: Callable[[], float] = time.monotonic) -> None:
        """Probe ``store`` when it is asked for the first time."""
        self._root = Store.of(store)
        self._clock = clock
        self._lock = threading.Lock()
        self._found = self._silent()
        self._until = -1.0
        self._late = -1.0
        self._looking: threading.Thread | None = None

    def reasons(self) -> list[str]:
        """Why light cannot be read or kept; none where it can, or where the store is one that is
        only read.

        Looked up at most every ``FINDING_SECONDS`` seconds, in a separate thread: a store that
        hangs holds nobody. What was found before stands for as long again.
        """
        with self._lock:
            if self._looking is None and self._clock() >= self._until:
                self._late = self._clock() + FINDING_SECONDS
                self._looking = threading.Thread(target=self._look_up, name="probe", daemon=True)
                self._looking.start()
            looking = self._looking
        if looking is not None:
            looking.join(PROBE_SECONDS)
        with self._lock:
            late = self._looking is not None and self._clock() >= self._late
            return self._silent() if late else self._found

    def _silent(self) -> list[str]:
        return [f"The store at {self._root.url} does not answer."]

    def _look_up(self) -> None:
        """Note what is found."""
        found = self._look()
        with self._lock:
            self._until = self._clock() + FINDING_SECONDS
            self._found = found
            self._looking = None

    def _look(self) -> list[str]:
        try:
            self._root.check_writable()
        except StoreReadOnlyError:
            return []
        except StoreError as error:
            return [str(error)]
        return []


def existing_store(settings: Settings) -> Store:
    """The store of the settings, for its upkeep. Raises StoreError where there is none."""
    place = place_of(settings)
    if place.scheme == "file" and not place.folder.is_dir():
        raise StoreError(
            f"There is no store at {place}: name the folder or URL that light was baked into."
        )
    store = Store(place, make=False)
    store.open()
    return store


def root_of(settings: Settings) -> Store:
    """The root of the light that a server of these settings reads and has baked. Raises
    StoreError.
    """
    place = place_of(settings)
    keeps = place.remote and settings.store_cache_mb > 0
    return Store(place, copies=Copies(place.url, settings.store_cache_mb << 20) if keeps else None)


def place_of(settings: Settings) -> StoreUrl:
    """The place that the settings name."""
    url = settings.store or str(default_store())
    return whereabouts(StoreUrl(url, settings.store_seconds, settings.store_retries))


def whereabouts(place: StoreUrl) -> StoreUrl:
    """A place whose folder is an absolute path, a URL as it is: workers may stand elsewhere."""
    if "://" in place.url:
        return place
    return replace(place, url=str(Path(place.url).resolve()))


KERNELS_ELSEWHERE = (
    "The folder of compiled kernels %s cannot be written: what it lacks is compiled into %s."
)
COMPILATION_PROGRESS = "Compiling, once on this machine: {done} of {total}"


class SceneKernels:
    """What pictures of the ``scenes``, and bakes of their light, call. Work ends early once
    ``stopped`` is set.
    """

    def __init__(self, scenes: Callable[[], Collection[Scene]], stopped: threading.Event) -> None:
        """Compile nothing yet. ``scenes`` gives those that are shown at the moment."""
        self._scenes = scenes
        self._stopped = stopped
        self.kinds = {kind for each in scenes() for kind in each.bakes}
        lit = *frame_kernels(scenes(), surveyed=False), *bake_kernels(self.kinds)
        self._lit = (*first_kernels(scenes()), *lit)
        self._all = Compilation(first_kernels(scenes()), self._lit)
        self._admitted: tuple[Compilation, list[Any]] | None = None

    @property
    def progress(self) -> KernelProgress | None:
        """How far the kernels of pictures and their light are compiled, or else of the scene that
        was admitted last; None where this machine has them all.
        """
        own = self._all.progress(self._lit)
        admitted = self._admitted
        return own or (admitted[0].progress(admitted[1]) if admitted else None)

    @property
    def compiling(self) -> str:
        """``progress`` for a person; empty where this machine has them all."""
        progress = self.progress
        if progress is None:
            return ""
        far = COMPILATION_PROGRESS.format(done=progress.done, total=progress.total)
        return ", ".join(filter(None, (far, about_left(progress.seconds)))) + "."

    def first(self) -> None:
        """Have kernels of pictures without light in this process; the others begin to be
        compiled.
        """
        if self.progress is not None:
            start_fork_server()
        self._all.begin(self._stopped, COMPILER_NICENESS, START_METHOD)
        self._all.wait(first_kernels(self._scenes()))
        load(first_kernels(self._scenes()), self._stopped)

    def light(self) -> None:
        """Have kernels of pictures with light in this process, and those of bakes on this
        machine.
        """
        self._all.wait(self._lit)
        load(frame_kernels(self._scenes()), self._stopped)
        prune_folders(KERNEL_FOLDER)
        if READ_ONLY_FOLDER is not None:
            log.info(KERNELS_ELSEWHERE, READ_ONLY_FOLDER, KERNEL_FOLDER)

    def others(self) -> None:
        """Have kernels of pictures without light from texels, and of whole paths, in this
        process.
        """
        warm(other_kernels(self._scenes()), self._stopped, COMPILER_NICENESS)

    def admit(self, scene: Scene) -> None:
        """Have kernels of pictures of one more scene in this process."""
        kernels = list(frame_kernels([scene]))
        work = Compilation(kernels)
        self._admitted = work, kernels
        work.begin(self._stopped)
        work.wait(kernels)
        load(kernels, self._stopped)
