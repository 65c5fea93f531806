"""Refinement: more samples for texels that need them, added to what is there.

Sample counts climb one ladder (16, 32, 64, …) and all that is kept is rounded to what the store keeps after
each rung, so that a texel with n samples has the same bits whoever sent them, in how many goes. Which parts of
a texel climb next follows from what is kept of it alone.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.look import Look
from isogi_core.bake.noise import DECAYS, blend_noise, evenness, finished, noise_of_halves
from isogi_core.bake.precision import VOID, next_rung, noise_codes, noise_of, round_light
from isogi_core.bake.recipe import Recipe
from isogi_core.kernels.bricks import Bricks
from isogi_core.kernels.irradiance import bake_irradiance
from isogi_core.kernels.moves import MOVED, move_texels
from isogi_core.kernels.transfer import bake_texels, locate_texels
from isogi_core.model.plan import Layer, most_samples

NOISE_ORDER = 2
"""The least order that paths are projected to, for what it tells of the noise."""

Place = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Texels (m, 3; z, y, x) int32, their points and normals (3, m) and isovalues (m,): see ``locate_texels``."""


def refine(light: Light, texels: np.ndarray, look: Look, until: int, target: float) -> None:
    """Bring ``light`` of the ``texels`` (m, 3; z, y, x) up to ``until`` samples each, in place.

    A texel that has reached the relative error ``target``, and whose parts are level, is left as it is. Of the others
    those parts climb that have the fewest samples: parts on one rung do so together, since the same paths serve them.
    """
    while True:
        waiting = next_samples(light, look, target)
        climbing = (waiting >= 0) & (waiting < until)
        if not climbing.any():
            return
        rows = np.flatnonzero(climbing & (waiting == waiting[climbing].min()))
        level = np.array([part.samples[rows] == waiting[rows] for part in light.parts])
        for pattern in np.unique(level, axis=1).T:
            parts = tuple(part for part, climbs in zip(light.parts, pattern, strict=True) if climbs)
            climb(parts, rows[(level == pattern[:, None]).all(axis=0)], texels, look)


def next_samples(light: Light, look: Look, target: float) -> np.ndarray:
    """Samples of the parts of each texel that climb next; -1 where the texel is finished and none lags; (texels,) int.

    A part that was lost, or not written before a kill, catches up with the others, and so has the samples it had.
    That costs all of its paths once more, which are of no use to the parts that did not lag.
    """
    most = np.max([part.samples for part in light.parts], axis=0)
    lags = ~light.void & (light.samples < np.minimum(most, most_samples(target)))
    return np.where(finished(light, look, target) & ~lags, -1, light.samples)


def climb(parts: Sequence[Part], rows: np.ndarray, texels: np.ndarray, look: Look) -> None:
    """Take ``rows`` of some parts, all with as many samples, to the next rung."""
    samples = int(parts[0].samples[rows[0]])
    total = next_rung(samples)
    place, void = locate(texels[rows], look.recipe, look.shown)
    sample = sample_irradiance if parts[0].layer.kind == "irradiance" else sample_transfer
    layers = [part.layer for part in parts]
    sampled = sample(layers, place, void, look, samples, total - samples)
    for part, (halves, second) in zip(parts, sampled, strict=True):
        add(part, rows, halves, second, total, look)
        part.samples[rows] = np.where(void, VOID, total)


def add(part: Part, rows: np.ndarray, halves: np.ndarray, second: np.ndarray, total: int, look: Look) -> None:
    """Add sums over new samples (m, 2, channels, N²; N² >= n²) to ``rows``, which then have ``total`` samples.

    ``second`` (m,) are those of the squares, see ``evenness``.
    """
    layer, samples = part.layer, int(part.samples[rows[0]])
    added = halves.sum(axis=1)[:, :, : layer.order**2]
    noise = noise_of_new(halves, second, total - samples, layer, look)
    noise = blend_noise(part.noise[rows], samples, noise, DECAYS[layer.kind])
    part.coefficients[rows] = round_light(add_to_mean(part.coefficients[rows], samples, added, total), layer)
    part.noise[rows] = noise_of(noise_codes(noise, layer.scale), layer.scale)


def noise_of_new(halves: np.ndarray, second: np.ndarray, count: int, layer: Layer, look: Look) -> np.ndarray:
    """What ``count`` new samples of a layer tell of its noise, by their sums; see ``noise_of_halves``."""
    seen = look.judged(halves, layer)
    if layer.order > 1 or layer.kind == "irradiance":
        return noise_of_halves(seen, count, layer.order)
    even = evenness(seen.sum(axis=1) / count, second / count, count)
    return noise_of_halves(seen, count, layer.order, even)


def locate(texels: np.ndarray, recipe: Recipe, shown: float | None = None) -> tuple[Place, np.ndarray]:
    """Where texels are lit, and which of them are void (m,).

    On the isosurfaces through their own points, or moved onto the one that is ``shown``, a normalised isovalue: void
    are then those that cannot be moved, see ``move_texels``.
    """
    m = len(texels)
    void = np.empty(m, np.bool_)
    place = (np.ascontiguousarray(texels, np.int32), np.empty((3, m)), np.empty((3, m)), np.empty(m))
    if shown is None:
        locate_texels(recipe.field, recipe.step, *place, void)
        return place, void
    verdicts = np.empty(m, np.uint8)
    move_texels(recipe.field, recipe.step, shown, *place[:3], verdicts)
    place[3][:] = shown
    return place, verdicts != MOVED


def sample_transfer(
    layers: Sequence[Layer], place: Place, void: np.ndarray, look: Look, samples: int, count: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Sums over ``count`` samples after the first ``samples``, of the same paths for all ``layers``.

    Harmonics of the ways that paths leave: for each layer, and each half of them, (m, 2, channels, N²) float64; and
    band 0 of the squares of what paths bring, of both halves, (m,).
    """
    shares = np.vstack([look.shares(layers), look.squares(layers)])
    orders = np.repeat([max(layer.order, NOISE_ORDER) for layer in layers], [layer.channels for layer in layers])
    orders = np.append(orders, np.ones(len(layers), np.int64))
    sums = np.zeros((len(void), 2, len(orders), int(orders.max()) ** 2))
    for bricks, rows in by_isovalue(place[3], void, look.recipe):
        paths = (samples // 2, count // 2, shares, look.plan.survival, orders)
        bake_texels(look.recipe.field, bricks, place, rows, *paths, sums)
    first = 0
    for number, layer in enumerate(layers):
        halves = sums[:, :, first : first + layer.channels, : max(layer.order, NOISE_ORDER) ** 2]
        yield halves, sums[:, :, number - len(layers), 0].sum(axis=1)
        first += layer.channels


def sample_irradiance(
    layers: Sequence[Layer], place: Place, void: np.ndarray, look: Look, samples: int, count: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The same of the light that paths meet, and no squares; where a layer keeps one channel, all three are alike."""
    sums, surroundings = np.zeros((len(void), 2, 3)), look.recipe.surroundings(np.eye(3))
    weights = np.broadcast_to(look.weights(layers[0]), (look.plan.bounces + 1, 3)).copy()
    for bricks, rows in by_isovalue(place[3], void, look.recipe):
        paths = (samples // 2, count // 2, weights, look.plan.survival, surroundings)
        bake_irradiance(look.recipe.field, bricks, place, rows, *paths, sums)
    for layer in layers:
        yield sums[:, :, : layer.channels, None], np.zeros(len(void))


def by_isovalue(isovalues: np.ndarray, void: np.ndarray, recipe: Recipe) -> Iterator[tuple[Bricks, np.ndarray]]:
    """The rows that are not void in groups of near isovalues, each with the map of its isosurfaces."""
    lit = np.flatnonzero(~void)
    groups, ends = recipe.maps.groups(isovalues[lit])
    for group in np.unique(groups):
        yield recipe.bricks(float(ends[group]), float(ends[group + 1])), lit[groups == group]


def add_to_mean(mean: np.ndarray, samples: int, added: np.ndarray, total: int) -> np.ndarray:
    """The mean over ``total`` samples of an old mean over ``samples`` and the sum of the new ones, float64."""
    return (mean.astype(np.float64) * samples + added) / total
