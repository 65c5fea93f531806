"""The probe of the store; and what a server's memory is for, and that what is freed is used again
or given back.
"""

import errno
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from isogi_core.storage import folder
from isogi_core.storage.store import Store
from isogi_server.render import stores
from isogi_server.render.loaded_scene import shared
from isogi_server.render.stores import StoreProbe
from tests.worker.clock import Clock


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slow disk is waited for."""
    monkeypatch.setattr(stores, "PROBE_SECONDS", 60.0)


def test_a_store_that_works_has_nothing_left_of_it(tmp_path: Path) -> None:
    assert StoreProbe(str(tmp_path)).reasons() == []
    assert StoreProbe(f"file://{tmp_path}").reasons() == []
    assert [path.name for path in tmp_path.rglob("*")] == ["isogi.json"]


def test_what_is_no_folder_is_told_with_its_name(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (reason,) = StoreProbe(str(tmp_path / "file")).reasons()
    assert str(tmp_path / "file") in reason and "\n" not in reason


def test_a_store_that_is_gone_is_told(tmp_path: Path) -> None:
    (tmp_path / "light").mkdir()
    probe = StoreProbe(Store(tmp_path / "light"), clock := Clock())
    assert probe.reasons() == []
    (tmp_path / "light").rename(tmp_path / "away")
    clock.now += 10.0
    assert "is gone: its isogi.json is missing" in probe.reasons()[0]
    (tmp_path / "away").rename(tmp_path / "light")
    clock.now += 10.0
    assert probe.reasons() == []


@pytest.mark.parametrize(
    ("number", "told"), [(errno.ENOSPC, "the store is full"), (errno.EIO, "Input/output error")]
)
def test_a_store_that_takes_nothing_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, told: str
) -> None:
    place = Store(tmp_path)
    place.open()

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(folder, "partial_file", refuse)
    assert told in StoreProbe(place).reasons()[0]


def test_a_store_that_is_only_read_is_as_it_should_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = Store(tmp_path)
    place.open()

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(folder, "partial_file", refuse)
    assert StoreProbe(place).reasons() == []
    assert place.read_only


def test_a_finding_stands_for_a_while(tmp_path: Path) -> None:
    clock = Clock()
    store = tmp_path / "store"
    probe = StoreProbe(str(store), clock)
    store.write_text("in the way")
    assert probe.reasons() != []
    store.unlink()
    clock.now += 2.0
    assert probe.reasons() != []
    clock.now += 10.0
    assert probe.reasons() == []


def test_a_store_that_hangs_holds_no_probe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    probe = StoreProbe(Store(tmp_path), clock := Clock())
    hangs = threading.Event()
    assert probe.reasons() == []
    monkeypatch.setattr(stores, "PROBE_SECONDS", 0.01)
    monkeypatch.setattr(Store, "check_writable", lambda _: hangs.wait(60))
    clock.now += 10.0
    assert probe.reasons() == [], "what was found before stands for a while"
    clock.now += 10.0
    assert probe.reasons() == [f"The store at {tmp_path} does not answer."]
    hangs.set()
    monkeypatch.setattr(stores, "PROBE_SECONDS", 60.0)
    assert probe.reasons() == []


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
    told = subprocess.run(
        [sys.executable, "-c", THREADS, *how], capture_output=True, check=True, text=True
    ).stdout
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
"""Large arrays that come and go beside small ones that stay; the bytes by which the process has
grown in the end.
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc holds on to it")
def test_large_arrays_go_back_to_the_system() -> None:
    run = [sys.executable, "-c", LARGE, "small"]
    assert int(subprocess.run(run, capture_output=True, check=True, text=True).stdout) < 8 << 20
