"""Tiles: run pieces of a frame on a few threads, and end them when the frame is cancelled;
measure the time of its stages.
"""

import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field
from typing import Self

from isogi_core.errors import Cancelled


@dataclass(eq=False)
class Stopwatch:
    """Seconds of each stage of one frame, in order, since it was ``begun``. No second counts in
    two stages.
    """

    begun: float = field(default_factory=time.perf_counter)
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block as stage ``name``, without the stages inside it."""
        begun = time.perf_counter()
        others = sum(self.seconds.values())
        yield
        inside = sum(self.seconds.values()) - others
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begun - inside

    @property
    def elapsed(self) -> float:
        """Seconds since it was begun."""
        return time.perf_counter() - self.begun


class Interruption(threading.Event):
    """An event that is set once nobody waits for some work any more. Long work calls
    ``give_way`` between its passes.
    """

    def give_way(self) -> None:
        """Return when the work may go on. Here that is immediately; other kinds wait for work
        with priority.
        """


Piece = Callable[[int, int], object]

MIN_PIECE_ROWS = 4096
"""Points, texels or rows of a piece, at least, if a thread has several: each piece must acquire
the interpreter lock.
"""


class Tiles:
    """Runs a function over the ranges of a whole on several threads. The kernels under it release
    the interpreter lock.

    The calling thread works, too: threads that are woken by one that then sleeps are often put on
    one core, and a stage of a few milliseconds is over before they are moved apart.
    """

    def __init__(self, threads: int | None = None) -> None:
        """Work on ``threads`` threads, the caller's among them; by default one for each core."""
        self.threads = threads or os.cpu_count() or 1
        self._helpers = ThreadPoolExecutor(max(self.threads - 1, 1), "tile")
        self._cancelled: tuple[threading.Event, ...] = ()

    def cancelled_by(self, event: threading.Event) -> Self:
        """Return tiles on the same threads that ``event`` cancels, too."""
        bound = copy(self)
        bound._cancelled = (*self._cancelled, event)
        return bound

    def check(self) -> None:
        """Raise Cancelled if the work is cancelled."""
        if self._over():
            raise Cancelled("Nobody waits for this frame any more.")

    def give_way(self) -> None:
        """Return when the next pass of long work may begin: other work may go first. Raises
        Cancelled.
        """
        for event in self._cancelled:
            if isinstance(event, Interruption):
                event.give_way()
        self.check()

    def _over(self) -> bool:
        """Return True if the work is cancelled."""
        return any(event.is_set() for event in self._cancelled)

    def run(self, piece: Piece, total: int, size: int) -> None:
        """Call ``piece(first, last)`` for consecutive ranges of at most ``size`` that cover
        ``total``.

        Threads take ranges as they become free. Raises Cancelled if the work is cancelled, and any
        error of a piece; in both cases no further piece is begun, and those at work end first.
        """
        # All threads draw ranges from one iterator, which is safe in CPython.
        starts = iter(range(0, total, size))
        failed = threading.Event()

        def work() -> None:
            for first in starts:
                if failed.is_set() or self._over():
                    return
                try:
                    piece(first, min(first + size, total))
                except BaseException:
                    failed.set()
                    raise

        # Wake no more helpers than there are ranges for.
        helpers = [
            self._helpers.submit(work) for _ in range(min(self.threads, -(-total // size)) - 1)
        ]
        # Work on this thread, and wait for helpers that have begun.
        try:
            work()
        finally:
            troubles = [helper.exception() for helper in helpers if not helper.cancel()]
        # Raise the error of a helper if this thread met none.
        try:
            if (trouble := next(filter(None, troubles), None)) is not None:
                raise trouble
        finally:
            # Otherwise the error's traceback keeps this frame, and all arrays in it, alive until
            # garbage is collected.
            del helpers, troubles, trouble
        self.check()

    def even(self, total: int, share: int = 4) -> int:
        """Return the size of equal pieces of ``total``: ``share`` of them for each thread,
        fewer if each would have less than MIN_PIECE_ROWS.
        """
        share = min(max(total // (MIN_PIECE_ROWS * self.threads), 1), share)
        return max(-(-total // (share * self.threads)), 1)

    def close(self) -> None:
        """End the threads."""
        self._helpers.shutdown(cancel_futures=True)
