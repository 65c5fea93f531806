"""The pause: while the store is away nothing is baked but one task now and then, to see whether it is back.

One task that cannot reach it tells little: a second that ends so, and none in between that went well, begins a pause.
"""

import threading
from collections.abc import Callable

SHORTEST, LONGEST = 1.0, 8.0
"""Seconds until the first try, and the most that pass until the next; each pause is twice as long as the last."""


class Pause:
    """Why nothing is baked, the ``reason``, empty while all goes well; ``resume`` is called when it is time for a try.

    The caller's lock is held around all methods, and not when ``resume`` is called, from another thread.
    """

    def __init__(self, clock: Callable[[], float], resume: Callable[[], None]) -> None:
        """Pause nothing yet."""
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
        """Pause, or pause on: another task has failed for this ``reason``. The first is let go."""
        if not self._stumbled:
            self._stumbled = True
            return
        if self.reason and not self.over:
            return
        self._seconds = min(2.0 * self._seconds, LONGEST) if self.reason else SHORTEST
        self.reason, self._until = reason, self._clock() + self._seconds
        self._timer = threading.Timer(self._seconds, self._resume)
        self._timer.daemon = True
        self._timer.start()

    def end(self) -> None:
        """All goes well again, or nothing is to go on."""
        self.reason, self._stumbled = "", False
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
