"""Warming up: having entry kernels ready before they are called."""

import signal
import threading
from collections.abc import Iterable
from importlib import import_module
from multiprocessing import get_context
from typing import Any

import numba

from isogi_core.kernels._jit import Entry

LOOK = 0.02
"""Seconds between two looks at whether the wait for a compilation is given up."""


def warm(kernels: Iterable[Any], stopped: threading.Event | None = None) -> None:
    """Load ``kernels``; those that were never compiled are compiled first, on all cores, in the order given.

    Once ``stopped`` is set it returns as soon as it can.
    """
    stopped = stopped or threading.Event()
    entries = entries_of(kernels)
    compile_beside([entry.name for entry in entries if not entry.stored], stopped)
    load(entries, stopped)


def load(kernels: Iterable[Any], stopped: threading.Event | None = None) -> None:
    """Have ``kernels`` in this process, which compiles those that it must. Ends between two once ``stopped`` is set."""
    for entry in entries_of(kernels):
        if stopped is None or not stopped.is_set():
            entry.ready  # noqa: B018


def entries_of(kernels: Iterable[Any]) -> list[Entry]:
    """The entry kernels among ``kernels``; none where Numba is switched off: they are plain functions then."""
    return [kernel for kernel in kernels if isinstance(kernel, Entry)]


def compile_beside(names: list[str], stopped: threading.Event) -> None:
    """Compile kernels in processes of their own: within one, Numba compiles one thing at a time."""
    processes = min(numba.config.NUMBA_DEFAULT_NUM_THREADS, len(names))
    if processes < 2:
        return
    spawn = get_context("spawn")
    helpers = [spawn.Process(target=compile_named, args=[names], daemon=True) for _ in range(processes)]
    for helper in helpers:
        helper.start()
    for helper in helpers:
        while helper.is_alive() and not stopped.is_set():
            helper.join(LOOK)
        helper.terminate()
        helper.join()


def compile_named(names: list[str]) -> None:
    """Compile those kernels that are not stored yet and that no other process is at."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in names:
        module, _, function = name.rpartition(".")
        getattr(import_module(module), function).offer()
