"""The fork server: the process that workers are forked from, which has imported their code and
loaded their kernels.

A process that is spawned imports and loads for two seconds before it can bake. A forked one has all
of that at once, and shares its memory with the others.
"""

import sys
from multiprocessing import forkserver

START_METHOD = (
    "forkserver" if sys.platform == "linux" and sys.version_info >= (3, 11, 1) else "spawn"
)
"""How workers are started.

On other systems the libraries that a process has loaded may not survive a fork. The fork server of
Python 3.11.0 runs what any user of the machine tells it (CVE-2022-42919), later ones what their own
user does.
"""

PRELOADED_MODULES = ["worker.interrupts", "worker.preload"]
"""The modules that the fork server imports, in this order."""

WORKER_PROCESS_NAME = "isogi worker"
"""The name of a worker process, as ``ps`` and ``top`` show it."""


def start_fork_server() -> None:
    """Have this process's fork server, if it has none: it loads while other things are done.

    It ends when this process does. Workers have the environment of now, and what they are given.
    """
    if START_METHOD == "forkserver":
        forkserver.set_forkserver_preload(PRELOADED_MODULES)
        forkserver.ensure_running()
