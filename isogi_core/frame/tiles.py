"""Tiles: pieces of a frame on a few threads, dropped as soon as nobody waits for the frame."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from isogi_core.errors import Cancelled

Piece = Callable[[int, int], object]


class Tiles:
    """Runs a function over the ranges of a whole. The kernels under it release the interpreter.

    The thread that calls works too: threads that are all woken by one that then sleeps are often
    put on one core, and a stage of a few milliseconds is over before they are moved apart.
    """

    def __init__(self, threads: int | None = None) -> None:
        """Work on ``threads`` threads, the caller's among them; by default as many as the machine has cores."""
        self.threads = threads or os.cpu_count() or 1
        self._helpers = ThreadPoolExecutor(max(self.threads - 1, 1), "tile")

    def run(self, piece: Piece, total: int, size: int, cancelled: threading.Event | None = None) -> None:
        """Call ``piece(first, last)`` for consecutive ranges of at most ``size`` until ``total`` is covered.

        A thread that has done its range takes the next one. Raises Cancelled, after the pieces at
        work have ended, once ``cancelled`` is set; so it does with what a piece raises, and begins no more.
        """
        starts, failed = iter(range(0, total, size)), threading.Event()

        def work() -> None:
            for first in starts:
                if failed.is_set() or (cancelled is not None and cancelled.is_set()):
                    return
                try:
                    piece(first, min(first + size, total))
                except BaseException:
                    failed.set()
                    raise

        helpers = [self._helpers.submit(work) for _ in range(min(self.threads, -(-total // size)) - 1)]
        try:
            work()
        finally:
            troubles = [helper.exception() for helper in helpers if not helper.cancel()]
        for trouble in filter(None, troubles):
            raise trouble
        if cancelled is not None and cancelled.is_set():
            raise Cancelled("Nobody waits for this frame any more.")

    def even(self, total: int, share: int = 4) -> int:
        """The size of equal pieces, ``share`` of them for each thread."""
        return max(-(-total // (share * self.threads)), 1)

    def close(self) -> None:
        """End the threads."""
        self._helpers.shutdown(cancel_futures=True)
