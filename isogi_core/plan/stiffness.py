"""Stiffness: how much of each isosurface is steep, on a plateau, noisy, beside holes or cut open by the box."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from isogi_core.kernels.field import Field
from isogi_core.kernels.stiffness import CELLS, FACES, HOLED, NOISY, PLATEAU, ROWS, STEEP, count_stiffness

LAYERS = 8
"""Layers of cells that are counted in one go; the plane of voxels between two of them is looked at twice."""

SMOOTH_ERROR, STEEP_ERROR, NOISY_ERROR = 0.005, 0.01, 0.12
"""What light errs by on a surface that is not stiff, and how much more on one that is all steep, or all noisy.

Fitted to 48 surfaces of real volumes and made ones (`benchmarks.stiffness`), each a view of 48 × 48 pixels under
constant light with texels at 2 %: relative RMSE beside paths from each pixel, less its noise. They rank as the figures
do (Spearman's ρ = 0.7); steep ones err little since their texels are lit half-way of the step.
"""

LEAST, MOST = 0.2, 3.5
"""Of these surfaces nine in ten erred between so many times what is told.

What they do not tell is what stands behind a surface at other isovalues: a table under a teapot, say.
"""

Run = Callable[[Callable[[int, int], object], int, int], None]
"""Whoever calls a function over the ranges of a whole, as ``frame.tiles.Tiles.run`` does."""


@dataclass(frozen=True)
class Expectation:
    """What interpolation between texels is expected to err by: relative RMSE, and the range that it is likely in."""

    low: float
    likely: float
    high: float


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Counts of cells, (m,) int64 each, for isovalues ``levels`` (m,) float32 in voxel units, ascending.

    ``cells`` are those that the surface passes; of these, ``steep`` are those where the field leaps from one plateau
    to another, ``plateau`` those where it hardly changes, ``noisy`` those whose normals stray, and ``holed`` those
    beside a voxel that is no number. ``faces`` (6, m) are cells whose surface meets a face of the box, x = 0 first,
    then the other end along x, y = 0, … . See ``kernels.stiffness`` for what exactly makes them so.
    """

    levels: np.ndarray
    cells: np.ndarray
    steep: np.ndarray
    plateau: np.ndarray
    noisy: np.ndarray
    holed: np.ndarray
    faces: np.ndarray

    def share(self, some: np.ndarray) -> np.ndarray:
        """``some`` counts over all cells of the surface, 0 where there are none; (m,)."""
        return np.asarray(some / np.maximum(self.cells, 1))

    def expectation(self, place: int) -> Expectation:
        """What light on the surface at ``levels[place]`` is expected to err by, from its STEEP and NOISY shares."""
        steep, noisy = (float(self.share(each)[place]) for each in (self.steep, self.noisy))
        likely = SMOOTH_ERROR + STEEP_ERROR * steep + NOISY_ERROR * noisy
        return Expectation(LEAST * likely, likely, MOST * likely)


def measure_stiffness(field: Field, levels: Any, run: Run) -> Stiffness:
    """Count the cells of all surfaces of a ``field`` at ``levels`` (m,), in one pass."""
    ascending = np.unique(np.asarray(levels, np.float32))
    counts, lock = np.zeros((ROWS, len(ascending) + 1), np.int64), threading.Lock()

    def piece(first: int, last: int) -> None:
        own = np.zeros_like(counts)
        count_stiffness(field, ascending, first, last, own)
        with lock:
            np.add(counts, own, out=counts)

    run(piece, field.voxels.shape[0] - 1, LAYERS)
    rows = counts.cumsum(axis=1)[:, :-1]
    return Stiffness(ascending, rows[CELLS], rows[STEEP], rows[PLATEAU], rows[NOISY], rows[HOLED], rows[FACES:])
