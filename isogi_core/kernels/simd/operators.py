"""Python's operators on vectors: arithmetic, comparison and logic of masks, for any element type
and width.

A single number on either side is copied to every lane. Sums and products of float32 may be fused
into one rounding, as elsewhere in kernels. Those of float64 are rounded one by one, so that they
give the same bits as a kernel that is ``exact``.
"""

import operator
from typing import Any

from llvmlite import ir
from numba import types

from isogi_core.kernels.simd.llvm import Build, elementwise
from isogi_core.kernels.simd.types import Vector

REAL_TYPES = {types.float32, types.float64}
INTEGER_TYPES = {types.int32, types.uint32}
BOOLEAN_TYPES = {types.boolean}

# An operation without any flag is given those of its kernel, so products of float64 would be fused
# with sums. To prevent that, each has a flag that is harmless: signs of zeros may be ignored.
FAST_FLAGS = {types.float32: ("contract", "nsz"), types.float64: ("nsz",)}


def method(real: str, whole: str = "") -> Build:
    """Return a builder that calls the IRBuilder's method ``real`` for floating point, and
    ``whole`` for integers and masks.
    """

    def _build(builder: ir.IRBuilder, kind: Vector, *values: ir.Value) -> ir.Value:
        """Emit the operation with the flags of its element type."""
        if kind.number in REAL_TYPES:
            return getattr(builder, real)(*values, flags=FAST_FLAGS[kind.number])
        return getattr(builder, whole)(*values)

    return _build


def define_binary(name: str, elements: set[Any], build: Build) -> None:
    """Define the binary operator ``name`` of module ``operator`` for vectors,
    and its in-place form.
    """
    for each in (name, "i" + name.rstrip("_")):
        elementwise(getattr(operator, each), 2, elements)(build)


for _operator in ("add", "sub", "mul"):
    define_binary(_operator, REAL_TYPES | INTEGER_TYPES, method("f" + _operator, _operator))
define_binary("truediv", REAL_TYPES, method("fdiv"))
define_binary("lshift", INTEGER_TYPES, method("", "shl"))
for _operator in ("and_", "or_", "xor"):
    define_binary(_operator, INTEGER_TYPES | BOOLEAN_TYPES, method("", _operator))
elementwise(operator.invert, 1, BOOLEAN_TYPES)(method("", "not_"))
elementwise(operator.neg, 1, REAL_TYPES)(lambda builder, kind, a: builder.fneg(a))


def _shift_right(builder: ir.IRBuilder, kind: Vector, a: ir.Value, b: ir.Value) -> ir.Value:
    """Shift right: int32 fills up with the sign bit, uint32 with zeros."""
    if kind.number == types.int32:
        return builder.ashr(a, b)
    return builder.lshr(a, b)


define_binary("rshift", INTEGER_TYPES, _shift_right)


def comparison(sign: str) -> Build:
    """Return the builder of a comparison; NaN differs from everything, and no other comparison
    with it is true.
    """

    def _build(builder: ir.IRBuilder, kind: Vector, a: ir.Value, b: ir.Value) -> ir.Value:
        """Emit the comparison for the element type."""
        if kind.number in REAL_TYPES:
            return (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(sign, a, b)
        if kind.number == types.int32:
            return builder.icmp_signed(sign, a, b)
        return builder.icmp_unsigned(sign, a, b)

    return _build


for _operator, _sign in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">=")):
    elementwise(getattr(operator, _operator), 2, REAL_TYPES | INTEGER_TYPES, masks=True)(
        comparison(_sign)
    )
for _operator, _sign in (("eq", "=="), ("ne", "!=")):
    elementwise(
        getattr(operator, _operator), 2, REAL_TYPES | INTEGER_TYPES | BOOLEAN_TYPES, masks=True
    )(comparison(_sign))
