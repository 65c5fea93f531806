"""Control pixels: some pixels of a picture that paths of their own light too, and that so tell its whole error.

A control pixel has two independent halves of paths, a and b, beside the light s that the picture shows. As both halves
are right on the average and independent of each other, (s - a)(s - b) is right on the average for the squared error of
s, whatever its causes: noise, interpolation, harmonics, light that leaks, bounces that are cut off.
"""

import math
from dataclasses import dataclass

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.pixel_rays import Paths
from isogi_core.frame.tiles import Tiles
from isogi_core.model.sky import LUMINANCE
from isogi_core.plan.budget import BOUNCES, bounces_for

STREAM = 1 << 17
"""Number of the first half's randomisation: frames and references draw other random numbers."""

CUT = 0.001
"""Share of the light that bounces beyond those of control paths may bring, where the plan chose the bounces."""

FIRST, MOST = 256, 1024
"""Pixels of the first round of controls, and of all rounds together; each further round doubles what there is."""

EVEN = 0.5
"""Share of the controls that is drawn evenly from the picture; the others where it is uncertain."""

FEWEST_PATHS, MOST_PATHS = 16, 512
"""Paths of each half, at least and at most."""


@dataclass(frozen=True, eq=False)
class ControlPixels:
    """Points of a view that were drawn at random, and what paths from each brought.

    ``places`` (k,) int64 are rows of the G-buffer's points, ``weights`` (k,) over k what each counts in a mean over all
    points, and ``halves`` (k, 2) float64 the luminance by either half.
    """

    places: np.ndarray
    weights: np.ndarray
    halves: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that they take."""
        return self.places.nbytes + self.weights.nbytes + self.halves.nbytes

    @classmethod
    def none(cls) -> "ControlPixels":
        """No controls."""
        return cls(np.empty(0, np.int64), np.empty(0), np.empty((0, 2)))

    def joined(self, other: "ControlPixels") -> "ControlPixels":
        """These and others of the same picture."""
        places, weights = np.append(self.places, other.places), np.append(self.weights, other.weights)
        return ControlPixels(places, weights, np.concatenate([self.halves, other.halves]))

    def mean(self, shown: np.ndarray, mean: float) -> float:
        """The true mean luminance of all points, at least 0: the picture's ``mean`` less what controls find too much.

        The picture shows the luminance ``shown`` (k,) at the controls.
        """
        return max(mean - float((self.weights * (shown - self.halves.mean(axis=1))).mean()), 0.0)

    def squares(self, shown: np.ndarray) -> np.ndarray:
        """The squared error of each control's luminance, ``shown`` (k,), right on the average; (k,)."""
        wrong = shown[:, None] - self.halves
        return np.asarray(wrong[:, 0] * wrong[:, 1])


def draw_places(gbuffer: GBuffer, uncertainty: np.ndarray, key: tuple[int, int], count: int) -> np.ndarray:
    """Rows of ``count`` points, drawn in strata along a curve that fills the picture, more where it is uncertain.

    Half of them are drawn evenly, the others by the ``uncertainty`` (m,) of each point; random numbers follow from the
    ``key``. Returns rows (count,) int64.
    """
    order = np.argsort(interleaved(gbuffer.pixels % gbuffer.shape[1], gbuffer.pixels // gbuffer.shape[1]))
    reached = np.cumsum(chances(uncertainty)[order])
    strata = (np.arange(count) + np.random.default_rng((STREAM, *key)).random(count)) / count
    return np.asarray(order[np.minimum(np.searchsorted(reached, strata * reached[-1]), len(order) - 1)])


def chances(uncertainty: np.ndarray) -> np.ndarray:
    """The chance of each point (m,) to be drawn."""
    total = float(uncertainty.sum())
    uneven = uncertainty / total if total > 0.0 else np.full(len(uncertainty), 1.0 / len(uncertainty))
    return np.asarray(EVEN / len(uncertainty) + (1.0 - EVEN) * uneven)


def interleaved(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Numbers along Morton's curve of pixels (m,) uint32; (m,) uint64."""
    spread = [spread_bits(each.astype(np.uint64)) for each in (x, y)]
    return np.asarray(spread[0] | spread[1] << np.uint64(1))


def spread_bits(words: np.ndarray) -> np.ndarray:
    """The low 16 bits of words with a zero after each."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        words = (words | words << np.uint64(shift)) & np.uint64(mask)
    return words


def paths_for(target: float) -> int:
    """Paths of each half for pictures of a ``target`` error: a power of two, whose noise is about the target."""
    return int(np.clip(2 ** math.ceil(math.log2(8.0 / target)), FEWEST_PATHS, MOST_PATHS))


def trace_controls(
    light: RotatedLight, gbuffer: GBuffer, places: np.ndarray, paths: int, stream: int, tiles: Tiles
) -> np.ndarray:
    """The luminance of points at ``places`` (k,) by two halves of so many ``paths`` each; (k, 2). Raises Cancelled.

    Halves of another ``stream`` draw random numbers of their own.
    """
    distinct, each = np.unique(places, return_inverse=True)
    sums = np.zeros((len(distinct), 2, 3))
    paths_from = Paths(light, gbuffer.part(distinct, tiles), tiles, bounces_of_truth(light))
    paths_from.add(sums, STREAM + 2 * stream, 0, paths)
    return np.asarray((sums @ LUMINANCE / paths)[each])


def bounces_of_truth(light: RotatedLight) -> int:
    """Bounces of paths that nothing of worth is cut off from; the scene's own where somebody gave them."""
    plan, (red, green, blue) = light.spec.prepared.scene.plan, light.albedo.tolist()
    chosen = "bounces" in dict(plan.errors)
    return max(bounces_for((red, green, blue), CUT / BOUNCES), plan.bounces) if chosen else plan.bounces
