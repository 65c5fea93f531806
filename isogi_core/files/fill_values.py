"""Fill values that no header names: what scanners write outside of their field of view, as -2000 or -3024 in CT."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid
from isogi_core.files.packing import Packing

FILLED_SHARE = 0.02
"""Least share of the voxels that a fill value takes; the corners beside a circle take a fifth."""

MIN_FILL_GAP, TAIL_SHARE = 1 / 16, 0.001
"""Least gap above a fill value, as a share of the range of the other values without a tail at each end."""

FEW_VALUES = 64
"""Distinct values that others have at least: phantoms and labels have fewer, and gaps between all of them."""

MAX_ENCLOSED_SHARE = 0.001
"""Largest share of the filled voxels that may lie between others of their row: a field of view is convex."""

BESIDE_QUANTILE, MIN_SHARE_ABOVE = 0.75, 0.4
"""Beside a field of view lies air: of all voxels that are left, at least the share MIN_SHARE_ABOVE is brighter than the
share BESIDE_QUANTILE of the voxels there. An object that stands in the fill value itself has its skin there.
"""

SAMPLED_VALUES = 1 << 12
"""Values that are kept of a layer."""

FILL_NOTE = "Voxels of {value} lie outside the field of view: they are holes. In a scene, missing = [] keeps them."


def without_fill(grid: Grid) -> Grid:
    """The grid with holes where a fill value is that its file does not name; the grid itself where there is none.

    Such a value is the least of all and negative, as zero may be a sky or the air around a phantom. Many voxels have
    it, no other value is near, it takes what is outside of a convex region, and the voxels beside it are themselves
    darker than much of the rest.
    """
    fill = find_fill(grid)
    if fill is None:
        return grid
    packing, named = Packing(grid.dtype, ((fill, fill),)), f"{fill:.10g}"
    return replace(
        grid,
        dtype=packing.dtype,
        slabs=partial(_holed, grid, packing),
        stamp=lambda: f"{grid.stamp()} without {named}",
        notes=(*grid.notes, FILL_NOTE.format(value=named)),
        read_as=f"{grid.read_as}; {named} is a fill value",
    )


def _holed(grid: Grid, packing: Packing) -> Iterator[np.ndarray]:
    return map(packing.apply, grid.slabs())


def find_fill(grid: Grid) -> Any:
    """The fill value of a grid, a number of its type; None where it has none.

    Only the first slab is read where its first layer has no negative value that is its least in a corner.
    """
    if grid.dtype.kind not in "if" or min(grid.shape) < 2:
        return None
    slabs = grid.slabs()
    try:
        first = next(slabs)
        fill = _in_a_corner(first[0])
        if fill is None:
            return None
        seen = Seen(fill)
        return fill if all(map(seen.add, itertools.chain((first,), slabs))) and seen.is_fill(grid.size) else None
    except VolumeError:  # the source is damaged, which its next reading says
        return None


def _in_a_corner(layer: np.ndarray) -> Any:
    """The least value of a ``layer``, where it is negative and in a corner; else None."""
    least = np.fmin.reduce(layer, axis=None)
    corners = layer[:: max(len(layer) - 1, 1), :: max(layer.shape[1] - 1, 1)]
    return least if least < 0 and np.isfinite(least) and (corners == least).any() else None


@dataclass
class Seen:
    """What was seen of a volume that may have the ``fill`` value: how many voxels have it, how many of them lie between
    others, values ``beside`` these voxels, a sample of all ``others``, and the ``least`` of these.
    """

    fill: Any
    filled: int = 0
    enclosed: int = 0
    beside: list[np.ndarray] = field(default_factory=list)
    others: list[np.ndarray] = field(default_factory=list)
    least: float = math.inf

    def add(self, slab: np.ndarray) -> bool:
        """Look at layers (n, ny, nx); False where a value is less, and all is decided."""
        return not (slab < self.fill).any() and all(map(self._add, slab))

    def _add(self, layer: np.ndarray) -> bool:
        filled = layer == self.fill
        inside = ~filled & np.isfinite(layer)
        others = layer[inside]
        self.filled += int(filled.sum())
        self.enclosed += int((filled & (_between(inside) | _between(inside.T).T)).sum())
        self.beside.append(layer[_touching(filled) & inside])
        self.others.append(others[:: len(others) // SAMPLED_VALUES + 1])
        self.least = min(self.least, float(others.min()) if others.size else math.inf)
        return True

    def is_fill(self, size: int) -> bool:
        """Whether the value fills what is outside of a field of view in a volume of ``size`` voxels."""
        others, beside = np.concatenate(self.others), np.concatenate(self.beside)
        if (
            self.filled < FILLED_SHARE * size
            or not len(others)
            or not len(beside)
            or self.enclosed > MAX_ENCLOSED_SHARE * self.filled
        ):
            return False
        bright = np.mean(others > np.quantile(beside, BESIDE_QUANTILE, method="nearest"))
        return bool(bright >= MIN_SHARE_ABOVE) and self._is_apart(others.astype(np.float64))

    def _is_apart(self, others: np.ndarray) -> bool:
        """Whether the fill value is far below all ``others``, of which there are many."""
        low, high = np.quantile(others, (TAIL_SHARE, 1.0 - TAIL_SHARE))
        return len(np.unique(others)) >= FEW_VALUES and bool(
            self.least - float(self.fill) >= MIN_FILL_GAP * (high - low)
        )


def _between(inside: np.ndarray) -> np.ndarray:
    """Where a row has voxels ``inside`` on both sides."""
    return np.logical_or.accumulate(inside, 1) & np.logical_or.accumulate(inside[:, ::-1], 1)[:, ::-1]


def _touching(filled: np.ndarray) -> np.ndarray:
    """Where one of the four neighbours in a layer is ``filled``."""
    wide = np.pad(filled, 1)
    found: np.ndarray = wide[:-2, 1:-1] | wide[2:, 1:-1] | wide[1:-1, :-2] | wide[1:-1, 2:]
    return found
