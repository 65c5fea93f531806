"""Mapped memory of which the system makes resident the pages that are read, and none around them."""

import ctypes
import fcntl
import mmap
import os
import platform
import struct
import sys
import threading
from contextlib import suppress

USERFAULTFD_CALLS = {"x86_64": 323, "aarch64": 282}
"""Number of Linux's call userfaultfd, by machine."""

USERFAULTFD_FLAGS = os.O_CLOEXEC | 1
"""Of that call: the file is closed in other programs, and serves faults of this program alone, as all users may ask."""

API_REQUEST, REGISTER_REQUEST = 0xC018AA3F, 0xC020AA00
"""Requests of userfaultfd(2): UFFDIO_API and UFFDIO_REGISTER."""

INTERFACE_VERSION, WRITE_PROTECTED_ASYNC, WRITE_PROTECTED = 0xAA, 1 << 15, 2
"""The interface's number; the feature by which the system itself answers faults (Linux 6.7); and the mode of that."""

MIN_PIECE_BYTES, MAX_PIECES = 1 << 18, 1 << 14
"""Least bytes of a piece of a mapping, and most pieces: a process may have 65,530 mappings on Linux."""


class SinglePages:
    """Mappings that are read page by page. Safe to use from many threads.

    On a fault Linux maps what its cache has around a page, by 64 kB or a whole folio, which may be 2 MiB: some reads
    make 300 MB resident in a millisecond. It maps one page where writes are watched by userfaultfd. Nothing is done
    with what that finds.
    """

    def __init__(self) -> None:
        """Ask for nothing yet."""
        self._file: int | None = None
        self._lock = threading.Lock()

    def add(self, mapping: mmap.mmap, address: int) -> None:
        """Have a mapping, which begins at an ``address``, read by single pages; by pieces where that cannot be had."""
        size = -(-len(mapping) // mmap.PAGESIZE) * mmap.PAGESIZE
        with self._lock:
            if self._file is None:
                self._file = self._opened()
            if self._file >= 0:
                with suppress(OSError, AttributeError):
                    mapping.madvise(mmap.MADV_NOHUGEPAGE)  # 2 MiB of a folio would be one page
                    fcntl.ioctl(self._file, REGISTER_REQUEST, struct.pack("=QQQQ", address, size, WRITE_PROTECTED, 0))
                    return
        part(mapping)

    @staticmethod
    def _opened() -> int:
        """The file to register mappings at, which is kept open; -1 where the system has none."""
        number = USERFAULTFD_CALLS.get(platform.machine()) if sys.platform == "linux" else None
        file = -1 if number is None else int(ctypes.CDLL(None).syscall(number, USERFAULTFD_FLAGS))
        if file >= 0:
            try:
                fcntl.ioctl(file, API_REQUEST, struct.pack("=QQQ", INTERFACE_VERSION, WRITE_PROTECTED_ASYNC, 0))
            except OSError:
                os.close(file)
                return -1
        return file


def part(mapping: mmap.mmap) -> None:
    """Have the system take a mapping for many: it maps nothing around a page beyond a mapping's end.

    Neighbours differ in whether core dumps hold them: that alone keeps them apart.
    """
    size = max(MIN_PIECE_BYTES, -(-len(mapping) // MAX_PIECES // mmap.PAGESIZE) * mmap.PAGESIZE)
    with suppress(OSError, AttributeError):  # too many mappings, or another system
        for start in range(0, len(mapping), 2 * size):
            mapping.madvise(mmap.MADV_DONTDUMP, start, min(size, len(mapping) - start))
