"""The compiler of kernels: Numba's, with two changes: one halves the time to compile, the other
the time of rays whose records hold many arrays.

Kernels that allocate no arrays are compiled without reference counts: their caller holds the arrays
until they return. With counts, Numba would add to each array of a record, atomically, wherever a
helper takes the record apart; that took half of the time of a ray of shine.

Helpers are optimised and turned into machine code as parts of the entry kernels that call them, and
not by themselves as well.
"""

from typing import Any

from numba.core import ir, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonTypeInference

TAKES_APART = {"getattr", "getitem", "static_getitem", "exhaust_iter", "build_tuple", "phi", "cast"}
"""Expressions whose arrays belong to their operands, and are not new."""


class HelperCode(JITCodeLibrary):  # type: ignore[misc]
    """LLVM code of a helper, which is linked into the code of its callers."""

    def _optimize_final_module(self) -> None:
        """Do nothing: the entry kernel is optimised once everything is inlined."""

    def _finalize_final_module(self) -> None:
        """Finish the module without making machine code of it."""
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class Uncalled:
    """Placeholder for the compiled function of a helper, which Python never calls."""


@register_pass(mutates_CFG=False, analysis_only=True)
class ChooseLowering(FunctionPass):  # type: ignore[misc]
    """A compiler pass after type inference that chooses how a kernel is lowered: with or
    without reference counts, and as a helper or not.
    """

    _name = "choose_lowering"

    def __init__(self) -> None:
        """Take no arguments, as Numba's passes do."""

    def run_pass(self, state: Any) -> bool:
        """Choose for the kernel in the compiler's ``state``; return False,
        as its code is not changed.
        """
        # A kernel that allocates nothing needs no runtime for references.
        if not makes_arrays(state):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        # Helpers have no wrappers for Python: that flag marks them.
        if state.flags.no_cpython_wrapper:
            state.targetctx = state.targetctx.subtarget()
            state.targetctx.get_executable = lambda *_: Uncalled()
            state.library = HelperCode(state.targetctx.codegen(), state.func_id.func_qualname)
        return False


class Compiler(CompilerBase):  # type: ignore[misc]
    """Numba's compiler with the pass ``ChooseLowering``."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's passes in their order, with ``ChooseLowering`` after type inference."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(ChooseLowering, NopythonTypeInference)
        passes.finalize()
        return [passes]


def makes_arrays(state: Any) -> bool:
    """Return True if a typed function allocates arrays, calls a function that returns some,
    or returns any.
    """
    if holds_arrays(state, state.return_type):
        return True
    statements = [each for block in state.func_ir.blocks.values() for each in block.body]
    # An assignment of an array to a slice allocates a copy if both overlap.
    copies = [
        each.value.name for each in statements if isinstance(each, ir.SetItem | ir.StaticSetItem)
    ]
    if any(isinstance(state.typemap[name], types.Array) for name in copies):
        return True
    # An expression allocates if its result holds arrays that are not parts of its operands.
    made = [
        each
        for each in statements
        if isinstance(each, ir.Assign) and isinstance(each.value, ir.Expr)
    ]
    return any(
        holds_arrays(state, state.typemap[each.target.name]) and not borrows(state, each.value)
        for each in made
    )


def borrows(state: Any, expression: Any) -> bool:
    """Return True if the arrays of an ``expression`` are held elsewhere: parts of others,
    or a record of such.
    """
    if expression.op == "call":
        return isinstance(state.typemap[expression.func.name], types.NamedTupleClass)
    return expression.op in TAKES_APART


def holds_arrays(state: Any, kind: Any) -> bool:
    """Return True if values of the type ``kind`` hold references to arrays."""
    return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())
