"""Voxels that no isosurface of a range is drawn by: they may be any number on their side, which takes no bytes."""

import numpy as np

from isogi_core.model.volume import Isovalue
from isogi_core.plan.reachable_texels import surface_cells

BEFORE, AFTER = 1, 2
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
        a, b = max(first - AFTER, 0), min(last + AFTER, len(self._voxels))
        slab, (low, high), (below, above) = self._voxels[a:b], self._range, self._sides
        needed = surface_cells(slab, low, high)
        for axis in range(3):
            needed = spread(needed, axis)
        own, idle = slab[first - a : last - a], ~needed[first - a : last - a]
        sided = np.where(idle & (own <= low), np.float32(below), own)
        return np.asarray(np.where(idle & (own > high), np.float32(above), sided), np.float32)


def spread(cells: np.ndarray, axis: int) -> np.ndarray:
    """The voxels along an ``axis`` that drawing marked ``cells`` reads; bool, one more along that axis."""
    marks = np.moveaxis(cells, axis, 0)
    wide = np.zeros((len(marks) + BEFORE + AFTER, *marks.shape[1:]), np.bool_)
    for shift in range(BEFORE + AFTER + 1):
        wide[shift : shift + len(marks)] |= marks
    return np.moveaxis(wide[BEFORE : BEFORE + len(marks) + 1], 0, axis)
