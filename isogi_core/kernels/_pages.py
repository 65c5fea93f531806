"""A limit on the memory that pages of mapped files take,
kept by a thread that never waits for the interpreter.
"""

import ctypes
import mmap
from typing import Any

import numba
import numpy as np
from numba import types

from isogi_core.kernels._jit import INTEGER_ARRAY, kernel

MICROSECONDS = 1000
"""Microseconds between two checks of resident memory."""

RELEASE_BYTES = 1 << 24
"""Bytes of addresses that are released in one step."""

LIBRARY_BYTES = 1 << 25
"""Bytes of other files, such as libraries, that a process may still load."""

STATM_BYTES = 256
"""Size of a buffer for a line of /proc/self/statm."""

NEVER_NEEDED = getattr(mmap, "MADV_DONTNEED", 4)
SPACE_CODE = ord(" ")
ZERO_CODE = ord("0")
RESIDENT_FIELD = 2
PAGE_BYTES = mmap.PAGESIZE

C_TYPES = {types.int32: ctypes.c_int32, types.int64: ctypes.c_int64, types.uint32: ctypes.c_uint32}


def system_function(name: str, result: Any, *arguments: Any) -> Any:
    """Return a function of the C library for kernels; addresses are int64."""
    if not numba.config.DISABLE_JIT:
        return types.ExternalFunction(name, result(*arguments))
    found = getattr(ctypes.CDLL(None), name)
    found.restype = C_TYPES[result]
    found.argtypes = [C_TYPES[each] for each in arguments]
    return found


usleep = system_function("usleep", types.int32, types.uint32)
pread = system_function("pread", types.int64, types.int32, types.int64, types.int64, types.int64)
madvise = system_function("madvise", types.int32, types.int64, types.int64, types.int32)
lock_mutex = system_function("pthread_mutex_lock", types.int32, types.int64)
unlock_mutex = system_function("pthread_mutex_unlock", types.int32, types.int64)


@kernel()
def resident(status, line):
    """Return the bytes of files in memory: the third number in the open file ``status``
    (/proc/self/statm), read into ``line`` (uint8).
    """
    count = pread(status, line.ctypes.data, line.size, 0)
    field = 0
    pages = 0
    for i in range(count):
        if line[i] == SPACE_CODE:
            field += 1
        elif field == RESIDENT_FIELD:
            pages = 10 * pages + (np.int64(line[i]) - ZERO_CODE)
    return pages * PAGE_BYTES


@kernel()
def release_pages(status, line, enough, table, row, start):
    """Release pages from byte ``start`` of mapping ``row`` on, until at most ``enough`` bytes are
    resident.

    Each byte is released once at most. Returns the row and the byte to go on from, and True if all
    pages were released.
    """
    total = table[:, 1].sum()
    done = 0
    while done < total and resident(status, line) > enough:
        # Go on to the next mapping at the end of one.
        while start >= table[row, 1]:
            row = (row + 1) % table.shape[0]
            start = 0
        size = min(RELEASE_BYTES, table[row, 1] - start)
        madvise(table[row, 0] + start, size, NEVER_NEEDED)
        start = start + size
        done = done + size
    return row, start, done >= total


@kernel(types.void(types.int32, INTEGER_ARRAY, types.int64[:, ::1], INTEGER_ARRAY))
def bound_pages(status, bounds, table, mutex):
    """Keep pages of mapped files in bounds, until ``bounds[0]`` is 0: if more than ``bounds[0]``
    bytes are resident, release pages down to ``bounds[1]``.

    ``table`` (m, 2) holds address and bytes of each mapping, whole pages, zeros for a free entry;
    it is changed only under ``mutex``, which is the memory of a pthread mutex. Pages in use are
    released too: those needed again are still in the system's cache. ``status`` is the open file
    /proc/self/statm.

    Other files, such as libraries, do not count: the ``bounds[2]`` bytes resident at first, and up
    to LIBRARY_BYTES more.
    """
    line = np.empty(STATM_BYTES, np.uint8)
    row = 0
    start = 0
    others = bounds[2]
    while bounds[0] > 0:
        usleep(MICROSECONDS)
        if resident(status, line) > others + bounds[0]:
            lock_mutex(mutex.ctypes.data)
            row, start, all_released = release_pages(
                status, line, others + bounds[1], table, row, start
            )
            unlock_mutex(mutex.ctypes.data)
            # Bytes left after everything was released belong to other files: approach them by an
            # eighth.
            if all_released:
                left = resident(status, line)
                others = min(others + (left - others) // 8, bounds[2] + LIBRARY_BYTES)
