"""Loads of voxels: the eight corners of cells, and four in a row."""

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from isogi_core.kernels.simd.llvm import (
    DOUBLE_TYPE,
    FLOAT_TYPE,
    WORD_TYPE,
    consecutive,
    splat,
    vector_type,
)
from isogi_core.kernels.simd.types import Vector

FOUR = Vector(types.float64, 4)


def open_voxels(
    context: Any, builder: ir.IRBuilder, kind: Any, voxels: ir.Value
) -> tuple[ir.Value, ...]:
    """Return a pointer to the first element of a 3-D array, and the numbers of elements in a
    slab and in a row.
    """
    array = context.make_array(kind)(context, builder, voxels)
    _, ny, nx = cgutils.unpack_tuple(builder, array.shape, 3)
    return array.data, builder.mul(ny, nx), nx


def cube(voxels: Any, k: Any, j: Any, i: Any) -> Any:
    """Return the corners of cell (k, j, i), x fastest, as eight float64; for vectors of whole
    numbers, as eight f64×N.
    """
    below = np.float64(voxels[k, j, i]), np.float64(voxels[k, j, i + 1])
    behind = np.float64(voxels[k, j + 1, i]), np.float64(voxels[k, j + 1, i + 1])
    above = np.float64(voxels[k + 1, j, i]), np.float64(voxels[k + 1, j, i + 1])
    last = np.float64(voxels[k + 1, j + 1, i]), np.float64(voxels[k + 1, j + 1, i + 1])
    return below + behind + above + last


def load_pairs(builder: ir.IRBuilder, data: ir.Value, places: ir.Value) -> list[ir.Value]:
    """Load two consecutive float32 at each of the ``places``; return the first ones and the
    second ones as vectors of float64.
    """
    count = places.type.count
    pairs = ir.Constant(ir.VectorType(DOUBLE_TYPE, count), ir.Undefined)
    # Load each pair as one 64-bit value: half as many loads.
    for lane in range(count):
        pair = builder.bitcast(
            builder.gep(data, [builder.extract_element(places, WORD_TYPE(lane))]),
            DOUBLE_TYPE.as_pointer(),
        )
        pairs = builder.insert_element(pairs, builder.load(pair, align=4), WORD_TYPE(lane))
    # Split even from odd elements, and widen them.
    singles = builder.bitcast(pairs, ir.VectorType(FLOAT_TYPE, 2 * count))
    halves = [consecutive(odd, 2 * count, 2) for odd in (0, 1)]
    wide = ir.VectorType(DOUBLE_TYPE, count)
    return [builder.fpext(builder.shuffle_vector(singles, singles, half), wide) for half in halves]


@intrinsic
def _cube(typing: Any, voxels: Any, k: Any, j: Any, i: Any) -> Any:
    """Emit the loads of the corners of cells (k, j, i), vectors of whole float64."""
    result = types.UniTuple(i, 8)

    def _build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        data, slab, row = open_voxels(context, builder, sig.args[0], values[0])
        # Convert indices to integers, and find the flat place of the first corner of each cell.
        integers = ir.VectorType(row.type, i.count)
        cell = [builder.fptosi(value, integers) for value in values[1:]]
        along = [
            builder.mul(c, splat(builder, step, i.count))
            for c, step in zip(cell, (slab, row), strict=False)
        ]
        first = builder.add(builder.add(along[0], along[1]), cell[2])
        # Load pairs along x from four rows: those at y, y + 1, and both in the next slab.
        corners = []
        for step in (row.type(0), row, slab, builder.add(slab, row)):
            corners += load_pairs(builder, builder.gep(data, [step]), first)
        return context.make_tuple(builder, result, corners)

    return result(voxels, k, j, i), _build


@overload(cube)
def _overload_cube(voxels: Any, k: Any, j: Any, i: Any) -> Any:
    """Choose the code of ``cube``: of a vector of cells, or of one."""

    def _of_vectors(voxels: Any, k: Any, j: Any, i: Any) -> Any:
        return _cube(voxels, k, j, i)

    if isinstance(i, Vector):
        return _of_vectors
    return cube


def four(voxels: Any, k: int, j: int, i: int) -> Any:
    """Return voxels i - 1 … i + 2 of row (k, j) as a vector of four float64; beyond the ends of
    the row, the end's value. Voxel i is in the row; voxels are float32.
    """
    return voxels[k, j, np.clip(np.arange(i - 1, i + 3), 0, voxels.shape[2] - 1)].astype(np.float64)


@intrinsic
def _four_together(typing: Any, voxels: Any, k: Any, j: Any, i: Any) -> Any:
    """Emit the load of four consecutive voxels from voxel (k, j, i) on, widened to float64."""

    def _build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        data, slab, row = open_voxels(context, builder, sig.args[0], values[0])
        place = builder.add(
            builder.mul(values[1], slab), builder.add(builder.mul(values[2], row), values[3])
        )
        first = builder.bitcast(
            builder.gep(data, [place]), ir.VectorType(FLOAT_TYPE, 4).as_pointer()
        )
        return builder.fpext(builder.load(first, align=4), vector_type(FOUR))

    return FOUR(voxels, types.int64, types.int64, types.int64), _build


@intrinsic
def _four_apart(typing: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Emit a vector of four float64 from four single numbers."""

    def _build(context: Any, builder: ir.IRBuilder, sig: Any, values: Any) -> ir.Value:
        vector = ir.Constant(vector_type(FOUR), ir.Undefined)
        for lane, value in enumerate(values):
            vector = builder.insert_element(
                vector, builder.fpext(value, DOUBLE_TYPE), WORD_TYPE(lane)
            )
        return vector

    return FOUR(types.float32, types.float32, types.float32, types.float32), _build


@numba.njit
def _four_at_border(voxels: Any, k: Any, j: Any, i: Any) -> Any:
    """Return ``four`` near the ends of a row, beyond which the end's voxel is repeated: one load of
    all four would read other rows, or memory outside the volume.
    """
    last = voxels.shape[2] - 1
    a = voxels[k, j, max(i - 1, 0)]
    d = voxels[k, j, min(i + 2, last)]
    return _four_apart(a, voxels[k, j, i], voxels[k, j, min(i + 1, last)], d)


@overload(four)
def _overload_four(voxels: Any, k: Any, j: Any, i: Any) -> Any:
    """Choose the code of ``four``: one load, except near the ends of a row."""

    def _compiled(voxels: Any, k: Any, j: Any, i: Any) -> Any:
        if 1 <= i < voxels.shape[2] - 2:
            return _four_together(voxels, k, j, i - 1)
        return _four_at_border(voxels, k, j, i)

    return _compiled
