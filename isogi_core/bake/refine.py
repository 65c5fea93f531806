"""Refinement: more samples for texels that need them, added to what is there.

Sample counts climb one ladder (16, 32, 64, …) and all that is kept is rounded to what the store keeps after
each rung, so that a texel with n samples has the same bits whoever sent them, in how many goes. Which part of
a texel climbs next follows from what is kept of it alone.
"""

from collections.abc import Iterator

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.look import Look
from isogi_core.bake.noise import blend_noise, finished, next_part, noise_of_halves
from isogi_core.bake.precision import VOID, next_rung, noise_codes, noise_of, round_light
from isogi_core.bake.recipe import Recipe
from isogi_core.kernels.bricks import Bricks
from isogi_core.kernels.irradiance import bake_irradiance
from isogi_core.kernels.transfer import bake_texels, locate_texels
from isogi_core.model.plan import Layer

GROUPS = 32
"""Groups of isovalues over the volume's range; one map of its cells serves the texels of one group."""

NOISE_ORDER = 2
"""The least order that paths are projected to, for what it tells of the noise."""

Place = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Texels (m, 3; z, y, x) int32, their points and normals (3, m) and isovalues (m,): see ``locate_texels``."""


def refine(light: Light, texels: np.ndarray, look: Look, until: int, target: float) -> None:
    """Bring ``light`` of the ``texels`` (m, 3; z, y, x) up to ``until`` samples each, in place.

    A texel that has reached the relative error ``target`` is left as it is; one whose next part
    to climb has ``until`` samples waits.
    """
    while True:
        waiting = next_samples(light, look, target)
        climbing = (waiting >= 0) & (waiting < until)
        if not climbing.any():
            return
        fewest = int(waiting[climbing].min())
        rows = np.flatnonzero(climbing & (waiting == fewest))
        which = next_part(light.rows(rows), look, target)
        for number, part in enumerate(light.parts):
            if (which == number).any():
                climb(part, rows[which == number], texels, look)


def next_samples(light: Light, look: Look, target: float) -> np.ndarray:
    """Samples of the part of each texel that climbs next; -1 where the texel is finished; (texels,) int."""
    samples = np.array([part.samples for part in light.parts])
    own = np.take_along_axis(samples, next_part(light, look, target)[None], axis=0)[0]
    return np.where(finished(light, look, target), -1, own)


def climb(part: Part, rows: np.ndarray, texels: np.ndarray, look: Look) -> None:
    """Take ``rows`` of a part, all with as many samples, to the next rung."""
    samples = int(part.samples[rows[0]])
    total = next_rung(samples)
    place, void = locate(texels[rows], look.recipe)
    halves = sample(part.layer, place, void, look, samples, total - samples)
    added = halves.sum(axis=1)[:, :, : part.layer.order**2]
    noise = noise_of_halves(halves, total - samples, part.layer.order)
    noise = blend_noise(part.noise[rows], samples, noise)
    part.coefficients[rows] = round_light(add_to_mean(part.coefficients[rows], samples, added, total), part.layer)
    part.noise[rows] = noise_of(noise_codes(noise, part.layer.scale), part.layer.scale)
    part.samples[rows] = np.where(void, VOID, total)


def locate(texels: np.ndarray, recipe: Recipe) -> tuple[Place, np.ndarray]:
    """Where texels lie, and which of them are void (m,)."""
    m = len(texels)
    void = np.empty(m, np.bool_)
    place = (np.ascontiguousarray(texels, np.int32), np.empty((3, m)), np.empty((3, m)), np.empty(m))
    locate_texels(recipe.field, recipe.step, *place, void)
    return place, void


def sample(layer: Layer, place: Place, void: np.ndarray, look: Look, samples: int, count: int) -> np.ndarray:
    """Sums over ``count`` further samples, half of them each; (m, 2, channels, N²) float64, N² >= n²."""
    light = sample_irradiance if layer.kind == "irradiance" else sample_transfer
    return light(layer, place, void, look, (samples // 2, count // 2))


def sample_transfer(layer: Layer, place: Place, void: np.ndarray, look: Look, paths: tuple[int, int]) -> np.ndarray:
    """``sample`` by harmonics of the ways that paths leave; ``paths`` are the first of each half, and how many."""
    order, shares = max(layer.order, NOISE_ORDER), look.shares(layer)
    sums = np.zeros((len(void), 2, layer.channels, order**2))
    for bricks, rows in by_isovalue(place[3], void, look.recipe):
        bake_texels(look.recipe.field, bricks, place, rows, *paths, shares, look.plan.survival, order, sums)
    return sums


def sample_irradiance(layer: Layer, place: Place, void: np.ndarray, look: Look, paths: tuple[int, int]) -> np.ndarray:
    """``sample`` of the light that paths meet; where one channel is kept, all three are alike."""
    sums, surroundings = np.zeros((len(void), 2, 3)), look.recipe.surroundings(np.eye(3))
    weights = np.broadcast_to(look.weights(layer), (look.plan.bounces + 1, 3)).copy()
    for bricks, rows in by_isovalue(place[3], void, look.recipe):
        bake_irradiance(look.recipe.field, bricks, place, rows, *paths, weights, look.plan.survival, surroundings, sums)
    return sums[:, :, : layer.channels, None]


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
