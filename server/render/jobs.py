"""Jobs: work that goes on when its request has been answered. They live in memory, as long as the
server does.

Files that exports have made are kept meanwhile, within a quota. Prewarms besides have records
beside the light, by which a server that starts takes them up.
"""

from __future__ import annotations

import asyncio
import logging
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Container, Coroutine, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Any
from uuid import uuid4

from pydantic import BaseModel

from isogi_core.errors import IsogiError
from isogi_core.storage.atomic_file import PARTIAL_SUFFIX
from server.errors import BusyError, FullError, UnknownJobError, UnknownResultError
from server.render.scheduling import AdmissionLimit, Place
from worker.progress import Promise, TimeLeft

log = logging.getLogger("isogi.server")

ENDED_JOB_TIME = timedelta(hours=1)
"""Time for which a job that has ended is known."""

MOST_KEPT = 1000
"""Jobs that have ended and are known, at most; the oldest are forgotten first."""

JOB_STOPPED = "The server stopped: ask again, light that was baked is kept."


class Status(StrEnum):
    """How far a job is, in the words of OGC API Processes."""

    ACCEPTED = "accepted"
    RUNNING = "running"
    SUCCESSFUL = "successful"
    FAILED = "failed"
    DISMISSED = "dismissed"


@dataclass(frozen=True)
class Result:
    """What a job has made: the address ``href`` of a ``type``, in a few words the ``title``."""

    href: str
    type: str
    title: str


def now() -> datetime:
    """The present time."""
    return datetime.now(UTC)


@dataclass(eq=False)
class Job:
    """One piece of work of a ``process``, such as "frame"; the ``title`` says what of. It belongs
    to its ``owner``.

    ``progress`` is in percent and never falls. Work says how far it is by ``report``; a
    ``document`` that it leaves is the job's own result.
    """

    process: str
    title: str
    id: str = field(default_factory=lambda: str(uuid4()))
    owner: str = ""
    status: Status = Status.ACCEPTED
    message: str = "This begins soon."
    progress: int = 0
    results: tuple[Result, ...] = ()
    document: BaseModel | None = None
    created: datetime = field(default_factory=now)
    started: datetime | None = None
    finished: datetime | None = None
    updated: datetime = field(default_factory=now)
    promise: Promise | None = field(default=None, repr=False)

    @property
    def time_left(self) -> TimeLeft | None:
        """The time that the rest takes, as it is reported now; None if that is unknown."""
        if self.promise is None:
            return None
        return self.promise.now

    @property
    def expires(self) -> datetime | None:
        """When it is forgotten; None before its end."""
        if self.finished is None:
            return None
        return self.finished + ENDED_JOB_TIME

    def report(self, share: float, message: str, left: TimeLeft | None = None) -> None:
        """Say that so large a share is done, and the time that the rest takes."""
        self.progress = max(self.progress, int(100 * share))
        self.message = message
        if left is None:
            self.promise = None
        else:
            self.promise = self.promise or Promise()
            self.promise.kept(left)
        self.updated = now()

    def begin(self) -> None:
        """Mark the job as running."""
        self.status = Status.RUNNING
        self.started = now()

    def end(self, status: Status, message: str, results: Iterable[Result] = ()) -> None:
        """No more is done for it. The first end counts."""
        if self.finished is not None:
            return
        self.report(1.0 if status is Status.SUCCESSFUL else 0.0, message)
        self.status = status
        self.finished = self.updated
        self.results = tuple(results)


Work = Callable[[Job], Coroutine[Any, Any, Iterable[Result]]]
"""What a job does, and its results. It is cancelled when the job is dismissed, and what it raises
is why it failed.
"""


class Jobs:
    """At most so many jobs at once; each may be dismissed. For one event loop alone."""

    def __init__(self, most: int) -> None:
        """Have none yet."""
        self._limit = AdmissionLimit(most, "jobs are at work", work=True)
        self.closed = False
        self._jobs: dict[str, Job] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}

    def begin(
        self,
        process: str,
        title: str,
        work: Work,
        key: str | None = None,
        client: tuple[str, str] = ("", ""),
    ) -> Job:
        """A new job, whose work begins once the caller waits for something. Raises BusyError where
        there are enough.

        Its id is ``key`` where one is given; a job that has that id and has not ended is the answer
        then, whoever its owner is. The ``client`` that asks for it, its owner's name first, may
        take the place of another client's job, which is dismissed.
        """
        if (running := self.running(key)) is not None:
            return running
        place = self._limit.enter(client)
        owner = client[0]
        self._forget()
        if key is None:
            job = Job(process, title, owner=owner)
        else:
            job = Job(process, title, key, owner)
        self._jobs.pop(job.id, None)
        self._jobs[job.id] = job
        self._tasks[job.id] = task = asyncio.create_task(run_job(job, work, place))
        task.add_done_callback(lambda _: self._ended(job, place))
        return job

    def running(self, key: str | None) -> Job | None:
        """The job with this id, where it has not ended."""
        if key is not None and key in self._tasks:
            return self._jobs[key]
        return None

    def all(self) -> list[Job]:
        """All that are known, the newest first."""
        self._forget()
        return list(reversed(self._jobs.values()))

    def find(self, key: str) -> Job:
        """The job with this id; UnknownJobError where there is none."""
        self._forget()
        if key not in self._jobs:
            raise UnknownJobError(
                f"There is no job '{key[:64]}': /v1/jobs lists them all. A job is forgotten an "
                "hour after its"
                " end, and when the server stops."
            )
        return self._jobs[key]

    async def dismiss(self, key: str) -> Job:
        """End a job, and return once it has; one that has ended is forgotten. Raises
        UnknownJobError.
        """
        job = self.find(key)
        if job.finished is not None:
            del self._jobs[key]
            return job
        job.end(Status.DISMISSED, "This was dismissed.")
        await ended(self._tasks[key])
        return job

    def counts(self) -> dict[Status, int]:
        """How many there are of each status."""
        return dict.fromkeys(Status, 0) | Counter(job.status for job in list(self._jobs.values()))

    async def close(self) -> None:
        """End all of them."""
        self.closed = True
        for key in list(self._tasks):
            self._jobs[key].end(Status.DISMISSED, JOB_STOPPED)
        await asyncio.gather(*map(ended, self._tasks.values()))

    def _ended(self, job: Job, place: Place) -> None:
        self._limit.leave(place)
        del self._tasks[job.id]

    def _forget(self) -> None:
        """Forget what ended long ago, and the oldest of too much that has ended."""
        over = [job for job in self._jobs.values() if job.expires is not None]
        surplus = len(over) - MOST_KEPT
        present = now()
        for place, job in enumerate(over):
            if place < surplus or (job.expires is not None and job.expires <= present):
                del self._jobs[job.id]


async def run_job(job: Job, work: Work, place: Place) -> None:
    """Do the work of a job to one end or the other; it is dismissed where another client needs its
    ``place``.
    """
    job.begin()
    try:
        job.end(Status.SUCCESSFUL, "This is done.", await place.keep(work(job)))
    except BusyError as error:
        job.end(Status.DISMISSED if place.lost else Status.FAILED, str(error))
    except IsogiError as error:
        job.end(Status.FAILED, str(error))
    except Exception:
        log.exception("job %s (%s) failed", job.id, job.title)
        job.end(Status.FAILED, "The server failed on this job; its log says why.")


async def ended(task: asyncio.Task[None]) -> None:
    """Cancel a task; returns when it has ended."""
    task.cancel()
    await asyncio.wait({task})


EXPORT_TOO_LARGE = (
    "This export takes about {needed:,} MB, and this server keeps {quota:,} MB of exports "
    "(exports_mb): ask its"
    " operator for more, or use isogi export."
)
FILE_GONE = (
    "The file of the job '{job}' is not there: it is not made yet, or gave way to "
    "newer ones; export it again."
)
MEGABYTE = 1 << 20


class ExportFolder:
    """A temporary folder of at most ``quota`` bytes, with a folder for each job. ``turn`` is held
    to make a file.
    """

    def __init__(self, quota: int) -> None:
        """Make no folder yet; without a quota there are no exports."""
        self.quota = quota
        self.turn = asyncio.Lock()
        self._folder: Path | None = None

    def check(self, needed: int) -> None:
        """Raise FullError where a file of about so many bytes never fits."""
        if needed > self.quota:
            sizes = {"needed": -(-needed // MEGABYTE), "quota": self.quota // MEGABYTE}
            raise FullError(EXPORT_TOO_LARGE.format(**sizes))

    def place(self, job: str, name: str) -> Path:
        """Where the file of a job is to be made, under the name that it is fetched by."""
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="isogi-exports-"))
        (self._folder / job).mkdir(exist_ok=True)
        return self._folder / job / name

    def find(self, job: str) -> Path:
        """The file of a job. Raises UnknownResultError where there is none."""
        files = self._folder.glob(f"{job}/*") if self._folder else iter(())
        found = next((path for path in files if path.suffix != PARTIAL_SUFFIX), None)
        if found is None:
            raise UnknownResultError(FILE_GONE.format(job=job))
        return found

    def make_room(self, known: Container[str], needed: int) -> None:
        """Delete the files of jobs that are not ``known`` any more, and the oldest until so many
        bytes are free.
        """
        if self._folder is None:
            return
        aged = sorted(
            self._folder.iterdir(), key=lambda path: (path.name in known, path.stat().st_mtime)
        )
        sizes = {path: sum(file.stat().st_size for file in path.iterdir()) for path in aged}
        total = sum(sizes.values())
        for path, size in sizes.items():
            if total + needed > self.quota or path.name not in known:
                total -= size
                shutil.rmtree(path)

    def close(self) -> None:
        """Delete all of it."""
        if self._folder is not None:
            with suppress(OSError):
                shutil.rmtree(self._folder)
