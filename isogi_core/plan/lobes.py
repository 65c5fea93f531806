"""Which lobes of an environment are worth a light of their own, and what they leave to harmonics.

A lobe's disc is lit by shadow rays, and harmonics have the environment less the disc: what they keep of it is exact
whatever the disc is, and a disc is good that leaves little beyond.
"""

import math
from collections.abc import Sequence

import numpy as np

from isogi_core.kernels.harmonics import MAX_ORDER
from isogi_core.model.environment import Environment
from isogi_core.model.lobes import Lobe, outlines
from isogi_core.plan.bands import band_energy, truncation_error
from isogi_core.plan.projection import evaluate_harmonics

MOST = 4
"""Lobes that an environment has at most."""

ORDER = 6
"""The order of harmonics beyond which lobes are to leave little."""

GAIN = 0.9
"""A lobe is one only where less than so much of the error is left."""

ENOUGH = 0.004
"""An error so small leaves nothing to gain by more lobes."""

NODES, WEIGHTS = np.polynomial.legendre.leggauss(MAX_ORDER)


def find_lobes(environment: Environment, light: np.ndarray) -> tuple[Lobe, ...]:
    """The lobes of an environment whose coefficients are ``light`` (3, MAX_ORDER²), the most telling edge of each.

    They come brightest peak first, until the error that harmonics of ORDER have is small, or one leaves most of it.
    """
    lobes: tuple[Lobe, ...] = ()
    radiance, left = environment.image.astype(np.float64), error_beside(light, lobes)
    while len(lobes) < MOST and left > ENOUGH:
        found = {error_beside(light, (*lobes, each.lobe)): each for each in outlines(radiance)}
        if not min(found, default=math.inf) <= GAIN * left:
            break
        left = min(found)
        found[left].clear(radiance)
        lobes = (*lobes, found[left].lobe)
    return lobes


def error_beside(light: np.ndarray, lobes: Sequence[Lobe]) -> float:
    """Relative error that harmonics of ORDER have with what ``lobes`` leave of a ``light`` (3, MAX_ORDER²)."""
    return truncation_error(energy_beside(light, lobes), ORDER, "direct")


def energy_beside(light: np.ndarray, lobes: Sequence[Lobe]) -> np.ndarray:
    """Mean square luminance of each band of a ``light`` (3, n²) less its ``lobes``; (n,) float64.

    Band 0 is that of all light: errors of what is left are relative to the whole.
    """
    energy = band_energy(light - project_lobes(lobes, math.isqrt(light.shape[1])))
    energy[0] = band_energy(light[:, :1])[0]
    return energy


def project_lobes(lobes: Sequence[Lobe], order: int) -> np.ndarray:
    """Coefficients of discs of even radiance, Φ Y_i(d) times the mean of P_l over the disc; (3, order²) float64."""
    coefficients = np.zeros((3, order**2))
    for lobe in lobes:
        x, y, z = lobe.towards
        theta, phi = np.array([math.atan2(math.hypot(x, y), z)]), np.array([math.atan2(y, x)])
        bands = np.repeat(disc_means(lobe.cosine, order), 2 * np.arange(order) + 1)
        coefficients += np.outer(lobe.flux, bands * evaluate_harmonics(order, theta, phi)[:, 0])
    return coefficients


def disc_means(cosine: float, order: int) -> np.ndarray:
    """Means of the Legendre polynomials P_l, l < ``order``, from ``cosine`` to 1: 1 for a disc without size."""
    heights = cosine + (1.0 - cosine) * (NODES + 1.0) / 2.0
    return np.asarray(WEIGHTS / 2.0 @ np.polynomial.legendre.legvander(heights, order - 1))
