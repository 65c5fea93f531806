"""Vectors against NumPy, and where numbers run out."""

import math

import numpy as np
import pytest

from isogi_core.kernels.tracing import vec

RNG = np.random.default_rng(1)
A, B = RNG.normal(size=(2, 100, 3))
TWINS = [
    (vec.add, (A, B), np.add),
    (vec.sub, (A, B), np.subtract),
    (vec.dot, (A, B), lambda a, b: np.sum(a * b, axis=-1)),
    (vec.cross, (A, B), np.cross),
    (vec.length, (A,), lambda a: np.linalg.norm(a, axis=-1)),
    (vec.normalize, (A,), lambda a: a / np.linalg.norm(a, axis=-1, keepdims=True)),
]
AXES = [tuple(sign * row) for row in np.eye(3) for sign in (1.0, -1.0)]
NEAR_POLES = [(1e-9, -1e-9, 1.0), (1e-200, 0.0, -1.0), (0.0, 1e-8, -1.0), (0.0, 0.0, -0.0 - 1.0)]


def python(function):
    """The Python function behind a kernel, or itself where Numba is switched off."""
    return getattr(function, "py_func", function)


@pytest.mark.parametrize(
    ("kernel", "arguments", "twin"), TWINS, ids=lambda x: getattr(x, "__name__", "")
)
def test_matches_numpy_compiled_and_not(kernel, arguments, twin):
    rows = [tuple(map(tuple, row)) for row in zip(*arguments, strict=True)]
    for function in (kernel, python(kernel)):
        np.testing.assert_allclose(
            [function(*row) for row in rows], twin(*arguments), rtol=1e-14, atol=1e-15
        )


def test_scale_and_madd():
    assert vec.scale((1.0, -2.0, 3.0), 2.0) == (2.0, -4.0, 6.0)
    assert vec.madd((1.0, 2.0, 3.0), 0.5, (2.0, 4.0, -6.0)) == (2.0, 4.0, 0.0)


@pytest.mark.parametrize("size", [5e-324, 1e-310, 1e-200, 1e200, 1.7e308])
def test_normalize_keeps_directions_of_extreme_length(size):
    unit = vec.normalize((-size, 0.0, size))
    np.testing.assert_allclose(unit, (-math.sqrt(0.5), 0.0, math.sqrt(0.5)), rtol=1e-15)


@pytest.mark.parametrize("bad", [0.0, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(3))
def test_normalize_of_no_direction_is_zero(bad, place):
    if bad == 0.0:
        vector = [0.0, 0.0, 0.0]
    else:
        vector = [1.0, 2.0, 3.0]
    vector[place] = bad
    assert vec.normalize(tuple(vector)) == (0.0, 0.0, 0.0)
    assert python(vec.normalize)(tuple(vector)) == (0.0, 0.0, 0.0)


def test_basis_is_orthonormal_and_right_handed_everywhere():
    units = RNG.normal(size=(10_000, 3))
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    for n in [*AXES, *NEAR_POLES, *map(tuple, units)]:
        frame = np.array([*vec.orthonormal_basis(n), n])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=4e-15)
        np.testing.assert_allclose(np.linalg.det(frame), 1.0, atol=4e-15)
