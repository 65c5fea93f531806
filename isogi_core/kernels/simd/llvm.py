"""Tools that define functions of vectors for Numba, and build their LLVM code.

``operators``, ``maths``, ``memory`` and ``voxels`` use them. A function is defined by a typer,
which gives the signature for types of arguments, and a builder, which emits instructions.
"""

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
"""LLVM types of the elements of vectors."""

Build = Callable[..., ir.Value]
Typer = Callable[..., Any]

ANYTHING = ((types.VarArg(types.Any),),)
UNARY_PATTERNS = ((Vector,),)
BINARY_PATTERNS = ((Vector, Vector), (Vector, types.Number), (types.Number, Vector))
"""Patterns of argument types for Numba's registry. Functions that exist for vectors alone match
anything; functions of Python match if a vector is among the arguments.
"""


def vector_type(vector: Vector) -> ir.VectorType:
    """Return the LLVM type of a vector."""
    return ir.VectorType(ELEMENTS[vector.number], vector.count)


@register_model(Vector)
class VectorModel(models.PrimitiveModel):
    """Numba's data model of a vector: one LLVM vector, in variables, arguments and tuples alike."""

    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        super().__init__(dmm, fe_type, vector_type(fe_type))


def define(
    function: Any, typer: Typer, patterns: Sequence[Any] = ANYTHING
) -> Callable[[Build], Build]:
    """Return a decorator that registers a builder as the code of ``function``.

    ``typer(*arguments)`` returns the signature for these types of arguments, or None if there is
    none. The builder is called as ``build(context, builder, signature, *values)`` and returns the
    result's value. ``patterns`` are the argument types that it is registered for. The decorator
    returns the builder as it is, so that it may serve several functions.
    """

    def _generic(self: Any, args: Any, kws: Any) -> Any:
        """Return the signature for these types of arguments, as Numba's typing asks for it."""
        return typer(*args)

    # Numba asks this template for the signature of a call.
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
    """Return the type of the vectors among ``arguments``."""
    return next(each for each in arguments if isinstance(each, Vector))


def elementwise(
    function: Any, arity: int, elements: set[Any], masks: bool = False
) -> Callable[[Build], Build]:
    """Return a decorator that registers a builder for a ``function`` of vectors of one type,
    element by element.

    The builder is called as ``build(builder, vector type, *vectors)``. The function takes ``arity``
    arguments, at least one of them a vector whose element type is in ``elements``; single numbers
    among them are copied to all lanes first. The result is of the same type or, if ``masks``, a
    mask.
    """

    def _typer(*args: Any) -> Any:
        """Return the signature if all vectors have one type, with allowed elements, and the
        rest are numbers.
        """
        vectors = [each for each in args if isinstance(each, Vector)]
        others = [each for each in args if not isinstance(each, Vector)]
        if (
            len(args) != arity
            or not vectors
            or not all(isinstance(each, types.Number) for each in others)
        ):
            return None
        # All vectors must have one type, with an element that the function is made for.
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
    """Make a function of ``module`` that exists in compiled code only, as a key by which ``define``
    registers its code; ``does`` is its docstring.

    Python's version raises NotImplementedError.
    """

    def _function(*_: Any) -> Any:
        raise NotImplementedError(f"{name} exists in compiled code only, and takes vectors")

    _function.__name__ = _function.__qualname__ = name
    _function.__doc__ = does
    _function.__module__ = module
    return _function


def splat(builder: ir.IRBuilder, value: ir.Value, count: int) -> ir.Value:
    """Return a vector with ``value`` in each of ``count`` lanes."""
    vector = ir.VectorType(value.type, count)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, WORD_TYPE(0))
    zeros = ir.Constant(ir.VectorType(WORD_TYPE, count), [0] * count)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def spread(builder: ir.IRBuilder, value: ir.Value, kind: Vector) -> ir.Value:
    """Return a number in every lane of a vector of type ``kind``; vectors are returned as they are.

    Numba hands single numbers over in the wide type ``kind.scalar``, so they are narrowed to the
    element type first.
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
    """Call the LLVM intrinsic ``name``."""
    kind = ir.FunctionType(result, [value.type for value in values])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), values)


def suffix(kind: Vector) -> str:
    """Return the end of the names of LLVM intrinsics for a vector of reals, such as v32f64."""
    return f"v{kind.count}f{kind.number.bitwidth}"


def consecutive(first: int, last: int, step: int = 1) -> ir.Constant:
    """Return the constant vector first, first + step, … below ``last``, as indices of a shuffle."""
    numbers = list(range(first, last, step))
    return ir.Constant(ir.VectorType(WORD_TYPE, len(numbers)), numbers)


def join(builder: ir.IRBuilder, parts: list[ir.Value]) -> ir.Value:
    """Return the vectors ``parts``, a power of two of them, end to end as one."""
    # Join neighbours in pairs until one is left.
    while len(parts) > 1:
        both = 2 * parts[0].type.count
        pairs = zip(parts[::2], parts[1::2], strict=True)
        parts = [builder.shuffle_vector(a, b, consecutive(0, both)) for a, b in pairs]
    return parts[0]


def mask_bits(builder: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    """Return a mask as a 64-bit integer, bit i for lane i."""
    return builder.zext(builder.bitcast(mask, ir.IntType(mask.type.count)), LONG_TYPE)


def ranks(builder: ir.IRBuilder, word: ir.Value, count: int) -> ir.Value:
    """Return, for each of ``count`` lanes, the number of bits below it that are set
    in a 32-bit ``word``.
    """
    before = ir.Constant(
        ir.VectorType(WORD_TYPE, count), [(1 << lane) - 1 for lane in range(count)]
    )
    below = builder.and_(splat(builder, word, count), before)
    return call(builder, f"llvm.ctpop.v{count}i32", before.type, below)
