"""Sessions of workers: Linux shares the cores among sessions first, so these step back while a view moves."""

import threading
import time
from collections.abc import Callable, Collection

from worker.nice import FORWARD, set_session_niceness

BACK = 10
"""Niceness of a session that stands back, next to which one of niceness 0 has nine times as much of a core."""

TICK = 0.1
"""Seconds between two rounds of changes: in so long the kernel grants one to a process without privileges."""

CLOSING = 2.0
"""Seconds for which closing waits until all stand forward."""


class Sessions:
    """Sessions that worker processes lead: they stand back for a while, and forward at all other times.

    A thread of its own changes them, and ends once all stand forward again.
    """

    def __init__(
        self,
        leaders: Callable[[], Collection[int]],
        change: Callable[[int, int], bool] = set_session_niceness,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """Change those of the processes that ``leaders`` tells, which is asked each time: workers come and go.

        ``change`` takes a process id and a niceness, and returns False where it is to be tried again.
        """
        self._leaders, self._change, self._clock, self._pause = leaders, change, clock, pause
        self._back: frozenset[int] = frozenset()
        self._until = clock()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def step_back(self, seconds: float) -> None:
        """Have all stand back for so long from now. Does not wait."""
        with self._lock:
            self._until = self._clock() + seconds
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="sessions", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """Have all stand forward, and wait for that."""
        with self._lock:
            self._until, thread = self._clock(), self._thread
        if thread is not None:
            thread.join(CLOSING)

    def _run(self) -> None:
        while not self._round():
            self._pause(TICK)

    def _round(self) -> bool:
        """Make the changes that are due and granted. Returns whether all stand forward and the thread may end."""
        leaders = frozenset(self._leaders())
        self._back &= leaders
        moving = self._clock() < self._until
        for leader in leaders - self._back if moving else self._back:
            if not self._change(leader, BACK if moving else FORWARD):
                break
            self._back ^= {leader}
        with self._lock:
            if self._back or self._clock() < self._until:
                return False
            self._thread = None
            return True
