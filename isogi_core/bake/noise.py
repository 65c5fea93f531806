"""How wrong a texel's light still is, and when it is good enough."""

from collections.abc import Mapping

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.look import Look, band_of
from isogi_core.model.plan import FEWEST, Layer, most_samples
from isogi_core.plan.albedos import mixing_weights

FLOOR = 0.5
"""Texels darker than this share of unoccluded light are held to its error, not to their own small light's."""

DECAYS: Mapping[str, tuple[float, float]] = {
    "direct": (0.38, 0.24),
    "indirect": (0.46, 0.49),
    "whole": (0.46, 0.35),
    "irradiance": (0.42, 0.42),
}
"""What twice the samples do to the variance of band 0, and to what the bands above have more than that, by kind.

Points are stratified, and light that paths bring straight is even between its edges: it gains most. Of plain
random points, and nearly of long paths, half is left. Mean squares of whole halves' differences over 16 to 1024
samples, on two views each of the engine, the CT head, the bonsai, the MNI brain, the casting and the orbital: within
a tenth, but 0.35 (orbital) to 0.41 (bonsai) for band 0 of direct light, and 0.22 to 0.30 above it.
"""

BAND_0 = np.array([0.75, 1 / 12, 1 / 12, 1 / 12])
"""What the coefficients of bands 0 and 1 count in the variance of band 0.

Band 0's own difference of two halves is one number, and would say too little; band 1 is of the same paths, and is
scaled to band 0 where there is nothing else: see ``evenness``.
"""


DARKEST = 1e-30
"""Luminance, in units of a look, that stands for none where it is divided by."""


def deviations(light: Light, look: Look) -> np.ndarray:
    """Standard error of the luminance in each part, a mean over all turns of the light; (parts, texels) float64."""
    return np.array([deviation(part, look) for part in light.parts])


def deviation(part: Part, look: Look) -> np.ndarray:
    """Standard error of the luminance in one part, see ``Look.gains``; (texels,) float64.

    Where band 0 was told too noisy by chance, a quarter of what even noise would be is the least.
    """
    squares, gains = part.noise.astype(np.float64) ** 2, look.gains(part.layer)
    return np.asarray(np.sqrt(np.maximum(squares @ gains, squares[:, -1] * gains.sum() / 4.0)))


def luminance(light: Light, look: Look) -> np.ndarray:
    """Mean luminance of each texel over all turns of the light, lobes among it; (texels,) float64."""
    total = np.zeros(len(light))
    for part in light.parts:
        total += part.coefficients[:, :, 0].astype(np.float64) @ white(part.layer, look)
    return total


def white(layer: Layer, look: Look) -> np.ndarray:
    """What band 0 of a ``layer`` counts in the mean luminance over all turns of the light; (channels,) float64.

    Where views may ask for other albedos, reflected light counts as it does at the lowest, all else as at the highest:
    an error that is told of the most noise over the least light holds at each of them.
    """
    weights = look.luminance_light[:, 0]
    if layer.nodes:
        return np.asarray(weights.sum() * mixing_weights(look.recipe.scene.lowest, layer.nodes, look.plan.bounces))
    return np.array(weights if layer.channels == len(weights) else weights.sum(keepdims=True))


def standard_error(light: Light, look: Look) -> np.ndarray:
    """Standard error of each texel's luminance, all parts together; (texels,) float64."""
    return np.asarray(np.sqrt((deviations(light, look) ** 2).sum(axis=0)))


def level(light: Light, look: Look) -> np.ndarray:
    """The luminance that each texel's error is held against: its own, or that of FLOOR; (texels,) float64."""
    return np.maximum(luminance(light, look), least_level(look))


def least_level(look: Look) -> float:
    """The luminance that errors of the darkest texels are held against."""
    return FLOOR * max(look.unoccluded, DARKEST * look.unit)


def relative_error(light: Light, look: Look) -> np.ndarray:
    """Standard error of each texel's luminance over the luminance, a mean over all turns of the light; (texels,)."""
    return np.asarray(standard_error(light, look) / level(light, look))


def finished(light: Light, look: Look, target: float) -> np.ndarray:
    """Whether each texel is final: its error within ``target``, its samples spent, or void; (texels,) bool."""
    return light.void | good_enough(relative_error(light, look), light.samples, target)


def good_enough(error: np.ndarray, samples: np.ndarray, target: float) -> np.ndarray:
    """Whether texels of this relative ``error`` after so many ``samples`` are final for ``target``; bool."""
    return (error <= target) & (samples >= FEWEST) | (samples >= most_samples(target))


def noise_of_halves(halves: np.ndarray, samples: int, order: int, evenness: np.ndarray | float = 1.0) -> np.ndarray:
    """Standard errors of coefficients, in band 0 and above it, told from two independent randomisations.

    ``halves`` (m, 2, N²) are sums over half of ``samples`` each, with the bands below ``order`` in front. Band 0 is
    judged with its neighbour, see BAND_0, of which ``evenness`` (m,) is the share that band 0 varies by. Above it is
    the mean of the bands' variances. (m, 1 or 2) float64.
    """
    squares = ((halves[:, 0] - halves[:, 1]) / samples) ** 2
    low = np.average(squares[:, :4], axis=1, weights=BAND_0[: squares.shape[1]])
    if squares.shape[1] > 1:
        low += (evenness - 1.0) * (squares[:, 1:4] @ BAND_0[1:])
    if order == 1:
        return np.sqrt(low[:, None])
    weights = 1.0 / (2 * band_of(order)[1:] + 1)
    return np.sqrt(np.stack([low, squares[:, 1 : order**2] @ weights / weights.sum()], axis=1))


def evenness(mean: np.ndarray, second: np.ndarray, samples: int) -> np.ndarray:
    """Variance of band 0 over that of a coefficient of band 1, for paths drawn at random; (m,) float64.

    ``mean`` (m, >= 4) is that of X Y_i(ω) and ``second`` (m,) that of X² Y_0(ω) over ``samples`` paths that bring X
    from ω. Under light that is the same from all sides band 0 is the even one: an open texel's has no variance at
    all. One path more is counted of either, so that a few that agree do not claim that all do.
    """
    square = second / np.sqrt(4.0 * np.pi)
    more = square / samples
    low = np.maximum(square - mean[:, 0] ** 2, 0.0) + more
    return np.asarray(low / np.maximum(square - (mean[:, 1:4] ** 2).mean(axis=1) + more, 1e-30))


def blend_noise(former: np.ndarray, samples: int, latest: np.ndarray, decay: tuple[float, float]) -> np.ndarray:
    """Noise after twice the samples, from two estimates of what half of them leave: before, and of the new ones.

    The variance of their common mean is ``decay`` times theirs, see DECAYS; with none before, it is that of the new
    ones.
    """
    if samples == 0:
        return latest
    squares = (former.astype(np.float64) ** 2 + latest**2) / 2.0
    low = squares[:, :1]
    return np.asarray(np.sqrt(decay[0] * np.minimum(squares, low) + decay[1] * np.maximum(squares - low, 0.0)))
