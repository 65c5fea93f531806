"""Tiles: pieces of a frame on a few threads, which a cancellation ends; and how long each stage
took.
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
    """Seconds of each stage of one frame, in order, since it has ``begun``. No second counts in two
    stages.
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
        """Seconds since it has begun."""
        return time.perf_counter() - self.begun


class Interruption(threading.Event):
    """Set once nobody waits for some work any more; long work calls ``give_way`` between its
    passes.
    """

    def give_way(self) -> None:
        """Return when the work may go on: at once here, and later where others have their turn
        first.
        """


Piece = Callable[[int, int], object]

MIN_PIECE_ROWS = 4096
"""Points, texels or rows that a piece has where a thread has several: each piece asks for the
interpreter again.
"""


class Tiles:
    """Runs a function over the ranges of a whole. The kernels under it release the interpreter.

    The calling thread works too: threads that are all woken by one that then sleeps are often
    put on one core, and a stage of a few milliseconds is over before they are moved apart.
    """

    def __init__(self, threads: int | None = None) -> None:
        """Work on ``threads`` threads, the caller's among them; by default as many as the machine
        has cores.
        """
        self.threads = threads or os.cpu_count() or 1
        self._helpers = ThreadPoolExecutor(max(self.threads - 1, 1), "tile")
        self._cancelled: tuple[threading.Event, ...] = ()

    def cancelled_by(self, event: threading.Event) -> Self:
        """Tiles on these threads, cancelled once ``event`` is set or whatever cancels these
        tiles.
        """
        bound = copy(self)
        bound._cancelled = (*self._cancelled, event)
        return bound

    def check(self) -> None:
        """Raise Cancelled once the work is cancelled."""
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
        return any(event.is_set() for event in self._cancelled)

    def run(self, piece: Piece, total: int, size: int) -> None:
        """Call ``piece(first, last)`` for consecutive ranges of at most ``size`` until ``total`` is
        covered.

        A thread that has done its range takes the next one. Raises Cancelled, after the pieces at
        work have ended, once the work is cancelled; it does the same with what a piece raises, and
        begins no more.
        """
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

        helpers = [
            self._helpers.submit(work) for _ in range(min(self.threads, -(-total // size)) - 1)
        ]
        try:
            work()
        finally:
            troubles = [helper.exception() for helper in helpers if not helper.cancel()]
        try:
            if (trouble := next(filter(None, troubles), None)) is not None:
                raise trouble
        finally:
            del (
                helpers,
                troubles,
                trouble,
            )  # else they hold this frame and all arrays in it till garbage is sought
        self.check()

    def even(self, total: int, share: int = 4) -> int:
        """The size of equal pieces, ``share`` for each thread; fewer where each would be below
        MIN_PIECE_ROWS.
        """
        share = min(max(total // (MIN_PIECE_ROWS * self.threads), 1), share)
        return max(-(-total // (share * self.threads)), 1)

    def close(self) -> None:
        """End the threads."""
        self._helpers.shutdown(cancel_futures=True)
