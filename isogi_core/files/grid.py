"""Grids: the values of a volume where they are kept, read slab by slab: they need not fit into memory."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Shape = tuple[int, ...]

SLAB = 1 << 25
"""Bytes of one slab, about, where its source leaves the choice."""


def _nothing() -> str:
    return ""


@dataclass(frozen=True, eq=False)
class Grid:
    """One value per voxel, wherever they are.

    ``shape`` is voxels along z, y, x, ``dtype`` the type that they come in and ``spacing`` (x, y, z) as the source
    says. ``slabs`` begins anew each time: arrays (layers, ny, nx) that make up the whole from z = 0 on; it raises
    VolumeError where the source is damaged. ``stamp`` names the state that the source is in, as far as its files'
    sizes and times tell.
    """

    shape: Shape
    dtype: np.dtype[Any]
    spacing: Sequence[float]
    slabs: Callable[[], Iterator[np.ndarray]]
    stamp: Callable[[], str] = _nothing

    @classmethod
    def of(cls, array: np.ndarray, spacing: Sequence[float] = (1.0, 1.0, 1.0)) -> "Grid":
        """The grid of an array in memory, which is its only slab."""
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
    """Layers of so many bytes in a slab; one at least."""
    return max(SLAB // max(layer_bytes, 1), 1)
