"""Building LLVM code for vectors; mathematics are in ``operators`` and ``maths``."""

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import models, register_model

from isogi_core.kernels.simd.types import Vector

BIT_TYPE = ir.IntType(1)
BYTE_TYPE = ir.IntType(8)
WORD_TYPE = ir.IntType(32)
LONG_TYPE = ir.IntType(64)
FLOAT_TYPE = ir.FloatType()
DOUBLE_TYPE = ir.DoubleType()
ELEMENTS = {
    types.float32: FLOAT_TYPE,
    types.float64: DOUBLE_TYPE,
    types.int32: WORD_TYPE,
    types.uint32: WORD_TYPE,
    types.boolean: BIT_TYPE,
}
"""LLVM's types of a vector's elements."""

Build = Callable[..., ir.Value]
Typer = Callable[..., Any]

ANYTHING = ((types.VarArg(types.Any),),)
UNARY_PATTERNS = ((Vector,),)
BINARY_PATTERNS = ((Vector, Vector), (Vector, types.Number), (types.Number, Vector))
"""Patterns of arguments: those of functions that are ours alone, and of Python's with vectors among
the arguments.
"""


def vector_type(vector: Vector) -> ir.VectorType:
    """LLVM's type of a vector."""
    return ir.VectorType(ELEMENTS[vector.number], vector.count)


@register_model(Vector)
class VectorModel(models.PrimitiveModel):
    """A vector is one LLVM vector, in variables, arguments and tuples alike."""

    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        super().__init__(dmm, fe_type, vector_type(fe_type))


def define(
    function: Any, typer: Typer, patterns: Sequence[Any] = ANYTHING
) -> Callable[[Build], Build]:
    """Decorator: ``build(context, builder, signature, *values)`` makes the code of ``function``.

    ``typer(*arguments)`` gives the signature for these types of arguments, or None where there is
    none.
    """

    def _generic(self: Any, args: Any, kws: Any) -> Any:
        return typer(*args)

    infer_global(function)(
        type("Case", (AbstractTemplate,), {"key": function, "generic": _generic})
    )

    def _register(build: Build) -> Build:
        for pattern in patterns:

            @lower_builtin(function, *pattern)
            def _lower(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
                return build(context, builder, sig, *values)

        return build

    return _register


def operand(arguments: Sequence[Any]) -> Vector:
    """The type of the vectors among ``arguments``."""
    return next(each for each in arguments if isinstance(each, Vector))


def elementwise(
    function: Any, arity: int, elements: set[Any], masks: bool = False
) -> Callable[[Build], Build]:
    """Decorator: ``build(builder, vector type, *vectors)`` for a function of vectors of one type,
    element by element.

    Single numbers among the arguments are spread over all lanes first. The result is of the same
    type, or a mask.
    """

    def _typer(*args: Any) -> Any:
        vectors = [each for each in args if isinstance(each, Vector)]
        others = [each for each in args if not isinstance(each, Vector)]
        if (
            len(args) != arity
            or not vectors
            or not all(isinstance(each, types.Number) for each in others)
        ):
            return None
        kind = vectors[0]
        if any(each != kind for each in vectors) or kind.number not in elements:
            return None
        given = [each if isinstance(each, Vector) else kind.scalar for each in args]
        return signature(kind.mask if masks else kind, *given)

    def _register(build: Build) -> Build:
        @define(
            function,
            _typer,
            UNARY_PATTERNS if arity == 1 else BINARY_PATTERNS if arity == 2 else ANYTHING,
        )
        def _lower(context: Any, builder: ir.IRBuilder, sig: Any, *values: ir.Value) -> ir.Value:
            kind = operand(sig.args)
            return build(builder, kind, *[spread(builder, value, kind) for value in values])

        return build

    return _register


def stub(name: str, does: str, module: str) -> Any:
    """A function of ``module`` that exists in compiled code only."""

    def _function(*_: Any) -> Any:
        raise NotImplementedError(f"{name} works on vectors, in compiled code")

    _function.__name__ = _function.__qualname__ = name
    _function.__doc__ = does
    _function.__module__ = module
    return _function


def splat(builder: ir.IRBuilder, value: ir.Value, count: int) -> ir.Value:
    """A vector with ``value`` in each of ``count`` lanes."""
    vector = ir.VectorType(value.type, count)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, WORD_TYPE(0))
    zeros = ir.Constant(ir.VectorType(WORD_TYPE, count), [0] * count)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def spread(builder: ir.IRBuilder, value: ir.Value, kind: Vector) -> ir.Value:
    """A number in every lane of a ``kind``, cut to the size of its elements; vectors as they
    are.
    """
    if isinstance(value.type, ir.VectorType):
        return value
    element = ELEMENTS[kind.number]
    if value.type != element:
        if element == FLOAT_TYPE:
            value = builder.fptrunc(value, FLOAT_TYPE)
        else:
            value = builder.trunc(value, element)
    return splat(builder, value, kind.count)


def call(builder: ir.IRBuilder, name: str, result: ir.Type, *values: ir.Value) -> ir.Value:
    """Call LLVM's intrinsic ``name``."""
    kind = ir.FunctionType(result, [value.type for value in values])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), values)


def suffix(kind: Vector) -> str:
    """What ends the names of LLVM's intrinsics for a vector of reals: v32f64 and the like."""
    return f"v{kind.count}f{kind.number.bitwidth}"


def consecutive(first: int, last: int, step: int = 1) -> ir.Constant:
    """The vector first, first + step, … below ``last``, to shuffle by."""
    numbers = list(range(first, last, step))
    return ir.Constant(ir.VectorType(WORD_TYPE, len(numbers)), numbers)


def join(builder: ir.IRBuilder, parts: list[ir.Value]) -> ir.Value:
    """Vectors end to end."""
    while len(parts) > 1:
        both = 2 * parts[0].type.count
        pairs = zip(parts[::2], parts[1::2], strict=True)
        parts = [builder.shuffle_vector(a, b, consecutive(0, both)) for a, b in pairs]
    return parts[0]


def mask_bits(builder: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    """A mask as an integer of 64 bits, bit i for lane i."""
    return builder.zext(builder.bitcast(mask, ir.IntType(mask.type.count)), LONG_TYPE)


def ranks(builder: ir.IRBuilder, word: ir.Value, count: int) -> ir.Value:
    """How many bits below it are set in a word of 32 bits, for each of ``count`` lanes."""
    before = ir.Constant(
        ir.VectorType(WORD_TYPE, count), [(1 << lane) - 1 for lane in range(count)]
    )
    below = builder.and_(splat(builder, word, count), before)
    return call(builder, f"llvm.ctpop.v{count}i32", before.type, below)
