"""Voxel codes: a volume's voxels in the smallest numbers that hold them exactly, for drawing away from here.

Voxels that no isosurface of a range is drawn by may be any number on their side, which takes no bytes.
"""

import math
from dataclasses import dataclass

import numpy as np

from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.reachable_texels import surface_cells

HOLE_CODE = -float(np.finfo(np.float32).max)
"""The code of a voxel without a value: graphics cards may take NaN for any number."""

SLAB_CODE_BYTES = 1 << 22
"""Bytes of codes in a slab at most, but for volumes of which one layer takes more."""


@dataclass(frozen=True)
class VoxelCodes:
    """``voxel = base + gain · code`` exactly, with codes of a NumPy ``kind``: uint8, uint16 or float32.

    ``gain`` is a power of two, so that order and normals are those of the voxels. Voxels without a value have the code
    ``hole``, None where there are none; ``shape`` are the codes along z, y, x.
    """

    kind: str
    gain: float
    base: float
    hole: float | None
    shape: tuple[int, int, int]

    @property
    def nbytes(self) -> int:
        """Bytes of all codes."""
        return math.prod(self.shape) * np.dtype(self.kind).itemsize

    @property
    def slabs(self) -> tuple[tuple[int, int], ...]:
        """The first layer of each slab along z, and the first after it."""
        depth = self.shape[0]
        layers = max(SLAB_CODE_BYTES * depth // self.nbytes, 1)
        return tuple((z, min(z + layers, depth)) for z in range(0, depth, layers))

    def code(self, voxels: np.ndarray) -> np.ndarray:
        """The codes of ``voxels`` of any shape, little-endian."""
        if self.kind == "float32":
            codes = voxels if self.hole is None else np.where(np.isnan(voxels), np.float32(self.hole), voxels)
            return np.asarray(codes, "<f4")
        return np.rint((voxels.astype(np.float64) - self.base) / self.gain).astype(
            np.dtype(self.kind).newbyteorder("<")
        )

    def holds(self, voxels: np.ndarray) -> bool:
        """Whether the codes of ``voxels`` are these voxels again."""
        return bool(np.array_equal((self.base + self.gain * self.code(voxels)).astype(np.float32), voxels))


def find_codes(volume: Volume) -> VoxelCodes:
    """The codes of a ``volume``: of whole numbers where its file has such, and few enough, else its voxels as they are.

    All voxels are looked at.
    """
    ends = sorted(float(volume.normalise_isovalue(value)) for value in volume.value_range)
    gain = 1.0 / abs(volume.scale)
    if np.issubdtype(np.dtype(volume.dtype), np.integer) and not volume.holes:
        for kind in ("uint8", "uint16"):
            codes = VoxelCodes(kind, gain, ends[0], None, volume.shape)
            if ends[1] - ends[0] <= gain * np.iinfo(kind).max and all(map(codes.holds, volume.slabs())):
                return codes
    return VoxelCodes("float32", 1.0, 0.0, HOLE_CODE if volume.holes else None, volume.shape)


VOXELS_BEFORE, VOXELS_AFTER = 1, 2
"""Voxels along each axis that drawing a cell reads before the cell's first one, and from that on: the B-spline's."""


class IdleVoxels:
    """A volume's ``voxels`` (z, y, x), as isosurfaces from the ``low`` isovalue to the ``high`` one need them."""

    def __init__(self, voxels: np.ndarray, low: Isovalue, high: Isovalue) -> None:
        """Find the values that stand for idle voxels: the nearest to the range on either side."""
        self._voxels, self._range = voxels, (low, high)
        above = [float(layer[layer > high].min(initial=np.inf)) for layer in voxels]
        below = [float(layer[layer <= low].max(initial=-np.inf)) for layer in voxels]
        self._sides = max(below), min(above)

    def flattened(self, first: int, last: int) -> np.ndarray:
        """Layers from ``first`` to before ``last`` with all idle voxels of a side alike; those without a value stay."""
        a, b = max(first - VOXELS_AFTER, 0), min(last + VOXELS_AFTER, len(self._voxels))
        slab, (low, high), (below, above) = self._voxels[a:b], self._range, self._sides
        needed = surface_cells(slab, low, high)
        for axis in range(3):
            needed = voxels_read(needed, axis)
        own, idle = slab[first - a : last - a], ~needed[first - a : last - a]
        sided = np.where(idle & (own <= low), np.float32(below), own)
        return np.asarray(np.where(idle & (own > high), np.float32(above), sided), np.float32)


def voxels_read(cells: np.ndarray, axis: int) -> np.ndarray:
    """The voxels along an ``axis`` that drawing marked ``cells`` reads; bool, one more along that axis."""
    marks = np.moveaxis(cells, axis, 0)
    wide = np.zeros((len(marks) + VOXELS_BEFORE + VOXELS_AFTER, *marks.shape[1:]), np.bool_)
    for shift in range(VOXELS_BEFORE + VOXELS_AFTER + 1):
        wide[shift : shift + len(marks)] |= marks
    return np.moveaxis(wide[VOXELS_BEFORE : VOXELS_BEFORE + len(marks) + 1], 0, axis)
