"""Writing of light that workers have handed back, once it rests or has waited for some seconds."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from isogi_core.cache.fresh_light import Fresh, FreshLight
from isogi_core.errors import StoreAwayError
from isogi_core.prepared.prepared_scene import Index
from isogi_worker.errors import WorkersAwayError
from isogi_worker.tasks import BakeResult, BakeTask, Unwritten, WriteTask, Written

if TYPE_CHECKING:
    from isogi_worker.pool import WorkerPool

CHECK_SECONDS = 0.25
"""Seconds between two checks for light that is to be written."""

WRITE_CHUNKS = 32
"""Most chunks of one task: about 0.1 s of a worker."""

SHORTEST_RETRY = 1.0
LONGEST_RETRY = 8.0
"""Seconds until a store that takes no light is tried again;
doubled after each failure, up to the longest.
"""

LAST_SECONDS = 20.0
"""Seconds within which all light is written when the server stops."""

MOST_FAILURES = 5
"""Failures after which a chunk's light is dropped; it is baked again when a view needs it."""

log = logging.getLogger("isogi.worker")


@dataclass(frozen=True, eq=False)
class BakeLight:
    """The ``light`` in memory of the bake ``name``, and the last task of that bake, ``like``, from
    which write tasks take the description of the bake.
    """

    name: str
    light: FreshLight
    like: BakeTask


Contended = Callable[[str, Index], None]
"""A function that is called with the name of a bake, and a chunk of it to which another process
has written, too.
"""


class LightWriter:
    """Has the workers of a ``pool`` write light. Safe to use from many threads."""

    def __init__(
        self, pool: "WorkerPool", contended: Contended, recovered: Callable[[], None]
    ) -> None:
        """Begin without light.

        ``contended`` is called for chunks to which another process has written, too, ``recovered``
        if the store takes light again after it took none.
        """
        self.reason = ""
        """The reason if light cannot be written, else empty."""
        self._pool = pool
        self._contended = contended
        self._recovered = recovered
        self._bakes: dict[str, BakeLight] = {}
        self._writing: set[tuple[str, Index]] = set()
        self._failures: dict[tuple[str, Index], int] = {}
        self._wait = SHORTEST_RETRY
        self._retry = 0.0
        self._changed = threading.Condition()

    def take(self, name: str, light: FreshLight, task: BakeTask, result: BakeResult) -> None:
        """Keep in memory the light that a task of the bake ``name`` has brought."""
        if result.chunk is not None:
            light.put(result.chunk, result.changed)
            self._bakes[task.digest] = BakeLight(name, light, replace(task, light=None))

    def write_due(self, wanted: Callable[[str], set[Index]]) -> None:
        """Begin to write light that rests, or that has waited long enough: see ``FreshLight.due``.

        ``wanted`` gives the chunks of a bake for which more light is requested: their light does
        not rest yet.
        """
        # After a failure of the store, write nothing until the next try.
        if time.monotonic() >= self._retry:
            for lit in list(self._bakes.values()):
                self._write(lit, lit.light.due(wanted(lit.name).__contains__))

    def sweep(self, busy: Callable[[str, Index], bool]) -> None:
        """Forget light that was written long ago, except chunks with tasks, which are ``busy``."""
        for lit in list(self._bakes.values()):
            lit.light.sweep(partial(busy, lit.name))

    def write_all(self) -> None:
        """Begin to write all light."""
        if time.monotonic() < self._retry:
            return
        for lit in list(self._bakes.values()):
            self._write(lit, lit.light.unwritten())

    def finish(self, seconds: float = LAST_SECONDS) -> None:
        """Write all light, and return when that is done,
        or when the store takes none, or after ``seconds``.
        """
        # Write again after each wait: tasks that were in flight bring light, and writes fail.
        deadline = time.monotonic() + seconds
        while self.unwritten and not self.reason and time.monotonic() < deadline:
            self.write_all()
            with self._changed:
                self._changed.wait(CHECK_SECONDS)
        if self.unwritten:
            log.error(
                "the light of %d chunks is not written, and will be baked again: %s",
                self.unwritten,
                self.reason or "the store is slow",
            )

    @property
    def unwritten(self) -> int:
        """Number of chunks with light that is not written."""
        return sum(len(lit.light.unwritten()) for lit in list(self._bakes.values()))

    def _write(self, lit: BakeLight, due: Iterable[Fresh]) -> None:
        """Hand over tasks that write the ``due`` chunks of a bake, except those that are being
        written already.

        Does not wait for them: ``_end`` is called with the outcome of each task, from another
        thread.
        """
        like = lit.like
        with self._changed:
            free = [each for each in due if (like.digest, each.chunk.index) not in self._writing]
            self._writing |= {(like.digest, each.chunk.index) for each in free}
        # A write task describes its bake as the bake's last task did, so that a worker that has
        # this bake open need not open it again.
        place = (like.source, like.plan, like.digest, like.store_url, like.assets, like.shown)
        # A chunk that could not be written before gets a task of its own, so that it does not make
        # the writing of others fail.
        failed = [each for each in free if (like.digest, each.chunk.index) in self._failures]
        rest = [each for each in free if each not in failed]
        groups = [[each] for each in failed]
        groups += [rest[i : i + WRITE_CHUNKS] for i in range(0, len(rest), WRITE_CHUNKS)]
        for some in groups:
            chunks = tuple(Unwritten(each.chunk, each.changed) for each in some)
            self._pool.write(WriteTask(*place, chunks), partial(self._end, lit, some))

    def _end(
        self,
        lit: BakeLight,
        some: Sequence[Fresh],
        outcomes: Sequence[Written] | None,
        error: BaseException | None,
    ) -> None:
        """Note the outcomes of a write task, or its ``error``."""
        met = [
            each.chunk.index
            for number, each in enumerate(some)
            if self._settle(lit, each, error if outcomes is None else outcomes[number])
        ]
        with self._changed:
            self._writing -= {(lit.like.digest, each.chunk.index) for each in some}
            self._changed.notify_all()
        for index in met:
            self._contended(lit.name, index)

    def _settle(
        self, lit: BakeLight, fresh: Fresh, outcome: Written | BaseException | None
    ) -> bool:
        """Note the outcome of writing one chunk; return True if another writer was found at it.

        - A bool of either value: the chunk is written, and the store takes light; see ``Written``.
        - StoreAwayError: writing pauses; the light stays in memory.
        - WorkersAwayError: the light stays in memory, and is due again.
        - Anything else: the chunk has failed. After MOST_FAILURES of these its light is dropped.
        """
        index = fresh.chunk.index
        key = lit.like.digest, index
        if isinstance(outcome, bool):
            lit.light.written(fresh)
            self._failures.pop(key, None)
            self._recover()
            other_writer = outcome
            return other_writer
        if isinstance(outcome, WorkersAwayError):
            return False
        if isinstance(outcome, StoreAwayError):
            self._pause(str(outcome))
            return False
        self._failures[key] = self._failures.get(key, 0) + 1
        log.warning("writing chunk %s of %s failed: %s", index, lit.name, outcome)
        if self._failures[key] >= MOST_FAILURES:
            lit.light.drop(index)
            self._failures.pop(key)
        return False

    def _pause(self, reason: str) -> None:
        """Write nothing for a while, as the store takes none.

        Each further failure doubles the wait; chunks of one task fail together, and count once.
        """
        if time.monotonic() < self._retry:
            return
        if not self.reason:
            self._wait = SHORTEST_RETRY
            log.error("light waits in memory for the store: %s", reason)
        else:
            self._wait = min(2.0 * self._wait, LONGEST_RETRY)
        self.reason = reason
        self._retry = time.monotonic() + self._wait

    def _recover(self) -> None:
        """End the pause, as the store takes light again."""
        if self.reason:
            self.reason = ""
            self._retry = 0.0
            self._recovered()
