"""Grids: the values of a volume at their source, read slab by slab, as they need not fit into memory."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Shape = tuple[int, ...]

SLAB = 1 << 25
"""Approximate bytes of a slab, where the source leaves the choice."""


def _nothing() -> str:
    return ""


@dataclass(frozen=True, eq=False)
class Grid:
    """One value per voxel, at any source.

    ``shape`` is voxels along z, y, x, ``dtype`` the source's type and ``spacing`` (x, y, z) as the source gives it.
    ``slabs`` iterates anew on each call: arrays (layers, ny, nx) that make up the whole from z = 0 on. It raises
    VolumeError where the source is damaged. ``stamp`` names the source's state, as far as sizes and times of files
    show it.
    """

    shape: Shape
    dtype: np.dtype[Any]
    spacing: Sequence[float]
    slabs: Callable[[], Iterator[np.ndarray]]
    stamp: Callable[[], str] = _nothing

    @classmethod
    def of(cls, array: np.ndarray, spacing: Sequence[float] = (1.0, 1.0, 1.0)) -> "Grid":
        """The grid of an array in memory; the array is its only slab."""
        return cls(array.shape, array.dtype, spacing, lambda: iter((array,)))

    def __len__(self) -> int:
        """Layers along z."""
        return self.shape[0]

    @property
    def size(self) -> int:
        """Voxels in all."""
        return math.prod(self.shape)

    def whole(self) -> np.ndarray:
        """All values in memory; (nz, ny, nx)."""
        array, z = np.empty(self.shape, self.dtype), 0
        for slab in self.slabs():
            array[z : z + len(slab)] = slab
            z += len(slab)
        return array


def layers_of(layer_bytes: int) -> int:
    """Number of layers of so many bytes in a slab, at least one."""
    return max(SLAB // max(layer_bytes, 1), 1)
