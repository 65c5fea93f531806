"""Reals: float64 numbers and 32-bit words side by side, in which whole paths are worked out together.

A kernel of numbers that has no branch, written with operators, ``where`` and functions of math, takes
these lanes as well. Each operation is rounded by itself, as those of an ``exact`` kernel are, so that
lanes and numbers give the same bits. Two registers hold one vector of reals. Without Numba, and in
``four``, the same functions work on NumPy's numbers and arrays.
"""

import math
import operator
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from isogi_core.kernels.lanes import (
    BIT,
    DOUBLE,
    FLOAT,
    REAL,
    REGISTER,
    TRUTH,
    WORD,
    Lanes,
    call,
    define,
    define_operator,
    method,
    spread,
)

ABREAST = 1 if numba.config.DISABLE_JIT else REGISTER or 4
"""Lanes of a vector: 16 with AVX-512, 8 with AVX2."""

NUMBER = types.uint64
TO_UNIT = 2.0**-32

REALS, WORDS = Lanes(types.float64, DOUBLE, ABREAST, "abreast"), Lanes(types.uint32, WORD, ABREAST, "abreast")
WHOLES, TRUTHS = (
    Lanes(types.int64, ir.IntType(64), ABREAST, "abreast"),
    Lanes(types.boolean, BIT, ABREAST, "abreast"),
)
FOUR = Lanes(types.float64, DOUBLE, 4, "row")


for _name, _method in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    define_operator(getattr(operator, _name), REALS, REAL, REALS, method(_method))
for _name, _method in (("add", "fadd"), ("mul", "fmul")):
    define_operator(getattr(operator, _name), FOUR, REAL, FOUR, method(_method))
for _name, _method in (("add", "add"), ("mul", "mul"), ("and_", "and_"), ("or_", "or_"), ("xor", "xor"),
                       ("lshift", "shl"), ("rshift", "lshr")):  # fmt: skip
    define_operator(getattr(operator, _name), WORDS, NUMBER, WORDS, method(_method))
for _name, _sign in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">="), ("ne", "!=")):
    _ordered = "fcmp_unordered" if _sign == "!=" else "fcmp_ordered"
    define_operator(getattr(operator, _name), REALS, REAL, TRUTHS, method(_ordered, _sign))
define(operator.neg, REALS, REALS)(method("fneg"))
define(operator.and_, TRUTHS, TRUTHS, TRUTHS)(method("and_"))


@define(operator.getitem, REAL, FOUR, types.int64)
def _item(builder: ir.IRBuilder, four: ir.Value, i: ir.Value) -> ir.Value:
    return builder.extract_element(four, i)


@define(abs, REALS, REALS)
def _abs(builder: ir.IRBuilder, a: ir.Value) -> ir.Value:
    return call(builder, f"llvm.fabs.v{ABREAST}f64", a.type, a)


@define(math.sqrt, REALS, REALS)
def _sqrt(builder: ir.IRBuilder, a: ir.Value) -> ir.Value:
    return call(builder, f"llvm.sqrt.v{ABREAST}f64", a.type, a)


def floor_within(x: Any, last: Any) -> Any:
    """The whole number at or below ``x``, within 0 … ``last``, and 0 of no number; of lanes, reals that are whole."""
    return last if x >= last else int(x) if x > 0.0 else 0


@overload(floor_within)
def _overload_floor_within(x: Any, last: Any) -> Any:
    def of_lanes(x: Any, last: Any) -> Any:
        whole = _floor(x)
        whole = where(whole > 0.0, whole, 0.0)
        return where(whole < last, whole, last)

    return of_lanes if x is REALS else floor_within


@intrinsic
def _floor(typing: Any, x: Any) -> Any:
    def build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        return call(builder, f"llvm.floor.v{ABREAST}f64", REALS.vector, values[0])

    return REALS(REALS), build


@define(math.copysign, REALS, REAL, REALS)
def _copysign(builder: ir.IRBuilder, size: ir.Value, sign: ir.Value) -> ir.Value:
    return call(builder, f"llvm.copysign.v{ABREAST}f64", sign.type, spread(builder, size, REALS), sign)


def where(truth: Any, a: Any, b: Any) -> Any:
    """``a`` where it is true, else ``b``: both are worked out."""
    return a if truth else b


define(where, REAL, TRUTH, REAL, REAL)(method("select"))
define_operator(where, REALS, REAL, REALS, method("select"), TRUTHS)


@define(where, REALS, TRUTHS, REAL, REAL)
def _where_numbers(builder: ir.IRBuilder, truth: ir.Value, a: ir.Value, b: ir.Value) -> ir.Value:
    return builder.select(truth, spread(builder, a, REALS), spread(builder, b, REALS))


def words(number: Any) -> Any:
    """A number 0 … 2³² - 1 in all lanes."""
    return np.uint64(number)


define(words, WORDS, types.int64)(lambda builder, value: spread(builder, value, WORDS))


def fraction(word: Any) -> Any:
    """A word 0 … 2³² - 1 as a part of 2³², in [0, 1)."""
    return word * TO_UNIT


@define(fraction, REALS, WORDS)
@define(fraction, REAL, NUMBER)
def _fraction(builder: ir.IRBuilder, word: ir.Value) -> ir.Value:
    if isinstance(word.type, ir.VectorType):
        return builder.fmul(builder.uitofp(word, REALS.vector), spread(builder, DOUBLE(TO_UNIT), REALS))
    return builder.fmul(builder.uitofp(word, DOUBLE), DOUBLE(TO_UNIT))


# --- memory -------------------------------------------------------------------------------------------------

KINDS = {types.float64: REALS, types.uint32: WORDS}


def read(array: Any, i: int) -> Any:
    """ABREAST elements of a flat array of float64 or uint32 from place ``i`` on."""
    return array[i]


def write(array: Any, i: int, lanes: Any) -> None:
    """Write lanes to ABREAST elements of a flat array from place ``i`` on."""
    array[i] = lanes


def add_to(array: Any, i: Any, value: Any) -> Any:
    """Add a number to element ``i`` of a flat array, or lanes to its ABREAST elements from ABREAST · i on."""
    array[i] += value


def place(context: Any, builder: ir.IRBuilder, kind: Any, array: ir.Value, i: ir.Value, vector: ir.Type) -> ir.Value:
    """Pointer to a ``vector`` that begins at element ``i`` of a flat array."""
    base = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(base, [i]), vector.as_pointer())


@intrinsic
def _read(typing: Any, array: Any, i: Any) -> Any:
    lanes = KINDS[array.dtype]

    def build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        return builder.load(place(context, builder, sig.args[0], *values, lanes.vector), align=4)

    return lanes(array, types.int64), build


@intrinsic
def _write(typing: Any, array: Any, i: Any, lanes: Any) -> Any:
    def build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        builder.store(values[2], place(context, builder, sig.args[0], *values[:2], lanes.vector), align=4)
        return context.get_dummy_value()

    return types.none(array, types.int64, lanes), build


@overload(read)
def _overload_read(array: Any, i: Any) -> Any:
    def compiled(array: Any, i: Any) -> Any:
        return _read(array, i)

    return compiled


@overload(write)
def _overload_write(array: Any, i: Any, lanes: Any) -> Any:
    def compiled(array: Any, i: Any, lanes: Any) -> None:
        _write(array, i, lanes)

    return compiled


@overload(add_to)
def _overload_add_to(array: Any, i: Any, value: Any) -> Any:
    def add_lanes(array: Any, i: Any, value: Any) -> Any:
        _write(array, ABREAST * i, _read(array, ABREAST * i) + value)

    return add_lanes if value is REALS else add_to


# --- voxels --------------------------------------------------------------------------------------------------


def open_voxels(context: Any, builder: ir.IRBuilder, kind: Any, voxels: ir.Value) -> tuple[ir.Value, ...]:
    """Pointer to the first element of a 3-D array, elements of a slab and of a row."""
    array = context.make_array(kind)(context, builder, voxels)
    _, ny, nx = cgutils.unpack_tuple(builder, array.shape, 3)
    return array.data, builder.mul(ny, nx), nx


def cube(voxels: Any, k: Any, j: Any, i: Any) -> Any:
    """The corners of cell (k, j, i), x fastest, as float64; of lanes, those of cells at whole reals."""
    below = np.float64(voxels[k, j, i]), np.float64(voxels[k, j, i + 1])
    behind = np.float64(voxels[k, j + 1, i]), np.float64(voxels[k, j + 1, i + 1])
    above = np.float64(voxels[k + 1, j, i]), np.float64(voxels[k + 1, j, i + 1])
    last = np.float64(voxels[k + 1, j + 1, i]), np.float64(voxels[k + 1, j + 1, i + 1])
    return below + behind + above + last


def load_pairs(builder: ir.IRBuilder, data: ir.Value, places: ir.Value) -> list[ir.Value]:
    """Two float32 at each of the ``places``: the first ones and the second ones, as reals."""
    pairs = ir.Constant(ir.VectorType(DOUBLE, ABREAST), ir.Undefined)
    for lane in range(ABREAST):
        pair = builder.bitcast(builder.gep(data, [builder.extract_element(places, WORD(lane))]), DOUBLE.as_pointer())
        pairs = builder.insert_element(pairs, builder.load(pair, align=4), WORD(lane))
    singles = builder.bitcast(pairs, ir.VectorType(FLOAT, 2 * ABREAST))
    halves = [ir.Constant(ir.VectorType(WORD, ABREAST), list(range(odd, 2 * ABREAST, 2))) for odd in (0, 1)]
    return [builder.fpext(builder.shuffle_vector(singles, singles, half), REALS.vector) for half in halves]


@intrinsic
def _cube(typing: Any, voxels: Any, k: Any, j: Any, i: Any) -> Any:
    result = types.UniTuple(REALS, 8)

    def build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        data, slab, row = open_voxels(context, builder, sig.args[0], values[0])
        whole = ir.VectorType(row.type, ABREAST)
        cell = [builder.fptosi(value, whole) for value in values[1:]]
        along = [builder.mul(c, spread(builder, step, WHOLES)) for c, step in zip(cell, (slab, row), strict=False)]
        first = builder.add(builder.add(along[0], along[1]), cell[2])
        corners = []
        for step in (row.type(0), row, slab, builder.add(slab, row)):
            corners += load_pairs(builder, builder.gep(data, [step]), first)
        return context.make_tuple(builder, result, corners)

    return result(voxels, REALS, REALS, REALS), build


@overload(cube)
def _overload_cube(voxels: Any, k: Any, j: Any, i: Any) -> Any:
    def of_lanes(voxels: Any, k: Any, j: Any, i: Any) -> Any:
        return _cube(voxels, k, j, i)

    return of_lanes if i is REALS else cube


def four(voxels: Any, k: int, j: int, i: int) -> Any:
    """Voxels i - 1 … i + 2 of row (k, j) as four float64 side by side; beyond the row's ends, the end's."""
    return voxels[k, j, np.clip(np.arange(i - 1, i + 3), 0, voxels.shape[2] - 1)].astype(np.float64)


@intrinsic
def _four_together(typing: Any, voxels: Any, k: Any, j: Any, i: Any) -> Any:
    def build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        data, slab, row = open_voxels(context, builder, sig.args[0], values[0])
        place = builder.add(builder.mul(values[1], slab), builder.add(builder.mul(values[2], row), values[3]))
        first = builder.bitcast(builder.gep(data, [place]), ir.VectorType(FLOAT, 4).as_pointer())
        narrow = builder.load(first, align=4)
        return builder.fpext(narrow, FOUR.vector)

    return FOUR(voxels, types.int64, types.int64, types.int64), build


@intrinsic
def _four_apart(typing: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    def build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        vector = ir.Constant(FOUR.vector, ir.Undefined)
        for lane, value in enumerate(values):
            vector = builder.insert_element(vector, builder.fpext(value, DOUBLE), WORD(lane))
        return vector

    return FOUR(types.float32, types.float32, types.float32, types.float32), build


@numba.njit
def _four_at_border(voxels: Any, k: Any, j: Any, i: Any) -> Any:
    last = voxels.shape[2] - 1
    a, d = voxels[k, j, max(i - 1, 0)], voxels[k, j, min(i + 2, last)]
    return _four_apart(a, voxels[k, j, i], voxels[k, j, min(i + 1, last)], d)


@overload(four)
def _overload_four(voxels: Any, k: Any, j: Any, i: Any) -> Any:
    def compiled(voxels: Any, k: Any, j: Any, i: Any) -> Any:
        if 1 <= i < voxels.shape[2] - 2:
            return _four_together(voxels, k, j, i - 1)
        return _four_at_border(voxels, k, j, i)

    return compiled
