"""How much the light differs that single paths from a texel bring: its variance under a light, told from the transfer.

A path that leaves towards ω brings L(ω), and its square L(ω)². Both are dot products with the same transfer, since
τ_i is the mean of Y_i(ω): the mean is τ·ℓ, the second moment τ·q, where q_i = ∫ L² Y_i dω. Of paths that were
reflected R^k stands where R^2k should, which is left out: what counts is how one light compares with another.
"""

import math
from itertools import product

import numpy as np

from isogi_core.bake.light import Light
from isogi_core.bake.look import Look, band_of
from isogi_core.bake.noise import DARKEST
from isogi_core.kernels.lattice import LEAST_SPREAD


def scatter(wrong: np.ndarray, light: Light, look: Look) -> np.ndarray:
    """Standard errors ``wrong`` of the luminance over the standard deviation of one path's; both (texels,) float64.

    It is what a texel's noise keeps as the light turns: ``light_texels`` puts the present light's deviation to it.
    """
    return np.asarray(wrong / np.maximum(path_deviation(light, look), DARKEST * look.unit))


def path_deviation(light: Light, look: Look) -> np.ndarray:
    """Standard deviation of one path's luminance, the mean square over all turns of the light; (texels,) float64.

    For a light turned at random the second moment keeps its first band, and E[(τ·Dℓ)²] = Σ_l Σ_cd (τ_c·τ_d)_l
    (ℓ_c·ℓ_d)_l / (2l + 1) over the channels c, d of all terms. LEAST_SPREAD of the second moment is added, as in
    ``light_texels``.
    """
    terms = look.terms
    transfer = [light.columns([term]).astype(np.float64) for term in terms]
    second = sum(t[:, t.shape[1] // 2, 0] * term.square[0] for t, term in zip(transfer, terms, strict=True))
    mean = np.zeros(len(light))
    for (t, one), (u, other) in product(zip(transfer, terms, strict=True), repeat=2):
        each = powers(one.luminance / look.unit, other.luminance / look.unit)
        mean += np.einsum("mcn,mdn,cdn->m", t[:, :, : each.shape[2]], u[:, :, : each.shape[2]], each)
    return look.unit * np.sqrt(np.maximum(second - mean, 0.0) + LEAST_SPREAD * np.maximum(second, 0.0))


def powers(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """What each τ_c τ_d counts in E[(τ·D ``one``)(τ·D ``other``)]: (ℓ_c·ℓ_d)_l / (2l + 1); (channels, channels, n²).

    The lights are (channels, n²), of which the lower order counts; the mean is over all rotations D.
    """
    n = min(one.shape[1], other.shape[1])
    order = math.isqrt(n)
    bands = np.add.reduceat(one[:, None, :n] * other[None, :, :n], np.arange(order) ** 2, axis=2)
    return np.asarray((bands / (2.0 * np.arange(order) + 1.0))[:, :, band_of(order)])
