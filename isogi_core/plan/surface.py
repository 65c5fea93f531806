"""The texels of whole isosurfaces, chunk by chunk: what views from anywhere may read."""

from collections.abc import Iterator, Sequence
from functools import reduce

import numpy as np

from isogi_core.plan.texels import Shape, shown_blocks, surface_cells

Range = tuple[float, float]
"""Isovalues from one to another, both included."""


def surface_texels(
    voxels: np.ndarray, shape: Shape, chunk: int, ranges: Sequence[Range]
) -> Iterator[tuple[Shape, np.ndarray]]:
    """The chunks (z, y, x) that hold texels of isosurfaces in the ``ranges``, and the offsets of these, ascending.

    Isovalues are normalised as the voxels are. The lattice of ``shape`` (z, y, x) has ``chunk`` texels along each
    side of a chunk; offsets are int32. One layer of chunks is in memory at a time.
    """
    nz, ny, nx = (n - 1 for n in voxels.shape)

    def cells(first: int, last: int) -> np.ndarray:
        slab = voxels[first : last + 1]
        return reduce(np.logical_or, [surface_cells(slab, low, high) for low, high in ranges])

    for layer, shown in enumerate(shown_blocks(cells, (nz, ny, nx), shape, chunk)):
        for y in range(0, shape[1], chunk):
            for x in range(0, shape[2], chunk):
                z, j, i = np.nonzero(shown[:, y : y + chunk, x : x + chunk])
                if len(z):
                    yield (layer, y // chunk, x // chunk), ((z * chunk + j) * chunk + i).astype(np.int32)
