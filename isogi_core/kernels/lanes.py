"""Lanes: vectors that live in registers of the processor, so that many rays walk in one loop.

Three Numba types, ``FLOATS`` (float32), ``INTS`` (int32) and ``MASK`` (one bit per lane), with the
operators of numbers, numbers of Python next to them being spread over all lanes. Kernels are then
written as arithmetic: ``select(t < far, near + t * d, far)``. Each operation is one instruction of
LLVM on a vector type. A vector fills two registers, so that one half computes while the other waits
for memory (up to 1.2 times faster than one, with AVX-512).

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
from numba.core.typing.templates import AbstractTemplate, ConcreteTemplate, infer_global, signature
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

BIT, WORD, FLOAT = ir.IntType(1), ir.IntType(32), ir.FloatType()
REAL, WHOLE, TRUTH = types.float64, types.int64, types.boolean


class Lanes(types.Type):
    """Numba's type of a vector of COUNT numbers of LLVM type ``element``."""

    def __init__(self, name: str, element: ir.Type) -> None:
        self.element = element
        self.vector = ir.VectorType(element, COUNT)
        super().__init__(f"lanes({name} x {COUNT})")


FLOATS, INTS, MASK = Lanes("float32", FLOAT), Lanes("int32", WORD), Lanes("bit", BIT)


@register_model(Lanes)
class LanesModel(models.PrimitiveModel):
    """Lanes are one LLVM vector, in variables, arguments and tuples alike."""

    def __init__(self, dmm: Any, fe_type: Lanes) -> None:
        super().__init__(dmm, fe_type, fe_type.vector)


Build = Callable[..., ir.Value]


def repeat(builder: ir.IRBuilder, value: ir.Value) -> ir.Value:
    """A vector with ``value`` in every lane."""
    vector = ir.VectorType(value.type, COUNT)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, WORD(0))
    zeros = ir.Constant(ir.VectorType(WORD, COUNT), [0] * COUNT)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def spread(builder: ir.IRBuilder, value: ir.Value, kind: Any) -> ir.Value:
    """Numbers of Python as lanes: float64 as float32, int64 as int32; lanes as they are."""
    if kind == REAL:
        return repeat(builder, builder.fptrunc(value, FLOAT))
    return repeat(builder, builder.trunc(value, WORD)) if kind == WHOLE else value


def define(function: Any, result: Any, *arguments: Any, widen: bool = False) -> Callable[[Build], Build]:
    """Decorator: ``build(builder, *values)`` makes the code of ``function`` for these types of arguments.

    With ``widen`` numbers are spread over the lanes first.
    """

    def register(build: Build) -> Build:
        infer_global(function)(
            type("Case", (ConcreteTemplate,), {"key": function, "cases": [signature(result, *arguments)]})
        )

        @lower_builtin(function, *arguments)
        def lower(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
            kinds = sig.args if widen else (None,) * len(values)
            return build(builder, *(spread(builder, v, k) for v, k in zip(values, kinds, strict=True)))

        return build

    return register


def stub(name: str, does: str) -> Any:
    """A function that exists in compiled code only."""

    def function(*_: Any) -> Any:
        raise NotImplementedError(f"{name} works on lanes, in compiled code")

    function.__name__ = function.__qualname__ = name
    function.__doc__ = does
    return function


def call(builder: ir.IRBuilder, name: str, result: ir.Type, *values: ir.Value) -> ir.Value:
    """Call LLVM's intrinsic ``name``."""
    kind = ir.FunctionType(result, [value.type for value in values])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), values)


# --- arithmetic ---------------------------------------------------------------------------------------------


def define_operator(function: Any, kind: Lanes, number: Any, result: Lanes, build: Build) -> None:
    """Define a binary operator for lanes with lanes, lanes with a number and a number with lanes."""
    for left, right in ((kind, kind), (kind, number), (number, kind)):
        define(function, result, left, right, widen=True)(build)


def method(name: str, *leading: Any, **options: Any) -> Build:
    """The builder's method ``name`` as a Build, ``leading`` arguments first."""
    return lambda builder, *values: getattr(builder, name)(*leading, *values, **options)


LOOSE = {"flags": ("contract", "nsz")}
for _operator, _name in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    define_operator(getattr(operator, _operator), FLOATS, REAL, FLOATS, method(_name, **LOOSE))
for _operator, _name in (
    ("add", "add"), ("sub", "sub"), ("mul", "mul"), ("and_", "and_"), ("or_", "or_"), ("xor", "xor"),
    ("lshift", "shl"), ("rshift", "ashr"),
):  # fmt: skip
    define_operator(getattr(operator, _operator), INTS, WHOLE, INTS, method(_name))
for _operator, _sign in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">="), ("eq", "=="), ("ne", "!=")):
    _ordered = "fcmp_unordered" if _sign == "!=" else "fcmp_ordered"
    define_operator(getattr(operator, _operator), FLOATS, REAL, MASK, method(_ordered, _sign))
    define_operator(getattr(operator, _operator), INTS, WHOLE, MASK, method("icmp_signed", _sign))
for _operator in ("and_", "or_", "xor"):
    define(getattr(operator, _operator), MASK, MASK, MASK)(method(_operator))
define(operator.invert, MASK, MASK)(method("not_"))
define(operator.neg, FLOATS, FLOATS)(method("fneg"))


fma = stub("fma", "a · b + c, rounded once.")
least = stub("least", "The smaller of two floats in each lane; b where either is not a number.")
most = stub("most", "The larger of two floats or ints in each lane; b where either is not a number.")
magnitude = stub("magnitude", "Absolute value.")
select = stub("select", "a where the mask is set, else b.")
floats = stub("floats", "Ints, or a number in all lanes, as floats.")
ints = stub("ints", "Floats cut to ints (they must fit), or a number in all lanes.")
mask_of = stub("mask_of", "The truth in all lanes.")
popcount = stub("popcount", "How many lanes of the mask are set.")
bits = stub("bits", "The mask as an integer, bit i for lane i.")
lane_numbers = stub("lane_numbers", "0, 1, 2 … as ints.")
rank = stub("rank", "How many lanes before it are set in the mask, for each lane.")
gather = stub("gather", "array[index] of a flat array; every lane's index must be in it.")
load = stub("load", "COUNT elements of a flat array from place i on.")
store = stub("store", "Write lanes to COUNT elements of a flat array from place i on.")
pick = stub("pick", "The number in one lane.")


@define(fma, FLOATS, FLOATS, FLOATS, FLOATS)
def _fma(builder: ir.IRBuilder, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
    return call(builder, f"llvm.fma.v{COUNT}f32", a.type, a, b, c)


@define(magnitude, FLOATS, FLOATS)
def _magnitude(builder: ir.IRBuilder, a: ir.Value) -> ir.Value:
    return call(builder, f"llvm.fabs.v{COUNT}f32", a.type, a)


@define(least, FLOATS, FLOATS, FLOATS)
def _least(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


@define(most, FLOATS, FLOATS, FLOATS)
def _most(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


@define(most, INTS, INTS, INTS)
def _most_int(builder: ir.IRBuilder, a: ir.Value, b: ir.Value) -> ir.Value:
    return builder.select(builder.icmp_signed(">", a, b), a, b)


for _kind, _number in ((FLOATS, REAL), (INTS, WHOLE)):
    for _arguments in ((_kind, _kind), (_kind, _number), (_number, _kind)):
        define(select, _kind, MASK, *_arguments, widen=True)(method("select"))
define(select, MASK, MASK, MASK, MASK)(method("select"))


define(floats, FLOATS, REAL, widen=True)(lambda builder, value: value)
define(ints, INTS, WHOLE, widen=True)(lambda builder, value: value)
define(floats, FLOATS, INTS)(lambda builder, value: builder.sitofp(value, FLOATS.vector))
define(ints, INTS, FLOATS)(lambda builder, value: builder.fptosi(value, INTS.vector))
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


@define(rank, INTS, MASK)
def _rank(builder: ir.IRBuilder, mask: ir.Value) -> ir.Value:
    spread_bits = repeat(builder, builder.trunc(_bits(builder, mask), WORD))
    before = ir.Constant(INTS.vector, [(1 << lane) - 1 for lane in range(COUNT)])
    return call(builder, f"llvm.ctpop.v{COUNT}i32", INTS.vector, builder.and_(spread_bits, before))


# --- memory -------------------------------------------------------------------------------------------------

KINDS = {types.float32: FLOATS, types.int32: INTS}


def define_access(function: Any, typer: Callable[..., Any]) -> Callable[[Any], Any]:
    """Decorator: ``build(context, builder, array type, base pointer, *values)`` for a function on flat arrays."""

    def generic(self: Any, args: Any, kws: Any) -> Any:
        if isinstance(args[0], types.Array) and args[0].layout == "C" and args[0].dtype in KINDS:
            return typer(*args)
        return None

    infer_global(function)(type("Access", (AbstractTemplate,), {"key": function, "generic": generic}))

    def register(build: Any) -> Any:
        @lower_builtin(function, types.Array, types.VarArg(types.Any))
        def lower(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
            base = context.make_array(sig.args[0])(context, builder, values[0]).data
            return build(context, builder, sig.args[0].dtype, base, *values[1:])

        return build

    return register


@define_access(gather, lambda array, index: signature(KINDS[array.dtype], array, INTS))
def _gather(context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, index: ir.Value) -> ir.Value:
    if REGISTER == 16:
        halves = [
            _gather_half(builder, KINDS[dtype].element, base, index, first) for first in range(0, COUNT, REGISTER)
        ]
        return builder.shuffle_vector(*halves, _numbers(0, COUNT))
    vector = ir.Constant(KINDS[dtype].vector, ir.Undefined)
    for lane in range(COUNT):
        place = builder.sext(builder.extract_element(index, WORD(lane)), ir.IntType(64))
        vector = builder.insert_element(vector, builder.load(builder.gep(base, [place])), WORD(lane))
    return vector


def _numbers(first: int, last: int) -> ir.Constant:
    """The vector first, first + 1, … last - 1, to shuffle by."""
    return ir.Constant(ir.VectorType(WORD, last - first), list(range(first, last)))


def _gather_half(builder: ir.IRBuilder, element: ir.Type, base: ir.Value, index: ir.Value, first: int) -> ir.Value:
    """AVX-512's gather for the register that begins with lane ``first``; AVX2's gains nothing over single loads."""
    half = ir.VectorType(element, REGISTER)
    name = "llvm.x86.avx512.mask.gather.dp" + ("s" if element == FLOAT else "i") + ".512"
    every = ir.Constant(ir.VectorType(BIT, REGISTER), [1] * REGISTER)
    places = builder.shuffle_vector(index, index, _numbers(first, first + REGISTER))
    pointer = builder.bitcast(base, ir.IntType(8).as_pointer())
    return call(builder, name, half, ir.Constant(half, None), pointer, places, every, WORD(4))


def _whole(builder: ir.IRBuilder, base: ir.Value, place: ir.Value, kind: Lanes) -> ir.Value:
    """Pointer to COUNT elements from ``place`` on."""
    return builder.bitcast(builder.gep(base, [place]), kind.vector.as_pointer())


@define_access(load, lambda array, i: signature(KINDS[array.dtype], array, WHOLE))
def _load(context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, place: ir.Value) -> ir.Value:
    return builder.load(_whole(builder, base, place, KINDS[dtype]), align=4)


@define_access(store, lambda array, i, lanes: signature(types.none, array, WHOLE, KINDS[array.dtype]))
def _store(context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, place: ir.Value, value: Any) -> ir.Value:
    builder.store(value, _whole(builder, base, place, KINDS[dtype]), align=4)
    return context.get_dummy_value()


@define(pick, types.float32, FLOATS, WHOLE)
@define(pick, types.int32, INTS, WHOLE)
def _pick(builder: ir.IRBuilder, lanes: ir.Value, lane: ir.Value) -> ir.Value:
    return builder.extract_element(lanes, lane)
