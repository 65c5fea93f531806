"""The one place that owns Numba's options, and has entry kernels compiled or loaded before they are called."""

import signal
import threading
from collections.abc import Callable, Iterable
from functools import update_wrapper
from importlib import import_module
from multiprocessing import get_context
from typing import Any

import numba
from numba import njit, types
from numba.extending import register_jitable
from numba.np import linalg

from isogi_core.kernels._borrowing import Compiler
from isogi_core.kernels._cache_folder import cache_folder, hold, locked

# Not the whole of fastmath: `nnan` would make isnan() False, and the kernels ask.
FASTMATH = {"nsz", "contract"}
EXACT = {"nsz"}
ANY_ORDER = FASTMATH | {"reassoc"}

FOLDER = cache_folder()
USED = hold(FOLDER)

numba.config.CACHE_DIR = str(FOLDER)


def no_blas() -> None:
    """Tell Numba that there is no BLAS: to look for it, each process would import SciPy, where that is installed."""
    raise ImportError("Kernels call no BLAS.")


linalg.ensure_blas = no_blas


class Entry:
    """An entry kernel, called from outside compiled code.

    It is compiled once for all processes, or loaded, when it is first called, and only for the types of
    its signature. Any thread may call it.
    """

    def __init__(self, function: Callable[..., Any], signature: Any, options: dict[str, Any]) -> None:
        """Take on a Python ``function``; nothing is compiled yet."""
        update_wrapper(self, function)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.targetoptions = options
        self._signature = signature
        self._ready: Any = None

    def __call__(self, *arguments: Any) -> Any:
        """Run the kernel; TypeError where the arguments are of other types."""
        return self.ready(*arguments)

    @property
    def ready(self) -> Any:
        """Numba's compiled function. Asking for it compiles or loads it."""
        if self._ready is None:
            with locked(FOLDER / f"{self.name}.lock"):
                if self._ready is None:
                    self._compile()
        return self._ready

    def offer(self) -> None:
        """Compile it, unless that is done or somebody is at it."""
        with locked(FOLDER / f"{self.name}.lock", wait=False) as ours:
            if ours and not self.stored:
                self._compile()

    @property
    def loaded(self) -> bool:
        """Whether this process has it."""
        return self._ready is not None

    @property
    def stored(self) -> bool:
        """Whether the folder of compiled kernels has it."""
        module, name = self.name.split(".")[-2:]
        return any(FOLDER.glob(f"*/{module}.{name}-*.nbi"))

    def _compile(self) -> None:
        self._ready = njit(self._signature, cache=True, no_cfunc_wrapper=True, **self.targetoptions)(self.__wrapped__)


def kernel(
    signature: Any = None, exact: bool = False, any_order: bool = False, inline: bool = False
) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile with the house's options.

    Without a signature the function is a helper, compiled where it is called; with one it is an ``Entry``.
    What is ``exact`` gives the same bits wherever it is inlined: no product is fused with a sum. Sums in
    ``any_order`` fill vectors: their bits belong to the processor, and to nothing else. What is
    ``inline`` becomes part of its callers however long it is.
    """
    fastmath = EXACT if exact else ANY_ORDER if any_order else FASTMATH
    options = {"nogil": True, "error_model": "numpy", "fastmath": fastmath, "pipeline_class": Compiler}
    if numba.config.DISABLE_JIT:
        return lambda function: function
    if signature is None:
        return lambda function: helper(function, {"forceinline": inline, **options})
    return lambda function: Entry(function, signature, options)


def helper(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Numba's dispatcher of a helper. What compiled code calls is without wrappers, which take a quarter of the time.

    A twin that has them is compiled where Python calls it, as tests do.
    """
    twin = njit(**options)(function)
    dispatcher = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(function)
    twin._insert, dispatcher._insert = dispatcher._insert, lambda *_: None  # Python jumps to wrappers: to the twin's
    dispatcher._compile_for_args = twin._compile_for_args
    return dispatcher


def plain(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: a function for kernels and for Python alike, which runs it as it stands and compiles nothing."""
    return function if numba.config.DISABLE_JIT else register_jitable(error_model="numpy")(function)


def record(cls: type, *members: Any) -> Any:
    """Numba's type of the NamedTuple ``cls`` whose members have the types ``members``."""
    return types.BaseTuple.from_types(members, cls)


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
