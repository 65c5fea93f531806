"""Compiling entry kernels ahead of the first call: on all cores, in processes of their own, with
progress.
"""

import os
import signal
import threading
import time
from collections.abc import Collection, Iterable
from importlib import import_module
from multiprocessing import get_context
from typing import Any, NamedTuple

import numba

from isogi_core.kernels._jit import Entry, entries_of, load

POLL_SECONDS = 0.02
"""Seconds between two looks at whether the wait for a compilation is given up."""

MIN_TIMED_SHARE = 0.1
"""Share of a compilation after which its time is estimated."""

COMPILER_NICENESS = 5
"""Niceness of processes that compile beside a server: pictures that can be drawn already come
first.
"""


class KernelProgress(NamedTuple):
    """How far a compilation is: ``done`` of ``total`` kernels, and the ``seconds`` left, None
    before that is known.
    """

    done: int
    total: int
    seconds: float | None


class Compilation:
    """Entry kernels that this machine lacks, stage by stage: each is compiled once for all
    processes.

    All cores work at it, in processes of their own: within one, Numba compiles one kernel at a
    time. Any thread may ask how far it is.
    """

    def __init__(self, *stages: Iterable[Any]) -> None:
        """Compile nothing yet: list the kernels of the ``stages``, and their callees, that are not
        stored.
        """
        listed: dict[Entry, None] = {}
        for stage in stages:
            listed |= dict.fromkeys(in_order(with_callees(stage), listed))
        self._lacking = [each for each in listed if not each.stored]
        self._begun = time.monotonic()
        self._work: threading.Thread | None = None

    def begin(self, stopped: threading.Event, niceness: int = 0, start: str = "spawn") -> None:
        """Have all compiled by processes whose ``niceness`` is so much higher than this one's,
        until ``stopped``.

        They ``start`` by that method of multiprocessing.
        """
        names = [each.name for each in self._lacking]
        self._begun = time.monotonic()
        work = [names, stopped, niceness, start]
        self._work = threading.Thread(target=compile_beside, args=work, name="compiling")
        self._work.start()

    def wait(self, kernels: Iterable[Any]) -> None:
        """Returns once ``kernels`` are compiled, or nobody is at it any more: it was stopped, or
        there is one core.
        """
        for entry in with_callees(kernels):
            while (
                self._work and self._work.is_alive() and not entry.stored
            ):  # a look at a folder: one at a time
                self._work.join(POLL_SECONDS)

    def progress(self, kernels: Iterable[Any]) -> KernelProgress | None:
        """How far the compilation of ``kernels`` is; None where this machine has them all."""
        wanted = set(with_callees(kernels))
        lacking = [each for each in self._lacking if each in wanted]
        left = [each for each in lacking if not each.stored]
        if not left:
            return None
        whole = sum(each.size for each in lacking)
        rest = sum(each.size for each in left)
        under_way = sum(each.size for each in left[: numba.config.NUMBA_DEFAULT_NUM_THREADS]) / 2
        pace = (time.monotonic() - self._begun) / (whole - rest + under_way)
        if whole - rest > MIN_TIMED_SHARE * whole:
            seconds = pace * (rest - under_way)
        else:
            seconds = None
        return KernelProgress(len(lacking) - len(left), len(lacking), seconds)


def warm(kernels: Iterable[Any], stopped: threading.Event | None = None, niceness: int = 0) -> None:
    """Load ``kernels``; kernels that were never compiled are compiled first, on all cores.

    Once ``stopped`` is set it returns as soon as it can. For the ``niceness`` see ``Compilation``.
    """
    kernels = list(kernels)
    stopped = stopped or threading.Event()
    work = Compilation(kernels)
    work.begin(stopped, niceness)
    work.wait(kernels)
    load(kernels, stopped)


def with_callees(kernels: Iterable[Any]) -> list[Entry]:
    """The entry kernels among ``kernels`` and their callees, each once and before its callers."""
    found: dict[Entry, None] = {}
    for entry in entries_of(kernels):
        found |= dict.fromkeys((*with_callees(entry.callees), entry))
    return list(found)


def in_order(entries: Iterable[Entry], before: Collection[Entry] = ()) -> list[Entry]:
    """Kernels first that call none but ``before``, and of these the largest: what comes last is
    short.
    """
    return sorted(
        entries, key=lambda entry: (any(each not in before for each in entry.callees), -entry.size)
    )


def compile_beside(
    names: list[str], stopped: threading.Event, niceness: int = 0, start: str = "spawn"
) -> None:
    """Compile kernels in processes, one for each core, until ``stopped``; none where that would be
    one process.
    """
    processes = min(numba.config.NUMBA_DEFAULT_NUM_THREADS, len(names))
    if processes < 2:
        return
    context: Any = get_context(start)
    helpers = [
        context.Process(target=compile_named, args=[names, niceness], daemon=True)
        for _ in range(processes)
    ]
    for helper in helpers:
        helper.start()
    for helper in helpers:
        while helper.is_alive() and not stopped.is_set():
            helper.join(POLL_SECONDS)
        helper.terminate()
        helper.join()


def compile_named(names: list[str], niceness: int) -> None:
    """Compile the kernels that are not stored yet and that no other process compiles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(niceness)
    for name in names:
        module, _, function = name.rpartition(".")
        getattr(import_module(module), function).offer()
