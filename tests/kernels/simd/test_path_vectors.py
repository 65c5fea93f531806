"""Vectors of PATH_WIDTH lanes against NumPy and single numbers: the same bits."""

import math

import numpy as np
import pytest
from numba import njit

from isogi_core.kernels.simd.maths import any_of, floor_within, fraction, not_, u32, where
from isogi_core.kernels.simd.memory import add_to, store
from isogi_core.kernels.simd.memory import load as load_width
from isogi_core.kernels.simd.types import PATH_WIDTH
from isogi_core.kernels.simd.voxels import four
from isogi_core.kernels.tracing.field import smooth_gradient, smooth_gradients, value
from isogi_core.kernels.tracing.vec import (
    column,
    load_columns,
    orthonormal_basis,
    put_column,
    store_columns,
)
from isogi_core.kernels.transport.harmonics import accumulate
from isogi_core.kernels.transport.rng import point_2d, point_of_words
from isogi_core.kernels.transport.sampling import cosine_and_sine, sample_cosine_hemisphere
from tests.scale import PYTHON

RNG = np.random.default_rng(1)
COUNT = 16 * PATH_WIDTH
VOXELS = RNG.random((5, 6, 7), np.float32)


@njit
def load(array, i):
    return load_width(array, i, PATH_WIDTH)


@njit
def arithmetic(a, b, out):
    for i in range(0, len(a), PATH_WIDTH):
        x, y = load(a, i), load(b, i)
        results = (
            x + y,
            x - y,
            x * y,
            x / y,
            -x,
            2.0 - x,
            x * 0.5,
            abs(x),
            math.sqrt(abs(x)),
            math.copysign(1.0, x),
            where(x < y, x, y),
            where((x > 0.5) & (y <= 0.5), 1.0, 0.0),
            where(x != 0.0, x, 7.0),
            where(x >= y, 3.0, y),
        )
        for k, result in enumerate(results):
            store(out[k], i, result)


def test_arithmetic_of_f64_is_numpys():
    a, b = RNG.normal(size=(2, COUNT))
    a[:3] = (0.0, -0.0, 0.5)
    b[3:5] = (np.inf, -np.inf)
    out = np.empty((14, COUNT))
    arithmetic(a, b, out)
    expected = (
        a + b,
        a - b,
        a * b,
        a / b,
        -a,
        2.0 - a,
        a * 0.5,
        np.abs(a),
        np.sqrt(np.abs(a)),
        np.copysign(1.0, a),
        np.minimum(a, b),
        (a > 0.5) & (b <= 0.5),
        np.where(a != 0.0, a, 7.0),
        np.where(a >= b, 3.0, b),
    )
    for k, right in enumerate(expected):
        assert np.array_equal(out[k], right), f"operation {k}"


@njit
def wordwise(a, b, out, fractions):
    mask = np.uint64(0xFFFFFFFF)
    three = np.uint64(3)
    for i in range(0, len(a), PATH_WIDTH):
        x, y = load(a, i), load(b, i)
        results = (
            (x + y) & mask,
            (x * y) & mask,
            x ^ y,
            x & y,
            x | y,
            (x << three) & mask,
            x >> three,
            u32(7),
        )
        for k, result in enumerate(results):
            store(out[k], i, result)
        store(fractions, i, fraction(x))


def test_arithmetic_of_u32_is_numpys():
    a, b = RNG.integers(0, 2**32, (2, COUNT), dtype=np.uint64)
    a[0] = 2**32 - 1
    out = np.empty((8, COUNT), np.uint32)
    fractions = np.empty(COUNT)
    if PYTHON:
        wordwise(a, b, out, fractions)
    else:
        wordwise(a.astype(np.uint32), b.astype(np.uint32), out, fractions)
    expected = (
        a + b,
        a * b,
        a ^ b,
        a & b,
        a | b,
        a << np.uint64(3),
        a >> np.uint64(3),
        np.full_like(a, 7),
    )
    for k, right in enumerate(expected):
        assert np.array_equal(out[k], (right & np.uint64(2**32 - 1)).astype(np.uint32)), (
            f"operation {k}"
        )
    assert np.array_equal(fractions, a / 2.0**32) and fractions.max() < 1.0


@njit
def sums(values, out):
    for i in range(0, len(values), PATH_WIDTH):
        add_to(out, 0, load(values, i))
        add_to(out, 1, load(values, i) * 2.0)


def test_add_to_keeps_a_sum_for_each_lane():
    values = RNG.random(COUNT)
    out = np.zeros(2 * PATH_WIDTH)
    sums(values, out)
    lanes = values.reshape(-1, PATH_WIDTH).cumsum(axis=0)[-1]
    np.testing.assert_allclose(out, np.concatenate([lanes, 2 * lanes]), rtol=1e-14)


@njit
def floors(x, last, out):
    for i in range(0, len(x), PATH_WIDTH):
        store(out, i, floor_within(load(x, i), last))


def test_floor_within_is_that_of_numbers():
    ends = [-0.0, 0.0, 5.0, 4.999999999, 6.0, 1e9, 1e300, math.inf, -math.inf, math.nan]
    x = np.concatenate([RNG.uniform(-2.0, 8.0, COUNT - len(ends)), ends])
    out = np.empty(COUNT)
    floors(x, 5, out)
    assert out.tolist() == [floor_within(v, 5) for v in x.tolist()]


@njit
def choices(x, y, out):
    for i in range(0, len(x), PATH_WIDTH):
        below = load(x, i) < load(y, i)
        store(out[0], i, where(not_(below), load(x, i), load(y, i)))
        store(out[1], i, min(max(load(x, i), 0.0), load(y, i)))
        store(out[2], i, where(below == (load(x, i) < 0.0), 1.0, 0.0))
        store(out[3], i, where(below != (load(x, i) < 0.0), 1.0, 0.0))
    return any_of(below), any_of(load(x, 0) > 100.0)


def test_choices_between_vectors_are_numpys():
    x, y = RNG.normal(size=(2, COUNT))
    y[-1] = x[-1] + 1.0
    out = np.empty((4, COUNT))
    assert choices(x, y, out) == (True, False)
    agree = (x < y) == (x < 0.0)
    expected = np.where(x < y, y, x), np.minimum(np.maximum(x, 0.0), y), agree, ~agree
    assert np.array_equal(out, np.array(expected, float))


@njit
def neighbours(voxels, k, j, i):
    q = four(voxels, k, j, i)
    q = q * 2.0 + q
    return q[0], q[1], q[2], q[3]


@pytest.mark.parametrize("width", [2, 3, 4, 7])
def test_four_repeats_the_ends(width):
    voxels = VOXELS[:, :, :width].copy()
    for i in range(width - 1):
        expected = np.pad(voxels[2, 3], 2, mode="edge")[i + 1 : i + 5].astype(float) * 3.0
        np.testing.assert_allclose(neighbours(voxels, 2, 3, i), expected, rtol=1e-15)


@njit
def together(seeds, samples, normals, voxels, points, draws, values, gradients):
    weights = np.empty((3, 9, PATH_WIDTH))
    low = (seeds & np.uint64(0xFFFFFFFF)).astype(np.uint32)
    high = (seeds >> np.uint64(32)).astype(np.uint32)
    for i in range(0, len(seeds), PATH_WIDTH):
        u, v = point_of_words(load(low, i), load(high, i), load(samples, i), u32(2))
        store_columns(draws[0], i, sample_cosine_hemisphere(u, v))
        s, t = orthonormal_basis(load_columns(normals, i))
        store_columns(draws[1], i, s)
        store_columns(draws[2], i, t)
        store(values, i, value(voxels, load_columns(points, i)))
        smooth_gradients(voxels, points, i, PATH_WIDTH, weights, gradients)


@njit
def apart(seeds, samples, normals, voxels, points, draws, values, gradients):
    for m in range(len(seeds)):
        u, v = point_2d(seeds[m], samples[m], 2)
        put_column(draws[0], m, sample_cosine_hemisphere(u, v))
        s, t = orthonormal_basis(column(normals, m))
        put_column(draws[1], m, s)
        put_column(draws[2], m, t)
        values[m] = value(voxels, column(points, m))
        put_column(gradients, m, smooth_gradient(voxels, column(points, m)))


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(5, 6, 7), (2, 2, 2), (9, 3, 3)])
def test_vectors_are_one_number_at_a_time(shape):
    voxels = RNG.random(shape, np.float32)
    seeds = RNG.integers(0, 2**63, COUNT).astype(np.uint64)
    samples = np.arange(COUNT, dtype=np.uint32)
    normals = RNG.normal(size=(3, COUNT))
    normals /= np.linalg.norm(normals, axis=0)
    points = RNG.random((3, COUNT)) * (np.array(shape[::-1])[:, None] - 1)
    points[:, :9] = np.rint(points[:, :9])
    found = [(np.empty((3, 3, COUNT)), np.empty(COUNT), np.empty((3, COUNT))) for _ in range(2)]
    together(seeds, samples, normals, voxels, points, *found[0])
    apart(seeds, samples, normals, voxels, points, *found[1])
    for one, other in zip(*found, strict=True):
        assert np.array_equal(one, other)


@njit
def harmonics_together(order, ways, weights, out):
    for i in range(0, len(weights), PATH_WIDTH):
        x, y, z = load_columns(ways, i)
        accumulate(order, x, y, z, load(weights, i), out)


@njit
def harmonics_apart(order, ways, weights, out):
    for m in range(len(weights)):
        x, y, z = column(ways, m)
        accumulate(order, x, y, z, weights[m], out[m % PATH_WIDTH])


@pytest.mark.parametrize("order", [1, 2, 5, 10])
def test_harmonics_of_vectors_are_one_at_a_time(order):
    ways = RNG.normal(size=(3, COUNT))
    ways /= np.linalg.norm(ways, axis=0)
    weights = np.where(RNG.random(COUNT) < 0.5, 0.0, RNG.random(COUNT))
    together_ = np.zeros(order**2 * PATH_WIDTH)
    apart_ = np.zeros((PATH_WIDTH, order**2))
    harmonics_together(order, ways, weights, together_)
    harmonics_apart(order, ways, weights, apart_)
    assert np.array_equal(together_.reshape(-1, PATH_WIDTH).T, apart_)


def test_cosine_and_sine_are_libms_to_the_next_bit():
    for angle in [0.0, *np.linspace(-math.pi / 4, math.pi / 4, 2001).tolist()]:
        cosine, sine = cosine_and_sine(angle)
        assert abs(cosine - math.cos(angle)) <= 2.0**-53
        assert abs(sine - math.sin(angle)) <= math.ulp(sine)
