"""Tiles: pieces of a frame on a pool of threads, dropped as soon as nobody waits for the frame."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from isogi_core.errors import Cancelled

Piece = Callable[[int, int], object]


class Tiles:
    """Runs a function over the ranges of a whole. The kernels under it release the interpreter."""

    def __init__(self, threads: int | None = None) -> None:
        """Start ``threads`` threads, by default as many as the machine has cores."""
        self.threads = threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self.threads, "tile")

    def run(self, piece: Piece, total: int, size: int, cancelled: threading.Event | None = None) -> None:
        """Call ``piece(first, last)`` for consecutive ranges of at most ``size`` until ``total`` is covered.

        Raises Cancelled, after the pieces at work have ended, once ``cancelled`` is set.
        """

        def guarded(first: int) -> None:
            if cancelled is None or not cancelled.is_set():
                piece(first, min(first + size, total))

        for future in [self._pool.submit(guarded, first) for first in range(0, total, size)]:
            future.result()
        if cancelled is not None and cancelled.is_set():
            raise Cancelled("Nobody waits for this frame any more.")

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)
