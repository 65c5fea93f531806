"""Cells of fields that repeat, as of a crystal: one cell, or several side by side, closed across
their faces, on right angles.

Any box whose edges are the diagonal of the lattice's triangle (QR) holds one period, whatever the
lattice's angles: rows and layers are moved as a skewed grid is set upright, and parts that leave on
one side come in on the other. So a cell that is oblique becomes a box of the same volume, without
holes, and nothing in it is counted twice.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import (
    APERIODIC,
    MAX_SKEW_VOXELS,
    MAX_VOXELS,
    OR_RAW,
    Affine,
    Grid,
    Periodic,
    blended,
    decompose,
    on_voxels,
)
from isogi_core.files.vector import Vector, triple

Repeat = tuple[int, int, int]
"""How many cells are shown along x, y, z."""

ONCE: Repeat = (1, 1, 1)

MOST_REPEATED = 16
"""Most cells along an axis."""

CELL_NOTE = "The field repeats along {axes}: its surface goes on across the faces of the cell."
BOX_NOTE = (
    "The cell is oblique: a box with right angles is shown, which holds as much of the field as "
    "the cell does. {off} shows the cell by itself."
)
ASIDE_NOTE = (
    "The field repeats along {axes}, and its cell is oblique to an axis along which it does not: "
    "one cell is shown, open at its faces."
)


@dataclass(frozen=True)
class Cells:
    """How cells are shown: along which axes the field is ``periodic``, how often they ``repeat``,
    and how many voxels of the field lie around them along these axes, the ``margin``.
    """

    periodic: Periodic
    repeat: Repeat = ONCE
    margin: int = 0

    def shape(self, grid: Grid) -> tuple[int, ...]:
        """The shape (z, y, x) of the cells of a ``grid`` with their last faces and margins."""
        counts = zip(grid.shape, self.periodic[::-1], self.repeat[::-1], strict=True)
        return tuple(n * r + 1 + 2 * self.margin if p else n for n, p, r in counts)

    def left(self, shape: tuple[int, ...]) -> tuple[range, range, range]:
        """Voxels along x, y, z of a ``shape`` (z, y, x) that are not of the margin."""
        x, y, z = (
            range(self.margin, n - self.margin) if p else range(n)
            for n, p in zip(shape[::-1], self.periodic, strict=True)
        )
        return x, y, z


def set_side_by_side(
    grid: Grid, cells: Cells, spacing: tuple[float, ...] | None = None
) -> Grid | None:
    """The ``cells`` of a ``grid`` that lies in memory, on right angles and right-handed, whose
    ``spacing`` may be given; None if they are oblique along an axis that is not periodic.

    Raises VolumeError if axes lie in one plane or there are too many voxels.
    """
    matrix, origin = _placed(grid, spacing)
    flipped = np.linalg.det(matrix) < 0.0
    if flipped:
        # Read x backwards, which makes the axes right-handed: from the last face of the last cell,
        # or from the last voxel if x does not repeat.
        end = grid.shape[2] * cells.repeat[0] if cells.periodic[0] else grid.shape[2] - 1
        origin = origin + matrix[:, 0] * end
        matrix = matrix * np.array([-1.0, 1.0, 1.0])
    rotation, skewed = decompose(matrix)
    steps = np.diag(skewed)
    moves = _moves(skewed, cells.shape(grid))
    if (moves[0] or moves[1]) and not cells.periodic[0]:
        return None
    if moves[2] and not cells.periodic[1]:
        return None
    shape = cells.shape(grid)
    if math.prod(shape) > MAX_VOXELS:
        raise VolumeError(f"{math.prod(shape)} voxels are too many: repeat the cell less often.")
    margins = np.where(cells.periodic, -float(cells.margin), 0.0)
    affine = np.column_stack([rotation * steps, origin + rotation @ (margins * steps)])
    wide = grid.dtype.itemsize > 2 and grid.dtype != np.float32
    mixed: np.dtype[Any] = np.dtype(np.float64 if wide else np.float32)
    given = grid.stamp
    return replace(
        grid,
        shape=shape,
        dtype=mixed if any(moves) else grid.dtype,
        spacing=triple(steps),
        slabs=partial(_layers, grid, cells, shape, moves, flipped),
        stamp=lambda: f"{given()} {cells}",
        affine=Affine.of(affine, grid.affine.letters if grid.affine else ""),
        notes=(*grid.notes, *_notes(cells, any(moves))),
        periodic=APERIODIC,
        labels=None if any(moves) else grid.labels,
    )


def axes_of(periodic: Periodic) -> str:
    """Name the axes along which a field repeats, in words."""
    named = [axis for axis, repeats in zip("xyz", periodic, strict=True) if repeats]
    return " and ".join(filter(None, [", ".join(named[:-1]), named[-1]]))


def _notes(cells: Cells, oblique: bool) -> tuple[str, ...]:
    box = (BOX_NOTE.format(off="periodic = [false, false, false]"),) if oblique else ()
    return (CELL_NOTE.format(axes=axes_of(cells.periodic)), *box)


def _placed(grid: Grid, spacing: tuple[float, ...] | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix of a ``grid`` with its spacing, and its origin. Raises VolumeError."""
    if grid.affine is None:
        return np.diag(np.array(spacing or grid.spacing, np.float64)), np.zeros(3)
    matrix = np.array(grid.affine.matrix)
    lengths = np.linalg.norm(matrix, axis=0)
    sound = np.isfinite(matrix).all() and lengths.min() > 0.0
    if not sound or abs(np.linalg.det(matrix / lengths)) < 1e-3:
        raise VolumeError(f"The volume's axes lie in one plane: mend its affine, or {OR_RAW}.")
    return matrix / lengths * (spacing or lengths), np.array(grid.affine.origin)


def _moves(skewed: np.ndarray, shape: tuple[int, ...]) -> Vector:
    """Return three moves in voxels: of each row along x, of each layer along x, and of each layer
    along y. A move is 0 if it adds up to at most MAX_SKEW_VOXELS over the whole ``shape``.
    """
    rows = skewed[0, 1] / skewed[0, 0]
    columns = skewed[0, 2] / skewed[0, 0]
    down = skewed[1, 2] / skewed[1, 1]
    farthest = np.abs([rows * shape[1], columns * shape[0], down * shape[0]])
    row_x, layer_x, layer_y = np.where(
        farthest > MAX_SKEW_VOXELS, [rows, columns, down], 0.0
    ).tolist()
    return row_x, layer_x, layer_y


def _layers(
    grid: Grid, cells: Cells, shape: tuple[int, ...], moves: Vector, flipped: bool
) -> Iterator[np.ndarray]:
    """Yield the layers of ``cells`` of a ``grid`` that lie on right angles, (1, ny, nx) each, of a
    ``shape`` (z, y, x) with margins. ``moves`` are those of ``_moves``. If ``flipped``, x is read
    backwards.
    """
    whole = grid.whole()
    if flipped:
        # If x repeats, the face after its last voxel is voxel 0 again: backwards, its voxels are
        # 0, n - 1, …, 1. If it does not, they are n - 1, …, 0.
        turned = -np.arange(grid.shape[2]) - (0 if cells.periodic[0] else 1)
        whole = whole[..., turned % grid.shape[2]]
    # Number voxels from the first one of the first cell: those in the margin before it are
    # negative.
    k, j, i = (
        np.arange(n) - (cells.margin if p else 0)
        for n, p in zip(shape, cells.periodic[::-1], strict=True)
    )
    for at in k.tolist():
        layer = whole[at % len(whole)]
        if not any(moves):
            yield layer[np.ix_(j % layer.shape[0], i % layer.shape[1])][None]
            continue
        # Undo the moves: find the row and column of the skewed grid, which may lie in another cell.
        rows = on_voxels(j - at * moves[2])
        columns = on_voxels(i - (rows * moves[0] + at * moves[1])[:, None])
        yield _between(layer, rows, columns)[None]


def _between(layer: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Interpolate a ``layer`` that repeats linearly, at real ``rows`` (h,) and
    ``columns`` (h, w).
    """
    above = np.floor(rows)
    left = np.floor(columns)
    down = (rows - above)[:, None]
    right = columns - left
    j, i = above.astype(int)[:, None], left.astype(int)
    ny, nx = layer.shape
    corners = [
        layer[(j + dj) % ny, (i + di) % nx].astype(np.float64) for dj in (0, 1) for di in (0, 1)
    ]
    return blended(corners, down, right)
