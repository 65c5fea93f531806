"""The triangle mesh of an isosurface, as peers want one."""

import importlib.util

import numpy as np

from isogi_core.model.volume import Isovalue, Volume

Mesh = tuple[np.ndarray, np.ndarray]
"""Points (n, 3) float32, x, y, z, and triangles (m, 3) uint32."""


def installed() -> bool:
    """Whether scikit-image is there."""
    return importlib.util.find_spec("skimage") is not None


def make_mesh(volume: Volume, level: Isovalue) -> Mesh:
    """The marching-cubes mesh (scikit-image) of a normalised isovalue, in index space."""
    from skimage.measure import marching_cubes  # noqa: PLC0415

    points, triangles, _, _ = marching_cubes(volume.voxels, level, allow_degenerate=False)
    return points[:, ::-1].astype(np.float32).copy(), triangles.astype(np.uint32)
