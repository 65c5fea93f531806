"""Filtering of pixels' own light: a pixel of few paths takes over what pixels around it on the surface agree on.

The filter is that of texels (``kernels.shading.filtering``) among pixels: two passes over 3 × 3 pixels, the second at
twice the distance (Dammertz and others 2010), and as much of a pixel's own light as the pixels around it differ by more
than their noise (Lee 1980).
"""

from typing import NamedTuple

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.sky import LUMINANCE

STEPS = ((1, 1.0), (2, 1.8))
"""Distances, in pixels, between those that a pass mixes; and how much more variance their mean has than that of
independent ones: those of the second pass took over from the same pixels (1.8 times, on even light).
"""

LIKE = 16
"""Power of the cosine between two normals that pixels count by for each other: half at 17°."""

SLOPE = 0.4
"""Sine of the angle, between a pixel's surface and the way to another point, at which that one counts a half less."""

AROUND = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x)


class Neighbours(NamedTuple):
    """The pixels at one place around each of some (k,): their ``rows``, itself where none is, and ``weights``."""

    rows: np.ndarray
    weights: np.ndarray


def filter_pixels(
    light: np.ndarray, variance: np.ndarray, gbuffer: GBuffer, tiles: Tiles
) -> tuple[np.ndarray, np.ndarray]:
    """Linear RGB (k, 3) of the points of a G-buffer, filtered, and the ``variance`` (k,) that its luminance has then.

    Raises Cancelled.
    """
    points, normals = gbuffer.points * np.array(gbuffer.spacing, np.float32), gbuffer.normals(tiles)
    for step, shared in STEPS:
        tiles.check()
        around = [neighbours(gbuffer, points, normals, y * step, x * step) for y, x in AROUND]
        light, variance = mix(light, variance, around, shared)
    return light, variance


def neighbours(gbuffer: GBuffer, points: np.ndarray, normals: np.ndarray, down: int, right: int) -> Neighbours:
    """The pixels so far from each, and what they count: by how near they are, and how much of the same surface."""
    height, width = gbuffer.shape
    y, x = (each.astype(np.int64) for each in np.divmod(gbuffer.pixels, width))
    inside = (y + down >= 0) & (y + down < height) & (x + right >= 0) & (x + right < width)
    itself = np.arange(len(points))
    rows = np.where(inside, gbuffer.rows.ravel()[np.where(inside, (y + down) * width + x + right, 0)], -1)
    rows = np.where(rows < 0, itself, rows)
    way = points[rows] - points
    far = np.sqrt(np.maximum((way**2).sum(axis=1), 1e-30))
    slope = np.maximum(np.abs((way * normals).sum(axis=1)), np.abs((way * normals[rows]).sum(axis=1))) / far
    like = np.maximum((normals * normals[rows]).sum(axis=1), 0.0) ** LIKE
    near = np.exp(-0.5 * (np.sign(down) ** 2 + np.sign(right) ** 2)) * np.exp2(-((slope / SLOPE) ** 2))
    return Neighbours(rows, np.where(rows == itself, 0.0, near * like))


def mix(
    light: np.ndarray, variance: np.ndarray, around: list[Neighbours], shared: float
) -> tuple[np.ndarray, np.ndarray]:
    """One pass: the light of pixels (k, 3), and the variance of its luminance, with that of those ``around`` them.

    The variance of their mean is ``shared`` times that of independent light.
    """
    shown, total, mean, taken = light @ LUMINANCE, np.ones(len(light)), light.copy(), variance.copy()
    for rows, weights in around:
        total += weights
        mean += weights[:, None] * light[rows]
        taken += weights**2 * variance[rows]
    mean /= total[:, None]
    level = mean @ LUMINANCE
    apart, noise = (shown - level) ** 2, variance.copy()
    for rows, weights in around:
        apart += weights * (shown[rows] - level) ** 2
        noise += weights * variance[rows]
    signal = np.maximum(apart - noise, 0.0)
    own = signal / np.maximum(signal + noise, 1e-300)
    left = own * noise / total + (1.0 - own) ** 2 * shared * taken / total**2
    return own[:, None] * light + (1.0 - own)[:, None] * mean, np.minimum(left, variance)
