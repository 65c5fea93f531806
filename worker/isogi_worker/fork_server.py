"""The fork server: a process that has imported the workers' code and loaded their kernels, and that
workers are forked from.

A spawned process imports and loads for two seconds before it can bake. A forked one has all of that
immediately, and shares the memory with the others.
"""

import sys
from multiprocessing import forkserver

START_METHOD = (
    "forkserver" if sys.platform == "linux" and sys.version_info >= (3, 11, 1) else "spawn"
)
"""The method of ``multiprocessing`` by which workers are started.

On other systems the libraries that a process has loaded may not survive a fork. The fork server of
Python 3.11.0 takes orders from any user of the machine (CVE-2022-42919), those of later versions
only from its own user.
"""

PRELOADED_MODULES = ["isogi_worker.interrupts", "isogi_worker.preload"]
"""Modules that the fork server imports, in this order."""

WORKER_PROCESS_NAME = "isogi worker"
"""Name of a worker process, as ``ps`` and ``top`` show it."""


def start_fork_server() -> None:
    """Start the fork server of this process if there is none. It loads in the background, and ends
    with this process.

    Workers have the environment that it has now, and the variables that they are given.
    """
    if START_METHOD == "forkserver":
        forkserver.set_forkserver_preload(PRELOADED_MODULES)
        forkserver.ensure_running()
