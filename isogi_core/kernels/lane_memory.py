"""Lanes to and from memory: whole vectors of an array, or one element for each lane."""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

from isogi_core.kernels.lanes import (
    BIT,
    COUNT,
    DOUBLES,
    FLOATS,
    INTS,
    MASK,
    REGISTER,
    WHOLE,
    WORD,
    Lanes,
    call,
    rank_in,
    stub,
)

KINDS = {types.float32: FLOATS, types.float64: DOUBLES, types.int32: INTS, types.int8: INTS}
"""Lanes of an array's elements."""

SINGLE = {types.float32, types.int32}
"""Elements as large as a lane of a float."""

gather = stub("gather", "array[index] of a flat array; every lane's index must be in it.", __name__)
gather_pair = stub("gather_pair", "array[index] and array[index + 1] of a flat array of floats.", __name__)
take = stub("take", "array[first], array[first + 1] … for the lanes that the mask has set, in turn.", __name__)
load = stub("load", "COUNT elements of a flat array from place i on.", __name__)
store = stub("store", "Write lanes to COUNT elements of a flat array from place i on.", __name__)
scatter = stub("scatter", "array[index] = lanes where the mask is set, lane by lane.", __name__)


def define_access(function: Any, numbers: set[Any], typer: Callable[..., Any]) -> Callable[[Any], Any]:
    """Decorator: ``build(context, builder, array type, base pointer, *values)`` for a function on flat arrays.

    ``numbers`` are the types of elements that it is made for.
    """

    def generic(self: Any, args: Any, kws: Any) -> Any:
        if isinstance(args[0], types.Array) and args[0].layout == "C" and args[0].dtype in numbers:
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


@define_access(gather, SINGLE | {types.float64}, lambda array, index: signature(KINDS[array.dtype], array, INTS))
def _gather(context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, index: ir.Value) -> ir.Value:
    kind = KINDS[dtype]
    if REGISTER == 16:
        width = 8 if kind is DOUBLES else 16
        parts = [_gather_part(builder, kind, base, index, first, width) for first in range(0, COUNT, width)]
        return _join(builder, parts)
    vector = ir.Constant(kind.vector, ir.Undefined)
    for lane in range(COUNT):
        place = builder.sext(builder.extract_element(index, WORD(lane)), ir.IntType(64))
        vector = builder.insert_element(vector, builder.load(builder.gep(base, [place])), WORD(lane))
    return vector


@define_access(gather_pair, {types.float32}, lambda array, index: signature(types.UniTuple(FLOATS, 2), array, INTS))
def _gather_pair(context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, index: ir.Value) -> ir.Value:
    width = REGISTER // 2
    pairs = [_pairs(builder, base, index, first, width) for first in range(0, COUNT, width)]
    sides = [
        _join(builder, [builder.shuffle_vector(p, p, _numbers(side, 2 * width, 2)) for p in pairs]) for side in (0, 1)
    ]
    return context.make_tuple(builder, types.UniTuple(FLOATS, 2), sides)


def _pairs(builder: ir.IRBuilder, base: ir.Value, index: ir.Value, first: int, width: int) -> ir.Value:
    """Two neighbours for each of ``width`` lanes from lane ``first`` on, side by side in one register of floats."""
    vector = ir.VectorType(DOUBLES.element, width)
    if REGISTER == 16:
        name = "llvm.x86.avx512.mask.gather.dpd.512"
        every = ir.Constant(ir.VectorType(BIT, width), [1] * width)
        places = builder.shuffle_vector(index, index, _numbers(first, first + width))
        pointer = builder.bitcast(base, ir.IntType(8).as_pointer())
        pairs = call(builder, name, vector, ir.Constant(vector, None), pointer, places, every, WORD(4))
    else:
        pairs = ir.Constant(vector, ir.Undefined)
        for lane in range(width):
            place = builder.sext(builder.extract_element(index, WORD(first + lane)), ir.IntType(64))
            pointer = builder.bitcast(builder.gep(base, [place]), DOUBLES.element.as_pointer())
            pairs = builder.insert_element(pairs, builder.load(pointer, align=4), WORD(lane))
    return builder.bitcast(pairs, ir.VectorType(FLOATS.element, 2 * width))


@define_access(take, SINGLE, lambda array, first, mask: signature(KINDS[array.dtype], array, WHOLE, MASK))
def _take(context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, place: ir.Value, mask: ir.Value) -> ir.Value:
    kind, parts = KINDS[dtype], []
    name = {16: "llvm.x86.avx512.permvar.s{}.512", 8: "llvm.x86.avx2.perm{}"}[REGISTER]
    name = name.format({16: "fi", 8: ("ps", "d")}[REGISTER][kind is INTS])
    part = ir.VectorType(kind.element, REGISTER)
    for first in range(0, COUNT, REGISTER):
        own = builder.shuffle_vector(mask, mask, _numbers(first, first + REGISTER))
        word = builder.zext(builder.bitcast(own, ir.IntType(REGISTER)), WORD)
        pointer = builder.bitcast(builder.gep(base, [place]), part.as_pointer())
        parts.append(call(builder, name, part, builder.load(pointer, align=4), rank_in(builder, word, REGISTER)))
        taken = call(builder, "llvm.ctpop.i32", WORD, word)
        place = builder.add(place, builder.zext(taken, place.type))
    return _join(builder, parts)


def _numbers(first: int, last: int, step: int = 1) -> ir.Constant:
    """The vector first, first + step, … below ``last``, to shuffle by."""
    numbers = list(range(first, last, step))
    return ir.Constant(ir.VectorType(WORD, len(numbers)), numbers)


def _join(builder: ir.IRBuilder, parts: list[ir.Value]) -> ir.Value:
    """Vectors end to end."""
    while len(parts) > 1:
        both = 2 * parts[0].type.count
        parts = [builder.shuffle_vector(a, b, _numbers(0, both)) for a, b in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


def _gather_part(
    builder: ir.IRBuilder, kind: Lanes, base: ir.Value, index: ir.Value, first: int, width: int
) -> ir.Value:
    """AVX-512's gather for one register; AVX2's gains nothing over single loads."""
    part = ir.VectorType(kind.element, width)
    name = "llvm.x86.avx512.mask.gather.d" + {FLOATS: "ps", DOUBLES: "pd", INTS: "pi"}[kind] + ".512"
    every = ir.Constant(ir.VectorType(BIT, width), [1] * width)
    places = builder.shuffle_vector(index, index, _numbers(first, first + width))
    pointer = builder.bitcast(base, ir.IntType(8).as_pointer())
    scale = WORD(8 if kind is DOUBLES else 4)
    return call(builder, name, part, ir.Constant(part, None), pointer, places, every, scale)


def _whole(builder: ir.IRBuilder, base: ir.Value, place: ir.Value) -> ir.Value:
    """Pointer to COUNT elements from ``place`` on."""
    first = builder.gep(base, [place])
    return builder.bitcast(first, ir.VectorType(base.type.pointee, COUNT).as_pointer())


@define_access(load, set(KINDS), lambda array, i: signature(KINDS[array.dtype], array, WHOLE))
def _load(context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, place: ir.Value) -> ir.Value:
    vector = builder.load(_whole(builder, base, place), align=dtype.bitwidth // 8)
    return builder.sext(vector, INTS.vector) if dtype == types.int8 else vector


@define_access(store, set(KINDS), lambda array, i, lanes: signature(types.none, array, WHOLE, KINDS[array.dtype]))
def _store(context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, place: ir.Value, value: Any) -> ir.Value:
    vector = builder.trunc(value, ir.VectorType(base.type.pointee, COUNT)) if dtype == types.int8 else value
    builder.store(vector, _whole(builder, base, place), align=dtype.bitwidth // 8)
    return context.get_dummy_value()


@define_access(
    scatter, set(KINDS), lambda array, index, lanes, mask: signature(types.none, array, INTS, KINDS[array.dtype], MASK)
)
def _scatter(
    context: Any, builder: ir.IRBuilder, dtype: Any, base: ir.Value, index: ir.Value, value: Any, mask: ir.Value
) -> ir.Value:
    for lane in range(COUNT):
        with builder.if_then(builder.extract_element(mask, WORD(lane))):
            place = builder.sext(builder.extract_element(index, WORD(lane)), ir.IntType(64))
            element = builder.extract_element(value, WORD(lane))
            element = builder.trunc(element, ir.IntType(8)) if dtype == types.int8 else element
            builder.store(element, builder.gep(base, [place]))
    return context.get_dummy_value()
