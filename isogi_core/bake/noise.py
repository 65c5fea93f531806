"""How wrong a texel's light still is, and when it is good enough."""

import numpy as np

from isogi_core.bake.light import Light
from isogi_core.bake.recipe import Recipe

FLOOR = 0.5
"""Texels darker than this share of unoccluded light are held to its error, not to their own small light's."""

MOST_SAMPLES = 16384
"""A texel with this many samples is final: what noise it has left is told, not chased."""


def relative_error(light: Light, recipe: Recipe) -> np.ndarray:
    """Standard error of each texel's luminance over the luminance, a mean over all turns of the light; (texels,)."""
    variance = np.tensordot(light.spread.astype(np.float64) ** 2, recipe.noise_weights, 2)
    mean = light.transfer[:, :, 0].astype(np.float64) @ recipe.luminance_light[:, 0]
    unoccluded = recipe.luminance_light[:, 0].sum() / np.sqrt(4.0 * np.pi)
    level = np.maximum(mean, FLOOR * max(unoccluded, 1e-30))
    return np.sqrt(variance) / level


def finished(light: Light, recipe: Recipe, target: float) -> np.ndarray:
    """Whether each texel is final: its error within ``target``, its samples spent, or void; (texels,) bool."""
    void = light.samples < 0
    lit = light.samples > 0
    return void | (lit & ((relative_error(light, recipe) <= target) | (light.samples >= MOST_SAMPLES)))
