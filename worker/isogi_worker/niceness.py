"""Niceness: workers run at lower priority than the server."""

import os
from contextlib import suppress
from pathlib import Path

from isogi_worker.fork_server import WORKER_PROCESS_NAME

WORKER_NICENESS = 10
"""Niceness of the workers, added to the server's: a server of niceness 0 gets nine times as much of
a core as a worker.
"""


def worker_niceness() -> int:
    """Return the niceness of workers, which stay below this process, the server; at most 19."""
    return min(os.getpriority(os.PRIO_PROCESS, 0) + WORKER_NICENESS, 19)


def stand_behind(niceness: int) -> None:
    """Name this process, a worker, and lower its priority to ``niceness`` unless it is as low
    already.
    """
    with suppress(OSError):  # another system
        Path("/proc/self/comm").write_text(WORKER_PROCESS_NAME, encoding="ascii")
    os.setpriority(os.PRIO_PROCESS, 0, max(niceness, os.getpriority(os.PRIO_PROCESS, 0)))
