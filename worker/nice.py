"""Niceness: baking stands behind the server. Alone in its file, for workers load it when they start."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from distributed import WorkerPlugin

NICENESS = 10
"""How far the workers stand behind the server when both want a core."""

FORWARD = 3
"""Niceness of a worker's own session where nothing asks it to stand back.

Two such sessions together have as much of the cores as one of niceness 0, such as the server's.
"""


class Nice(WorkerPlugin):
    """Sets a worker process behind the server."""

    name = "nice"

    def __init__(self, apart: bool = False) -> None:
        """Take the priority of this process, the server, as the one to stay behind.

        Workers that are set ``apart`` lead sessions of their own, where the kernel gives sessions a niceness.
        """
        self.niceness = min(os.getpriority(os.PRIO_PROCESS, 0) + NICENESS, 19)
        self.apart = apart

    def setup(self, worker: Any) -> None:
        """Lower the process's priority, unless it is as low already."""
        os.setpriority(os.PRIO_PROCESS, 0, max(self.niceness, os.getpriority(os.PRIO_PROCESS, 0)))
        if self.apart and Path("/proc/self/autogroup").exists():
            with suppress(PermissionError):
                os.setsid()
                set_session_niceness(os.getpid(), FORWARD)


def leads_session(pid: int) -> bool:
    """Whether a process leads a session, so that its session's niceness concerns nobody else."""
    try:
        return os.getsid(pid) == pid
    except OSError:
        return False


def set_session_niceness(pid: int, niceness: int) -> bool:
    """Set how far the session of process ``pid`` stands behind others when all want a core (Linux: autogroups).

    Returns False where it is worth another try: the kernel grants unprivileged processes, all of them together, one
    change in 0.1 s. Where a kernel has no autogroups, or the process is gone, there is nothing to do.
    """
    try:
        with open(f"/proc/{pid}/autogroup", "wb", buffering=0) as file:
            return file.write(b"%d" % niceness) is not None
    except OSError:
        return True
