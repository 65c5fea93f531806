"""Lanes: vectors that live in registers of the processor, so that many rays walk in one loop.

Four Numba types, ``FLOATS`` (float32), ``DOUBLES`` (float64), ``INTS`` (int32) and ``MASK`` (one bit per
lane), with the operators of numbers, numbers of Python next to them being spread over all lanes. Kernels
are then written as arithmetic: ``select(t < far, near + t * d, far)``. Each operation is one instruction
of LLVM on a vector type; those on DOUBLES give the bits that numbers give in an exact kernel. A vector of
floats fills two registers, so that one half computes while the other waits for memory (up to 1.2 times
faster than one, with AVX-512).

``WIDTH`` is 32 with AVX-512, 16 with AVX2, and None elsewhere and without Numba: callers then use the
scalar kernel. Lanes cannot leave compiled code.
"""

import operator
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import models, register_model

LANES_OF_FEATURE = {"avx512f": 16, "avx2": 8}
AVX512_CPUS = ("skylake-avx512", "cascadelake", "cooperlake", "icelake", "sapphirerapids", "znver4", "znver5")
AVX2_CPUS = ("haswell", "broadwell", "skylake", "znver1", "znver2", "znver3", "alderlake")


def register_lanes() -> int | None:
    """Float32 lanes of a register of the processor that Numba compiles for; None where lanes do not pay."""
    if numba.config.DISABLE_JIT:
        return None
    name, features = numba.config.CPU_NAME, numba.config.CPU_FEATURES
    if features is None and name in (None, "", "host"):
        host = llvm.get_host_cpu_features()
        return next((width for feature, width in LANES_OF_FEATURE.items() if host.get(feature)), None)
    if features:
        return next((width for feature, width in LANES_OF_FEATURE.items() if f"+{feature}" in features), None)
    wide = any(name.startswith(cpu) for cpu in AVX512_CPUS)
    return 16 if wide else 8 if any(name.startswith(cpu) for cpu in AVX2_CPUS) else None


REGISTER = register_lanes()
WIDTH = 2 * REGISTER if REGISTER else None
COUNT = WIDTH or 1

BIT, WORD, FLOAT, DOUBLE = ir.IntType(1), ir.IntType(32), ir.FloatType(), ir.DoubleType()
REAL, WHOLE, TRUTH = types.float64, types.int64, types.boolean


class Lanes(types.Type):
    """Numba's type of a vector of ``count`` numbers, of LLVM type ``element`` and Numba type ``number``."""

    def __init__(self, number: Any, element: ir.Type, count: int = COUNT, name: str = "lanes") -> None:
        self.number, self.element, self.count = number, element, count
        self.vector = ir.VectorType(element, count)
        super().__init__(f"{name}({number} x {count})")


FLOATS, DOUBLES = Lanes(types.float32, FLOAT), Lanes(types.float64, DOUBLE)
INTS, MASK = Lanes(types.int32, WORD), Lanes(types.boolean, BIT)


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """Lanes are one LLVM vector, in variables, arguments and tuples alike."""

    def __init__(self, dmm: Any, fe_type: Lanes) -> None:
        super().__init__(dmm, fe_type, fe_type.vector)


Build = Callable[..., ir.Value]


def repeat(builder: ir.IRBuilder, value: ir.Value, width: int = COUNT) -> ir.Value:
    """A vector with ``value`` in each of ``width`` lanes."""
    vector = ir.VectorType(value.type, width)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, WORD(0))
    zeros = ir.Constant(ir.VectorType(WORD, width), [0] * width)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def spread(builder: ir.IRBuilder, value: ir.Value, kind: Lanes) -> ir.Value:
    """A number in every lane of a ``kind``, cut to the size of its elements; lanes as they are."""
    if isinstance(value.type, ir.VectorType):
        return value
    if value.type != kind.element:
        value = builder.fptrunc(value, FLOAT) if kind.element == FLOAT else builder.trunc(value, kind.element)
    return repeat(builder, value, kind.count)


def define(function: Any, result: Any, *arguments: Any, widen: Lanes | None = None) -> Callable[[Build], Build]:
    """Decorator: ``build(builder, *values)`` makes the code of ``function`` for these types of arguments.

    With ``widen`` numbers are spread over lanes of that type first.
    """

    def register(build: Build) -> Build:
        infer_global(function)(
            type("Case", (ConcreteTemplate,), {"key": function, "cases": [signature(result, *arguments)]})
        )

        @lower_builtin(function, *arguments)
        def lower(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
            return build(builder, *(values if widen is None else [spread(builder, v, widen) for v in values]))

        return build

    return register


def stub(name: str, does: str, module: str = __name__) -> Any:
    """A function of ``module`` that exists in compiled code only."""

    def function(*_: Any) -> Any:
        raise NotImplementedError(f"{name} works on lanes, in compiled code")

    function.__name__ = function.__qualname__ = name
    function.__doc__ = does
    function.__module__ = module
    return function


def call(builder: ir.IRBuilder, name: str, result: ir.Type, *values: ir.Value) -> ir.Value:
    """Call LLVM's intrinsic ``name``."""
    kind = ir.FunctionType(result, [value.type for value in values])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), values)


# --- arithmetic ---------------------------------------------------------------------------------------------


def define_operator(function: Any, kind: Lanes, number: Any, result: Any, build: Build, *leading: Any) -> None:
    """Define a binary operator for lanes with lanes, lanes with a number and a number with lanes.

    Types of other arguments may lead; they are lanes.
    """
    for left, right in ((kind, kind), (kind, number), (number, kind)):
        define(function, result, *leading, left, right, widen=kind)(build)


def define_arithmetic(name: str, kind: Lanes, number: Any, build: Build) -> None:
    """Define a binary operator of module ``operator`` and the one that assigns its result."""
    define_operator(getattr(operator, name), kind, number, kind, build)
    define_operator(getattr(operator, "i" + name.rstrip("_")), kind, number, kind, build)


def method(name: str, *leading: Any, **options: Any) -> Build:
    """The builder's method ``name`` as a Build, ``leading`` arguments first."""
    return lambda builder, *values: getattr(builder, name)(*leading, *values, **options)


# An operation without a flag is given those of its kernel, products would be fused with sums.
LOOSE, EXACT = {"flags": ("contract", "nsz")}, {"flags": ("nsz",)}
for _operator, _name in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    define_arithmetic(_operator, FLOATS, REAL, method(_name, **LOOSE))
    define_arithmetic(_operator, DOUBLES, REAL, method(_name, **EXACT))
for _operator, _name in (
    ("add", "add"), ("sub", "sub"), ("mul", "mul"), ("and_", "and_"), ("or_", "or_"), ("xor", "xor"),
    ("lshift", "shl"), ("rshift", "ashr"),
):  # fmt: skip
    define_arithmetic(_operator, INTS, WHOLE, method(_name))
for _operator, _sign in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">="), ("eq", "=="), ("ne", "!=")):
    _ordered = "fcmp_unordered" if _sign == "!=" else "fcmp_ordered"
    define_operator(getattr(operator, _operator), FLOATS, REAL, MASK, method(_ordered, _sign))
    define_operator(getattr(operator, _operator), DOUBLES, REAL, MASK, method(_ordered, _sign))
    define_operator(getattr(operator, _operator), INTS, WHOLE, MASK, method("icmp_signed", _sign))
for _operator in ("and_", "or_", "xor"):
    define(getattr(operator, _operator), MASK, MASK, MASK)(method(_operator))
    define(getattr(operator, "i" + _operator.rstrip("_")), MASK, MASK, MASK)(method(_operator))
define(operator.invert, MASK, MASK)(method("not_"))
define(operator.neg, FLOATS, FLOATS)(method("fneg"))
define(operator.neg, DOUBLES, DOUBLES)(method("fneg"))


fma = stub("fma", "a · b + c of floats, rounded once.")
least = stub("least", "The smaller of two in each lane; a where either is not a number, as Python's min.")
most = stub("most", "The larger of two in each lane; a where either is not a number, as Python's max.")
magnitude = stub("magnitude", "Absolute value.")
root = stub("root", "Square root of doubles.")
copysign = stub("copysign", "The magnitude of a with the sign of b, doubles.")
select = stub("select", "a where the mask is set, else b.")
floats = stub("floats", "Doubles rounded, ints, or a number in all lanes, as floats.")
doubles = stub("doubles", "Floats, ints, or a number in all lanes, as doubles.")
ints = stub("ints", "Floats or doubles cut to ints (they must fit), or a number in all lanes.")
mask_of = stub("mask_of", "The truth in all lanes.")
popcount = stub("popcount", "How many lanes of the mask are set.")
bits = stub("bits", "The mask as an integer, bit i for lane i.")
lane_numbers = stub("lane_numbers", "0, 1, 2 … as ints.")
rank = stub("rank", "How many lanes before it are set in the mask, for each lane.")
pick = stub("pick", "The number in one lane.")


@define(fma, FLOATS, FLOATS, FLOATS, FLOATS)
def _fma(builder: ir.IRBuilder, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
    return call(builder, f"llvm.fma.v{COUNT}f32", a.type, a, b, c)


@define(root, DOUBLES, DOUBLES)
def _root(builder: ir.IRBuilder, a: ir.Value) -> ir.Value:
    return call(builder, f"llvm.sqrt.v{COUNT}f64", a.type, a)


@define(copysign, DOUBLES, DOUBLES, DOUBLES)
def _copysign(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    return call(builder, f"llvm.copysign.v{COUNT}f64", a.type, a, b)


def _choose(compare: str, sign: str) -> Build:
    """b where ``b sign a``, else a."""

    def build(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
        return builder.select(getattr(builder, compare)(sign, b, a), b, a)

    return build


for _kind, _bits in ((FLOATS, 32), (DOUBLES, 64)):
    define(magnitude, _kind, _kind)(
        lambda builder, a, name=f"llvm.fabs.v{COUNT}f{_bits}": call(builder, name, a.type, a)
    )
    define_operator(least, _kind, REAL, _kind, _choose("fcmp_ordered", "<"))
    define_operator(most, _kind, REAL, _kind, _choose("fcmp_ordered", ">"))
define_operator(least, INTS, WHOLE, INTS, _choose("icmp_signed", "<"))
define_operator(most, INTS, WHOLE, INTS, _choose("icmp_signed", ">"))

for _kind, _number in ((FLOATS, REAL), (DOUBLES, REAL), (INTS, WHOLE)):
    define_operator(select, _kind, _number, _kind, method("select"), MASK)
    define(pick, _kind.number, _kind, WHOLE)(method("extract_element"))
define(select, MASK, MASK, MASK, MASK)(method("select"))


define(floats, FLOATS, REAL, widen=FLOATS)(lambda builder, value: value)
define(doubles, DOUBLES, REAL, widen=DOUBLES)(lambda builder, value: value)
define(ints, INTS, WHOLE, widen=INTS)(lambda builder, value: value)
define(floats, FLOATS, INTS)(lambda builder, value: builder.sitofp(value, FLOATS.vector))
define(floats, FLOATS, DOUBLES)(lambda builder, value: builder.fptrunc(value, FLOATS.vector))
define(doubles, DOUBLES, INTS)(lambda builder, value: builder.sitofp(value, DOUBLES.vector))
define(doubles, DOUBLES, FLOATS)(lambda builder, value: builder.fpext(value, DOUBLES.vector))
define(ints, INTS, FLOATS)(lambda builder, value: builder.fptosi(value, INTS.vector))
define(ints, INTS, DOUBLES)(lambda builder, value: builder.fptosi(value, INTS.vector))
define(mask_of, MASK, TRUTH)(lambda builder, value: repeat(builder, builder.trunc(value, BIT)))


@define(bits, WHOLE, MASK)
def _bits(builder: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    return builder.zext(builder.bitcast(mask, ir.IntType(COUNT)), ir.IntType(64))


@define(popcount, WHOLE, MASK)
def _popcount(builder: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    return call(builder, "llvm.ctpop.i64", ir.IntType(64), _bits(builder, mask))


@define(lane_numbers, INTS)
def _lane_numbers(builder: ir.IRBuilder) -> ir.Value:
    return ir.Constant(INTS.vector, list(range(COUNT)))


def rank_in(builder: ir.IRBuilder, word: ir.Value, width: int) -> ir.Value:
    """How many bits below it are set in a word of 32 bits, for each of ``width`` lanes."""
    before = ir.Constant(ir.VectorType(WORD, width), [(1 << lane) - 1 for lane in range(width)])
    below = builder.and_(repeat(builder, word, width), before)
    return call(builder, f"llvm.ctpop.v{width}i32", before.type, below)


@define(rank, INTS, MASK)
def _rank(builder: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    return rank_in(builder, builder.trunc(_bits(builder, mask), WORD), COUNT)
