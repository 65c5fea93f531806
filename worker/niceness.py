"""Niceness: workers run at lower priority than the server, and at still lower one while a view
moves.

Linux first shares the cores among sessions (autogroups), so each worker leads a session, whose
niceness changes.
"""

import os
import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path

from worker.fork_server import WORKER_PROCESS_NAME

WORKER_NICENESS = 10
"""Niceness of the workers, added to the server's."""

FORWARD_NICENESS = 3
"""Niceness of a worker's session while no view moves.

Two such sessions together get as much of the cores as one of niceness 0, such as the server's.
"""


def worker_niceness() -> int:
    """Return the niceness of workers, which stay below this process, the server; at most 19."""
    return min(os.getpriority(os.PRIO_PROCESS, 0) + WORKER_NICENESS, 19)


def stand_behind(niceness: int, apart: bool = False) -> None:
    """Name this process, a worker, and lower its priority to ``niceness`` unless it is as low
    already.

    With ``apart``, it begins a session of its own if the kernel has autogroups.
    """
    with suppress(OSError):  # another system
        Path("/proc/self/comm").write_text(WORKER_PROCESS_NAME, encoding="ascii")
    os.setpriority(os.PRIO_PROCESS, 0, max(niceness, os.getpriority(os.PRIO_PROCESS, 0)))
    if apart and Path("/proc/self/autogroup").exists():
        with suppress(PermissionError):
            os.setsid()
            set_session_niceness(os.getpid(), FORWARD_NICENESS)


def leads_session(pid: int) -> bool:
    """Return True if a process leads a session,
    so that the session's niceness affects no process of others.
    """
    try:
        return os.getsid(pid) == pid
    except OSError:
        return False


def set_session_niceness(pid: int, niceness: int) -> bool:
    """Set the niceness of the session of the process ``pid`` (Linux: autogroups).

    Return False if it must be tried again: the kernel grants all unprivileged processes together
    one change in 0.1 s. If the kernel has no autogroups or the process is gone, do nothing and
    return True.
    """
    try:
        with open(f"/proc/{pid}/autogroup", "wb", buffering=0) as file:
            return file.write(b"%d" % niceness) is not None
    except OSError:
        return True


BACK_NICENESS = 10
"""Niceness of a session while a view moves:
a session of niceness 0 then gets nine times as much of a core.
"""

CHANGE_SECONDS = 0.1
"""Seconds between two rounds of changes, the time in which the kernel grants one change."""

CLOSING_SECONDS = 2.0
"""Seconds for which closing waits until all sessions have FORWARD_NICENESS again."""


class Sessions:
    """Sessions that worker processes lead: at BACK_NICENESS for a while, at FORWARD_NICENESS
    otherwise.

    A thread changes them, and ends once all have FORWARD_NICENESS again.
    """

    def __init__(
        self,
        leaders: Callable[[], Collection[int]],
        change: Callable[[int, int], bool] = set_session_niceness,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """Change the sessions of the processes in ``leaders()``, which is called each time, as
        workers come and go.

        ``change`` takes a process id and a niceness, and returns False if it must be tried again.
        """
        self._leaders = leaders
        self._change = change
        self._clock = clock
        self._pause = pause
        self._back: frozenset[int] = frozenset()
        self._until = clock()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def step_back(self, seconds: float) -> None:
        """Give all sessions BACK_NICENESS for ``seconds`` from now. Does not wait."""
        with self._lock:
            self._until = self._clock() + seconds
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="sessions", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """Give all sessions FORWARD_NICENESS, and wait for that."""
        with self._lock:
            self._until = self._clock()
            thread = self._thread
        if thread is not None:
            thread.join(CLOSING_SECONDS)

    def _run(self) -> None:
        """Make changes in rounds until the thread may end."""
        while not self._round():
            self._pause(CHANGE_SECONDS)

    def _round(self) -> bool:
        """Make the changes that are due and granted.

        Return True if all sessions have FORWARD_NICENESS, so that the thread may end.
        """
        leaders = frozenset(self._leaders())
        # ``_back`` are the sessions at BACK_NICENESS; new workers begin at the other one.
        self._back &= leaders
        moving = self._clock() < self._until
        for leader in leaders - self._back if moving else self._back:
            if not self._change(leader, BACK_NICENESS if moving else FORWARD_NICENESS):
                break
            self._back ^= {leader}
        # Decide under the lock, so that no call of ``step_back`` in between relies on a thread that
        # ends.
        with self._lock:
            if self._back or self._clock() < self._until:
                return False
            self._thread = None
            return True
