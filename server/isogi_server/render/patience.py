"""Limits of waiting: for light that does not come, and for steps that take too long."""

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from isogi_worker.errors import WorkersError

STALLED_SECONDS = 120.0
"""Seconds without progress after which the workers are taken for broken."""


class Patience:
    """A limit to waiting for light: ``seconds`` without progress, not counting time in which
    workers prepare.
    """

    def __init__(
        self, seconds: float = STALLED_SECONDS, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start to wait now."""
        self._seconds = seconds
        self._clock = clock
        self._since = clock()
        self._seen = None

    def check(self, progress: Any, preparing: str, reasons: Iterable[str]) -> None:
        """Start to wait again if ``progress`` differs from its last value, or if workers are
        ``preparing`` (they start, or compile kernels; a sentence, else empty).

        Raises WorkersError, with the known ``reasons``, if nothing has changed for longer than the
        patience.
        """
        now = self._clock()
        # Progress, or preparation, restarts the wait.
        if preparing or progress != self._seen:
            self._since = now
            self._seen = progress
        elif now - self._since > self._seconds:
            why = " ".join(reasons) or "The workers bake nothing new."
            raise WorkersError(f"No light came for {self._seconds:g} seconds. {why}")


@contextmanager
def time_limit(end: float) -> Iterator[threading.Event]:
    """Yield an event that is set when the monotonic clock reaches ``end``, in seconds; an infinite
    end sets it never.

    The event cancels a step that takes too long, between two of its tiles.
    """
    over = threading.Event()
    if math.isinf(end):
        yield over
        return
    timer = threading.Timer(max(end - time.monotonic(), 0.0), over.set)
    timer.daemon = True
    timer.start()
    try:
        yield over
    finally:
        timer.cancel()
