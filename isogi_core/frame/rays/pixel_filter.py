"""Filter light that is traced for single pixels, and correct the light of texels by it."""

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
"""Distances, in pixels, between those that a pass mixes; and how much more variance their mean has
than that of independent ones: those of the second pass took over from the same pixels (1.8 times,
on even light).
"""


FULL_COVERAGE = 0.4
"""The share of pixels around one, by what they count, that corrects it wholly: less than at a
straight border.
"""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Pixels around each point of a ``gbuffer``, as far as they show the same surface; on threads
    of ``tiles``.
    """

    gbuffer: GBuffer
    tiles: Tiles

    @cached_property
    def shown(self) -> tuple[np.ndarray, SurfacePoints]:
        """The number of the point in each pixel, and the points, in the world here. Raises
        Cancelled.
        """
        shown = self.gbuffer.shown(self.tiles)
        spacing = np.array(self.gbuffer.spacing, np.float32)
        return self.gbuffer.rows, shown._replace(points=shown.points * spacing)

    @property
    def voxel(self) -> float:
        """Width of a voxel in the picture, in pixels: the median over pixels beside others that
        show the surface.
        """
        beside = np.flatnonzero(np.diff(self.gbuffer.pixels.astype(np.int64)) == 1)
        if not len(beside):
            return 1.0
        ways = np.diff(self.gbuffer.points.astype(np.float64), axis=0)[beside]
        return 1.0 / max(float(np.median(np.linalg.norm(ways, axis=1))), 1e-3)

    def means(
        self, values: np.ndarray, variance: np.ndarray, step: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """The mean of ``values`` (m, n) over 3 × 3 pixels at a distance of ``step``; and its
        variance, (m,), where that of independent values is ``variance`` (m,). Raises Cancelled.
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
    """Linear RGB of the points of a G-buffer, filtered, and the ``variance`` (m,) that its
    luminance has then.

    Further columns of ``light`` (m, 3 or more) are mixed as the colours are. Raises Cancelled.
    """
    around = Surroundings(gbuffer, tiles)
    for step, shared in FILTER_PASSES:
        shown = light[:, :3] @ LUMINANCE_WEIGHTS
        means, taken = around.means(np.column_stack([light, variance, shown**2]), variance, step)
        mean = means[:, :-2]
        noise = means[:, -2]
        square = means[:, -1]
        kept = beyond_noise(square - (mean[:, :3] @ LUMINANCE_WEIGHTS) ** 2, noise)
        light = mean + kept[:, None] * (light - mean)
        variance = np.minimum(kept * noise + (1.0 - kept) ** 2 * shared * taken, variance)
    return light, variance


def beyond_noise(apart: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """The share of values (k,) to be kept that are so far ``apart``, squared, with so much
    ``noise``: Wiener's.
    """
    signal = np.maximum(apart - noise, 0.0)
    return np.asarray(signal / np.maximum(signal + noise, 1e-300))


class NoisyPixels(NamedTuple):
    """Light that pixels have of their own: ``light`` (k, 3) linear RGB, the ``variance`` (k,) of
    its luminance, and ``probes`` (k, n): luminances distributed as its noise is, independent of it.
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
) -> tuple[np.ndarray, np.ndarray]:
    """The texels' ``light`` (m, 3) of a picture, corrected by the ``own`` light of points in rows
    ``places`` (k,); and the mean squared error of these points' luminance then, (k,).

    A texel's error reaches as far as the texel, so differences are spread a voxel and more: by the
    error that is ``expected`` (m,) of each point, so that little changes where little is expected.
    See ``blended_error`` for the error; where little corrects a pixel it is what is expected of
    texels. Raises Cancelled.
    """
    # Differences from texels' light are spread over a voxel, and with them what the probes add.
    around = Surroundings(gbuffer, tiles)
    scale = np.maximum(expected, 1e-3 * expected.mean() + 1e-30)[:, None]
    found = np.column_stack([own.light - light[places], own.probes]) / scale[places]
    known = np.zeros((len(light), found.shape[1] + 1))
    known[places] = np.column_stack([found, np.ones(len(places))])
    none = np.zeros(len(light))
    for level in range(max(math.ceil(math.log2(around.voxel)), 0) + 1):
        known, _ = around.means(known, none, 1 << level)
    share = np.minimum(known[:, -1:] / FULL_COVERAGE, 1.0)
    ramp = share**2 * (3.0 - 2.0 * share)
    spread = ramp * scale / np.maximum(known[:, -1:], 1e-300)
    light = light + spread * known[:, :3]
    carried = (spread * known[:, 3:-1])[places]

    # What differs from the corrected light by more than noise stays.
    apart = own.light - light[places]
    near = Surroundings(gbuffer.part(places, tiles), tiles)
    kept, square = blended_error(own, apart @ LUMINANCE_WEIGHTS, carried, near)
    light[places] += kept[:, None] * apart
    left = ((1.0 - ramp) * scale)[places, 0]
    return light, np.maximum(square, ((1.0 - kept) * left) ** 2)


def blended_error(
    own: NoisyPixels, apart: np.ndarray, carried: np.ndarray, near: Surroundings
) -> tuple[np.ndarray, np.ndarray]:
    """The share of pixels' ``own`` light that is kept beside light that was corrected by it; and
    the mean squared error of what both make, (k,) each.

    The corrected light is C, own light O with the variance V is ``apart`` (k,) from it by x, and
    the share is κ = 1 - V / M, at least 0, where M is the mean of x² ``near``. The shown light
    C + κ x then errs, in the mean, by

        κ V + 2 (1 - κ) cov(O, C) + 4 V / M² · mean(x n)²   if M > V, and
        M - V + 2 cov(O, C)                                 if it is not.

    The first term is the error that own light leaves where it is kept, or what texels' light errs
    by beyond noise where it is not; the second the noise that C took over from the same paths; the
    third that of κ, which follows the noise, too. Probes show them: each adds p to O and p' to C,
    ``carried`` (k, n), so that cov(O, C) is the mean of p p', and n is p - p'. Of a pixel alone the
    estimate is rough, so it is the mean over pixels near, and at least the noise that is left,
    κ² V + 2 κ (1 - κ) cov(O, C) + (1 - κ)² var(C).

    It is assumed that the noise of paths is normal and independent from pixel to pixel, and of the
    light of texels; noise that the filter, or the correction, has in common between pixels is in
    the probes. Texels' noise is part of x.
    """
    noise = own.probes - carried
    both = (own.probes * carried).mean(axis=1)
    values = [own.variance, both, (carried**2).mean(axis=1), apart[:, None] * noise, apart**2]
    means, _ = near.means(np.column_stack(values), own.variance)
    (variance, common, left), square = means[:, :3].T, means[:, -1]
    kept = beyond_noise(square, variance)
    floor = np.maximum(square, 1e-300)
    followed = (means[:, 3:-1] ** 2).mean(axis=1) / floor * (variance / floor)
    risk = np.where(kept > 0.0, kept * variance + 4.0 * followed, square - variance)
    risk = (risk + 2.0 * (1.0 - kept) * common)[:, None]
    for step, _ in FILTER_PASSES:
        risk, _ = near.means(risk, own.variance, step)
    least = kept**2 * variance + (1.0 - kept) * (
        2.0 * kept * np.maximum(common, 0.0) + (1.0 - kept) * left
    )
    return kept, np.maximum(risk[:, 0], least)
