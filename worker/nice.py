"""Niceness: baking stands behind the server. Alone in its file, for workers load it when they start."""

import os
from typing import Any

from distributed import WorkerPlugin

NICENESS = 10
"""How far the workers stand behind the server when both want a core."""


class Nice(WorkerPlugin):
    """Sets a worker process behind the server."""

    name = "nice"

    def __init__(self) -> None:
        """Take the priority of this process, the server, as the one to stay behind."""
        self.niceness = min(os.getpriority(os.PRIO_PROCESS, 0) + NICENESS, 19)

    def setup(self, worker: Any) -> None:
        """Lower the process's priority, unless it is as low already."""
        os.setpriority(os.PRIO_PROCESS, 0, max(self.niceness, os.getpriority(os.PRIO_PROCESS, 0)))
