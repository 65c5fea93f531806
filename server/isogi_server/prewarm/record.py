"""The record of a prewarm: a file next to the light,
with the order, its progress, and a summary of the result.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from typing import Literal
from uuid import uuid4

from pydantic import BaseModel, Field, ValidationError

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.errors import Cancelled, StoreError
from isogi_core.plan.scene import Scene
from isogi_core.storage.store import Documents, StoreLike
from isogi_server.prewarm.baking import PrewarmContext, Step
from isogi_server.prewarm.order import PrewarmOrder
from isogi_server.progress import left_text
from isogi_server.render.jobs import Status, now
from isogi_server.schemas import TimeLeftSchema
from isogi_server.values import span
from isogi_worker.progress import TimeLeft

MOST_FAILURES = 100
"""Number of failures that are listed one by one; the others are only counted."""


class Errors(BaseModel):
    """The total relative errors of the pictures:
    of the views, or of those that stand for whole isosurfaces.
    """

    worst: float
    mean: float


class Failure(BaseModel):
    """A chunk (z, y, x) that could not be baked, and the reason."""

    chunk: tuple[int, int, int]
    reason: str


class Summary(BaseModel):
    """A summary of the work that a prewarm had to do, and of its result.

    - ``chunks``, ``texels``, ``refined``, ``bytes``: chunks, texels without light, texels to
      refine, and bytes before compression that were lacking at the start.
    - ``stored_bytes``: bytes of these chunks in the store.
    - ``final``: share of the views' surface that is final; of whole isosurfaces, share of the
      texels that have as many samples as pictures of them need.
    - ``error``: the worst of ``errors``.
    - ``paths``, ``processor_seconds``: spent on these chunks; ``seconds`` passed meanwhile.
    - ``time_left``: the forecast at the start.
    - ``stopped``: the reason for the end.
    - ``time``: the step of a series.

    In a dry run, ``stored_bytes`` and ``processor_seconds`` are forecasts.
    """

    scene: str
    order: PrewarmOrder
    views: int
    isovalues: tuple[float, ...]
    ranges: tuple[tuple[float, float], ...]
    target_error: float
    chunks: int
    texels: int
    refined: int
    bytes: int
    stored_bytes: int
    workers: int
    final: float
    error: float
    errors: Errors
    time_left: TimeLeftSchema
    paths: int = 0
    seconds: float = 0.0
    processor_seconds: float = 0.0
    stopped: Literal["dry run", "target", "deadline", "failures"] = "dry run"
    failed: int = 0
    failures: tuple[Failure, ...] = ()
    file: str | None = None
    time: int | None = None

    def __str__(self) -> str:
        """Return the summary on one line, for a person."""
        if self.views:
            subject = f"{self.views:,} views, {self.final:.1%} of their surface"
        else:
            subject = f"whole isosurfaces, {self.final:.1%} of their texels"
        quality = f"{subject} final at {self.target_error:g}"
        if self.time is not None:
            quality = f"step {self.time}: {quality}"
        if self.stopped == "dry run":
            return f"{quality}; {self._ahead()}"
        return f"{quality}, {self._done()}"

    def _ahead(self) -> str:
        """Return the sentence about work that is still to do."""
        size = (
            f"{self.bytes / 1e6:.1f} MB before compression, about "
            f"{self.stored_bytes / 1e6:.1f} MB after"
        )
        rest = f"and {self.refined:,} to be refined, in {self.chunks:,} chunks"
        left = left_text(TimeLeft(**self.time_left.model_dump()))
        lacking = f"to bake: {self.texels:,} texels without light ({size}) {rest}"
        return f"{lacking}; time with --workers {self.workers}: {left}"

    def _done(self) -> str:
        """Return the sentence about work that was done."""
        forecast = span(self.time_left.likely, digits=2)
        done = (
            f"{self.paths:,} paths in {span(self.seconds)} (forecast: {forecast}), worst "
            f"error {self.error:.2g}"
        )
        parts = [done]
        if self.failures:
            parts.append(f"{self.failed:,} chunks cannot be baked: {self.failures[0].reason}")
        if self.file:
            parts.append(self.file)
        return "; ".join(parts)


def failures_of(reasons: Sequence[tuple[tuple[int, int, int], str]]) -> tuple[Failure, ...]:
    """Return the first MOST_FAILURES failures."""
    return tuple(Failure(chunk=chunk, reason=reason) for chunk, reason in reasons[:MOST_FAILURES])


log = logging.getLogger("isogi.server")

RECORDS_FOLDER = "jobs"
"""Folder of records in the store."""

BEAT = 5.0
"""Seconds between two updates of a record while a process works on its prewarm."""

THIS_PROCESS = f"{socket.gethostname()}/{os.getpid()}/{uuid4().hex}"
"""Name of this process: its machine, its process id, and a part that no other process has had."""

OPEN_STATES = (Status.ACCEPTED, Status.RUNNING)
"""States of a prewarm that a process works on, or was working on when it was killed."""


class RecordDocument(BaseModel):
    """The content of a record.

    - ``by``: prewarms by a server are continued by servers.
    - ``owner``: name of the token that asked for it.
    - ``scene_digest``: digest of everything that the light depends on.
    - ``progress``: in percent; ``spent``: seconds that ``worker``, the last process at it, has
      worked.
    - ``rung``: samples that texels of whole isosurfaces are to have, as far as pictures have shown.
    """

    format: Literal[1] = 1
    id: str
    scene: str
    scene_digest: str
    by: Literal["command", "server"]
    owner: str = ""
    order: PrewarmOrder
    status: Status = Status.ACCEPTED
    message: str = "This begins soon."
    progress: int = 0
    spent: float = 0.0
    rung: int = FIRST_LEVEL
    created: datetime = Field(default_factory=now)
    updated: datetime = Field(default_factory=now)
    worker: str = Field(default=THIS_PROCESS, pattern=r"^[^/]*/\d+/\w+$")
    ahead: Summary | None = None
    summary: Summary | None = None

    @property
    def unfinished(self) -> bool:
        """True if there is work to continue."""
        return self.status is not Status.SUCCESSFUL or (
            self.summary is not None and self.summary.stopped != "target"
        )

    @property
    def rest(self) -> PrewarmOrder:
        """The order, with the time that is left until its deadline."""
        if self.order.deadline is None:
            return self.order
        return self.order.model_copy(
            update={"deadline": max(self.order.deadline - self.spent, 0.0)}
        )

    @property
    def left(self) -> bool:
        """True if its process is known to have ended before the prewarm did,
        without being asked to stop.
        """
        return self.status in OPEN_STATES and gone(self.worker)


def gone(worker: str) -> bool:
    """Return True if the process ``worker``, which worked on a prewarm, ran on this machine and has
    ended; False if that cannot be known.
    """
    machine, number, _ = worker.split("/")
    if machine != socket.gethostname():
        return False
    # This process may have got the number of an earlier one, as is usual in containers.
    if int(number) == os.getpid():
        return worker != THIS_PROCESS
    # Signal 0 only checks that the process exists.
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return True
    except OSError:
        pass
    return False


class Record:
    """The record of one prewarm in a store. Methods block: do not call them in an event loop."""

    def __init__(
        self,
        store: StoreLike,
        scene: Scene,
        order: PrewarmOrder,
        by: Literal["command", "server"],
        owner: str = "",
    ) -> None:
        """Write nothing yet.

        The name does not depend on the deadline, so it is the same for the same light.
        """
        digest = order.digest(scene)
        self.document = RecordDocument(
            id=digest, scene=scene.id, scene_digest=scene.digest, by=by, owner=owner, order=order
        )
        self._store = store
        self._documents = Documents(store, RECORDS_FOLDER)
        self._begun = time.monotonic()
        # Monotonic time of the last try to write: the first step is due.
        self._tried = -BEAT

    @property
    def place(self) -> str:
        """The path or URL of its file in the store."""
        return self._documents.path_of(self.document.id)

    def follow(self, context: PrewarmContext) -> None:
        """Start the prewarm of a ``context`` with as many samples as pictures of an earlier prewarm
        of this order had needed, so that they need not be measured again; from then on, record each
        higher number that pictures ask for. Raises StoreError.
        """
        former = [
            each.rung for each in recorded_prewarms(self._store) if each.id == self.document.id
        ]
        context.rung = max(context.rung, *former, FIRST_LEVEL)
        context.rung_rose = lambda rung: self.keep(rung=rung)
        self.document = self.document.model_copy(update={"rung": context.rung})

    @contextmanager
    def recording(
        self, context: PrewarmContext, stopped: str, stays_open: Callable[[], bool] = lambda: False
    ) -> Iterator[None]:
        """Record the progress of the prewarm that runs in the block with a ``context``, and the
        reason if it ends early. Raises StoreError.

        If the block is cancelled, the record is closed with the message ``stopped``, unless
        ``stays_open()`` is true: the next server then finds it open, and continues the prewarm.
        """
        self.follow(context)
        self.keep(status=Status.RUNNING)
        show = context.report

        # Record each step of progress besides showing it.
        def report(step: Step) -> None:
            show(step)
            self.report(step)

        context.report = report
        try:
            yield
        except (Cancelled, KeyboardInterrupt):
            # A server that stops leaves its records open for the next one.
            if not stays_open():
                self.keep(status=Status.DISMISSED, message=stopped)
            raise
        except Exception as error:
            with suppress(StoreError):
                self.keep(status=Status.FAILED, message=str(error))
            raise

    def report(self, step: Step) -> None:
        """Record a step of progress if BEAT seconds have passed since the record was last written.

        If the store refuses it, log this, and record the first step that comes BEAT seconds later:
        baking goes on without a record.
        """
        if time.monotonic() - self._tried >= BEAT:
            try:
                self.keep(status=Status.RUNNING, message=str(step), progress=int(100 * step.share))
            except StoreError as error:
                self._tried = time.monotonic()
                log.warning("The progress of a prewarm cannot be recorded: %s", error)

    def close(self, summary: Summary) -> Summary:
        """Record the end, and return the summary with the record's place. Raises StoreError."""
        summary = summary.model_copy(update={"file": self.place})
        if summary.failed:
            status = Status.FAILED
        else:
            status = Status.SUCCESSFUL
        self.keep(status=status, message=str(summary), progress=100, summary=summary)
        return summary

    def keep(self, **facts: object) -> None:
        """Write the record with changed ``facts``. Raises StoreError."""
        signs = {"updated": now(), "worker": THIS_PROCESS, "spent": time.monotonic() - self._begun}
        self.document = self.document.model_copy(update={**facts, **signs})
        self._documents.write(self.document.id, self.document.model_dump(mode="json"))
        self._tried = time.monotonic()


def recorded_prewarms(store: StoreLike) -> Iterator[RecordDocument]:
    """Yield the prewarms recorded in a store.

    Records that cannot be read are logged and left out. Raises StoreError.
    """
    documents = Documents(store, RECORDS_FOLDER)
    for name in documents.names():
        try:
            yield RecordDocument.model_validate(documents.read(name))
        except (StoreError, ValidationError) as error:
            log.warning(
                "The record of a prewarm, %s, cannot be read: %s", documents.path_of(name), error
            )


def last_unfinished(store: StoreLike, scene: Scene) -> RecordDocument | None:
    """Return the latest unfinished prewarm of a scene; None if there is none."""
    found = [
        each
        for each in recorded_prewarms(store)
        if each.scene_digest == scene.digest and each.unfinished
    ]
    return max(found, key=lambda each: each.updated, default=None)
