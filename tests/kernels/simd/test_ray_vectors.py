"""Vectors of RAY_WIDTH lanes against NumPy, one operation after another."""

import math

import numpy as np
import pytest
from numba import config, njit

from isogi_core.kernels.simd import types
from isogi_core.kernels.simd.maths import bits, f32, f64, fma, i32, mask_of, popcount, rank, where
from isogi_core.kernels.simd.memory import gather, scatter, store
from isogi_core.kernels.simd.memory import load as load_width
from isogi_core.kernels.simd.types import RAY_WIDTH, REGISTER_LANES

needs_simd = pytest.mark.skipif(
    REGISTER_LANES is None, reason="this processor, or Numba switched off, has no SIMD"
)


@njit
def load(array, i):
    return load_width(array, i, RAY_WIDTH)


def numbers(seed):
    """Floats for one vector, with ones that are equal, infinite and not a number among them."""
    values = np.random.default_rng(seed).normal(size=RAY_WIDTH).astype(np.float32)
    values[:4] = 0.5, np.inf, -np.inf, np.nan
    return values


@njit
def arithmetic(a, b, c, out):
    x, y, z = load(a, 0), load(b, 0), load(c, 0)
    results = (
        x + y,
        x - y,
        x * y,
        x / y,
        -x,
        fma(x, y, z),
        min(x, y),
        max(x, y),
        abs(x),
        2.0 - x,
        x * 0.5,
    )
    for i, result in enumerate(results):
        store(out[i], 0, result)


@needs_simd
def test_arithmetic_of_f32_is_numpys():
    a, b, c = numbers(1), numbers(2), numbers(3)
    a[5] = b[5]
    out = np.empty((11, RAY_WIDTH), np.float32)
    arithmetic(a, b, c, out)
    half = np.float32(0.5)
    two = np.float32(2)
    with np.errstate(invalid="ignore"):
        exact = (a.astype(float) * b + c).astype(np.float32)
        smaller = np.where(b < a, b, a)
        larger = np.where(b > a, b, a)
        expected = (
            a + b,
            a - b,
            a * b,
            a / b,
            -a,
            exact,
            smaller,
            larger,
            np.abs(a),
            two - a,
            a * half,
        )
    for i, (found, right) in enumerate(zip(out, expected, strict=True)):
        np.testing.assert_allclose(
            found, right, rtol=0 if i != 5 else 1e-6, err_msg=f"operation {i}"
        )


@njit
def whole(a, b, out):
    x, y = load(a, 0), load(b, 0)
    results = (
        x + y,
        x - y,
        x * y,
        x & y,
        x | y,
        x ^ y,
        x << 3,
        x >> 2,
        max(x, y),
        min(x, 5),
        i32(7),
        1 + x,
    )
    for i, result in enumerate(results):
        store(out[i], 0, result)


@needs_simd
def test_arithmetic_of_i32_is_numpys():
    a, b = np.random.default_rng(4).integers(-(2**31), 2**31, (2, RAY_WIDTH)).astype(np.int32)
    out = np.empty((12, RAY_WIDTH), np.int32)
    whole(a, b, out)
    expected = (
        a + b,
        a - b,
        a * b,
        a & b,
        a | b,
        a ^ b,
        a << 3,
        a >> 2,
        np.maximum(a, b),
        np.minimum(a, 5),
        7,
        1 + a,
    )
    for i, (found, right) in enumerate(zip(out, expected, strict=True)):
        assert np.array_equal(found, np.broadcast_to(right, RAY_WIDTH)), f"operation {i}"


@njit
def comparisons(a, b, out):
    x, y = load(a, 0), load(b, 0)
    masks = (
        x < y,
        x <= y,
        x > y,
        x >= y,
        x == y,
        x != y,
        (x < y) | (x > 1.0),
        (x < y) & ~(x < 0.0),
        (x < y) ^ (x < 0.0),
    )
    for i, mask in enumerate(masks):
        out[i] = bits(mask)
    out[9] = popcount(x < y)
    out[10] = bits(mask_of(True))
    out[11] = bits(mask_of(False))


@needs_simd
def test_masks_are_numpys():
    a, b = numbers(5), numbers(6)
    a[6] = b[6]
    out = np.zeros(12, np.int64)
    comparisons(a, b, out)
    less = a < b
    masks = (
        less,
        a <= b,
        a > b,
        a >= b,
        a == b,
        a != b,
        less | (a > 1),
        less & ~(a < 0),
        less ^ (a < 0),
    )
    assert out[:9].tolist() == [
        sum(1 << i for i in np.flatnonzero(mask).tolist()) for mask in masks
    ]
    assert out[9:].tolist() == [less.sum(), 2**RAY_WIDTH - 1, 0]


@njit
def moves(values, index, order, threshold, whole_numbers, real_numbers, picked):
    found = gather(values, load(index, 0))
    chosen = found > threshold
    store(real_numbers[0], 0, found)
    store(real_numbers[1], 0, where(chosen, found, -1.0))
    store(real_numbers[2], 0, f32(load(index, 0)))
    store(whole_numbers[0], 0, rank(chosen))
    store(whole_numbers[1], 0, i32(found * 100.0))
    store(whole_numbers[2], 0, gather(index, load(order, 0)))
    for lane in range(RAY_WIDTH):
        picked[lane] = found[lane]


@needs_simd
def test_gather_where_rank_and_item():
    rng = np.random.default_rng(7)
    values = rng.random(1000).astype(np.float32)
    index = rng.integers(0, 1000, RAY_WIDTH).astype(np.int32)
    whole_numbers = np.empty((3, RAY_WIDTH), np.int32)
    real_numbers = np.empty((3, RAY_WIDTH), np.float32)
    picked = np.empty(RAY_WIDTH, np.float32)
    order = (np.arange(RAY_WIDTH) ^ 1).astype(np.int32)
    moves(values, index, order, 0.5, whole_numbers, real_numbers, picked)
    found = values[index]
    assert np.array_equal(real_numbers, [found, np.where(found > 0.5, found, -1), index])
    before = np.cumsum(found > 0.5) - (found > 0.5)
    swapped = index[order]
    assert np.array_equal(
        whole_numbers, [before, (found * np.float32(100)).astype(np.int32), swapped]
    )
    assert np.array_equal(picked, found)


@njit
def in_doubles(a, b, whole, single, out, cut):
    x, y = load(a, 0), load(b, 0)
    results = (
        x + y,
        x - y,
        x * y,
        x / y,
        -x,
        math.sqrt(abs(x)),
        math.copysign(x, y),
        min(x, y),
        max(x, 0.5),
    )
    for i, result in enumerate(results):
        store(out[i], 0, result)
    total = x * y
    total += x
    store(out[9], 0, total)
    store(out[10], 0, where(x < y, f64(load(whole, 0)), f64(load(single, 0))))
    store(cut[0], 0, i32(x * 10.0))
    store(single, 0, f32(x))


@needs_simd
def test_f64_are_numpys_to_the_bit():
    rng = np.random.default_rng(8)
    a, b = rng.normal(size=(2, RAY_WIDTH))
    whole = rng.integers(-9, 9, RAY_WIDTH).astype(np.int32)
    single = rng.random(RAY_WIDTH).astype(np.float32)
    mixed = np.where(a < b, whole, single.astype(float))
    out = np.empty((11, RAY_WIDTH))
    cut = np.empty((1, RAY_WIDTH), np.int32)
    in_doubles(a, b, whole, single, out, cut)
    expected = (
        a + b,
        a - b,
        a * b,
        a / b,
        -a,
        np.sqrt(np.abs(a)),
        np.copysign(a, b),
        np.minimum(a, b),
        np.maximum(a, 0.5),
        a * b + a,
        mixed,
    )
    assert np.array_equal(out, expected)
    assert np.array_equal(cut[0], (a * 10).astype(np.int32))
    assert np.array_equal(single, a.astype(np.float32))


@njit
def scatter_some(values, index, limit, array, signs):
    vector = load(values, 0)
    scatter(array, load(index, 0), vector, vector > limit)
    scatter(signs, load(index, 0), i32(vector), vector > limit)


@needs_simd
def test_scatter_writes_where_the_mask_is_set():
    rng = np.random.default_rng(9)
    values = rng.normal(size=RAY_WIDTH) * 50
    index = rng.permutation(100)[:RAY_WIDTH].astype(np.int32)
    array = np.zeros(100)
    signs = np.zeros(100, np.int8)
    scatter_some(values, index, 0.0, array, signs)
    expected = np.zeros(100)
    expected[index] = np.where(values > 0, values, 0)
    assert np.array_equal(array, expected)
    assert np.array_equal(signs, expected.astype(np.int8))


def test_width_follows_the_processor(monkeypatch):
    monkeypatch.setattr(config, "DISABLE_JIT", 0)
    monkeypatch.setattr(types.llvm, "get_host_cpu_name", lambda: "haswell")
    for name, features, width in (
        ("skylake-avx512", None, 16),
        ("haswell", None, 8),
        ("generic", None, None),
        ("generic", "+sse2,+avx2", 8),
        ("generic", "+avx512f,+avx2", 16),
        (None, "+avx2", 8),
        (None, "", 8),
    ):
        monkeypatch.setattr(config, "CPU_NAME", name)
        monkeypatch.setattr(config, "CPU_FEATURES", features)
        assert types.register_lanes() == width, (name, features)
    monkeypatch.setattr(config, "DISABLE_JIT", 1)
    assert types.register_lanes() is None


def test_vectors_do_not_exist_outside_compiled_code():
    with pytest.raises(NotImplementedError, match="compiled code"):
        fma(1.0, 2.0, 3.0)
