"""Residents: the memory and the time that a process and its children took, looked at from outside,
and a limit.
"""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from isogi_worker.fork_server import WORKER_PROCESS_NAME

MIB = 1 << 20
PERIOD = 0.05
"""Seconds between two looks."""

KINDS = ("RssAnon", "RssFile")
"""What is looked at: memory of a process's own, and pages of files, which other processes may
share.
"""


class Residents:
    """Looks at a process and its children on a thread; ``most`` has MiB by role, one figure for
    each of KINDS and both.

    The roles are "main" and "worker", of which the largest counts; of each there are the
    processor's seconds too.
    """

    def __init__(self, pid: int) -> None:
        """Begin to look."""
        self.most: dict[str, float] = {}
        self._root = psutil.Process(pid)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Look no more."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(PERIOD):
            with suppress(psutil.NoSuchProcess):
                self._look(self._root, "main")
                for child in self._root.children(recursive=True):
                    with suppress(psutil.NoSuchProcess):
                        if child.name() == WORKER_PROCESS_NAME:
                            self._look(child, "worker")

    def _look(self, process: psutil.Process, role: str) -> None:
        held = held_by(process.pid)
        taken = process.cpu_times()
        found = {
            f"{name}, MiB": size for name, size in {**held, "both": sum(held.values())}.items()
        }
        for name, figure in {**found, "processor, s": taken.user + taken.system}.items():
            self.most[f"{role}: {name}"] = max(self.most.get(f"{role}: {name}", 0.0), figure)


def held_by(pid: int) -> dict[str, float]:
    """MiB of each of KINDS that a process holds now; zeros once it is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except (FileNotFoundError, ProcessLookupError):
        lines = []
    told = dict(line.split(":", 1) for line in lines)
    return {kind: float(told[kind].split()[0]) / 1024 if kind in told else 0.0 for kind in KINDS}


@contextmanager
def limited(mib: int | None) -> Iterator[list[str]]:
    """The beginning of a command whose processes may hold ``mib`` in all, page cache included; none
    for no limit.

    By a control group of this process's own, of version 1 or 2. Raises OSError where this user may
    make none.
    """
    if mib is None:
        yield []
        return
    group, most = group_folder()
    group.mkdir()
    try:
        (group / most).write_text(str(mib * MIB))
        yield ["sh", "-c", f'echo $$ > {group}/cgroup.procs && exec "$@"', "sh"]
    finally:
        group.rmdir()


def group_folder() -> tuple[Path, str]:
    """Where a control group of memory is to be made, and its file with the limit."""
    for line in Path("/proc/self/cgroup").read_text().splitlines():
        _, controllers, own = line.split(":", 2)
        if "memory" in controllers.split(","):
            return Path(f"/sys/fs/cgroup/memory{own}/isogi-{os.getpid()}"), "memory.limit_in_bytes"
    return Path(f"/sys/fs/cgroup/isogi-{os.getpid()}"), "memory.max"
