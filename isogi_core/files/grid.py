"""Grids: the values of a volume at their source, read slab by slab, as they need not fit into memory."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

Shape = tuple[int, ...]
Vector = tuple[float, float, float]

SLAB = 1 << 25
"""Approximate bytes of a slab, where the source leaves the choice."""


PATIENT = "RAS"
"""Letters of a world whose axes point to a patient's right, anterior and superior."""


@dataclass(frozen=True)
class Affine:
    """Where voxels lie in the world: ``world = matrix · (x, y, z) + origin`` of a voxel's indices.

    ``matrix`` is three rows. ``letters`` say where the world's axes point, PATIENT in a patient, else empty.
    """

    matrix: tuple[Vector, Vector, Vector]
    origin: Vector
    letters: str = ""

    @classmethod
    def of(cls, matrix: Any, letters: str = "") -> "Affine":
        """From an array (3, 4) or (4, 4): the matrix, and the origin as its last column."""
        rows = np.asarray(matrix, np.float64)[:3]
        x, y, z = (_vector(row) for row in rows[:, :3])
        return cls((x, y, z), _vector(rows[:, 3]), letters)

    @property
    def array(self) -> np.ndarray:
        """The matrix with the origin as its last column, (3, 4) float64."""
        return np.column_stack([np.array(self.matrix), np.array(self.origin)])


def _vector(row: np.ndarray) -> Vector:
    x, y, z = (float(value) for value in row)
    return x, y, z


ALONE = (0, 1)
"""The moment of what is no series in time."""


def _nothing() -> str:
    return ""


@dataclass(frozen=True, eq=False)
class Grid:
    """One value per voxel, at any source.

    ``shape`` is voxels along z, y, x, ``dtype`` the source's type and ``spacing`` (x, y, z) as the source gives it.
    ``slabs`` iterates anew on each call: arrays (layers, ny, nx) that make up the whole from z = 0 on. It raises
    VolumeError where the source is damaged. ``stamp`` names the source's state, as far as sizes and times of files
    show it. ``affine`` says where voxels lie in the world, None where the source says spacing alone; ``unit`` is that
    of lengths, empty where unknown. ``notes`` are sentences on what was done to make this field of the source. It is
    the ``moment`` of a series in time: which step it is, and of how many; ``unchosen`` where it is the first because
    nobody chose one.
    """

    shape: Shape
    dtype: np.dtype[Any]
    spacing: Sequence[float]
    slabs: Callable[[], Iterator[np.ndarray]]
    stamp: Callable[[], str] = _nothing
    affine: Affine | None = None
    unit: str = ""
    notes: tuple[str, ...] = ()
    moment: tuple[int, int] = ALONE
    unchosen: bool = False

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

    def loaded(self) -> "Grid":
        """The same grid with all values in memory."""
        array = self.whole()
        return replace(self, slabs=lambda: iter((array,)))

    def whole(self) -> np.ndarray:
        """All values in memory; (nz, ny, nx). The source's own array where that is its only slab."""
        slabs = self.slabs()
        first = next(slabs, None)
        if first is not None and first.shape == self.shape and first.dtype == self.dtype:
            next(slabs, None)  # what is wrong with the whole is told at its end
            return first
        array, z = np.empty(self.shape, self.dtype), 0
        for slab in chain(() if first is None else (first,), slabs):
            array[z : z + len(slab)] = slab
            z += len(slab)
        return array


def layers_of(layer_bytes: int) -> int:
    """Number of layers of so many bytes in a slab, at least one."""
    return max(SLAB // max(layer_bytes, 1), 1)
