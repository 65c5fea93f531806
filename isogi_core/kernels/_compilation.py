"""Compiling entry kernels ahead of the first call: on all cores, in processes of their own, with progress."""

import os
import signal
import threading
import time
from collections.abc import Iterable
from importlib import import_module
from multiprocessing import get_context
from typing import Any, NamedTuple

import numba

from isogi_core.kernels._jit import Entry, entries_of, load

LOOK = 0.02
"""Seconds between two looks at whether the wait for a compilation is given up."""

NICENESS = 5
"""Niceness of processes that compile beside a server: pictures that can be drawn already come first."""


class KernelProgress(NamedTuple):
    """How far a compilation is: ``done`` of ``total`` kernels, and the ``seconds`` left, None before that is known."""

    done: int
    total: int
    seconds: float | None


class Compilation:
    """Entry kernels that this machine lacks, which are compiled once for all processes. Any thread may ask how far."""

    def __init__(self, kernels: Iterable[Any]) -> None:
        """Compile nothing yet: list those of the ``kernels``, and of what they call, that are not stored."""
        self._lacking = [each for each in with_callees(kernels) if not each.stored]
        self._whole = sum(each.size for each in self._lacking)
        self._begun: float | None = None

    @property
    def progress(self) -> KernelProgress | None:
        """How far it is; None where nothing is lacking."""
        left = [each for each in self._lacking if not each.stored]
        if not left:
            return None
        rest, seconds = sum(each.size for each in left), None
        if self._begun is not None and rest < self._whole:
            seconds = (time.monotonic() - self._begun) * rest / (self._whole - rest)
        return KernelProgress(len(self._lacking) - len(left), len(self._lacking), seconds)

    def run(self, kernels: Iterable[Any], stopped: threading.Event, niceness: int = 0) -> None:
        """Compile those of its kernels that are among ``kernels``, or called by them, and load the ``kernels`` here.

        Returns as soon as it can once ``stopped`` is set.
        """
        self._begun = self._begun or time.monotonic()
        entries = entries_of(kernels)
        compile_beside(entries, stopped, niceness)
        load(entries, stopped)


def warm(kernels: Iterable[Any], stopped: threading.Event | None = None) -> None:
    """Load ``kernels``; those that were never compiled are compiled first, on all cores.

    Once ``stopped`` is set it returns as soon as it can.
    """
    kernels = list(kernels)
    Compilation(kernels).run(kernels, stopped or threading.Event())


def with_callees(kernels: Iterable[Any]) -> list[Entry]:
    """The entry kernels among ``kernels`` and those that they call, each once and before its callers."""
    found: dict[Entry, None] = {}
    for entry in entries_of(kernels):
        found |= dict.fromkeys((*with_callees(entry.callees), entry))
    return list(found)


def in_order(entries: Iterable[Entry]) -> list[Entry]:
    """Those first that call no other, and of these the largest: what comes last is short, and waits for none."""
    return sorted(entries, key=lambda entry: (bool(entry.callees), -entry.size))


def compile_beside(kernels: Iterable[Any], stopped: threading.Event, niceness: int = 0) -> None:
    """Compile ``kernels`` that are not stored in processes of their own: within one, Numba compiles one at a time.

    Their ``niceness`` is so much higher than this process's.
    """
    names = [entry.name for entry in in_order(with_callees(kernels)) if not entry.stored]
    processes = min(numba.config.NUMBA_DEFAULT_NUM_THREADS, len(names))
    if processes < 2:
        return
    spawn = get_context("spawn")
    helpers = [spawn.Process(target=compile_named, args=[names, niceness], daemon=True) for _ in range(processes)]
    for helper in helpers:
        helper.start()
    for helper in helpers:
        while helper.is_alive() and not stopped.is_set():
            helper.join(LOOK)
        helper.terminate()
        helper.join()


def compile_named(names: list[str], niceness: int) -> None:
    """Compile those kernels that are not stored yet and that no other process is at."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(niceness)
    for name in names:
        module, _, function = name.rpartition(".")
        getattr(import_module(module), function).offer()
