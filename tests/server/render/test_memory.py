"""What a server's memory is for, and that what is freed is used again or given back."""

import subprocess
import sys

import pytest

from server.render.workforce import shared

THREADS = """
import ctypes, re, sys, threading
from isogi_core.allocation import keep_memory_small
if "small" in sys.argv:
    keep_memory_small()
barrier = threading.Barrier(8)
def work():
    ctypes.pythonapi.PyMem_RawMalloc(100_000)
    barrier.wait()
threads = [threading.Thread(target=work) for _ in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
libc.malloc_info(0, ctypes.c_void_p(libc.fopen(b"/dev/stdout", b"w")))
libc.fflush(None)
"""
"""Eight threads that take memory at once, and what glibc then tells of its arenas, as XML."""


@pytest.mark.parametrize("total", [1, 7, 1 << 20, 1 << 40])
def test_a_memory_is_shared_to_the_last_byte(total: int) -> None:
    memory = shared(total)
    assert sum(memory) == total
    assert memory.light >= memory.views == memory.maps >= 0
    assert memory.light == pytest.approx(total / 2, abs=2)


def test_all_steps_of_finer_texels_take_a_quarter_more() -> None:
    memory = shared(1 << 30)
    steps = [memory := memory.finer for _ in range(4)]
    assert 0 < sum(step.light + step.views for step in steps) <= (1 << 30) / 4


def arenas(*how: str) -> int:
    """How many arenas glibc has after eight threads took memory."""
    told = subprocess.run([sys.executable, "-c", THREADS, *how], capture_output=True, check=True, text=True).stdout
    return told.count("<heap nr=")


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc has arenas")
def test_threads_share_one_arena() -> None:
    if arenas() == 0:
        pytest.skip("this C library is not glibc")
    assert arenas() > 1
    assert arenas("small") == 1


LARGE = """
import resource, sys
import numpy as np
from isogi_core.allocation import keep_memory_small
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()
if "small" in sys.argv:
    keep_memory_small()
del (largest := [np.ones(8 << 20, np.uint8)])[:]
before, kept, freed = resident(), [], []
for _ in range(64):
    freed.append(np.ones(1 << 20, np.uint8))
    kept.append(np.ones(1 << 10, np.uint8))
del freed[:]
print(resident() - before)
"""
"""Large arrays that come and go beside small ones that stay; the bytes by which the process has grown in the end."""


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc holds on to it")
def test_large_arrays_go_back_to_the_system() -> None:
    run = [sys.executable, "-c", LARGE, "small"]
    assert int(subprocess.run(run, capture_output=True, check=True, text=True).stdout) < 8 << 20
