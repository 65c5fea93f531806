"""The record of a prewarm: a file beside the light, so that what was asked for is never lost.

What is baked the chunks say themselves, so that to go on is to begin again; the record says what was asked, by whom,
how far it came, and at the end the summary.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Iterator
from datetime import datetime
from typing import Literal
from uuid import uuid4

from pydantic import BaseModel, Field, ValidationError

from isogi_core.cache.documents import Documents
from isogi_core.cache.root import Where
from isogi_core.errors import StoreError
from isogi_core.model.scene import Scene
from server.jobs import Status, now
from server.prewarm.desk import Step
from server.prewarm.order import PrewarmOrder
from server.prewarm.summary import Summary

log = logging.getLogger("isogi.server")

FOLDER = "jobs"
"""The folder of records beside the light."""

BEAT = 5.0
"""Seconds between two signs of life of who works on a prewarm."""

WORKER = f"{socket.gethostname()}/{os.getpid()}/{uuid4().hex}"
"""Who this process is: its machine, its number there, and a name that no other has had."""

OPEN = (Status.ACCEPTED, Status.RUNNING)
"""How far a prewarm is that somebody works on, or did when it was killed."""


class Paper(BaseModel):
    """What a record holds. Prewarms ``by`` a server are taken up by servers; ``worker`` was the last who worked on it.

    ``scene_digest`` names all that the light depends on; ``progress`` is in percent, and ``spent`` are the seconds that
    this worker has worked on it.
    """

    format: Literal[1] = 1
    id: str
    scene: str
    scene_digest: str
    by: Literal["command", "server"]
    order: PrewarmOrder
    status: Status = Status.ACCEPTED
    message: str = "This begins soon."
    progress: int = 0
    spent: float = 0.0
    created: datetime = Field(default_factory=now)
    updated: datetime = Field(default_factory=now)
    worker: str = Field(default=WORKER, pattern=r"^[^/]*/\d+/\w+$")
    ahead: Summary | None = None
    summary: Summary | None = None

    @property
    def unfinished(self) -> bool:
        """Whether there is something to go on with."""
        return self.status is not Status.SUCCESSFUL or (self.summary is not None and self.summary.stopped != "target")

    @property
    def rest(self) -> PrewarmOrder:
        """The order, with what is left of its time."""
        if self.order.deadline is None:
            return self.order
        return self.order.model_copy(update={"deadline": max(self.order.deadline - self.spent, 0.0)})

    @property
    def left(self) -> bool:
        """Whether nobody works on it, as far as is known, though somebody did and was not told to stop."""
        return self.status in OPEN and gone(self.worker)


def gone(worker: str) -> bool:
    """Whether a worker is a process of this machine that ended; False where that cannot be known."""
    machine, number, _ = worker.split("/")
    if machine != socket.gethostname():
        return False
    if int(number) == os.getpid():
        return worker != WORKER
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return True
    except OSError:
        pass
    return False


class Record:
    """One prewarm's ``paper`` in a store. Call from no event loop: it blocks."""

    def __init__(self, root: Where, scene: Scene, order: PrewarmOrder, by: Literal["command", "server"]) -> None:
        """Write nothing yet. A deadline is not part of the name, which is the same for the same light."""
        digest = order.digest(scene)
        self.paper = Paper(id=digest, scene=scene.id, scene_digest=scene.digest, by=by, order=order)
        self._documents = Documents(root, FOLDER)
        self._begun, self._written = time.monotonic(), -BEAT

    @property
    def place(self) -> str:
        """Where it is."""
        return self._documents.place(self.paper.id)

    def tell(self, step: Step) -> None:
        """Say how far it is; kept when some time has passed. A store that does not take it costs no more than that."""
        if time.monotonic() - self._written >= BEAT:
            try:
                self.keep(status=Status.RUNNING, message=str(step), progress=int(100 * step.share))
            except StoreError as error:
                self._written = time.monotonic()
                log.warning("How far a prewarm is cannot be kept: %s", error)

    def close(self, summary: Summary) -> Summary:
        """Write the end down; the summary with its place. Raises StoreError."""
        summary = summary.model_copy(update={"file": self.place})
        status = Status.FAILED if summary.failed else Status.SUCCESSFUL
        self.keep(status=status, message=str(summary), progress=100, summary=summary)
        return summary

    def keep(self, **facts: object) -> None:
        """Write the paper with new facts. Raises StoreError."""
        signs = {"updated": now(), "worker": WORKER, "spent": time.monotonic() - self._begun}
        self.paper = self.paper.model_copy(update={**facts, **signs})
        self._documents.write(self.paper.id, self.paper.model_dump(mode="json"))
        self._written = time.monotonic()


def papers(root: Where) -> Iterator[Paper]:
    """What is recorded in a store, without what cannot be read, which is told. Raises StoreError."""
    documents = Documents(root, FOLDER)
    for name in documents.names():
        try:
            yield Paper.model_validate(documents.read(name))
        except (StoreError, ValidationError) as error:
            log.warning("The record of a prewarm, %s, cannot be read: %s", documents.place(name), error)


def last_unfinished(root: Where, scene: Scene) -> Paper | None:
    """The prewarm of a scene that was worked on last, of those that did not come to their end; None without any."""
    found = [each for each in papers(root) if each.scene_digest == scene.digest and each.unfinished]
    return max(found, key=lambda each: each.updated, default=None)
