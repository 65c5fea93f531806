"""A bound of the pages of files in a process's memory, kept by a thread that never waits for the
interpreter.
"""

import ctypes
import mmap
from typing import Any

import numba
import numpy as np
from numba import types

from isogi_core.kernels._jit import INTEGER_ARRAY, kernel

MICROSECONDS = 1000
"""Between two looks at how much is resident."""

RELEASE_BYTES = 1 << 24
"""Bytes of addresses that are let go of in one step."""

LIBRARY_BYTES = 1 << 25
"""Bytes of files that a process may still load besides."""

STATM_BYTES = 256
"""Bytes that a line of /proc/self/statm fits into."""

NEVER_NEEDED = getattr(mmap, "MADV_DONTNEED", 4)
SPACE_CODE = ord(" ")
ZERO_CODE = ord("0")
RESIDENT_FIELD = 2
PAGE_BYTES = mmap.PAGESIZE

C_TYPES = {types.int32: ctypes.c_int32, types.int64: ctypes.c_int64, types.uint32: ctypes.c_uint32}


def system_function(name: str, result: Any, *arguments: Any) -> Any:
    """A function of the C library, for kernels; addresses are int64."""
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
    """Bytes of files in memory: the third number in the open file ``status``, read into ``line``
    (uint8).
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
def let_go(status, line, enough, table, row, start):
    """Let go of pages from byte ``start`` of mapping ``row`` on, until ``enough`` bytes or fewer
    are resident.

    Each mapping has its turn once at most. Returns where to go on, row and byte, and whether all
    pages were let go of.
    """
    total = table[:, 1].sum()
    done = 0
    while done < total and resident(status, line) > enough:
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
    """Let go of mappings' pages when more than ``bounds[0]`` bytes are resident, down to
    ``bounds[1]``, until it is 0.

    ``table`` (m, 2) holds address and bytes of each mapping, whole pages, zeros where there is
    none; it changes under the ``mutex`` alone, which is the memory of one of the C library. Pages
    are let go of whether they are in use or not: what is needed again is still in the system's
    cache. Other files do not count, such as libraries: the ``bounds[2]`` bytes resident at first,
    and LIBRARY_BYTES more at most, by an eighth of what is left once all is let go.
    """
    line = np.empty(STATM_BYTES, np.uint8)
    row = 0
    start = 0
    others = bounds[2]
    while bounds[0] > 0:
        usleep(MICROSECONDS)
        if resident(status, line) > others + bounds[0]:
            lock_mutex(mutex.ctypes.data)
            row, start, bare = let_go(status, line, others + bounds[1], table, row, start)
            unlock_mutex(mutex.ctypes.data)
            if bare:
                left = resident(status, line)
                others = min(others + (left - others) // 8, bounds[2] + LIBRARY_BYTES)
