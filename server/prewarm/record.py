"""The record of a prewarm: a file beside the light, and the summary of what it came to."""

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
from server.prewarm.baking import PrewarmContext, Step
from server.prewarm.order import PrewarmOrder
from server.progress import left_text
from server.render.jobs import Status, now
from server.schemas import TimeLeftSchema
from server.values import span
from worker.progress import TimeLeft

MOST_FAILURES = 100
"""Failures that are listed one by one; the rest is counted."""


class Errors(BaseModel):
    """The total relative errors of the pictures: of the views, or of those that stand for whole
    isosurfaces.
    """

    worst: float
    mean: float


class Failure(BaseModel):
    """A chunk (z, y, x) that could not be baked, and why."""

    chunk: tuple[int, int, int]
    reason: str


class Summary(BaseModel):
    """What a prewarm had to do, and what it did.

    ``chunks``, ``texels`` without light, ``refined`` texels with some and ``bytes`` before
    compression are what was lacking at the start; ``stored_bytes`` is what these chunks take in the
    store. ``final`` is the share of the views' surface that is final, or the share of the texels of
    whole isosurfaces that have as many samples as pictures of it need; ``error`` is the worst of
    ``errors``. ``paths`` and ``processor_seconds`` were spent on these chunks, ``seconds`` passed
    meanwhile; ``time_left`` is the forecast at the start. ``stopped`` says what ended it. A dry run
    forecasts ``stored_bytes`` and ``processor_seconds``. ``time`` is the step of a series that was
    gone through.
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
        """For a person, on one line."""
        if self.views:
            what = f"{self.views:,} views"
        else:
            what = "whole isosurfaces"
        share = f"{what}, {self.final:.1%} of their {'surface' if self.views else 'texels'} final"
        if self.time is None:
            step = ""
        else:
            step = f"step {self.time}: "
        quality = f"{step}{share} at {self.target_error:g}"
        if self.stopped == "dry run":
            return f"{quality}; {self._ahead()}"
        return f"{quality}, {self._done()}"

    def _ahead(self) -> str:
        size = (
            f"{self.bytes / 1e6:.1f} MB before compression, about "
            f"{self.stored_bytes / 1e6:.1f} MB after"
        )
        rest = f"and {self.refined:,} to be refined, in {self.chunks:,} chunks"
        left = left_text(TimeLeft(**self.time_left.model_dump()))
        lacking = f"to bake: {self.texels:,} texels without light ({size}) {rest}"
        return f"{lacking}; time with --workers {self.workers}: {left}"

    def _done(self) -> str:
        forecast = span(self.time_left.likely, digits=2)
        done = (
            f"{self.paths:,} paths in {span(self.seconds)} (forecast: {forecast}), worst "
            f"error {self.error:.2g}"
        )
        if self.failures:
            wrong = f"; {self.failed:,} chunks cannot be baked: {self.failures[0].reason}"
        else:
            wrong = ""
        return f"{done}{wrong}" + (f"; {self.file}" if self.file else "")


def failures_of(reasons: Sequence[tuple[tuple[int, int, int], str]]) -> tuple[Failure, ...]:
    """The first of the failures."""
    return tuple(Failure(chunk=chunk, reason=reason) for chunk, reason in reasons[:MOST_FAILURES])


log = logging.getLogger("isogi.server")

RECORDS_FOLDER = "jobs"
"""The folder of records beside the light."""

BEAT = 5.0
"""Seconds between two updates of a record, while a process works on its prewarm."""

THIS_PROCESS = f"{socket.gethostname()}/{os.getpid()}/{uuid4().hex}"
"""This process: its machine, its number there, and a name that no other has had."""

OPEN_STATES = (Status.ACCEPTED, Status.RUNNING)
"""States of a prewarm that a process works on, or did when it was killed."""


class RecordDocument(BaseModel):
    """What a record holds. Prewarms ``by`` a server are taken up by servers; ``worker`` is the last
    process at it. ``owner`` names the token that asked for it.

    ``scene_digest`` names all that the light depends on; ``progress`` is in percent, and ``spent``
    are the seconds that this worker has worked on it. Texels of whole isosurfaces are to have as
    many samples as ``rung``, as far as pictures have told.
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
        """Whether there is something to go on with."""
        return self.status is not Status.SUCCESSFUL or (
            self.summary is not None and self.summary.stopped != "target"
        )

    @property
    def rest(self) -> PrewarmOrder:
        """The order, with what is left of its time."""
        if self.order.deadline is None:
            return self.order
        return self.order.model_copy(
            update={"deadline": max(self.order.deadline - self.spent, 0.0)}
        )

    @property
    def left(self) -> bool:
        """Whether its process is known to have ended before the prewarm did, without being asked to
        stop.
        """
        return self.status in OPEN_STATES and gone(self.worker)


def gone(worker: str) -> bool:
    """Whether a worker is a process of this machine that ended; False where that cannot be
    known.
    """
    machine, number, _ = worker.split("/")
    if machine != socket.gethostname():
        return False
    if int(number) == os.getpid():
        return worker != THIS_PROCESS
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return True
    except OSError:
        pass
    return False


class Record:
    """One prewarm's ``document`` in a store. Call from no event loop: it blocks."""

    def __init__(
        self,
        store: StoreLike,
        scene: Scene,
        order: PrewarmOrder,
        by: Literal["command", "server"],
        owner: str = "",
    ) -> None:
        """Write nothing yet. A deadline is not part of the name, which is the same for the same
        light.
        """
        digest = order.digest(scene)
        self.document = RecordDocument(
            id=digest, scene=scene.id, scene_digest=scene.digest, by=by, owner=owner, order=order
        )
        self._store = store
        self._documents = Documents(store, RECORDS_FOLDER)
        self._begun = time.monotonic()
        self._written = -BEAT

    @property
    def place(self) -> str:
        """The path of its file in the store."""
        return self._documents.path_of(self.document.id)

    def follow(self, context: PrewarmContext) -> None:
        """Go on where an earlier prewarm of this order was, and keep how far this one climbs.
        Raises StoreError.
        """
        former = [
            each.rung for each in recorded_prewarms(self._store) if each.id == self.document.id
        ]
        context.rung = max(context.rung, *former, FIRST_LEVEL)
        context.climbed = lambda rung: self.keep(rung=rung)
        self.document = self.document.model_copy(update={"rung": context.rung})

    @contextmanager
    def kept(
        self, context: PrewarmContext, stopped: str, lasting: Callable[[], bool] = lambda: False
    ) -> Iterator[None]:
        """Keep how far a prewarm is meanwhile, and why it ended where that is early.

        Of one that was ``stopped`` it keeps this message, or nothing where it is ``lasting``: the
        next server goes on.
        """
        self.follow(context)
        self.keep(status=Status.RUNNING)
        draw = context.report

        def report(step: Step) -> None:
            draw(step)
            self.report(step)

        context.report = report
        try:
            yield
        except (Cancelled, KeyboardInterrupt):
            if not lasting():
                self.keep(status=Status.DISMISSED, message=stopped)
            raise
        except Exception as error:
            with suppress(StoreError):
                self.keep(status=Status.FAILED, message=str(error))
            raise

    def report(self, step: Step) -> None:
        """Say how far it is; kept when some time has passed. A store that does not take it costs no
        more than that.
        """
        if time.monotonic() - self._written >= BEAT:
            try:
                self.keep(status=Status.RUNNING, message=str(step), progress=int(100 * step.share))
            except StoreError as error:
                self._written = time.monotonic()
                log.warning("How far a prewarm is cannot be kept: %s", error)

    def close(self, summary: Summary) -> Summary:
        """Write the end down; the summary with its place. Raises StoreError."""
        summary = summary.model_copy(update={"file": self.place})
        if summary.failed:
            status = Status.FAILED
        else:
            status = Status.SUCCESSFUL
        self.keep(status=status, message=str(summary), progress=100, summary=summary)
        return summary

    def keep(self, **facts: object) -> None:
        """Write the document with new facts. Raises StoreError."""
        signs = {"updated": now(), "worker": THIS_PROCESS, "spent": time.monotonic() - self._begun}
        self.document = self.document.model_copy(update={**facts, **signs})
        self._documents.write(self.document.id, self.document.model_dump(mode="json"))
        self._written = time.monotonic()


def recorded_prewarms(store: StoreLike) -> Iterator[RecordDocument]:
    """The prewarms recorded in a store; records that cannot be read are logged and left out. Raises
    StoreError.
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
    """The latest prewarm of a scene that did not end; None where there is none."""
    found = [
        each
        for each in recorded_prewarms(store)
        if each.scene_digest == scene.digest and each.unfinished
    ]
    return max(found, key=lambda each: each.updated, default=None)
