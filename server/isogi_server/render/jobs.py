"""Jobs: work that goes on after its request is answered. Jobs live in memory, as long as the
server.

Files that exports make are kept in a folder, within a quota. Prewarms also leave records in the
store, from which a server that restarts resumes them.
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
from isogi_server.errors import BusyError, FullError, UnknownJobError, UnknownResultError
from isogi_server.render.scheduling import AdmissionLimit, Place
from isogi_worker.progress import Promise, TimeLeft

log = logging.getLogger("isogi.server")

ENDED_JOB_TIME = timedelta(hours=1)
"""Time for which a job is known after its end."""

MOST_KEPT = 1000
"""Jobs that are known after their end, at most; the oldest are forgotten first."""

JOB_STOPPED = "The server stopped: ask again, light that was baked is kept."


class Status(StrEnum):
    """The status of a job, in the words of OGC API Processes."""

    ACCEPTED = "accepted"
    RUNNING = "running"
    SUCCESSFUL = "successful"
    FAILED = "failed"
    DISMISSED = "dismissed"


@dataclass(frozen=True)
class Result:
    """A result of a job: the address ``href`` of a document of this media ``type``, and a short
    ``title``.
    """

    href: str
    type: str
    title: str


def now() -> datetime:
    """Return the present time, in UTC."""
    return datetime.now(UTC)


@dataclass(eq=False)
class Job:
    """A job of a ``process``, such as "frame"; the ``title`` names its subject. It belongs to its
    ``owner``.

    ``progress`` is in percent and never falls. Work reports its progress by ``report``; a
    ``document`` that it sets is served as the job's result.
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
        """Return the time that is left, as it is reported now; None if that is unknown."""
        if self.promise is None:
            return None
        return self.promise.now

    @property
    def expires(self) -> datetime | None:
        """Return the time at which the job is forgotten; None before its end."""
        if self.finished is None:
            return None
        return self.finished + ENDED_JOB_TIME

    def report(self, share: float, message: str, left: TimeLeft | None = None) -> None:
        """Set the ``share`` that is done, 0 to 1, a ``message``, and an estimate of the time
        that is ``left``.
        """
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
        """Mark the job as ended. Later calls change nothing."""
        if self.finished is not None:
            return
        self.report(1.0 if status is Status.SUCCESSFUL else 0.0, message)
        self.status = status
        self.finished = self.updated
        self.results = tuple(results)


Work = Callable[[Job], Coroutine[Any, Any, Iterable[Result]]]
"""The work of a job, which returns its results. It is cancelled if the job is dismissed; an
error that it raises fails the job.
"""


class Jobs:
    """The jobs of a server, a limited number at a time. For one event loop."""

    def __init__(self, most: int) -> None:
        """Allow ``most`` jobs that have not ended."""
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
        """Start a job and return it; its work begins when the caller next awaits. Raises BusyError
        if there are too many jobs.

        The job's id is ``key``, if given; a job with that id that has not ended is returned
        instead, whoever owns it. ``client`` is the owner's name and its address; the new job may
        take the place of another client's, which is dismissed: see ``AdmissionLimit``.
        """
        if (running := self.running(key)) is not None:
            return running
        place = self._limit.enter(client)
        owner = client[0]
        # Make room among ended jobs, and replace an ended job with the same id.
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
        """Return the job with this id if it has not ended, else None."""
        if key is not None and key in self._tasks:
            return self._jobs[key]
        return None

    def all(self) -> list[Job]:
        """Return all known jobs, the newest first."""
        self._forget()
        return list(reversed(self._jobs.values()))

    def find(self, key: str) -> Job:
        """Return the job with this id. Raises UnknownJobError if there is none."""
        self._forget()
        if key not in self._jobs:
            raise UnknownJobError(
                f"There is no job '{key[:64]}': /v1/jobs lists them all. A job is forgotten an "
                "hour after its"
                " end, and when the server stops."
            )
        return self._jobs[key]

    async def dismiss(self, key: str) -> Job:
        """End a job, and return when its work has ended; a job that had ended is forgotten.
        Raises UnknownJobError.
        """
        job = self.find(key)
        if job.finished is not None:
            del self._jobs[key]
            return job
        job.end(Status.DISMISSED, "This was dismissed.")
        await ended(self._tasks[key])
        return job

    def counts(self) -> dict[Status, int]:
        """Return the number of jobs of each status."""
        return dict.fromkeys(Status, 0) | Counter(job.status for job in list(self._jobs.values()))

    async def close(self) -> None:
        """Dismiss all jobs, and return when their work has ended."""
        # Work that is cancelled from now on reads this flag: a prewarm then leaves its record in
        # the store, so that the next server resumes it.
        self.closed = True
        for key in list(self._tasks):
            self._jobs[key].end(Status.DISMISSED, JOB_STOPPED)
        await asyncio.gather(*map(ended, self._tasks.values()))

    def _ended(self, job: Job, place: Place) -> None:
        """Free the place of a job whose task has ended."""
        self._limit.leave(place)
        del self._tasks[job.id]

    def _forget(self) -> None:
        """Forget jobs that ended long ago, and if too many have ended, those that began first."""
        over = [job for job in self._jobs.values() if job.expires is not None]
        surplus = len(over) - MOST_KEPT
        present = now()
        for place, job in enumerate(over):
            if place < surplus or (job.expires is not None and job.expires <= present):
                del self._jobs[job.id]


async def run_job(job: Job, work: Work, place: Place) -> None:
    """Run the work of a job, and end the job with its results or its error. The job is
    dismissed if another client takes its ``place``.
    """
    job.begin()
    try:
        job.end(Status.SUCCESSFUL, "This is done.", await place.keep(work(job)))
    except BusyError as error:
        # The place was lost to another client, or the work itself was refused.
        job.end(Status.DISMISSED if place.lost else Status.FAILED, str(error))
    except IsogiError as error:
        job.end(Status.FAILED, str(error))
    except Exception:
        log.exception("job %s (%s) failed", job.id, job.title)
        job.end(Status.FAILED, "The server failed on this job; its log says why.")


async def ended(task: asyncio.Task[None]) -> None:
    """Cancel a task, and return when it has ended."""
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
    """A temporary folder of at most ``quota`` bytes for the files that exports make, with a
    subfolder for each job.

    Hold ``turn`` to make a file: one is made at a time.
    """

    def __init__(self, quota: int) -> None:
        """Create no folder yet. A quota of 0 allows no exports."""
        self.quota = quota
        self.turn = asyncio.Lock()
        self._folder: Path | None = None

    def check(self, needed: int) -> None:
        """Raise FullError if a file of ``needed`` bytes exceeds the quota."""
        if needed > self.quota:
            sizes = {"needed": -(-needed // MEGABYTE), "quota": self.quota // MEGABYTE}
            raise FullError(EXPORT_TOO_LARGE.format(**sizes))

    def place(self, job: str, name: str) -> Path:
        """Return the path at which the file of a job is to be made; it is downloaded by this
        ``name``.
        """
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="isogi-exports-"))
        (self._folder / job).mkdir(exist_ok=True)
        return self._folder / job / name

    def find(self, job: str) -> Path:
        """Return the file of a job. Raises UnknownResultError if there is none, or it is not
        complete.
        """
        files = self._folder.glob(f"{job}/*") if self._folder else iter(())
        found = next((path for path in files if path.suffix != PARTIAL_SUFFIX), None)
        if found is None:
            raise UnknownResultError(FILE_GONE.format(job=job))
        return found

    def make_room(self, known: Container[str], needed: int) -> None:
        """Delete files until ``needed`` bytes are free: all files of jobs that are not
        ``known`` any more, then the oldest.
        """
        if self._folder is None:
            return
        # Files of forgotten jobs come first (False sorts before True), then older ones before
        # newer.
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
        """Delete the folder and all files in it."""
        if self._folder is not None:
            with suppress(OSError):
                shutil.rmtree(self._folder)
