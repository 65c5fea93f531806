"""Resident memory: how much of the mapped files of voxels this process holds at once.

The kernel of the operating system keeps pages of mapped files as long as memory is free, and counts them as memory of
each process that has touched them. Here pages above a budget are let go: they stay in the system's page cache, so that
to touch one again costs no reading while there is room for it.
"""

import mmap
import os
import threading
import time
import weakref
from pathlib import Path

from isogi_core.errors import VolumeError

BUDGET = 2048
"""Megabytes of mapped voxels that a process holds, unless ``ISOGI_VOLUME_MB`` says otherwise."""

OWN = 1 / 8
"""Share of the budget up to which the voxels of a volume are in memory of each process's own, and not mapped."""

PERIOD = 0.02
"""Seconds between two looks at how much is resident."""

STRIDE = 16 << 20
"""Bytes that are let go together."""

LEFT = 0.9
"""Share of the budget down to which pages are let go, once it is passed."""

STATUS = Path("/proc/self/statm")


def budget() -> int:
    """Bytes of voxels that a process may hold; VolumeError where the environment names no such number."""
    told = os.environ.get("ISOGI_VOLUME_MB") or str(BUDGET)
    if not told.isdecimal() or not int(told):
        raise VolumeError(f"ISOGI_VOLUME_MB is '{told}': give a whole number of megabytes, from 1 on.")
    return int(told) << 20


def file_bytes() -> int:
    """Bytes of files that are in this process's memory now; 0 where the system does not tell."""
    try:
        return int(STATUS.read_text().split()[2]) * mmap.PAGESIZE
    except OSError:
        return 0


class Resident:
    """The mappings of this process, and a thread that bounds what of them is resident, once there is one."""

    def __init__(self) -> None:
        """Begin with none."""
        self._mappings: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._hand = 0
        self._others = 0

    def watch(self, mapping: mmap.mmap) -> None:
        """Bound one mapping more, as long as it lives."""
        most = budget()
        with self._lock:
            self._mappings.add(mapping)
            if self._thread is None and STATUS.exists():
                self._others = file_bytes()  # code of libraries, which is no volume's
                self._thread = threading.Thread(target=self._watch, args=[most], name="resident", daemon=True)
                self._thread.start()

    def release(self, most: int) -> None:
        """Let pages go, round and round the mappings, until they hold no more than ``most`` bytes."""
        with self._lock:
            mappings = list(self._mappings)
        strides = [(each, at) for each in mappings for at in range(0, len(each), STRIDE)]
        for _ in strides:
            if file_bytes() - self._others <= most:
                return
            self._hand = (self._hand + 1) % len(strides)
            mapping, at = strides[self._hand]
            mapping.madvise(mmap.MADV_DONTNEED, at, min(STRIDE, len(mapping) - at))

    def _watch(self, most: int) -> None:
        while True:
            time.sleep(PERIOD)
            if file_bytes() - self._others > most:
                self.release(int(LEFT * most))


RESIDENT = Resident()
"""That of this process."""
