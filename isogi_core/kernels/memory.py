"""Memory: asking for what will be read soon."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload


def fetch(flat, place):
    """Have the line of ``flat[place]`` brought into the cache while other work goes on; without Numba nothing."""


@intrinsic
def _fetch(typing: Any, flat: Any, place: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> Any:
        data = context.make_array(flat)(context, builder, arguments[0]).data
        line = builder.bitcast(builder.gep(data, [arguments[1]]), cgutils.voidptr_t)
        word = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, word, word, word])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [line, word(0), word(3), word(1)])
        return context.get_dummy_value()

    return types.none(flat, types.int64), generate


@overload(fetch, inline="always")
def _overload_fetch(flat, place):
    return lambda flat, place: _fetch(flat, place)  # noqa: PLW0108 (Numba wants a function of Python)
