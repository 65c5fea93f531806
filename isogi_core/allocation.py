"""How the C library keeps memory that is freed."""

import ctypes

MMAP_THRESHOLD = -3
ARENA_MAX = -8
"""The numbers of glibc's parameters for what goes back to the system when freed, and for arenas
(malloc.h: M_…).
"""

LARGE_ARRAY_BYTES = 256 << 10
"""Bytes from which on memory comes from the system, and goes back to it: a view's arrays, not those
of a draft.
"""


def keep_memory_small() -> None:
    """Have memory that is freed used again, or given back; for all threads that are still to start.

    Left to itself glibc gives threads arenas of their own, up to eight a core, each of which keeps
    the most that its threads ever had at once; threads that hold the interpreter's lock to take
    memory gain nothing by that. And it gives ever larger arrays a place among small things, which
    hold on to it. Where the C library is another one, nothing is done.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(ARENA_MAX, 1)
        mallopt(MMAP_THRESHOLD, LARGE_ARRAY_BYTES)


def give_memory_back() -> None:
    """Give back to the system what is free between things that are in use, where the C library
    can.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
