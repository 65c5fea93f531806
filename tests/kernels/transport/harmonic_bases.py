"""The harmonics' basis at many directions, directions to integrate with, and whole rotation matrices."""

import math

import numpy as np
from numba import njit

from isogi_core.kernels.transport import harmonics
from isogi_core.kernels.transport.harmonics import MAX_ORDER


@njit
def basis(order, directions):
    """Y_i at unit directions (n, 3): (n, order²)."""
    out = np.empty((len(directions), order * order))
    for k in range(len(directions)):
        harmonics.evaluate(order, directions[k, 0], directions[k, 1], directions[k, 2], out[k])
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
