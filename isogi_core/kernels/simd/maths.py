"""Mathematics that run on numbers and on vectors alike, and conversions between them.

``abs``, ``min``, ``max``, ``math.sqrt`` and ``math.copysign`` take vectors too. If two elements are
equal, or one is NaN, ``min`` and ``max`` return the first, as Python does. ``vector[i]`` is the
number in lane i.
"""

import math
import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic, overload

from isogi_core.kernels.simd import operators
from isogi_core.kernels.simd.llvm import (
    BIT_TYPE,
    DOUBLE_TYPE,
    LONG_TYPE,
    WORD_TYPE,
    call,
    consecutive,
    define,
    elementwise,
    mask_bits,
    ranks,
    splat,
    spread,
    stub,
    suffix,
    vector_type,
)
from isogi_core.kernels.simd.operators import BOOLEAN_TYPES, REAL_TYPES
from isogi_core.kernels.simd.types import PATH_WIDTH, RAY_WIDTH, Vector

TO_UNIT = 2.0**-32

fma = stub("fma", "Return a · b + c of f32×N, rounded once.", __name__)
f32 = stub("f32", "Convert f64×N, i32×N, or a number in RAY_WIDTH lanes, to f32×N.", __name__)
f64 = stub("f64", "Convert f32×N, i32×N, or a number in RAY_WIDTH lanes, to f64×N.", __name__)
i32 = stub(
    "i32",
    "Truncate f32×N or f64×N to i32×N, which must hold them, or copy a number to RAY_WIDTH lanes.",
    __name__,
)
mask_of = stub("mask_of", "Return a mask with the given truth in RAY_WIDTH lanes.", __name__)
popcount = stub("popcount", "Return the number of lanes that are set in the mask.", __name__)
bits = stub("bits", "Return the mask as an integer, bit i for lane i.", __name__)
lane_numbers = stub("lane_numbers", "Return 0, 1, 2, … in RAY_WIDTH lanes of i32×N.", __name__)
rank = stub(
    "rank",
    "Return, for each lane, the number of lanes before it that are set in the mask.",
    __name__,
)


# --- choice ---


def where(truth: Any, a: Any, b: Any) -> Any:
    """Return ``a`` if ``truth`` is true, else ``b``; both are computed. For a mask, choose lane
    by lane; two single numbers become f64×N, or i32×N if both are integers.
    """
    return a if truth else b


def _type_of_choice(truth: Any, a: Any, b: Any) -> Any:
    """Return the signature of ``where``, or None if its arguments do not fit each other."""
    pair = (a, b)
    numbers = all(isinstance(each, types.Number) for each in pair)
    whole = all(isinstance(each, types.Integer) for each in pair)
    # A single truth chooses between two numbers, or between two truths.
    if isinstance(truth, types.Boolean):
        if whole:
            kind = types.int64
        elif numbers:
            kind = types.float64
        elif a == b == truth:
            kind = types.boolean
        else:
            kind = None
        return kind and signature(kind, truth, kind, kind)
    # A mask chooses between vectors of its width; numbers are converted to them.
    if not (isinstance(truth, Vector) and truth.number in BOOLEAN_TYPES):
        return None
    if numbers:
        kind = truth.of(types.int32 if whole else types.float64)
    else:
        kind = next((each for each in pair if isinstance(each, Vector)), None)
    fits = (
        kind
        and kind.count == truth.count
        and all(each == kind or isinstance(each, types.Number) for each in pair)
    )
    if fits:
        return signature(kind, truth, *[kind if each == kind else kind.scalar for each in pair])
    return None


@define(where, _type_of_choice)
def _where(
    context: Any, builder: ir.IRBuilder, sig: Any, truth: ir.Value, *pair: ir.Value
) -> ir.Value:
    """Emit a select; single numbers are first copied to all lanes if the result is a vector."""
    kind = sig.return_type
    if isinstance(kind, Vector):
        pair = tuple(spread(builder, value, kind) for value in pair)
    return builder.select(truth, *pair)


def _chooser(sign: str) -> Any:
    """Return the builder of "b if b ``sign`` a, else a", lane by lane."""

    def _build(builder: ir.IRBuilder, kind: Vector, a: ir.Value, b: ir.Value) -> ir.Value:
        return builder.select(operators.comparison(sign)(builder, kind, b, a), b, a)

    return _build


elementwise(min, 2, REAL_TYPES | operators.INTEGER_TYPES)(_chooser("<"))
elementwise(max, 2, REAL_TYPES | operators.INTEGER_TYPES)(_chooser(">"))


def not_(truth: Any) -> Any:
    """Return the negation of ``truth``; of a mask, in each lane."""
    return not truth


def any_of(truth: Any) -> Any:
    """Return True if ``truth`` is true; for a mask, in any lane."""
    return truth


@define(not_, lambda truth: signature(truth, truth))
def _not(context: Any, builder: ir.IRBuilder, sig: Any, truth: ir.Value) -> ir.Value:
    """Emit the negation of a truth or mask."""
    return builder.not_(truth)


@define(any_of, lambda truth: signature(types.boolean, truth))
def _any_of(context: Any, builder: ir.IRBuilder, sig: Any, truth: ir.Value) -> ir.Value:
    """Emit the test that any bit of a mask is set; a single truth is returned as it is."""
    if not isinstance(truth.type, ir.VectorType):
        return truth
    return builder.icmp_unsigned("!=", mask_bits(builder, truth), LONG_TYPE(0))


def divide(a: Any, b: Any) -> Any:
    """Return a / b by IEEE 754: infinite or NaN if b is 0, in Python too."""
    with np.errstate(all="ignore"):
        return np.float64(a) / b


def _type_of_quotient(a: Any, b: Any) -> Any:
    """Return the signature of ``divide``: two vectors of one type, or a vector and a number, give a
    vector; two numbers give float64.
    """
    pair = (a, b)
    kind = next((each for each in pair if isinstance(each, Vector)), types.float64)
    return signature(kind, *[each if each == kind else types.float64 for each in pair])


@define(divide, _type_of_quotient)
def _divide(context: Any, builder: ir.IRBuilder, sig: Any, *pair: ir.Value) -> ir.Value:
    """Emit a division that is rounded exactly; single numbers are first copied to all lanes."""
    kind = sig.return_type
    if isinstance(kind, Vector):
        pair = tuple(spread(builder, value, kind) for value in pair)
    return builder.fdiv(*pair, flags=operators.FAST_FLAGS[types.float64])


# --- functions ---


@elementwise(fma, 3, {types.float32})
def _fma(builder: ir.IRBuilder, kind: Vector, *values: ir.Value) -> ir.Value:
    """Emit a fused multiply-add."""
    return call(builder, f"llvm.fma.{suffix(kind)}", vector_type(kind), *values)


@elementwise(abs, 1, REAL_TYPES)
def _abs(builder: ir.IRBuilder, kind: Vector, a: ir.Value) -> ir.Value:
    """Emit the absolute value."""
    return call(builder, f"llvm.fabs.{suffix(kind)}", a.type, a)


@elementwise(math.sqrt, 1, REAL_TYPES)
def _sqrt(builder: ir.IRBuilder, kind: Vector, a: ir.Value) -> ir.Value:
    """Emit the square root."""
    return call(builder, f"llvm.sqrt.{suffix(kind)}", a.type, a)


@elementwise(math.copysign, 2, REAL_TYPES)
def _copysign(builder: ir.IRBuilder, kind: Vector, size: ir.Value, sign: ir.Value) -> ir.Value:
    """Emit ``size`` with the sign of ``sign``."""
    return call(builder, f"llvm.copysign.{suffix(kind)}", sign.type, size, sign)


def floor_within(x: Any, last: Any) -> Any:
    """Return the largest integer ≤ ``x``, clamped to 0 … ``last``, and 0 for NaN;
    for f64×N, as whole f64×N.
    """
    if x >= last:
        return last
    if x > 0.0:
        return int(x)
    return 0


@overload(floor_within)
def _overload_floor_within(x: Any, last: Any) -> Any:
    """Choose the code of ``floor_within`` by the type of ``x``."""

    def _of_vectors(x: Any, last: Any) -> Any:
        """Clamp by selects, which turn NaN into 0, as comparisons with it are false."""
        whole = _floor(x)
        whole = where(whole > 0.0, whole, 0.0)
        return where(whole < last, whole, last)

    if isinstance(x, Vector):
        return _of_vectors
    return floor_within


@intrinsic
def _floor(typing: Any, x: Any) -> Any:
    """Emit the floor of a vector."""

    def _build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        return call(builder, f"llvm.floor.{suffix(x)}", values[0].type, values[0])

    return x(x), _build


# --- conversion ---


def _conversion(number: Any) -> Any:
    """Return the typer of a conversion to vectors of ``number``: from other vectors, and from
    single numbers in RAY_WIDTH lanes.
    """

    def _typer(value: Any) -> Any:
        if isinstance(value, Vector):
            if value.number not in BOOLEAN_TYPES:
                return signature(value.of(number), value)
            return None
        kind = Vector(number, RAY_WIDTH)
        if isinstance(value, types.Number):
            return signature(kind, kind.scalar)
        return None

    return _typer


def _convert(context: Any, builder: ir.IRBuilder, sig: Any, value: ir.Value) -> ir.Value:
    """Build a conversion to a vector,
    from a single number or from a vector of another element type.
    """
    kind = sig.return_type
    if not isinstance(value.type, ir.VectorType):
        return spread(builder, value, kind)
    # Choose LLVM's instruction by the elements of both vectors.
    given = sig.args[0].number
    result = vector_type(kind)
    if given == kind.number:
        return value
    if given == types.int32:
        return builder.sitofp(value, result)
    if kind.number == types.int32:
        return builder.fptosi(value, result)
    if kind.number == types.float32:
        return builder.fptrunc(value, result)
    return builder.fpext(value, result)


for _function, _number in ((f32, types.float32), (f64, types.float64), (i32, types.int32)):
    define(_function, _conversion(_number))(_convert)


def u32(number: Any) -> Any:
    """Return a number 0 … 2³² - 1 in PATH_WIDTH lanes of u32×N."""
    return np.uint64(number)


@define(u32, lambda number: signature(Vector(types.uint32, PATH_WIDTH), types.int64))
def _u32(context: Any, builder: ir.IRBuilder, sig: Any, number: ir.Value) -> ir.Value:
    """Emit a number copied to PATH_WIDTH lanes."""
    return spread(builder, number, sig.return_type)


def fraction(word: Any) -> Any:
    """Return a word 0 … 2³² - 1 divided by 2³², in [0, 1)."""
    return word * TO_UNIT


def _type_of_fraction(word: Any) -> Any:
    """Return the signature of ``fraction``."""
    if isinstance(word, Vector):
        return signature(word.of(types.float64), word)
    return signature(types.float64, types.uint64)


@define(fraction, _type_of_fraction)
def _fraction(context: Any, builder: ir.IRBuilder, sig: Any, word: ir.Value) -> ir.Value:
    """Emit the conversion of unsigned words to float64, and the product with 2⁻³². Both are exact,
    so the product needs no flags against fusing.
    """
    kind = DOUBLE_TYPE
    unit = DOUBLE_TYPE(TO_UNIT)
    if isinstance(sig.return_type, Vector):
        kind = vector_type(sig.return_type)
        unit = splat(builder, unit, sig.return_type.count)
    return builder.fmul(builder.uitofp(word, kind), unit)


# --- masks and lanes ---


@define(mask_of, lambda truth: signature(Vector(types.boolean, RAY_WIDTH), types.boolean))
def _mask_of(context: Any, builder: ir.IRBuilder, sig: Any, truth: ir.Value) -> ir.Value:
    """Emit a truth copied to RAY_WIDTH lanes."""
    return splat(builder, builder.trunc(truth, BIT_TYPE), RAY_WIDTH)


@define(bits, lambda mask: signature(types.int64, mask))
def _bits(context: Any, builder: ir.IRBuilder, sig: Any, mask: ir.Value) -> ir.Value:
    """Emit the integer whose bits are the mask's."""
    return mask_bits(builder, mask)


@define(popcount, lambda mask: signature(types.int64, mask))
def _popcount(context: Any, builder: ir.IRBuilder, sig: Any, mask: ir.Value) -> ir.Value:
    """Emit the count of the mask's bits that are set."""
    return call(builder, "llvm.ctpop.i64", LONG_TYPE, mask_bits(builder, mask))


@define(lane_numbers, lambda: signature(Vector(types.int32, RAY_WIDTH)))
def _lane_numbers(context: Any, builder: ir.IRBuilder, sig: Any) -> ir.Value:
    """Emit the constant 0, 1, 2 …."""
    return consecutive(0, RAY_WIDTH)


@define(rank, lambda mask: signature(mask.of(types.int32), mask))
def _rank(context: Any, builder: ir.IRBuilder, sig: Any, mask: ir.Value) -> ir.Value:
    """Emit the counts of set lanes before each lane."""
    return ranks(builder, builder.trunc(mask_bits(builder, mask), WORD_TYPE), mask.type.count)


def _type_of_item(vector: Any, lane: Any) -> Any:
    """Return the signature of ``vector[lane]``."""
    if isinstance(vector, Vector):
        return signature(vector.number, vector, types.int64)
    return None


@define(operator.getitem, _type_of_item, ((Vector, types.Integer),))
def _item(
    context: Any, builder: ir.IRBuilder, sig: Any, vector: ir.Value, lane: ir.Value
) -> ir.Value:
    """Emit the extraction of one lane."""
    return builder.extract_element(vector, lane)
