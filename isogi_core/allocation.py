"""Settings of the C library for memory that is freed."""

import ctypes

MMAP_THRESHOLD = -3
ARENA_MAX = -8
"""Numbers of glibc's parameters for the size from which freed memory goes back to the system,
and for the number of arenas (malloc.h: M_…).
"""

LARGE_ARRAY_BYTES = 256 << 10
"""Size in bytes from which memory comes from the system and goes back to it: the arrays of a
view are larger, those of a draft smaller.
"""


def keep_memory_small() -> None:
    """Make glibc reuse freed memory or give it back, for all threads that start later.

    By default each thread gets an arena, up to eight per core, which keeps the most memory that its
    threads ever held at one time; threads that hold the interpreter's lock while they allocate gain
    nothing from that. And glibc places ever larger arrays among small objects, which then keep them
    from being given back. With another C library nothing is done.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(ARENA_MAX, 1)
        mallopt(MMAP_THRESHOLD, LARGE_ARRAY_BYTES)


def give_memory_back() -> None:
    """Give free memory between objects in use back to the system, if the C library can."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
