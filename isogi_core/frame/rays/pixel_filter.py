"""Filter light that is traced for single pixels, and correct the light of texels by it, so that no
border shows between pixels of either kind.

A pixel of few paths takes over light from pixels around it on the same surface. The filter is that
of texels (``kernels.shading.filtering``), among pixels: two passes over 3 × 3 pixels, the second at
twice the distance (Dammertz and others 2010). Each pass keeps as much of a pixel's difference from
the mean as is more than noise (Lee 1980).

The light that paths bring to pixels differs from the light of texels by the error of the texels,
which is smooth, and by noise. The mean of the differences corrects the light of texels, at these
pixels and around them, where the correction fades out. Of each pixel's traced light, the part is
kept that differs from the corrected light by more than noise.

The error of the mixture is Stein's unbiased estimate of risk (Stein, Annals of Statistics 9, 1981).
Besides measured differences it needs the derivative of each value by its noise, which probes show
(Ramani, Blu and Unser, IEEE Transactions on Image Processing 17, 2008). Probes are contrasts of the
replicas: they have the distribution of the noise of the mean, and are independent of it.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.surface_points import SurfacePoints, mean_around
from isogi_core.model.environment import LUMINANCE_WEIGHTS

FILTER_PASSES = ((1, 1.0), (2, 1.8))
"""For each pass, the distance in pixels between those that it mixes; and by how much the
variance of their mean is larger than that of independent ones. Pixels of the second pass share
light from the first (1.8 times, on even light).
"""


FULL_COVERAGE = 0.4
"""Share of the weight of the pixels around one that must have traced light to correct it
wholly: less than at a straight border.
"""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The neighbours of each point of a ``gbuffer`` in the picture, as far as they show the
    same surface.
    """

    gbuffer: GBuffer
    tiles: Tiles

    @cached_property
    def shown(self) -> tuple[np.ndarray, SurfacePoints]:
        """The number of the point in each pixel, and the points in world units. Raises
        Cancelled.
        """
        shown = self.gbuffer.shown(self.tiles)
        spacing = np.array(self.gbuffer.spacing, np.float32)
        return self.gbuffer.rows, shown._replace(points=shown.points * spacing)

    @property
    def voxel(self) -> float:
        """The width of a voxel in the picture, in pixels: the median over neighbouring pixels
        that show the surface.
        """
        neighbours = np.flatnonzero(np.diff(self.gbuffer.pixels.astype(np.int64)) == 1)
        if not len(neighbours):
            return 1.0
        steps = np.diff(self.gbuffer.points.astype(np.float64), axis=0)[neighbours]
        return 1.0 / max(float(np.median(np.linalg.norm(steps, axis=1))), 1e-3)

    def means(
        self, values: np.ndarray, variance: np.ndarray, step: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean of ``values`` (m, n) around each point, over 3 × 3 pixels at a
        distance of ``step``; and the variance (m,) of the mean of independent values of the
        ``variance`` (m,). Raises Cancelled.
        """
        shown = self.shown
        means = np.empty_like(values)
        left = np.empty(len(values))

        def _piece(a: int, b: int) -> None:
            mean_around(*shown, step, a, values, variance, means[a:b], left[a:b])

        self.tiles.run(_piece, len(values), self.tiles.even(len(values)))
        return means, left


def filter_pixels(
    light: np.ndarray, variance: np.ndarray, gbuffer: GBuffer, tiles: Tiles
) -> tuple[np.ndarray, np.ndarray]:
    """Filter the linear RGB of the points of a G-buffer; return it, and the variance (m,) that its
    luminance has then.

    Further columns of ``light`` (m, 3 or more) are mixed with the same weights. Raises Cancelled.
    """
    around = Surroundings(gbuffer, tiles)
    # Each pass takes the mean light, noise and squared luminance around each pixel, and keeps the
    # share of the difference that noise does not explain.
    for step, shared in FILTER_PASSES:
        shown = light[:, :3] @ LUMINANCE_WEIGHTS
        means, taken = around.means(np.column_stack([light, variance, shown**2]), variance, step)
        mean = means[:, :-2]
        noise = means[:, -2]
        # The mean square less the square of the mean is the spread of the pixels around.
        spread = means[:, -1] - (mean[:, :3] @ LUMINANCE_WEIGHTS) ** 2
        kept = beyond_noise(spread, noise)
        # Wiener's filter leaves the share ``kept`` of the noise as an error; the mean brings its
        # variance. A filtered pixel is never taken to be noisier than before.
        light = mean + kept[:, None] * (light - mean)
        variance = np.minimum(kept * noise + (1.0 - kept) ** 2 * shared * taken, variance)
    return light, variance


def beyond_noise(apart: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return the share of each of k differences, whose square is ``apart``, that exceeds noise
    of the variance ``noise``: Wiener's filter.
    """
    signal = np.maximum(apart - noise, 0.0)
    return np.asarray(signal / np.maximum(signal + noise, 1e-300))


class NoisyPixels(NamedTuple):
    """Light traced for k pixels: ``light`` (k, 3) linear RGB, the ``variance`` (k,) of its
    luminance, and ``probes`` (k, n), luminances with the distribution of its noise and
    independent of it.
    """

    light: np.ndarray
    variance: np.ndarray
    probes: np.ndarray


def correct(
    light: np.ndarray,
    expected: np.ndarray,
    places: np.ndarray,
    own: NoisyPixels,
    gbuffer: GBuffer,
    tiles: Tiles,
    shares: np.ndarray | float = 1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Correct the texels' ``light`` (m, 3) of a picture by the ``own`` light that paths brought to
    the points in rows ``places`` (k,); return the light, and the mean squared error (k,) of these
    points' luminance.

    ``expected`` (m,) is the error that is expected of the texels' light at each point: differences
    are spread in proportion to it, so that light changes little where little error is expected. For
    the error see ``blended_error``; it is at least the expected error where a pixel is hardly
    corrected. ``shares`` (k,) of the traced light are shown. Raises Cancelled.
    """
    # Spread the differences over the width of a voxel, as far as the error of a texel reaches; the
    # probes go along, and show how much noise the correction takes over.
    around = Surroundings(gbuffer, tiles)
    scale = np.maximum(expected, 1e-3 * expected.mean() + 1e-30)[:, None]
    found = np.column_stack([own.light - light[places], own.probes]) / scale[places]
    known = np.zeros((len(light), found.shape[1] + 1))
    known[places] = np.column_stack([found, np.ones(len(places))])
    none = np.zeros(len(light))
    # Doubling the distance in each pass reaches a voxel in few passes.
    for level in range(max(math.ceil(math.log2(around.voxel)), 0) + 1):
        known, _ = around.means(known, none, 1 << level)
    # The correction fades out smoothly with the share of neighbours that have traced light.
    share = np.minimum(known[:, -1:] / FULL_COVERAGE, 1.0)
    ramp = share**2 * (3.0 - 2.0 * share)
    spread = ramp * scale / np.maximum(known[:, -1:], 1e-300)
    light = light + spread * known[:, :3]
    carried = (spread * known[:, 3:-1])[places]

    # Keep the part of the traced light that differs from the corrected light by more than noise.
    apart = own.light - light[places]
    near = Surroundings(gbuffer.part(places, tiles), tiles)
    kept, square = blended_error(own, apart @ LUMINANCE_WEIGHTS, carried, near, shares)
    light[places] += kept[:, None] * apart
    left = ((1.0 - ramp) * scale)[places, 0]
    return light, np.maximum(square, ((1.0 - kept) * left) ** 2)


def blended_error(
    own: NoisyPixels,
    apart: np.ndarray,
    carried: np.ndarray,
    near: Surroundings,
    shares: np.ndarray | float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of the ``own`` light of pixels that is kept on top of corrected light, and
    the mean squared error of the sum, (k,) each.

    The corrected light is C. The light O of a pixel has the variance V and is ``apart`` (k,) from C
    by x. The share is κ = s (1 - V / M), at least 0, where M is the mean of x² over pixels
    ``near`` and s the pixel's one of ``shares``. The shown light C + κ x then has the mean squared
    error

        (1 - κ)² M + (2 κ - 1) V + 2 (1 - κ) cov(O, C) + 4 s V / M² · mean(x n)²,

    without the last term if κ is 0. The first two terms are the error of O where it is kept, or the
    error of texels beyond noise where it is not; the third is noise that C took over from the same
    paths; the fourth is the noise of κ, which depends on x. Probes show the last two: each adds p
    to O and p' to C, ``carried`` (k, n), so cov(O, C) is the mean of p p', and n is p - p'.

    The estimate for one pixel is rough, so it is averaged over pixels near, and is at least the
    noise that is left, κ² V + 2 κ (1 - κ) cov(O, C) + (1 - κ)² var(C).

    Assumed: the noise of paths is normal, and independent between pixels and of the texels' light.
    Noise that filter or correction share between pixels is in the probes. Noise of texels is part
    of x.
    """
    # Average all that the formula needs over the pixels near: V, cov(O, C), var(C), x n for each
    # probe, and x².
    noise = own.probes - carried
    covariance = (own.probes * carried).mean(axis=1)
    left = (carried**2).mean(axis=1)
    values = [own.variance, covariance, left, apart[:, None] * noise, apart**2]
    means, _ = near.means(np.column_stack(values), own.variance)
    variance, covariance, left = means[:, :3].T
    square = means[:, -1]
    kept = beyond_noise(square, variance)
    # Noise of the share itself: V / M² · mean(x n)².
    floor = np.maximum(square, 1e-300)
    noise_of_share = (means[:, 3:-1] ** 2).mean(axis=1) / floor * (variance / floor)
    # The unbiased estimate of each pixel's error, averaged over pixels near.
    noise_of_share = np.where(kept > 0.0, shares * noise_of_share, 0.0)
    kept = shares * kept
    risk = (1.0 - kept) ** 2 * square + (2.0 * kept - 1.0) * variance
    risk += 2.0 * (1.0 - kept) * covariance + 4.0 * noise_of_share
    risk = risk[:, None]
    for step, _ in FILTER_PASSES:
        risk, _ = near.means(risk, own.variance, step)
    # It cannot be below the noise that the mixture keeps.
    least = kept**2 * variance + (1.0 - kept) * (
        2.0 * kept * np.maximum(covariance, 0.0) + (1.0 - kept) * left
    )
    return kept, np.maximum(risk[:, 0], least)
