"""Limits of waiting: for light that does not come, and for steps that take too long."""

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from worker.errors import WorkersError

STALLED_SECONDS = 120.0
"""Seconds without anything new after which the workers are taken for broken."""


class Patience:
    """How long to wait for light: so many ``seconds`` without anything new, while workers can
    bake.
    """

    def __init__(
        self, seconds: float = STALLED_SECONDS, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin now."""
        self._seconds = seconds
        self._clock = clock
        self._since = clock()
        self._seen = None

    def check(self, progress: Any, preparing: str, reasons: Iterable[str]) -> None:
        """Go on where ``progress`` is another value than before, or workers are ``preparing``: they
        start or compile.

        Raises WorkersError, with the ``reasons`` that are known, once the patience has ended.
        """
        now = self._clock()
        if preparing or progress != self._seen:
            self._since = now
            self._seen = progress
        elif now - self._since > self._seconds:
            why = " ".join(reasons) or "The workers bake nothing new."
            raise WorkersError(f"No light came for {self._seconds:g} seconds. {why}")


@contextmanager
def time_limit(end: float) -> Iterator[threading.Event]:
    """An event for the block that is set once the monotonic clock is at the ``end``: it cancels a
    step that would take longer, between two of its tiles.
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
