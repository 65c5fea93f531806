"""Filtering of pixels' own light, and of what it corrects in texels' light: no border shows where one meets the other.

A pixel of few paths takes over what pixels around it on the surface agree on. The filter is that of texels
(``kernels.shading.filtering``) among pixels: two passes over 3 × 3 pixels, the second at twice the distance (Dammertz
and others 2010), and as much of a pixel's own light as pixels around it differ by more than their noise (Lee 1980).

Pixels' own light differs from the light of texels by their error, which is smooth, and by noise. The mean difference
over pixels around corrects the light of texels, there and beside, where it fades out. Of own light as much is kept as
differs from the corrected light by more than noise.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.same_surface import ShownPoints, mean_around
from isogi_core.model.sky import LUMINANCE_WEIGHTS

FILTER_PASSES = ((1, 1.0), (2, 1.8))
"""Distances, in pixels, between those that a pass mixes; and how much more variance their mean has than that of
independent ones: those of the second pass took over from the same pixels (1.8 times, on even light).
"""

FULL_COVERAGE = 0.4
"""The share of pixels around one, by what they count, that corrects it wholly: less than at a straight border."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Pixels around each point of a ``gbuffer``, as far as they show the same surface; on threads of ``tiles``."""

    gbuffer: GBuffer
    tiles: Tiles

    @cached_property
    def shown(self) -> ShownPoints:
        """The surface points, as the kernel takes them. Raises Cancelled."""
        buffer = self.gbuffer
        points = buffer.points * np.array(buffer.spacing, np.float32)
        return ShownPoints(buffer.rows, buffer.pixels, points, buffer.normals(self.tiles))

    @property
    def voxel(self) -> float:
        """Width of a voxel in the picture, in pixels: the median over pixels beside others that show the surface."""
        beside = np.flatnonzero(np.diff(self.gbuffer.pixels.astype(np.int64)) == 1)
        if not len(beside):
            return 1.0
        ways = np.diff(self.gbuffer.points.astype(np.float64), axis=0)[beside]
        return 1.0 / max(float(np.median(np.linalg.norm(ways, axis=1))), 1e-3)

    def means(self, values: np.ndarray, variance: np.ndarray, step: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """The mean of ``values`` (m, n) over 3 × 3 pixels at a distance of ``step``; and its variance, (m,), where that
        of independent values is ``variance`` (m,). Raises Cancelled.
        """
        shown, means, left = self.shown, np.empty_like(values), np.empty(len(values))

        def _piece(a: int, b: int) -> None:
            mean_around(shown, step, a, values, variance, means[a:b], left[a:b])

        self.tiles.run(_piece, len(values), self.tiles.even(len(values)))
        return means, left


def filter_pixels(
    light: np.ndarray, variance: np.ndarray, gbuffer: GBuffer, tiles: Tiles
) -> tuple[np.ndarray, np.ndarray]:
    """Linear RGB (m, 3) of the points of a G-buffer, filtered, and the ``variance`` (m,) that its luminance has then.

    Raises Cancelled.
    """
    around = Surroundings(gbuffer, tiles)
    for step, shared in FILTER_PASSES:
        shown = light @ LUMINANCE_WEIGHTS
        means, taken = around.means(np.column_stack([light, variance, shown**2]), variance, step)
        mean, noise, square = means[:, :3], means[:, 3], means[:, 4]
        kept = beyond_noise(square - (mean @ LUMINANCE_WEIGHTS) ** 2, noise)
        light = mean + kept[:, None] * (light - mean)
        variance = np.minimum(kept * noise + (1.0 - kept) ** 2 * shared * taken, variance)
    return light, variance


def beyond_noise(apart: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """The share of values (k,) to be kept that are so far ``apart``, squared, with so much ``noise``: Wiener's."""
    signal = np.maximum(apart - noise, 0.0)
    return np.asarray(signal / np.maximum(signal + noise, 1e-300))


def correct(
    light: np.ndarray,
    expected: np.ndarray,
    places: np.ndarray,
    own: np.ndarray,
    variance: np.ndarray,
    gbuffer: GBuffer,
    tiles: Tiles,
) -> tuple[np.ndarray, np.ndarray]:
    """The texels' ``light`` (m, 3) of a picture, corrected by the ``own`` light (k, 3) of points in rows ``places``.

    Its luminance has so much ``variance`` (k,); returns what is left of it, too. A texel's error reaches as far as the
    texel, so differences are spread a voxel and more: by the error that is ``expected`` (m,) of each point, so that
    little changes where little is expected. Raises Cancelled.
    """
    around, known = Surroundings(gbuffer, tiles), np.zeros((len(light), 4))
    scale = np.maximum(expected, 1e-3 * expected.mean() + 1e-30)[:, None]
    known[places] = np.column_stack([(own - light[places]) / scale[places], np.ones(len(places))])
    none = np.zeros(len(light))
    for level in range(max(math.ceil(math.log2(around.voxel)), 0) + 1):
        known, _ = around.means(known, none, 1 << level)
    share = np.minimum(known[:, 3:] / FULL_COVERAGE, 1.0)
    light = light + share**2 * (3.0 - 2.0 * share) * scale * known[:, :3] / np.maximum(known[:, 3:], 1e-300)
    apart = own - light[places]
    near = Surroundings(gbuffer.part(places, tiles), tiles)
    means, _ = near.means(np.column_stack([variance, (apart @ LUMINANCE_WEIGHTS) ** 2]), variance)
    kept = beyond_noise(means[:, 1], means[:, 0])
    light[places] += kept[:, None] * apart
    return light, kept * variance
