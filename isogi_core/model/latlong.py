"""Lat-long images of all directions, (h, w, ...): what their pixels stand for, their mean, and other grids."""

import numpy as np


def solid_angles(height: int, width: int) -> np.ndarray:
    """Steradians of each pixel, (h, w) float64, exact: 2π/w (cos θ_top - cos θ_bottom)."""
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    row = 4.0 * np.pi / width * np.sin(theta) * np.sin(np.pi / (2 * height))
    return np.broadcast_to(row[:, None], (height, width))


def pixel_directions(height: int, width: int) -> np.ndarray:
    """Unit directions (h, w, 3) float64 of the pixels' centres."""
    theta = (np.arange(height)[:, None] + 0.5) * (np.pi / height)
    phi = (np.arange(width) + 0.5) * (2.0 * np.pi / width)
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    return np.stack([x, y, np.broadcast_to(np.cos(theta), x.shape)], axis=-1)


def mean_radiance(image: np.ndarray) -> np.ndarray:
    """Mean (3,) of a lat-long image (h, w, 3) over the sphere, float64."""
    weights = solid_angles(*image.shape[:2])[:, 0] / (4.0 * np.pi)
    return np.asarray(weights @ image.sum(axis=1, dtype=np.float64))


def resample(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """The image averaged by solid angle over the pixels of another grid, (height, width, 3) float64."""
    if image.shape[:2] == (height, width):
        return np.asarray(image, np.float64)
    rows = _overlap(-np.cos(np.linspace(0, np.pi, height + 1)), -np.cos(np.linspace(0, np.pi, len(image) + 1)))
    columns = _overlap(np.linspace(0, 1, width + 1), np.linspace(0, 1, image.shape[1] + 1))
    wide = np.asarray(image, np.float64)
    return np.asarray(np.einsum("ij,jkc,lk->ilc", rows, wide, columns, optimize=True))


def _overlap(to: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Share of each interval between the edges ``to`` that lies in each between ``source``; rows sum to 1."""
    upper = np.minimum(to[1:, None], source[None, 1:])
    lower = np.maximum(to[:-1, None], source[None, :-1])
    return np.asarray(np.maximum(upper - lower, 0.0) / np.diff(to)[:, None])
