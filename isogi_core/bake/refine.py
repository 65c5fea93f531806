"""Refinement: more samples for texels that need them, added to what is there.

Sample counts climb one ladder (16, 32, 64, …) and the means are rounded to what the store keeps
after each rung, so that a texel with n samples has the same bits whoever sent them, in how many goes.
"""

from collections.abc import Iterator

import numpy as np

from isogi_core.bake.light import ERROR, ISOVALUE, SAMPLES, VOID, Light
from isogi_core.bake.noise import finished
from isogi_core.bake.recipe import Recipe
from isogi_core.kernels.bricks import Bricks
from isogi_core.kernels.transfer import bake_texels, locate_texels

FIRST_RUNG = 16

GROUPS = 32
"""Groups of isovalues over the volume's range; one map of its cells serves the texels of one group."""


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
    place = (np.ascontiguousarray(texels[chosen], np.int32), np.empty((3, m)), np.empty((3, m)), isovalues)
    locate_texels(recipe.field, recipe.step, *place, void)
    path = (samples // 2, (total - samples) // 2, recipe.weights, order)
    for bricks, rows in by_isovalue(isovalues, void, recipe):
        bake_texels(recipe.field, bricks, place, rows, *path, direct, indirect)
    whole = direct[:, :, None, :] + indirect
    light.direct[chosen] = add_to_mean(light.direct[chosen], samples, direct.sum(axis=1), total)
    light.indirect[chosen] = add_to_mean(light.indirect[chosen], samples, indirect.sum(axis=1), total)
    light.spread[chosen] = add_to_mean(light.spread[chosen], samples, whole[:, 0] - whole[:, 1], total)
    light.planes[chosen, ERROR] = np.sqrt((light.spread[chosen].astype(np.float64) ** 2).sum(axis=(1, 2)))
    light.planes[chosen, ISOVALUE] = np.nan_to_num(isovalues)
    light.planes[chosen, SAMPLES] = np.where(void, VOID, total)


def by_isovalue(isovalues: np.ndarray, void: np.ndarray, recipe: Recipe) -> Iterator[tuple[Bricks, np.ndarray]]:
    """The rows that are not void in groups of near isovalues, each with the map of its isosurfaces."""
    groups = np.floor(np.where(void, -1.0, isovalues) * GROUPS).astype(np.int64)
    order = np.argsort(groups, kind="stable")
    order = order[~void[order]]
    for rows in np.split(order, np.flatnonzero(np.diff(groups[order])) + 1):
        if len(rows):
            lowest = float(groups[rows[0]]) / GROUPS
            yield recipe.bricks(lowest, lowest + 1.0 / GROUPS), rows


def add_to_mean(mean: np.ndarray, samples: int, added: np.ndarray, total: int) -> np.ndarray:
    """The mean over ``total`` samples of an old mean over ``samples`` and the sum of the new ones, float64."""
    return (mean.astype(np.float64) * samples + added) / total
