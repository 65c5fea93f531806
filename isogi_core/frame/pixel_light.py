"""Pixels with light of their own: paths from each of them, where texels leave a picture too far from the truth."""

import math
from dataclasses import dataclass

import numpy as np

from isogi_core.frame.control_pixels import ControlPixels, bounces_of_truth
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.pixel_rays import Paths, variance_of_mean
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.shading.lattice import DARKEST
from isogi_core.model.sky import LUMINANCE

STREAM = 1 << 18
"""Number of the first randomisation: controls and references draw other random numbers."""

REPLICAS, FIRST = 4, 16
"""Independent randomisations of each pixel, and paths of each after the first step."""

MOST_PATHS = 1 << 14
"""Paths of each replica, at most: 65,536 from a pixel."""

REST, NOISE = 0.7, 0.5
"""Shares of the target error that remain: of pixels with light of texels, and of the noise of those with their own."""

BINS = 8
"""Classes of pixels by how uncertain they are; each is judged by its control pixels."""


@dataclass(frozen=True, eq=False)
class PixelLight:
    """Surface points with light of their own: their rows ``places`` (k,), ascending, and the ``sums`` of their paths.

    Sums (k, REPLICAS, 3) are of ``count`` paths of each replica.
    """

    places: np.ndarray
    sums: np.ndarray
    count: int

    @classmethod
    def none(cls) -> "PixelLight":
        """No pixel has light of its own."""
        return cls(np.empty(0, np.int64), np.empty((0, REPLICAS, 3)), 0)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.places.nbytes + self.sums.nbytes

    @property
    def means(self) -> np.ndarray:
        """Linear RGB by each replica; (k, REPLICAS, 3)."""
        return np.asarray(self.sums / max(self.count, 1))

    @property
    def variance(self) -> np.ndarray:
        """Variance of each point's luminance; (k,) float64."""
        return variance_of_mean(self.means)

    def grown(
        self, places: np.ndarray, count: int, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles
    ) -> "PixelLight":
        """The same of more points, or after more paths: those known are not traced again. Raises Cancelled."""
        paths = Paths(light, gbuffer.part(places, tiles), tiles, bounces_of_truth(light))
        sums = np.zeros((len(places), REPLICAS, 3))
        known = np.isin(places, self.places, assume_unique=True)
        sums[known] = self.sums[np.isin(self.places, places, assume_unique=True)]
        for rows, first in ((np.flatnonzero(known), self.count), (np.flatnonzero(~known), 0)):
            if len(rows) and first < count:
                some = sums[rows]
                paths.of(rows).add(some, STREAM, first, count - first)
                sums[rows] = some
        return PixelLight(places, sums, count)

    def put(self, framebuffer: Framebuffer, pixels: np.ndarray, unit: float) -> None:
        """Write it into a picture whose surface points show in ``pixels`` (m,), as final light."""
        own, light = pixels[self.places], self.means.mean(axis=1)
        error = np.sqrt(self.variance) / np.maximum(light @ LUMINANCE, DARKEST * unit)
        framebuffer.radiance[own] = np.minimum(light, np.finfo(np.float32).max)
        framebuffer.state[own] = FINAL
        framebuffer.error[own] = np.clip(error, 0.0, 1.0)


def choose_places(uncertainty: np.ndarray, controls: ControlPixels, shown: np.ndarray, allowed: float) -> np.ndarray:
    """The points that are to have light of their own, so that the others' mean squared error is within ``allowed``.

    Points are classed by ``uncertainty`` (m,), as many controls in each class; what a class errs by is told by its
    controls, whose luminance is ``shown`` (k,). Classes that err most come first. Ascending rows, (≤ m,) int64.
    """
    edges = np.quantile(uncertainty[controls.places], np.arange(1, BINS) / BINS)
    classes = np.searchsorted(edges, uncertainty)
    weights, known = controls.weights, classes[controls.places]
    sums = np.bincount(known, weights * controls.squares(shown), BINS)
    errors = np.maximum(sums / np.maximum(np.bincount(known, weights, BINS), 1e-9), 0.0)
    counts, worst = np.bincount(classes, minlength=BINS), np.argsort(-errors, kind="stable")
    rest = np.cumsum((errors * counts)[worst][::-1])[::-1]
    return np.flatnonzero(np.isin(classes, worst[rest > allowed * len(uncertainty)]))


def enough(light: PixelLight, mean: float, target: float, points: int) -> bool:
    """Whether the noise of such pixels is within its share of a ``target`` error of a picture of so many points."""
    return math.sqrt(light.variance.sum() / max(points, 1)) <= NOISE * target * mean
