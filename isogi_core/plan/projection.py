"""Environments as coefficients of spherical harmonics."""

import numpy as np

from isogi_core.kernels.harmonics import project
from isogi_core.model.environment import Environment


def project_environment(environment: Environment, order: int) -> np.ndarray:
    """SH coefficients of an environment, linear RGB, (3, n²) float64: the constant exactly, the image by quadrature."""
    coefficients = np.zeros((3, order**2))
    if environment.image.any():
        project(order, environment.image, coefficients)
    coefficients[:, 0] += environment.constant * np.sqrt(4.0 * np.pi)
    return coefficients
