"""Files of normalised voxels, which are mapped into memory, and a bound of their resident pages."""

import json
import math
import mmap
import os
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import google_crc32c
import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.storage.atomic_file import PARTIAL, sync_folder

BUDGET = 2048
"""Most megabytes of mapped voxels in memory, unless ``ISOGI_VOLUME_MB`` says otherwise."""

OWN = 1 / 8
"""Share of the budget up to which a volume's voxels are in each process's own memory, and not mapped."""

PERIOD = 0.002
"""Seconds between two checks of resident memory. The system maps some 130 kB around each voxel that is read."""

STATUS = Path("/proc/self/statm")

LINE = 256
"""Bytes that a line of it fits into."""


def budget() -> int:
    """Most bytes of voxels in memory; VolumeError where the environment variable is no such number."""
    given = os.environ.get("ISOGI_VOLUME_MB") or str(BUDGET)
    if not given.isdecimal() or not int(given):
        raise VolumeError(f"ISOGI_VOLUME_MB is '{given}': give a whole number of megabytes, from 1 on.")
    return int(given) << 20


def file_bytes() -> int:
    """Bytes of files in this process's memory; 0 where the system does not report them."""
    try:
        return pages_in(STATUS.read_bytes())
    except OSError:
        return 0


def pages_in(status: bytes) -> int:
    """Bytes of files that a line of STATUS tells."""
    return int(status.split()[2]) * mmap.PAGESIZE


class Resident:
    """The mappings of this process, with a thread that bounds their resident pages.

    It lets go of all of them at once: each step waits for the interpreter, which work on voxels may hold, and what is
    needed again is still in the system's cache.
    """

    def __init__(self) -> None:
        """Begin without mappings, and without the thread."""
        self._mappings: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def watch(self, mapping: mmap.mmap) -> None:
        """Add a mapping, for as long as it lives."""
        most = budget()
        with self._lock:
            self._mappings.add(mapping)
            if self._thread is None and STATUS.exists():
                most += file_bytes()  # code of libraries
                self._thread = threading.Thread(target=self._watch, args=[most], name="resident", daemon=True)
                self._thread.start()

    def release(self) -> None:
        """Let go of the pages of all mappings."""
        with self._lock:
            mappings = list(self._mappings)
        for mapping in mappings:
            mapping.madvise(mmap.MADV_DONTNEED)

    def _watch(self, most: int) -> None:
        with open(STATUS, "rb", buffering=0) as status:
            while True:
                time.sleep(PERIOD)
                if pages_in(os.pread(status.fileno(), LINE, 0)) > most:
                    self.release()


RESIDENT = Resident()
"""The mappings of this process."""


HEADER = 16384
"""Bytes before the voxels, whole pages for their alignment."""

FORMAT = f"isogi voxels 1 {sys.byteorder}"

NO_RESERVE = getattr(mmap, "MAP_NORESERVE", 0x4000 if sys.platform == "linux" else 0)
"""Flag against reserving memory: a private mapping takes none unless it is written to, which nothing does."""

Shape = tuple[int, ...]


@contextmanager
def new_voxels(path: Path) -> Iterator["Draft"]:
    """Write the file ``path`` by a draft; after the block the file is whole, and safe from a loss of power.

    The draft's name ends in ``.partial``; it is deleted where the block fails.
    """
    partial = path.with_suffix(PARTIAL)
    try:
        with open(partial, "wb") as file:
            file.seek(HEADER)
            yield Draft(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
        sync_folder(path.parent)
    finally:
        partial.unlink(missing_ok=True)


class Draft:
    """A file of voxels that is being written, plane by plane; ``seal`` makes it valid."""

    def __init__(self, file: IO[bytes]) -> None:
        """Write to ``file``, which is at the byte after the header."""
        self._file = file

    def write(self, plane: np.ndarray) -> None:
        """Add one plane of voxels (ny, nx), float32."""
        self._file.write(plane.data)

    def voxels(self, shape: Shape) -> np.ndarray:
        """Map the voxels that were written."""
        self._file.flush()
        with open(self._file.name, "rb") as file:
            return _map(file).reshape(shape)

    def seal(self, shape: Shape, facts: dict[str, Any]) -> None:
        """Write the header: the ``shape`` (z, y, x) and the other facts of the volume."""
        body = json.dumps({"shape": shape, "facts": facts})
        head = json.dumps({"format": FORMAT, "crc32c": google_crc32c.value(body.encode()), "body": body})
        self._file.seek(0)
        self._file.write(head.encode().ljust(HEADER))


def read_voxels(path: Path) -> tuple[np.ndarray, dict[str, Any]] | None:
    """Map the voxels of a file, and read its facts; None where it is missing or damaged.

    Damage of the header and a wrong size are detected. Do not write to the array: that would take memory of this
    process.
    """
    try:
        with open(path, "rb") as file:
            found = _read_header(file.read(HEADER))
            if found is None or os.fstat(file.fileno()).st_size != HEADER + 4 * math.prod(found[0]):
                return None
            return _map(file).reshape(found[0]), found[1]
    except FileNotFoundError:
        return None


def _map(file: IO[bytes]) -> np.ndarray:
    """Map all voxels in a file; float32."""
    flags, access = mmap.MAP_PRIVATE | NO_RESERVE, mmap.PROT_READ | mmap.PROT_WRITE
    mapping = mmap.mmap(file.fileno(), 0, flags=flags, prot=access)
    RESIDENT.watch(mapping)
    return np.frombuffer(mapping, np.float32, offset=HEADER)


def _read_header(header: bytes) -> tuple[Shape, dict[str, Any]] | None:
    try:
        head = json.loads(header)
        body = head["body"]
        if head["format"] != FORMAT or head["crc32c"] != google_crc32c.value(body.encode()):
            return None
        content = json.loads(body)
        return tuple(content["shape"]), {key: _tuples(value) for key, value in content["facts"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def _tuples(value: Any) -> Any:
    """JSON lists as tuples."""
    return tuple(value) if isinstance(value, list) else value
