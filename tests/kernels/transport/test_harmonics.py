"""Spherical harmonics against SciPy, exact quadrature and closed forms."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import eval_legendre

from isogi_core.kernels.transport import harmonics
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from tests.kernels.transport.harmonic_bases import basis, quadrature, rotation_matrix, scipy_basis
from tests.scale import few

COUNT = MAX_ORDER * MAX_ORDER
AXES = np.array([sign * row for row in np.eye(3) for sign in (1.0, -1.0)])
NEAR_POLES = np.array([[1e-9, 0.0, 1.0], [0.0, -1e-12, -1.0], [1e-300, 1e-300, 1.0]])


def units(seed, count):
    """Random unit vectors (count, 3)."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def rotations(count):
    """Rotation matrices: random ones, half turns, turns about the axes, poles swapped, and tiny
    ones.
    """
    half = Rotation.from_rotvec(math.pi * np.concatenate([AXES[::2], NEAR_POLES[:2], units(1, 40)]))
    turns = Rotation.from_rotvec(
        np.concatenate([AXES * angle for angle in (math.pi / 2, 1.0, 1e-3, 1e-9)])
    )
    special = np.concatenate([half.as_matrix(), turns.as_matrix()])
    return np.concatenate([special, Rotation.random(count - len(special), rng=2).as_matrix()])


@pytest.mark.parametrize("order", [1, 2, 5, MAX_ORDER])
def test_basis_matches_scipy(order):
    directions = np.concatenate([AXES, NEAR_POLES, units(3, few(10_000, 500))])
    np.testing.assert_allclose(
        basis(order, directions), scipy_basis(order, directions), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("order", range(1, MAX_ORDER + 1))
def test_accumulate_adds_weighted_bands_and_touches_no_more(order):
    out = np.full(COUNT, 7.0)
    x, y, z = units(5, 1)[0]
    harmonics.accumulate(order, x, y, z, 0.25, out)
    expected = 7.0 + 0.25 * basis(MAX_ORDER, np.array([[x, y, z]]))[0]
    expected[order * order :] = 7.0
    np.testing.assert_allclose(out, expected, rtol=1e-15)


def test_rotation_matches_reprojection():
    """D against ∫ Y_i(ω) Y_j(Q⁻¹ω) dω by exact quadrature."""
    directions, weights = quadrature()
    weighted = (basis(MAX_ORDER, directions) * weights[:, None]).T
    for matrix in rotations(few(250, 1000))[:: few(1, 50)]:
        expected = weighted @ basis(MAX_ORDER, directions @ matrix)
        np.testing.assert_allclose(rotation_matrix(matrix), expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("order", range(1, MAX_ORDER + 1))
def test_rotation_at_every_order_and_any_number_of_channels(order):
    matrix = Rotation.from_euler("ZYX", [20, 40, 60], degrees=True).as_matrix()
    coefficients = np.random.default_rng(6).normal(size=(4, order * order))
    out = np.full_like(coefficients, np.nan)
    harmonics.rotate(order, matrix, coefficients, out)
    d = units(7, 50)
    np.testing.assert_allclose(
        basis(order, d) @ out.T, basis(order, d @ matrix) @ coefficients.T, rtol=0, atol=1e-12
    )


def test_cosine_lobe_factors():
    """A_l = 2π ∫₀¹ P_l(z) z dz; the first are π, 2π/3, π/4, 0, -π/24."""
    z, weights = np.polynomial.legendre.leggauss(20)
    z = (z + 1.0) / 2.0
    weights = weights / 2.0
    integrals = [
        2.0 * math.pi * np.sum(weights * z * eval_legendre(l, z)) for l in range(MAX_ORDER)
    ]
    factors = harmonics.cosine_lobe_factors(MAX_ORDER)
    np.testing.assert_allclose(factors, integrals, rtol=0, atol=1e-14)
    first = math.pi * np.array([1, 2 / 3, 1 / 4, 0, -1 / 24])
    np.testing.assert_allclose(harmonics.cosine_lobe_factors(5), first, rtol=1e-15, atol=0)
    assert harmonics.cosine_lobe_factors(1).shape == (1,)
