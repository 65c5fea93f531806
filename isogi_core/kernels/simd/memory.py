"""Loads, stores, gathers and scatters of vectors in flat arrays, and prefetching."""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import signature
from numba.extending import overload

from isogi_core.kernels.simd.llvm import (
    BIT_TYPE,
    BYTE_TYPE,
    DOUBLE_TYPE,
    ELEMENTS,
    FLOAT_TYPE,
    LONG_TYPE,
    WORD_TYPE,
    call,
    consecutive,
    define,
    join,
    ranks,
    stub,
    vector_type,
)
from isogi_core.kernels.simd.types import REGISTER_LANES, Vector

ELEMENT_OF = {
    types.float32: types.float32,
    types.float64: types.float64,
    types.int32: types.int32,
    types.int8: types.int32,
    types.uint32: types.uint32,
}
"""The element type of a vector, by that of the array that it is loaded from or stored to."""

SINGLE = {types.float32, types.int32}
"""Element types of 32 bits."""

gather = stub(
    "gather",
    "Return array[index] of a flat array; the index of every lane must be in it.",
    __name__,
)
gather_pair = stub(
    "gather_pair",
    "Return array[index] and array[index + 1] of a flat array of float32; both indices of every "
    "lane must be in it. Only for processors with SIMD.",
    __name__,
)
take = stub(
    "take",
    "Return array[first], array[first + 1], … in the lanes that are set in the mask, in order.",
    __name__,
)
scatter = stub(
    "scatter",
    "Set array[index] = vector in the lanes that are set in the mask, one after the other.",
    __name__,
)


def load(array: Any, i: int, width: int) -> Any:
    """Return ``width`` elements of a flat array from place ``i`` on; the width must be a
    constant of the calling module.
    """
    return array[i]


def store(array: Any, i: int, vector: Any) -> None:
    """Write a vector to elements of a flat array from place ``i`` on."""
    array[i] = vector


def add_to(array: Any, i: Any, value: Any) -> Any:
    """Add a number to element ``i`` of a flat array,
    or a vector of N lanes to the N elements from N · i on.
    """
    array[i] += value


def prefetch(flat: Any, place: int) -> None:
    """Start to bring the cache line of ``flat[place]`` into the cache, and go on without
    waiting; do nothing without Numba.
    """


def access(function: Any, numbers: set[Any], typer: Callable[..., Any]) -> Callable[[Any], Any]:
    """Return a decorator that registers a builder for a function whose first argument is a flat
    array with elements of the types ``numbers``.

    The builder is called as ``build(context, builder, signature, base pointer, *values)``;
    ``typer`` is as in ``define``.
    """

    def _flat(*args: Any) -> Any:
        """Return the signature if the first argument is a flat array with elements
        of one of ``numbers``.
        """
        array = args[0]
        if isinstance(array, types.Array) and array.layout == "C" and array.dtype in numbers:
            return typer(*args)
        return None

    def _register(build: Any) -> Any:
        @define(function, _flat)
        def _lower(
            context: Any, builder: ir.IRBuilder, sig: Any, array: ir.Value, *values: ir.Value
        ) -> ir.Value:
            base = context.make_array(sig.args[0])(context, builder, array).data
            return build(context, builder, sig, base, *values)

        return build

    return _register


def _vector(array: Any, count: int) -> Vector:
    """Return the vector type of ``count`` elements of an array."""
    return Vector(ELEMENT_OF[array.dtype], count)


def _at(builder: ir.IRBuilder, base: ir.Value, place: ir.Value, count: int) -> ir.Value:
    """Return a pointer to ``count`` elements from ``place`` on."""
    return builder.bitcast(
        builder.gep(base, [place]), ir.VectorType(base.type.pointee, count).as_pointer()
    )


def _one(builder: ir.IRBuilder, base: ir.Value, index: ir.Value, lane: int) -> ir.Value:
    """Return a pointer to the element at the index in one ``lane``."""
    return builder.gep(
        base, [builder.sext(builder.extract_element(index, WORD_TYPE(lane)), LONG_TYPE)]
    )


# --- whole vectors ---


def _type_of_load(array: Any, i: Any, width: Any) -> Any:
    """Return the signature of ``load``."""
    if not isinstance(width, types.IntegerLiteral):
        return None
    return signature(_vector(array, width.literal_value), array, types.int64, width)


@access(load, set(ELEMENT_OF), _type_of_load)
def _load(
    context: Any, builder: ir.IRBuilder, sig: Any, base: ir.Value, place: ir.Value, width: Any
) -> ir.Value:
    """Emit a vector load, aligned to an element; int8 is widened to int32."""
    kind = sig.return_type
    dtype = sig.args[0].dtype
    vector = builder.load(_at(builder, base, place, kind.count), align=dtype.bitwidth // 8)
    if dtype == types.int8:
        return builder.sext(vector, vector_type(kind))
    return vector


def _type_of_store(array: Any, i: Any, vector: Any) -> Any:
    """Return the signature of ``store``,
    or None if the vector's elements do not match the array's.
    """
    fits = isinstance(vector, Vector) and vector.number == ELEMENT_OF[array.dtype]
    if fits:
        return signature(types.none, array, types.int64, vector)
    return None


@access(store, set(ELEMENT_OF), _type_of_store)
def _store(
    context: Any, builder: ir.IRBuilder, sig: Any, base: ir.Value, place: ir.Value, vector: Any
) -> ir.Value:
    """Emit a vector store, aligned to an element; int32 is cut to int8 for an array of these."""
    dtype = sig.args[0].dtype
    count = vector.type.count
    if dtype == types.int8:
        narrow = builder.trunc(vector, ir.VectorType(BYTE_TYPE, count))
    else:
        narrow = vector
    builder.store(narrow, _at(builder, base, place, count), align=dtype.bitwidth // 8)
    return context.get_dummy_value()


@overload(add_to)
def _overload_add_to(array: Any, i: Any, value: Any) -> Any:
    """Choose the code of ``add_to``: a vector is added to consecutive elements."""
    if not isinstance(value, Vector):
        return add_to
    width = value.count

    def _add_vector(array: Any, i: Any, value: Any) -> Any:
        store(array, width * i, load(array, width * i, width) + value)

    return _add_vector


@access(prefetch, {types.float32}, lambda flat, place: signature(types.none, flat, types.int64))
def _prefetch(
    context: Any, builder: ir.IRBuilder, sig: Any, base: ir.Value, place: ir.Value
) -> ir.Value:
    """Emit a prefetch for reading into all levels of the cache."""
    # LLVM's arguments: 0 to read and not to write, 3 to keep the line in all levels, 1 for data and
    # not for instructions.
    line = builder.bitcast(builder.gep(base, [place]), cgutils.voidptr_t)
    call(builder, "llvm.prefetch.p0", ir.VoidType(), line, WORD_TYPE(0), WORD_TYPE(3), WORD_TYPE(1))
    return context.get_dummy_value()


# --- single elements ---


@access(
    gather,
    SINGLE | {types.float64},
    lambda array, index: signature(_vector(array, index.count), array, index),
)
def _gather(
    context: Any, builder: ir.IRBuilder, sig: Any, base: ir.Value, index: ir.Value
) -> ir.Value:
    """Emit a gather, register by register or element by element."""
    kind = sig.return_type
    # AVX-512 gathers a register in one instruction; AVX2's gather is no faster than single loads.
    if REGISTER_LANES == 16:
        width = 8 if kind.number == types.float64 else 16
        parts = [
            _gather_part(builder, kind, base, index, first, width)
            for first in range(0, kind.count, width)
        ]
        return join(builder, parts)
    vector = ir.Constant(vector_type(kind), ir.Undefined)
    for lane in range(kind.count):
        vector = builder.insert_element(
            vector, builder.load(_one(builder, base, index, lane)), WORD_TYPE(lane)
        )
    return vector


def _gather_part(
    builder: ir.IRBuilder, kind: Vector, base: ir.Value, index: ir.Value, first: int, width: int
) -> ir.Value:
    """Emit AVX-512's gather of one register: ``width`` elements at the indices in lanes ``first``
    to ``first`` + ``width`` - 1 of ``index``.

    A register of results of the vector type ``kind`` has 16 elements of 32 bits, or 8 of 64 bits.
    """
    part = ir.VectorType(ELEMENTS[kind.number], width)
    letters = {types.float32: "ps", types.float64: "pd", types.int32: "pi"}[kind.number]
    every = ir.Constant(ir.VectorType(BIT_TYPE, width), [1] * width)
    # The instruction takes the result of lanes that are not loaded (none here), a pointer, a 32-bit
    # index for each lane, a mask of the lanes to load, and the bytes of an element. Its name has a
    # "d" for 32-bit indices, and the letters of the elements.
    places = builder.shuffle_vector(index, index, consecutive(first, first + width))
    pointer = builder.bitcast(base, BYTE_TYPE.as_pointer())
    arguments = (
        ir.Constant(part, None),
        pointer,
        places,
        every,
        WORD_TYPE(kind.number.bitwidth // 8),
    )
    return call(builder, f"llvm.x86.avx512.mask.gather.d{letters}.512", part, *arguments)


def _type_of_pair(array: Any, index: Any) -> Any:
    """Return the signature of ``gather_pair``."""
    return signature(types.UniTuple(_vector(array, index.count), 2), array, index)


@access(gather_pair, {types.float32}, _type_of_pair)
def _gather_pair(
    context: Any, builder: ir.IRBuilder, sig: Any, base: ir.Value, index: ir.Value
) -> ir.Value:
    """Emit the loads of two consecutive elements per lane.

    REGISTER_LANES is not None here, as rays that are traced one by one call no ``gather_pair``.
    """
    # Load both elements of a pair as one 64-bit value, a register at a time: half as many loads.
    # Then part even elements from odd ones.
    width = REGISTER_LANES // 2
    pairs = [
        _pairs(builder, base, index, first, width) for first in range(0, index.type.count, width)
    ]
    sides = [
        join(
            builder, [builder.shuffle_vector(p, p, consecutive(side, 2 * width, 2)) for p in pairs]
        )
        for side in (0, 1)
    ]
    return context.make_tuple(builder, sig.return_type, sides)


def _pairs(
    builder: ir.IRBuilder, base: ir.Value, index: ir.Value, first: int, width: int
) -> ir.Value:
    """Load two consecutive elements for each of ``width`` lanes from lane ``first`` on, as one
    register of float32.
    """
    vector = ir.VectorType(DOUBLE_TYPE, width)
    # Gather 64-bit values with AVX-512, or load them lane by lane.
    if REGISTER_LANES == 16:
        every = ir.Constant(ir.VectorType(BIT_TYPE, width), [1] * width)
        places = builder.shuffle_vector(index, index, consecutive(first, first + width))
        arguments = (
            ir.Constant(vector, None),
            builder.bitcast(base, BYTE_TYPE.as_pointer()),
            places,
            every,
            WORD_TYPE(4),
        )
        pairs = call(builder, "llvm.x86.avx512.mask.gather.dpd.512", vector, *arguments)
    else:
        pairs = ir.Constant(vector, ir.Undefined)
        for lane in range(width):
            pointer = builder.bitcast(
                _one(builder, base, index, first + lane), DOUBLE_TYPE.as_pointer()
            )
            pairs = builder.insert_element(pairs, builder.load(pointer, align=4), WORD_TYPE(lane))
    return builder.bitcast(pairs, ir.VectorType(FLOAT_TYPE, 2 * width))


def _type_of_take(array: Any, first: Any, mask: Any) -> Any:
    """Return the signature of ``take``."""
    return signature(_vector(array, mask.count), array, types.int64, mask)


@access(take, SINGLE, _type_of_take)
def _take(
    context: Any, builder: ir.IRBuilder, sig: Any, base: ir.Value, place: ir.Value, mask: ir.Value
) -> ir.Value:
    """Emit an expanding load: set lanes get consecutive elements, in order;
    the other lanes are arbitrary.

    Whole registers are loaded, so the array must have an element for every lane from ``first`` on,
    however few are taken.
    """
    kind = sig.return_type
    parts = []
    whole = kind.number == types.int32
    name = {16: "llvm.x86.avx512.permvar.s{}.512", 8: "llvm.x86.avx2.perm{}"}[REGISTER_LANES]
    name = name.format({16: "fi", 8: ("ps", "d")}[REGISTER_LANES][whole])
    part = ir.VectorType(ELEMENTS[kind.number], REGISTER_LANES)
    for first in range(0, kind.count, REGISTER_LANES):
        # Lane i gets element (number of set lanes before it): load a register, and permute it by
        # ranks.
        part_mask = builder.shuffle_vector(mask, mask, consecutive(first, first + REGISTER_LANES))
        word = builder.zext(builder.bitcast(part_mask, ir.IntType(REGISTER_LANES)), WORD_TYPE)
        pointer = builder.bitcast(builder.gep(base, [place]), part.as_pointer())
        parts.append(
            call(
                builder,
                name,
                part,
                builder.load(pointer, align=4),
                ranks(builder, word, REGISTER_LANES),
            )
        )
        # The next register goes on after the elements that this one took.
        taken = call(builder, "llvm.ctpop.i32", WORD_TYPE, word)
        place = builder.add(place, builder.zext(taken, place.type))
    return join(builder, parts)


def _type_of_scatter(array: Any, index: Any, vector: Any, mask: Any) -> Any:
    """Return the signature of ``scatter``, or None if the vector does not have the array's type of
    elements and as many lanes as the index. The mask is not tested.
    """
    fits = vector == _vector(array, index.count)
    if fits:
        return signature(types.none, array, index, vector, mask)
    return None


@access(scatter, set(ELEMENT_OF), _type_of_scatter)
def _scatter(
    context: Any,
    builder: ir.IRBuilder,
    sig: Any,
    base: ir.Value,
    index: ir.Value,
    vector: ir.Value,
    mask: ir.Value,
) -> ir.Value:
    """Emit one conditional store per lane."""
    for lane in range(index.type.count):
        with builder.if_then(builder.extract_element(mask, WORD_TYPE(lane))):
            element = builder.extract_element(vector, WORD_TYPE(lane))
            if sig.args[0].dtype == types.int8:
                element = builder.trunc(element, BYTE_TYPE)
            builder.store(element, _one(builder, base, index, lane))
    return context.get_dummy_value()
