"""Files that are mapped into memory: a bound of their resident pages, and arrays that lie in such
files.
"""

import atexit
import ctypes
import fcntl
import mmap
import os
import platform
import struct
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from isogi_core.errors import VolumeError

USERFAULTFD_CALLS = {"x86_64": 323, "aarch64": 282}
"""Number of Linux's call userfaultfd, by machine."""

USERFAULTFD_FLAGS = os.O_CLOEXEC | 1
"""Of that call: the file is closed in other programs, and serves faults of this program alone, as
all users may ask.
"""

API_REQUEST = 0xC018AA3F
REGISTER_REQUEST = 0xC020AA00
"""Requests of userfaultfd(2): UFFDIO_API and UFFDIO_REGISTER."""

INTERFACE_VERSION = 0xAA
WRITE_PROTECTED_ASYNC = 1 << 15
WRITE_PROTECTED = 2
"""The interface's number; the feature by which the system itself answers faults (Linux 6.7); and
the mode of that.
"""

MIN_PIECE_BYTES = 1 << 18
MAX_PIECES = 1 << 14
"""Least bytes of a piece of a mapping, and most pieces: a process may have 65,530 mappings on
Linux.
"""


class SinglePages:
    """Mappings that are read page by page. Safe to use from many threads.

    On a fault Linux maps what its cache has around a page, by 64 kB or a whole folio, which may be
    2 MiB: some reads make 300 MB resident in a millisecond. It maps one page where writes are
    watched by userfaultfd. Nothing is done with what that finds.
    """

    def __init__(self) -> None:
        """Ask for nothing yet."""
        self._file: int | None = None
        self._lock = threading.Lock()

    def add(self, mapping: mmap.mmap, address: int) -> None:
        """Have a mapping, which begins at an ``address``, read by single pages; by pieces where
        that cannot be had.
        """
        size = -(-len(mapping) // mmap.PAGESIZE) * mmap.PAGESIZE
        with self._lock:
            if self._file is None:
                self._file = self._opened()
            if self._file >= 0:
                with suppress(OSError, AttributeError):
                    mapping.madvise(mmap.MADV_NOHUGEPAGE)  # 2 MiB of a folio would be one page
                    fcntl.ioctl(
                        self._file,
                        REGISTER_REQUEST,
                        struct.pack("=QQQQ", address, size, WRITE_PROTECTED, 0),
                    )
                    return
        part(mapping)

    @staticmethod
    def _opened() -> int:
        """The file to register mappings at, which is kept open; -1 where the system has none."""
        if sys.platform == "linux":
            number = USERFAULTFD_CALLS.get(platform.machine())
        else:
            number = None
        if number is None:
            file = -1
        else:
            file = int(ctypes.CDLL(None).syscall(number, USERFAULTFD_FLAGS))
        if file >= 0:
            try:
                fcntl.ioctl(
                    file,
                    API_REQUEST,
                    struct.pack("=QQQ", INTERFACE_VERSION, WRITE_PROTECTED_ASYNC, 0),
                )
            except OSError:
                os.close(file)
                return -1
        return file


def part(mapping: mmap.mmap) -> None:
    """Have the system take a mapping for many: it maps nothing around a page beyond a mapping's
    end.

    Neighbours differ in whether core dumps hold them: that alone keeps them apart.
    """
    size = max(MIN_PIECE_BYTES, -(-len(mapping) // MAX_PIECES // mmap.PAGESIZE) * mmap.PAGESIZE)
    with suppress(OSError, AttributeError):  # too many mappings, or another system
        for start in range(0, len(mapping), 2 * size):
            mapping.madvise(mmap.MADV_DONTDUMP, start, min(size, len(mapping) - start))


DEFAULT_BUDGET_MB = 2048
"""Most megabytes of mapped voxels in memory, unless ``ISOGI_VOLUME_MB`` says otherwise."""

UNMAPPED_SHARE = 1 / 8
"""Share of the budget up to which a volume's voxels are in each process's own memory, and not
mapped.
"""

SMALL_BUDGET = 1 << 30
"""Budget below which larger volumes are read by single pages: that costs time, and bounds are else
passed by 300 MB.
"""

KEPT_PAGES_SHARE = 3 / 4
"""Share of the bound down to which pages are let go of."""

MAPPINGS = 4096
"""Most mappings that are bounded at a time."""

MEMORY_STATUS = Path("/proc/self/statm")

NO_RESERVE = getattr(mmap, "MAP_NORESERVE", 0x4000 if sys.platform == "linux" else 0)
"""Flag against reserving memory: a private mapping takes none unless it is written to, which
nothing does.
"""


def budget() -> int:
    """Most bytes of voxels in memory; VolumeError where the environment variable is no such
    number.
    """
    given = os.environ.get("ISOGI_VOLUME_MB") or str(DEFAULT_BUDGET_MB)
    if not given.isdecimal() or not int(given):
        raise VolumeError(
            f"ISOGI_VOLUME_MB is '{given}': give a whole number of megabytes, from 1 on."
        )
    return int(given) << 20


def require_memory(size: int, what: str, otherwise: str) -> None:
    """Raise VolumeError where ``size`` bytes are more than the budget: ``what`` takes them, and
    what to do instead.
    """
    if size > budget():
        raise VolumeError(
            f"{what} {size / 1e6:.0f} MB of memory: {otherwise}, or give more by ISOGI_VOLUME_MB."
        )


def file_bytes() -> int:
    """Bytes of files in this process's memory; 0 where the system does not report them."""
    try:
        return int(MEMORY_STATUS.read_bytes().split()[2]) * mmap.PAGESIZE
    except OSError:
        return 0


RECURSIVE_MUTEX = 1
"""Kind of a mutex that one thread may lock twice: a mapping may be forgotten while the same thread
adds another.
"""


def new_mutex(library: ctypes.CDLL) -> np.ndarray:
    """The memory of a mutex of the C library, which a thread may lock twice."""
    mutex = np.zeros(8, np.int64)
    attributes = np.zeros(8, np.int64)
    place, kind = (ctypes.c_void_p(each.ctypes.data) for each in (mutex, attributes))
    library.pthread_mutexattr_init(kind)
    library.pthread_mutexattr_settype(kind, RECURSIVE_MUTEX)
    library.pthread_mutex_init(place, kind)
    return mutex


class Mapping(mmap.mmap):
    """A mapped file whose resident pages are bounded, for as long as it is there: see
    ``Resident``.
    """

    def __del__(self) -> None:
        """Have it left alone, before its addresses go to somebody else."""
        RESIDENT_MAPPINGS.forget(self)


class Resident:
    """The mappings of this process, with a thread that bounds their resident pages by the budget of
    voxels.

    The thread is a kernel: it works while others hold the interpreter.
    """

    def __init__(self) -> None:
        """Begin without mappings, and without the thread."""
        self._table = np.zeros((MAPPINGS, 2), np.int64)
        self._bounds = np.zeros(3, np.int64)
        self._library = ctypes.CDLL(None)
        self._pages = SinglePages()
        self._mutex = new_mutex(self._library)
        self._rows: dict[int, int] = {}
        self._lock = threading.RLock()
        self._thread: threading.Thread | None = None

    def watch(self, mapping: Mapping) -> None:
        """Bound the pages of a mapping. Raises VolumeError as ``budget`` does."""
        most = budget()
        if not MEMORY_STATUS.exists():
            return
        size = -(-len(mapping) // mmap.PAGESIZE) * mmap.PAGESIZE
        address = int(np.frombuffer(mapping, np.uint8).ctypes.data)
        with self._lock:
            if self._thread is None:
                self._begin(most)
            if most < SMALL_BUDGET and int(self._table[:, 1].sum()) + size > most:
                self._pages.add(mapping, address)
            free = np.flatnonzero(self._table[:, 1] == 0)
            if len(free):
                self._rows[id(mapping)] = int(free[0])
                self._set(int(free[0]), address, size)

    def forget(self, mapping: Mapping) -> None:
        """Leave a mapping alone."""
        with self._lock:
            row = self._rows.pop(id(mapping), None)
            if row is not None:
                self._set(row, 0, 0)

    def _set(self, row: int, address: int, size: int) -> None:
        """Change a row of the table while the thread is not at it."""
        mutex = ctypes.c_void_p(self._mutex.ctypes.data)
        self._library.pthread_mutex_lock(mutex)
        self._table[row] = address, size
        self._library.pthread_mutex_unlock(mutex)

    def _begin(self, most: int) -> None:
        """Start the thread, which ends before the interpreter does."""
        from isogi_core.kernels._pages import bound_pages  # noqa: PLC0415 (loads Numba, which readers do not need)

        run = getattr(bound_pages, "ready", bound_pages)
        self._bounds[:] = most, int(KEPT_PAGES_SHARE * most), file_bytes()
        self._thread = threading.Thread(target=self._run, args=[run], name="resident", daemon=True)
        self._thread.start()
        atexit.register(self._end)

    def _run(self, bound_pages: Callable[..., None]) -> None:
        ask_for_promptness(self._library)
        with open(MEMORY_STATUS, "rb", buffering=0) as status:
            bound_pages(status.fileno(), self._bounds, self._table, self._mutex)

    def _end(self) -> None:
        self._bounds[:] = 0
        with self._lock:
            self._rows.clear()
        if self._thread is not None:
            self._thread.join()


SCHED_SETATTR_CALLS = {"x86_64": 314, "aarch64": 274}
"""Number of Linux's call sched_setattr, by machine."""

TIME_SLICE_NANOSECONDS = 100_000
"""Nanoseconds that the thread works before others may: the least that Linux takes, and its turn
comes the sooner.
"""


def ask_for_promptness(library: ctypes.CDLL) -> None:
    """Have this thread wake at once among busy ones, where Linux is new enough (6.12)."""
    number = SCHED_SETATTR_CALLS.get(platform.machine())
    if number is not None and sys.platform == "linux":
        attributes = struct.pack(
            "=IIQiIQQQ",
            48,
            0,
            0,
            os.getpriority(os.PRIO_PROCESS, 0),
            0,
            TIME_SLICE_NANOSECONDS,
            0,
            0,
        )
        library.syscall(number, 0, attributes, 0)


RESIDENT_MAPPINGS = Resident()
"""The mappings of this process."""


def map_file(file: IO[bytes], offset: int) -> np.ndarray:
    """Map what a file holds from a byte on, float32. Writing to the array would take memory of this
    process.
    """
    flags = mmap.MAP_PRIVATE | NO_RESERVE
    access = mmap.PROT_READ | mmap.PROT_WRITE
    mapping = Mapping(file.fileno(), 0, flags=flags, prot=access)
    RESIDENT_MAPPINGS.watch(mapping)
    return np.frombuffer(mapping, np.float32, offset=offset)


def scratch(folder: Path, count: int, dtype: Any) -> np.ndarray:
    """An array of ``count`` numbers, of any values, in a file that has no name; in memory where the
    disk is full.
    """
    size = count * np.dtype(dtype).itemsize
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, size)
            mapping = Mapping(file.fileno(), size)
    except (OSError, ValueError, AttributeError):  # a full disk; no bytes; another system
        return np.empty(count, dtype)
    RESIDENT_MAPPINGS.watch(mapping)
    return np.frombuffer(mapping, dtype)
