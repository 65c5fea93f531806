"""Noise taken out of transfer, for pages that put it under a light by themselves: each number by its neighbours'."""

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, square_light
from isogi_core.frame.shading import filter_records
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.filtering import PATHS_COLUMN, VARIANCE_COLUMN
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL
from isogi_core.kernels.shading.irradiance_ratio import (
    DIRECT_COLUMN,
    GRADE_COLUMN,
    NORMAL_COLUMN,
    RECORD_LENGTH,
    UNSHADOWED_COLUMN,
)
from isogi_core.kernels.shading.lattice import VOID_GRADE

LEAST_SPREAD = 0.1
"""What the variance of a path's number is of its mean square at least: where all paths agree, few may by chance."""


def number_noise(numbers: np.ndarray, scatter: np.ndarray, spec: BakeSpec) -> np.ndarray:
    """The variance of ``numbers`` (m, channels · columns) of texels of this ``scatter`` (m,); of the same shape.

    A path's number k is its light where that is harmonic k: its mean square is transfer times that square.
    """
    each = numbers.reshape(len(numbers), spec.channels, spec.columns)
    judged = each[:, min(spec.channels - 1, 1)]
    ends = zip(spec.firsts.tolist(), (term.order**2 for term in spec.terms), strict=True)
    seconds = [judged[:, a : a + n] @ np.array([square_light(one) for one in np.eye(n)]).T for a, n in ends]
    second = np.maximum(np.concatenate(seconds, axis=1), 0.0)[:, None]
    spread = np.maximum(second - each**2, LEAST_SPREAD * second)
    return np.asarray((scatter[:, None, None] ** 2 * spread).reshape(numbers.shape), np.float32)


def filter_numbers(
    texels: ViewTexels, reading: Reading, numbers: np.ndarray, noise: np.ndarray, normals: np.ndarray, tiles: Tiles
) -> np.ndarray:
    """The ``numbers`` (texels, n) of texels' transfer, those of grainy texels filtered as their neighbours allow.

    The filter is that of light, ``filter_texel_light``, of each number alone: so it holds for any light. ``noise``
    (texels, n) is a variance, and ``normals`` (texels, 3) are those that texels are lit about. Raises Cancelled.
    """
    filtered, records = np.empty_like(numbers), np.zeros((len(numbers), RECORD_LENGTH), np.float32)
    records[:, UNSHADOWED_COLUMN : UNSHADOWED_COLUMN + 3], records[:, NORMAL_COLUMN : NORMAL_COLUMN + 3] = 1.0, normals
    grade = np.where(reading.grainy, CONVERGING, FINAL)
    records[:, PATHS_COLUMN], records[:, GRADE_COLUMN] = reading.samples, np.where(reading.lit, grade, VOID_GRADE)
    for k in range(numbers.shape[1]):
        before = records.copy()
        before[:, DIRECT_COLUMN : DIRECT_COLUMN + 3], before[:, VARIANCE_COLUMN] = numbers[:, k, None], noise[:, k]
        filtered[:, k] = filter_records(texels, before, tiles)[:, DIRECT_COLUMN]
    return filtered
