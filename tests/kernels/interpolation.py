"""The field by NumPy and SciPy: values, smoothed gradients and where a level is crossed."""

import numpy as np
from scipy.ndimage import map_coordinates

from isogi_core.kernels.tracing.field import bspline, bspline_slope

REACH = 1.5
"""Voxels that a texel is moved at most."""

STRIDE = 1 / 16
"""Voxels from one place to the next along a way."""

OFFSET = 0.3
"""Voxels above a surface at which rays start."""


def smoothed(voxels, p):
    """The smoothed gradient at `p`, (3,)."""
    cells = [min(int(x), n - 2) for x, n in zip(p[::-1], voxels.shape, strict=True)]
    taps = [
        np.clip(np.arange(i - 1, i + 3), 0, n - 1) for i, n in zip(cells, voxels.shape, strict=True)
    ]
    block = voxels[np.ix_(*taps)].astype(float)
    weights, slopes = (
        [own(x - i) for x, i in zip(p[::-1], cells, strict=True)]
        for own in (bspline, bspline_slope)
    )
    factors = [[slopes[a] if a == axis else weights[a] for a in range(3)] for axis in (2, 1, 0)]
    return np.array([np.einsum("kji,k,j,i->", block, *each) for each in factors])


def trilinear(voxels, points):
    """Trilinear values at points (…, 3), x first, or at the nearest to them in the box; float64."""
    return map_coordinates(
        voxels.astype(float), np.moveaxis(points, -1, 0)[::-1], order=1, mode="nearest"
    )


def search(voxels, p, down, level):
    """The stride (first, last place) along `down` in which the level is crossed; None where it is
    in none.
    """
    places = p + np.arange(0.0, REACH + STRIDE / 2, STRIDE)[:, None] * down
    solid = trilinear(voxels, places) > level
    changes = np.flatnonzero(solid != solid[0])
    if len(changes):
        return places[changes[0] - 1 : changes[0] + 1]
    return None


def at_edge(around, own):
    """Whether a value is at the edge of a plateau: within a tenth of the range from an end of the
    values around it, two sevenths of which are like it.
    """
    low, high = np.nanmin(around), np.nanmax(around)
    near = 0.1 * (np.float64(high) - np.float64(low))
    return not low + near < own < high - near and (np.abs(around - own) <= near).mean() >= 2 / 7
