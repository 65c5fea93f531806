"""Foresight: while nobody waits for a frame, what the next isovalues of a moving slider need is made ready."""

import math
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from isogi_core.errors import Cancelled

AHEAD = 2
"""Values to come that are prepared."""

Prepare = Callable[[float, threading.Event], object]


class Foresight:
    """Watches the isovalues of the frames that are asked for. Safe to use from many threads."""

    def __init__(self, prepare: Prepare, step: float, span: tuple[float, float]) -> None:
        """``prepare(isovalue, cancelled)`` makes ready what serves an isovalue and those less than ``step`` away.

        ``span`` are the lowest and the highest isovalue that may be asked for.
        """
        self._prepare = prepare
        self._step = step
        self._span = span
        self._thread = ThreadPoolExecutor(1, "foresight")
        self._lock = threading.Lock()
        self._open = 0
        self._last: float | None = None
        self._coming: list[float] = []
        self._cancelled = threading.Event()

    @contextmanager
    def frame(self, isovalue: float) -> Iterator[None]:
        """Around the work on a frame: preparations stop when it begins, and go on when none is worked on."""
        with self._lock:
            self._open += 1
            self._cancelled.set()
        try:
            yield
        finally:
            with self._lock:
                self._open -= 1
                self._note(isovalue)
                if self._coming and not self._open:
                    self._cancelled = threading.Event()
                    self._thread.submit(self._work, self._cancelled)

    def close(self) -> None:
        """Stop, and wait until it has."""
        self._cancelled.set()
        self._thread.shutdown(cancel_futures=True)

    def _note(self, isovalue: float) -> None:
        """Where the slider goes, if it moved."""
        if self._last is not None and isovalue != self._last:
            lowest, highest = self._span
            self._coming = [v for v in next_values(self._last, isovalue, self._step) if lowest <= v <= highest]
        self._last = isovalue

    def _work(self, cancelled: threading.Event) -> None:
        """Prepare what is coming until a frame is asked for."""
        while not cancelled.is_set():
            with self._lock:
                coming = self._coming[:1]
            if not coming:
                return
            try:
                self._prepare(coming[0], cancelled)
            except Cancelled:
                return
            with self._lock:
                if self._coming[:1] == coming:
                    del self._coming[0]


def next_values(before: float, now: float, step: float) -> list[float]:
    """The values that follow ``now`` at the pace and in the direction of the last move, at least ``step`` apart."""
    pace = math.copysign(max(abs(now - before), step), now - before)
    return [now + pace * n for n in range(1, AHEAD + 1)]
