"""The decorators of kernels: the one place that sets Numba's options, and compiles or loads entry
kernels.

A kernel with a signature is an ``Entry``: Python calls it, and it is compiled once per machine.
Other kernels are helpers, compiled as parts of the entries that call them. A ``Choice`` is a helper
with several bodies, chosen by the types of its arguments.
"""

import threading
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, update_wrapper
from types import CodeType
from typing import Any

import llvmlite.binding as llvm
import numba
from numba import njit, types
from numba.core import cgutils
from numba.core.imputils import lower_builtin
from numba.core.sigutils import normalize_signature
from numba.core.typing.templates import AbstractTemplate, builtin_registry, signature
from numba.extending import register_jitable
from numba.np import linalg

from isogi_core.kernels._cache_folder import LOCK_SUFFIX, locked, open_folder
from isogi_core.kernels._compiler import Compiler

# Sums and products may be fused, and signs of zeros ignored. Not all of fastmath is allowed: `nnan`
# would make isnan() False, which kernels call.
FASTMATH = {"nsz", "contract"}
EXACT = {"nsz"}
ANY_ORDER = FASTMATH | {"reassoc"}

KERNEL_FOLDER, FOLDER_HOLD, READ_ONLY_FOLDER = open_folder()

numba.config.CACHE_DIR = str(KERNEL_FOLDER)

REAL_ARRAY = types.float64[::1]
REAL_ROWS = types.float64[:, ::1]
INTEGER_ARRAY = types.int64[::1]
SINGLE_ROWS = types.float32[:, ::1]
SINGLE_ARRAY = types.float32[::1]
REAL_TRIPLE = types.UniTuple(types.float64, 3)
COUNT_ARRAY = types.int32[::1]
"""Numba's types of arguments that many entry kernels have."""


def no_blas() -> None:
    """Tell Numba that there is no BLAS:
    to look for one, each process would import SciPy if it is installed.
    """
    raise ImportError("Kernels call no BLAS.")


linalg.ensure_blas = no_blas


class Entry:
    """An entry kernel, called from Python, and by other kernels through its address.

    When first called, it is compiled once for all processes, or loaded; it has code only for the
    types of its signature. Any thread may call it. Kernels that call it hold no copy of its code,
    and are compiled without it.
    """

    def __init__(self, function: Callable[..., Any], given: Any, options: dict[str, Any]) -> None:
        """Wrap a Python ``function`` with the Numba signature ``given``;
        nothing is compiled yet.
        """
        update_wrapper(self, function)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.targetoptions = options
        self._signature = given
        self._ready: Any = None
        let_kernels_call(self, *normalize_signature(given))

    def __call__(self, *arguments: Any) -> Any:
        """Run the kernel. Raises TypeError if the arguments have other types than the signature."""
        return self.ready(*arguments)

    @property
    def ready(self) -> Any:
        """Numba's compiled function; the first access compiles or loads it."""
        if self._ready is None:
            # Callees come first: their addresses must be known when this kernel is linked.
            load(self.callees)
            # The lock lets one process compile and the others load its result.
            with locked(KERNEL_FOLDER / f"{self.name}{LOCK_SUFFIX}"):
                if self._ready is None:
                    self._compile()
        return self._ready

    @cached_property
    def parts(self) -> tuple[Any, ...]:
        """The functions that become its machine code, and the entry kernels that it calls."""
        found: dict[Any, None] = {}
        find_parts(self.__wrapped__, found)
        return tuple(found)

    @property
    def callees(self) -> list["Entry"]:
        """The entry kernels that it calls, which must be loaded before it."""
        return entries_of(self.parts)

    @property
    def size(self) -> int:
        """Bytes of the Python bytecode that becomes its machine code; the time to compile it
        grows with this.
        """
        return sum(len(each.__code__.co_code) for each in self.parts if not isinstance(each, Entry))

    def offer(self) -> None:
        """Compile the kernel, unless it is stored already or another process compiles it.

        Its callees are loaded first; if another process compiles one of them, wait for that.
        """
        if self.stored:
            return
        load(self.callees)
        with locked(KERNEL_FOLDER / f"{self.name}{LOCK_SUFFIX}", wait=False) as ours:
            if ours and not self.stored:
                self._compile()

    @property
    def loaded(self) -> bool:
        """True if this process has loaded it."""
        return self._ready is not None

    @property
    def stored(self) -> bool:
        """True if the folder of compiled kernels holds it."""
        module, name = self.name.split(".")[-2:]
        return any(KERNEL_FOLDER.glob(f"*/{module}.{name}-*.nbi"))

    def _compile(self) -> None:
        """Compile the kernel, or load it from the folder of compiled kernels."""
        ready = njit(self._signature, cache=True, no_cfunc_wrapper=True, **self.targetoptions)(
            self.__wrapped__
        )
        # Publish the address under the kernel's name, by which compiled callers link to it.
        (compiled,) = ready.overloads.values()
        llvm.add_symbol(
            self.name, compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
        )
        self._ready = ready


def let_kernels_call(entry: Entry, arguments: tuple[Any, ...], result: Any) -> None:
    """Register an ``entry`` kernel with Numba, so that compiled code calls it by its name.

    The name is a symbol that ``Entry._compile`` sets to the address of the machine code.
    """
    call = signature(result or types.none, *arguments)

    def _generic(self: Any, given: Any, kws: Any) -> Any:
        if len(given) == len(arguments):
            return call
        return None

    template = type("Call", (AbstractTemplate,), {"key": entry, "generic": _generic})
    builtin_registry.register_global(entry, types.Function(template))

    @lower_builtin(entry, *arguments)
    def _call(context: Any, builder: Any, sig: Any, values: Any) -> Any:
        entry.ready  # noqa: B018 (a caller that is loaded before the symbol is known ends the process)
        # Call the symbol by Numba's convention, and pass errors of the callee on.
        kind = context.call_conv.get_function_type(sig.return_type, sig.args)
        function = cgutils.get_or_insert_function(builder.module, kind, entry.name)
        status, value = context.call_conv.call_function(
            builder, function, sig.return_type, sig.args, values
        )
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return value


class Choice:
    """A helper with several bodies, of which one is chosen by the types of the records that it is
    called with, when its caller is compiled.

    It is multiple dispatch at compile time: ``@choice.case(RecordType)`` adds a body.
    """

    __name__: str

    def __init__(self, function: Callable[..., Any]) -> None:
        """Take name and docstring from a Python ``function``, whose body is never run."""
        update_wrapper(self, function)
        self._cases: dict[frozenset[type], Any] = {}
        let_kernels_choose(self)

    def __call__(self, *arguments: Any) -> Any:
        """Run the body for arguments of these types in Python, if Numba is switched off."""
        return self.chosen([type(each) for each in arguments])(*arguments)

    def case(self, *records: type) -> Callable[[Callable[..., Any]], Any]:
        """Return a decorator that adds the body for calls that have all of these ``records``
        among their arguments; other arguments are free.
        """

        def _add(body: Callable[..., Any]) -> Any:
            self._cases[frozenset(records)] = kernel()(body)
            return self._cases[frozenset(records)]

        return _add

    @property
    def bodies(self) -> Iterable[Any]:
        """All bodies that may be chosen."""
        return self._cases.values()

    def chosen(self, given: Iterable[Any]) -> Any:
        """Return the body of the case that names the most of the types ``given``, which are Numba's
        or Python's.

        Raises TypeError if two cases name as many.
        """
        # Numba's type of a NamedTuple knows its class.
        kinds = {getattr(each, "instance_class", each) for each in given}
        *others, best = sorted((case for case in self._cases if case <= kinds), key=len)
        if others and len(others[-1]) == len(best):
            raise TypeError(
                f"{self.__name__} has two cases for {kinds}: name more records in one of them."
            )
        return self._cases[best]


def let_kernels_choose(choice: Choice) -> None:
    """Register a ``choice`` with Numba, so that compiled code that calls it calls the body for
    the types of the arguments.
    """

    def _body(given: Any) -> Any:
        return types.Dispatcher(choice.chosen(given))

    def _generic(self: Any, given: Any, kws: Any) -> Any:
        return _body(given).get_call_type(self.context, given, kws)

    def _key(_: Any, called: Any) -> Any:
        return _body(called.args).get_impl_key(called)

    # Numba types the call, and looks its code up, as a call of the chosen body.
    template = type(
        "Chosen", (AbstractTemplate,), {"key": choice, "generic": _generic, "get_impl_key": _key}
    )
    builtin_registry.register_global(choice, types.Function(template))


def find_parts(function: Callable[..., Any], found: dict[Any, None]) -> None:
    """Add to ``found`` a function, all helpers that it reaches by calls, and the entry kernels
    that any of them calls.
    """
    found[function] = None
    for name in names_in(function.__code__):
        each = function.__globals__.get(name)
        # An entry kernel is compiled by itself: its helpers are not parts of the caller.
        if isinstance(each, Entry):
            found[each] = None
            continue
        # Any body of a choice may become a part.
        for body in each.bodies if isinstance(each, Choice) else ():
            part = getattr(body, "py_func", body)
            if part not in found:
                find_parts(part, found)
        part = getattr(each, "py_func", each)
        if hasattr(part, "__code__") and part not in found:
            find_parts(part, found)


def names_in(code: CodeType) -> Iterator[str]:
    """Yield the global names that ``code`` and the code objects within it use."""
    yield from code.co_names
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from names_in(each)


def kernel(
    signature: Any = None, exact: bool = False, any_order: bool = False, inline: bool = False
) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function by Numba with the options of this project.

    Without a ``signature`` the function is a helper, compiled as a part of its callers; with one it
    is an ``Entry``.

    - ``exact``: give the same bits wherever it is inlined, by not fusing products with sums.
    - ``any_order``: let sums be reordered to fill vectors, so that their last bits depend on the
      processor.
    - ``inline``: inline it into its callers, however long it is.
    """
    if exact:
        fastmath = EXACT
    elif any_order:
        fastmath = ANY_ORDER
    else:
        fastmath = FASTMATH
    # ``nogil`` lets threads run side by side; NumPy's error model divides by zero without a test.
    options = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": fastmath,
        "pipeline_class": Compiler,
    }
    # Without Numba, for debugging, kernels are plain Python functions.
    if numba.config.DISABLE_JIT:
        return lambda function: function
    if signature is None:
        return lambda function: helper(function, {"forceinline": inline, **options})
    return lambda function: Entry(function, signature, options)


def helper(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Return Numba's dispatcher of a helper, without wrappers for calls from Python, which take a
    quarter of the time to compile.

    A twin with wrappers is compiled if Python calls the helper, as tests do.
    """
    twin = njit(**options)(function)
    dispatcher = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **options)(function)
    # Python jumps to the wrappers of the twin; the dispatcher serves compiled callers alone.
    twin._insert, dispatcher._insert = (
        dispatcher._insert,
        lambda *_: None,
    )
    dispatcher._compile_for_args = twin._compile_for_args
    return dispatcher


def plain(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a function that kernels and Python share: kernels compile it,
    Python runs it as it stands.
    """
    if numba.config.DISABLE_JIT:
        return function
    return register_jitable(error_model="numpy")(function)


def record(cls: type, *members: Any) -> Any:
    """Return Numba's type of the NamedTuple ``cls`` whose members have the types ``members``."""
    return types.BaseTuple.from_types(members, cls)


def load(kernels: Iterable[Any], stopped: threading.Event | None = None) -> None:
    """Load ``kernels`` into this process, and compile those that are not stored; stop between
    two kernels once ``stopped`` is set.
    """
    for entry in entries_of(kernels):
        if stopped is None or not stopped.is_set():
            entry.ready  # noqa: B018


def entries_of(kernels: Iterable[Any]) -> list[Entry]:
    """Return the entry kernels among ``kernels``; none if Numba is switched off, as all are
    plain functions then.
    """
    return [kernel for kernel in kernels if isinstance(kernel, Entry)]
