"""The harmonics' basis at many directions, also by SciPy, directions to integrate with, and
rotation matrices.
"""

import math

import numpy as np
from numba import njit
from scipy.special import sph_harm_y

from isogi_core.kernels.transport import harmonics
from isogi_core.kernels.transport.harmonics import MAX_ORDER


@njit
def basis(order, directions):
    """Y_i at unit directions (n, 3): (n, order²)."""
    out = np.empty((len(directions), order * order))
    for k in range(len(directions)):
        harmonics.evaluate(order, directions[k, 0], directions[k, 1], directions[k, 2], out[k])
    return out


def scipy_basis(order, directions):
    """Y_i at unit directions (n, 3) by SciPy's complex harmonics, without their Condon-Shortley
    phase: (n, order²).
    """
    x, y, z = directions.T
    theta = np.arctan2(np.hypot(x, y), z)
    phi = np.arctan2(y, x)
    out = np.empty((len(directions), order * order))
    for l in range(order):
        for m in range(l + 1):
            value = (-1) ** m * sph_harm_y(l, m, theta, phi) * math.sqrt(2.0 if m else 1.0)
            out[:, l * (l + 1) - m] = value.imag
            out[:, l * (l + 1) + m] = value.real
            if m == 0:
                out[:, l * (l + 1)] = value.real
    return out


def quadrature(bands=MAX_ORDER):
    """Directions (n, 3) and weights (n,) exact for products of two functions of that many bands."""
    z, weights = np.polynomial.legendre.leggauss(bands)
    phi = np.arange(2 * bands) * math.pi / bands
    z, phi = (grid.ravel() for grid in np.meshgrid(z, phi, indexing="ij"))
    r = np.sqrt(1.0 - z * z)
    directions = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
    return directions, np.repeat(weights * math.pi / bands, 2 * bands)


def rotation_matrix(matrix, order=MAX_ORDER):
    """The whole D of a rotation: rotated coefficients are D c."""
    out = np.empty((order * order, order * order))
    harmonics.rotate(order, np.ascontiguousarray(matrix), np.eye(order * order), out)
    return out.T
