"""Projection of a light onto spherical harmonics, in NumPy alone: planning a scene compiles nothing."""

import math

import numpy as np

from isogi_core.kernels.harmonics import DIAGONAL, OFFSET, SLOPE
from isogi_core.model.environment import Environment

# Gauss nodes and weights on [0, 1]: exact to rounding up to MAX_ORDER, even over a whole meridian.
NODES, WEIGHTS = (0.5 * (g + shift) for g, shift in zip(np.polynomial.legendre.leggauss(24), (1.0, 0.0), strict=True))


def project_environment(environment: Environment, order: int) -> np.ndarray:
    """SH coefficients of an environment, linear RGB, (3, n²) float64: the constant exactly, the image by quadrature."""
    coefficients = np.zeros((3, order**2))
    if environment.image.any():
        coefficients += project_image(environment.image, order)
    coefficients[:, 0] += environment.constant * math.sqrt(4.0 * math.pi)
    return coefficients


def project_image(image: np.ndarray, order: int) -> np.ndarray:
    """Coefficients ∫ L Y_i dω of a lat-long image (h, w, 3) for ``order`` <= MAX_ORDER; (3, order²) float64.

    Exact for the image as it is looked up, constant over each pixel: the integral over a pixel is one in
    θ times one in φ, so pixel solid angles are exact too. S1, eq. 7.
    """
    height, width = image.shape[:2]
    moments = np.tensordot(_waves(order, width), image, (2, 1))
    even, odd = np.matmul(_profiles(order, height), moments)
    m, l = np.triu_indices(order)
    out = np.zeros((3, order**2))
    out[:, l * (l + 1) - m] = odd[m, l].T
    out[:, l * (l + 1) + m] = even[m, l].T
    return out


def _waves(order: int, width: int) -> np.ndarray:
    """∫ cos mφ dφ and ∫ sin mφ dφ over each of the ``width`` pixels of a row; (2, order, width)."""
    m = np.arange(order)[:, None]
    half = math.pi / width
    angle = m * (half * (2 * np.arange(width) + 1))
    share = 2.0 * half * np.sinc(m / width)
    return np.asarray(share * np.stack([np.cos(angle), np.sin(angle)]))


def _profiles(order: int, height: int) -> np.ndarray:
    """∫ Y_lm(θ, 0) sinθ dθ over each of the ``height`` rows, m >= 0; (order, order, height) at [m, l], 0 for l < m."""
    row = math.pi / height
    theta = (np.arange(height)[:, None] + NODES) * row
    weights = row * WEIGHTS * np.sin(theta)
    profiles = np.zeros((order, order, height))
    for m in range(order):
        for l, values in enumerate(_meridian(order, m, theta), start=m):
            profiles[m, l] = (weights * values).sum(axis=1)
    return profiles


def _meridian(order: int, m: int, theta: np.ndarray) -> list[np.ndarray]:
    """Y_lm(θ, 0) for l = m … order - 1: the recurrence of ``harmonics.accumulate``, array by array."""
    z = np.cos(theta)
    before, values = np.zeros_like(z), [DIAGONAL[m] * np.sin(theta) ** m]
    for l in range(m + 1, order):
        values.append(SLOPE[l, m] * z * values[-1] - OFFSET[l, m] * before)
        before = values[-2]
    return values


def sphere_nodes(degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points θ, φ of the sphere and their weights, (points,) each: exact for harmonics below ``degree``."""
    z, weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    phi = 2.0 * math.pi / degree * np.arange(degree)
    theta, phi = (grid.ravel() for grid in np.meshgrid(np.arccos(z), phi, indexing="ij"))
    return theta, phi, np.repeat(weights * 2.0 * math.pi / degree, degree)


def evaluate_harmonics(order: int, theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Y_i at the points θ, φ (points,) for i < order²; (order², points) float64."""
    basis = np.empty((order**2, len(theta)))
    for m in range(order):
        for l, values in enumerate(_meridian(order, m, theta), start=m):
            basis[l * (l + 1) - m] = np.sin(m * phi) * values
            basis[l * (l + 1) + m] = np.cos(m * phi) * values
    return basis
