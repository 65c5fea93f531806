"""How wrong a texel's light still is, and when it is good enough."""

import math

import numpy as np

from isogi_core.bake.light import Light
from isogi_core.bake.recipe import Recipe

FLOOR = 0.5
"""Texels darker than this share of unoccluded light are held to its error, not to their own small light's."""

FEWEST, MOST = 64, 1 << 20
"""Bounds of what any target error is worth in samples. With fewer, a dark texel may have met no light at all."""


def most_samples(target: float) -> int:
    """The samples that the relative error ``target`` is worth: 4096 at 2 %, a power of two growing as target^-3/2.

    A texel that has taken them is final: what noise it has left is told, not chased. The stratified
    points' error falls about as n^-2/3, so a target that most texels reach leaves few behind.
    """
    worth = 4096.0 * (0.02 / max(target, 1e-6)) ** 1.5
    return min(max(1 << round(math.log2(worth)), FEWEST), MOST)


def relative_error(light: Light, recipe: Recipe) -> np.ndarray:
    """Standard error of each texel's luminance over the luminance, a mean over all turns of the light; (texels,)."""
    variance = np.tensordot(light.spread.astype(np.float64) ** 2, recipe.noise_weights, 2)
    mean = light.transfer[:, :, 0].astype(np.float64) @ recipe.luminance_light[:, 0]
    unoccluded = recipe.luminance_light[:, 0].sum() / np.sqrt(4.0 * np.pi)
    level = np.maximum(mean, FLOOR * max(unoccluded, 1e-30))
    return np.sqrt(variance) / level


def finished(light: Light, recipe: Recipe, target: float) -> np.ndarray:
    """Whether each texel is final: its error within ``target``, its samples spent, or void; (texels,) bool."""
    return (light.samples < 0) | good_enough(relative_error(light, recipe), light.samples, target)


def good_enough(error: np.ndarray, samples: np.ndarray, target: float) -> np.ndarray:
    """Whether texels of this relative ``error`` after so many ``samples`` are final for ``target``; bool."""
    return (error <= target) & (samples >= FEWEST) | (samples >= most_samples(target))
