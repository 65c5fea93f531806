"""How much the light differs that single paths from a texel bring: its variance under a light, told from the transfer.

A path that leaves towards ω brings L(ω), and its square L(ω)². Both are dot products with the same transfer, since
τ_i is the mean of Y_i(ω): the mean is τ·ℓ, the second moment τ·q, where q_i = ∫ L² Y_i dω. Of paths that were
reflected R^k stands where R^2k should, which is left out: what counts is how one light compares with another.
"""

import numpy as np

from isogi_core.bake.light import Light
from isogi_core.bake.look import Look, band_of
from isogi_core.kernels.lattice import LEAST_SPREAD


def path_deviation(light: Light, look: Look) -> np.ndarray:
    """Standard deviation of one path's luminance, the mean square over all turns of the light; (texels,) float64.

    For a light turned at random the second moment keeps its first band, and E[(τ·Dℓ)²] = Σ_l Σ_cd (τ_c·τ_d)_l
    (ℓ_c·ℓ_d)_l / (2l + 1) over channels c, d. LEAST_SPREAD of the second moment is added, as in ``light_texels``.
    """
    lights, n = look.luminance_light / look.unit, look.order**2
    transfer = light.transfer[:, :, :n].astype(np.float64)
    second = look.square[0] * transfer[:, transfer.shape[1] // 2, 0]
    starts, width = np.arange(look.order) ** 2, 2.0 * np.arange(look.order) + 1.0
    powers = np.add.reduceat(lights[:, None] * lights[None], starts, axis=2) / width
    mean = np.einsum("mcn,mdn,cdn->m", transfer, transfer, powers[:, :, band_of(look.order)])
    return look.unit * np.sqrt(np.maximum(second - mean, 0.0) + LEAST_SPREAD * np.maximum(second, 0.0))
