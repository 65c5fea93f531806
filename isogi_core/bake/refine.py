"""Refinement: more samples for texels that need them, added to what is there.

Sample counts climb one ladder (16, 32, 64, …) and the means are rounded to what the store keeps
after each rung, so that a texel with n samples has the same bits whoever sent them, in how many goes.
"""

import numpy as np

from isogi_core.bake.light import ERROR, ISOVALUE, SAMPLES, VOID, Light
from isogi_core.bake.noise import finished
from isogi_core.bake.recipe import Recipe
from isogi_core.kernels.integrator import bake_texels

FIRST_RUNG = 16


def next_rung(samples: int) -> int:
    """The sample count that follows ``samples`` on the ladder."""
    return FIRST_RUNG if samples < FIRST_RUNG else 2 * samples


def refine(light: Light, texels: np.ndarray, recipe: Recipe, until: int, target: float) -> None:
    """Bring ``light`` of the ``texels`` (m, 3; z, y, x) up to ``until`` samples each, in place.

    A texel that has reached the relative error ``target`` is left as it is.
    """
    while True:
        waiting = ~finished(light, recipe, target) & (light.samples < until)
        if not waiting.any():
            return
        fewest = int(light.samples[waiting].min())
        climb(light, np.flatnonzero(waiting & (light.samples == fewest)), texels, recipe, fewest)


def climb(light: Light, chosen: np.ndarray, texels: np.ndarray, recipe: Recipe, samples: int) -> None:
    """Take the ``chosen`` rows, all at ``samples``, to the next rung."""
    total = next_rung(samples)
    order, channels, m = recipe.scene.plan.order, recipe.scene.plan.channels, len(chosen)
    direct, indirect = np.zeros((m, 2, order**2)), np.zeros((m, 2, channels, order**2))
    isovalues, void = np.empty(m), np.empty(m, np.bool_)
    places = np.ascontiguousarray(texels[chosen], np.int32)
    first, count = samples // 2, (total - samples) // 2
    path = (first, count, recipe.weights, order)
    bake_texels(recipe.field, recipe.step, places, *path, direct, indirect, isovalues, void)
    whole = direct[:, :, None, :] + indirect
    light.direct[chosen] = add_to_mean(light.direct[chosen], samples, direct.sum(axis=1), total)
    light.indirect[chosen] = add_to_mean(light.indirect[chosen], samples, indirect.sum(axis=1), total)
    light.spread[chosen] = add_to_mean(light.spread[chosen], samples, whole[:, 0] - whole[:, 1], total)
    light.planes[chosen, ERROR] = np.sqrt((light.spread[chosen].astype(np.float64) ** 2).sum(axis=(1, 2)))
    light.planes[chosen, ISOVALUE] = np.nan_to_num(isovalues)
    light.planes[chosen, SAMPLES] = np.where(void, VOID, total)


def add_to_mean(mean: np.ndarray, samples: int, added: np.ndarray, total: int) -> np.ndarray:
    """The mean over ``total`` samples of an old mean over ``samples`` and the sum of the new ones, float64."""
    return (mean.astype(np.float64) * samples + added) / total
