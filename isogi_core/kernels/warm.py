"""Warming up: having entry kernels ready before they are called."""

import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from importlib import import_module
from multiprocessing import get_context

from isogi_core.kernels._jit import Entry


def warm(kernels: Iterable[Entry]) -> None:
    """Load ``kernels``; those that were never compiled are compiled first, on all cores, in the order given."""
    entries = [entry for entry in kernels if isinstance(entry, Entry)]
    compile_beside(entries)
    for entry in entries:
        entry.ready  # noqa: B018


def compile_beside(entries: Iterable[Entry]) -> None:
    """Compile what is not stored yet in processes of their own: within one, Numba compiles one thing at a time."""
    missing = [entry.name for entry in entries if not entry.stored]
    processes = min(len(os.sched_getaffinity(0)), len(missing))
    if processes > 1:
        with suppress(BrokenProcessPool), ProcessPoolExecutor(processes, get_context("spawn")) as pool:
            list(pool.map(compile_one, missing))


def compile_one(name: str) -> None:
    """Compile the kernel that ``name`` says, with its module."""
    module, _, function = name.rpartition(".")
    getattr(import_module(module), function).ready  # noqa: B018
