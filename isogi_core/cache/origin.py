"""Where a chunk comes from: its isovalues must be the volume's own at its texels.

A checksum says that an object is whole, not that it lies under its own name; this says so.
"""

import numpy as np

from isogi_core.bake.recipe import Recipe
from isogi_core.cache.chunk import Chunk

TOLERANCE = 1e-6
"""Largest difference between a stored isovalue and the field, whose voxels span [0, 1]: rounding only."""


def was_baked_here(chunk: Chunk, recipe: Recipe) -> bool:
    """Whether every texel of ``chunk`` was lit on the isosurface through its own point of the recipe's volume."""
    texels = chunk.positions(chunk.offsets)
    if (texels >= recipe.shape).any():
        return False
    field = values_at(recipe.scene.volume.voxels, texels * recipe.step[::-1])
    return bool((np.abs(np.nan_to_num(field) - chunk.light.isovalue) <= TOLERANCE).all())


def values_at(voxels: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Trilinear values (m,) float64 at ``points`` (m, 3; z, y, x in voxels), as ``kernels.field.value`` has them."""
    cell = np.clip(np.floor(points).astype(np.intp), 0, np.array(voxels.shape) - 2)
    fz, fy, fx = (points - cell).T
    k, j, i = cell.T
    total = np.zeros(len(points))
    for c, wz in ((0, 1.0 - fz), (1, fz)):
        for b, wy in ((0, 1.0 - fy), (1, fy)):
            v0 = voxels[k + c, j + b, i].astype(np.float64)
            total += wz * wy * (v0 + fx * (voxels[k + c, j + b, i + 1] - v0))
    return total
