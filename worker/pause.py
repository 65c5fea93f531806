"""The pause: while the store is away, one task now and then tries whether it is back, and nothing else is baked.

A pause begins with the second failure in a row, as a single one says little.
"""

import threading
from collections.abc import Callable

SHORTEST, LONGEST_PAUSE = 1.0, 8.0
"""Seconds until the first try, and the most that pass until the next; each pause is twice as long as the last."""


class Pause:
    """A pause and its ``reason``, empty while there is none; ``resume`` is called when it is time for a try.

    The caller holds its lock around all methods. ``resume`` is called from another thread without that lock.
    """

    def __init__(self, clock: Callable[[], float], resume: Callable[[], None]) -> None:
        """Begin without a pause."""
        self.reason = ""
        self._stumbled = False
        self._clock = clock
        self._resume = resume
        self._seconds = SHORTEST
        self._until = 0.0
        self._timer: threading.Timer | None = None

    @property
    def over(self) -> bool:
        """Whether it is time for a try."""
        return self._clock() >= self._until

    def begin(self, reason: str) -> None:
        """Begin or prolong the pause: a task has failed for this ``reason``. A single failure is ignored."""
        if not self._stumbled:
            self._stumbled = True
            return
        if self.reason and not self.over:
            return
        self._seconds = min(2.0 * self._seconds, LONGEST_PAUSE) if self.reason else SHORTEST
        self.reason, self._until = reason, self._clock() + self._seconds
        self._timer = threading.Timer(self._seconds, self._resume)
        self._timer.daemon = True
        self._timer.start()

    def end(self) -> None:
        """End the pause: a task went well, or the baker stops."""
        self.reason, self._stumbled = "", False
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
