"""Compilation of entry kernels ahead of their first call:
on all cores, in separate processes, with progress.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from typing import Any, NamedTuple

import numba

from isogi_core.kernels._jit import Entry, entries_of, load

POLL_SECONDS = 0.02
"""Seconds between two checks for stored kernels, and for the end of the compilation."""

MIN_TIMED_SHARE = 0.1
"""Share of a compilation after which the remaining time is estimated."""

COMPILER_NICENESS = 5
"""Niceness of processes that compile next to a server, so that pictures that can be drawn
already come first.
"""


class KernelProgress(NamedTuple):
    """Progress of a compilation: ``done`` of ``total`` kernels,
    and the ``seconds`` left, None while unknown.
    """

    done: int
    total: int
    seconds: float | None


class Compilation:
    """Entry kernels that this machine lacks, compiled stage by stage, once for all processes.

    All cores work at it, in separate processes: within one process, Numba compiles one kernel at a
    time. Any thread may ask for the progress.
    """

    def __init__(self, *stages: Iterable[Any]) -> None:
        """List the kernels of the ``stages``, and their callees, that are not stored;
        compile nothing yet.
        """
        asked: dict[Entry, None] = {}
        for stage in stages:
            asked |= dict.fromkeys(in_order(with_callees(stage), asked))
        self._lacking = [each for each in asked if not each.stored]
        self._begun = time.monotonic()
        self._work: threading.Thread | None = None

    def begin(self, stopped: threading.Event, niceness: int = 0, start: str = "spawn") -> None:
        """Start to compile the kernels that the constructor found missing, in up to one process per
        core, until ``stopped`` is set; return at once.

        If one process would be enough, none is started, and each kernel is compiled when it is
        first loaded. The niceness of the processes is higher than that of this one by ``niceness``;
        ``start`` is the start method of multiprocessing.
        """
        names = [each.name for each in self._lacking]
        self._begun = time.monotonic()
        work = [names, stopped, niceness, start]
        self._work = threading.Thread(target=compile_in_processes, args=work, name="compiling")
        self._work.start()

    def wait(self, kernels: Iterable[Any]) -> None:
        """Wait until ``kernels`` are compiled, or no process compiles: because it was stopped,
        or there is one core.
        """
        for entry in with_callees(kernels):
            # A check reads a folder, so that kernels are checked one at a time.
            while self._work and self._work.is_alive() and not entry.stored:
                self._work.join(POLL_SECONDS)

    def progress(self, kernels: Iterable[Any]) -> KernelProgress | None:
        """Return the progress of the compilation of ``kernels``;
        None if this machine has them all.
        """
        wanted = set(with_callees(kernels))
        lacking = [each for each in self._lacking if each in wanted]
        left = [each for each in lacking if not each.stored]
        if not left:
            return None
        # Estimate the time left by size, taking kernels that are being compiled as half done.
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
    """Load ``kernels``; those that were never compiled are compiled first, on all cores.

    Returns soon after ``stopped`` is set. For ``niceness`` see ``Compilation.begin``.
    """
    kernels = list(kernels)
    stopped = stopped or threading.Event()
    work = Compilation(kernels)
    work.begin(stopped, niceness)
    work.wait(kernels)
    load(kernels, stopped)


def with_callees(kernels: Iterable[Any]) -> list[Entry]:
    """Return the entry kernels among ``kernels`` and their callees,
    each once and before its callers.
    """
    found: dict[Entry, None] = {}
    for entry in entries_of(kernels):
        found |= dict.fromkeys((*with_callees(entry.callees), entry))
    return list(found)


def in_order(entries: Iterable[Entry], before: Collection[Entry] = ()) -> list[Entry]:
    """Sort kernels: first those that call none but ``before``, and of these the largest first,
    so that the last ones are short.
    """
    return sorted(
        entries, key=lambda entry: (any(each not in before for each in entry.callees), -entry.size)
    )


def compile_in_processes(
    names: list[str], stopped: threading.Event, niceness: int = 0, start: str = "spawn"
) -> None:
    """Compile the kernels ``names`` in processes, one per core, until ``stopped``; do nothing
    if one process would be enough.
    """
    processes = min(numba.config.NUMBA_DEFAULT_NUM_THREADS, len(names))
    if processes < 2:
        return
    # Each process goes through all names, and compiles those that no other has begun.
    context: Any = get_context(start)
    helpers = [
        context.Process(target=compile_named, args=[names, niceness], daemon=True)
        for _ in range(processes)
    ]
    with without_main():
        for helper in helpers:
            helper.start()
    # Wait for the processes, or end them once stopped.
    for helper in helpers:
        while helper.is_alive() and not stopped.is_set():
            helper.join(POLL_SECONDS)
        helper.terminate()
        helper.join()


@contextmanager
def without_main() -> Iterator[None]:
    """Start processes meanwhile that do not import the main module.

    A process that Python starts imports the main module of its parent again. A user's script
    without ``if __name__ == "__main__":`` would then run once more in each of them.
    """
    main = sys.modules["__main__"]
    with STARTING:
        hidden = {name: vars(main).pop(name, None) for name in ("__file__", "__spec__")}
        main.__spec__ = None
        try:
            yield
        finally:
            vars(main).update({name: value for name, value in hidden.items() if value is not None})


STARTING = threading.Lock()
"""Held while processes start and the main module is hidden."""


def compile_named(names: list[str], niceness: int) -> None:
    """Compile those of the kernels ``names`` that are not stored yet
    and that no other process compiles.
    """
    # An interrupt goes to the parent, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(niceness)
    for name in names:
        module, _, function = name.rpartition(".")
        getattr(import_module(module), function).offer()
