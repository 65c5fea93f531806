"""How wrong a texel's light still is, and when it is good enough."""

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.look import Look, band_of
from isogi_core.model.plan import FEWEST, most_samples

FLOOR = 0.5
"""Texels darker than this share of unoccluded light are held to its error, not to their own small light's."""

DECAY = 2.0 ** (-4.0 / 3.0)
"""What twice the samples do to the variance of a texel: its points are stratified."""

BAND_0 = np.array([0.75, 1 / 12, 1 / 12, 1 / 12])
"""What the coefficients of bands 0 and 1 count in the variance of band 0.

Band 0's own difference of two halves is one number, and would say too little; band 1 is of the same paths, but
up to ten times the variance where light is reflected often. Under constant light errors at a target of 2 % were
told as 1.39 % and were 1.34 %, after 216 samples (of equal weights 1.52 %, 1.09 %, 306; of band 0 alone
1.13 %, 1.74 %, 154: 800 texels of the orbital, albedo 0.7, 3 bounces).
"""


def deviations(light: Light, look: Look) -> np.ndarray:
    """Standard error of the luminance in each part, a mean over all turns of the light; (parts, texels) float64."""
    return np.array([deviation(part, look) for part in light.parts])


def deviation(part: Part, look: Look) -> np.ndarray:
    """Standard error of the luminance in one part, see ``Look.gains``; (texels,) float64."""
    return np.asarray(np.sqrt(part.noise.astype(np.float64) ** 2 @ look.gains(part.layer) ** 2))


def luminance(light: Light, look: Look) -> np.ndarray:
    """Mean luminance of each texel over all turns of the light; (texels,) float64."""
    total = np.zeros(len(light))
    for part in light.parts:
        weights = look.luminance_light[:, 0]
        weights = weights if part.layer.channels == len(weights) else weights.sum(keepdims=True)
        total += part.coefficients[:, :, 0].astype(np.float64) @ weights
    return total


def standard_error(light: Light, look: Look) -> np.ndarray:
    """Standard error of each texel's luminance, all parts together; (texels,) float64."""
    return np.asarray(np.sqrt((deviations(light, look) ** 2).sum(axis=0)))


def level(light: Light, look: Look) -> np.ndarray:
    """The luminance that each texel's error is held against: its own, or that of FLOOR; (texels,) float64."""
    return np.maximum(luminance(light, look), FLOOR * max(look.unoccluded, 1e-30))


def relative_error(light: Light, look: Look) -> np.ndarray:
    """Standard error of each texel's luminance over the luminance, a mean over all turns of the light; (texels,)."""
    return np.asarray(standard_error(light, look) / level(light, look))


def finished(light: Light, look: Look, target: float) -> np.ndarray:
    """Whether each texel is final: its error within ``target``, its samples spent, or void; (texels,) bool."""
    return light.void | good_enough(relative_error(light, look), light.samples, target)


def good_enough(error: np.ndarray, samples: np.ndarray, target: float) -> np.ndarray:
    """Whether texels of this relative ``error`` after so many ``samples`` are final for ``target``; bool."""
    return (error <= target) & (samples >= FEWEST) | (samples >= most_samples(target))


def noise_of_halves(halves: np.ndarray, samples: int, order: int) -> np.ndarray:
    """Standard errors of coefficients, in band 0 and above it, told from two independent randomisations.

    ``halves`` (m, 2, channels, N²) are sums over half of ``samples`` each, with the bands below ``order`` in
    front. Band 0 is judged with its neighbour, see BAND_0. In the bands above a band counts 1 / l, as if light
    had 1 / l of its energy there. (m, 1 or 2) float64.
    """
    spread = (halves[:, 0] - halves[:, 1]) / samples
    squares = (spread**2).mean(axis=1)
    low = np.average(squares[:, :4], axis=1, weights=BAND_0[: squares.shape[1]])
    if order == 1:
        return np.sqrt(low[:, None])
    band = band_of(order)[1:]
    weights = 1.0 / (band * (2 * band + 1))
    return np.sqrt(np.stack([low, squares[:, 1 : order**2] @ weights / weights.sum()], axis=1))


def blend_noise(former: np.ndarray, samples: int, latest: np.ndarray) -> np.ndarray:
    """Noise after twice the samples, from two estimates of what half of them leave: before, and of the new ones.

    The variance of their common mean is DECAY times theirs; with none before, it is that of the new ones.
    """
    return latest if samples == 0 else np.sqrt(DECAY * (former.astype(np.float64) ** 2 + latest**2) / 2.0)
