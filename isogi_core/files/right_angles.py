"""Grids on right angles: what is mirrored is read the other way round, and what is skewed is resampled, layer by layer.

A renderer's box has right angles and is right-handed; all else that an affine may say, a camera and its light can do.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Affine, Grid

MAX_SKEW_VOXELS = 0.1
"""Most voxels by which a corner may be off, for axes that are not quite at right angles to be taken as if they were."""

OR_RAW = "leave it out by axes = 'raw'"

MAX_GROWTH = 8
"""Most times the voxels that a skewed grid may need once its axes are at right angles."""


def on_right_angles(grid: Grid, spacing: tuple[float, ...] | None = None) -> Grid:
    """The field with an affine that is a rotation of a box, right-handed, whose ``spacing`` may be given.

    Mirrored axes are read the other way round along x: no value changes. Skewed axes are resampled linearly along the
    layers, and a note says so. A grid without an affine stays as it is. Raises VolumeError where axes lie in one plane.
    """
    if grid.affine is None:
        return replace(grid, spacing=spacing or grid.spacing)
    matrix, origin = np.array(grid.affine.matrix), np.array(grid.affine.origin)
    lengths = _lengths(matrix)
    if not np.isfinite(matrix).all() or not np.isfinite(origin).all() or min(lengths) <= 0.0:
        raise VolumeError(f"The volume's axes have no direction: mend its affine, or {OR_RAW}.")
    directions = matrix / lengths
    if abs(np.linalg.det(directions)) < 1e-3:
        raise VolumeError(f"The volume's axes lie in one plane: mend its affine, or {OR_RAW}.")
    matrix = directions * (spacing or lengths)
    placed = replace(grid, affine=Affine.of(np.column_stack([matrix, origin]), grid.affine.letters))
    return _straight(_right_handed(placed), spacing or lengths)


def _lengths(matrix: np.ndarray) -> tuple[float, ...]:
    """World lengths of a step along x, y, z: of the matrix's columns."""
    return tuple(math.hypot(*column) for column in matrix.T.tolist())


def _right_handed(grid: Grid) -> Grid:
    """The grid, its x the other way round where its axes are a left-handed system."""
    assert grid.affine is not None, "on_right_angles has asked"
    array = grid.affine.array
    if np.linalg.det(array[:, :3]) > 0.0:
        return grid
    array[:, 3] += array[:, 0] * (grid.shape[2] - 1)
    array[:, 0] *= -1.0
    return replace(grid, slabs=partial(_turned, grid), affine=Affine.of(array, grid.affine.letters))


def _turned(grid: Grid) -> Iterator[np.ndarray]:
    """The slabs of a grid, x the other way round."""
    return (slab[..., ::-1] for slab in grid.slabs())


def _straight(grid: Grid, steps: tuple[float, ...]) -> Grid:
    """A right-handed grid with the spacing ``steps``, resampled where its axes are skewed."""
    assert grid.affine is not None, "on_right_angles has asked"
    array = grid.affine.array
    rotation, skewed = _decompose(array[:, :3])
    last = np.array(grid.shape[::-1]) - 1.0
    off = np.abs(skewed - np.diag(np.diag(skewed))) @ last / np.diag(skewed)
    if off.max() <= MAX_SKEW_VOXELS:
        affine = Affine.of(np.column_stack([rotation * np.array(steps), array[:, 3]]), grid.affine.letters)
        return replace(grid, spacing=steps, affine=affine)
    return _resampled(grid, rotation, skewed)


def _decompose(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rotation and an upper triangle with a positive diagonal, whose product is the ``matrix``; (3, 3) each.

    The layers' own x axis and plane keep their directions: a layer is moved, and never tilted.
    """
    rotation, triangle = np.linalg.qr(matrix)
    signs = np.where(np.diag(triangle) < 0.0, -1.0, 1.0)
    return rotation * signs, triangle * signs[:, None]


def _resampled(grid: Grid, rotation: np.ndarray, skewed: np.ndarray) -> Grid:
    """A skewed grid on right angles: rows and layers are moved in their own planes, and between voxels is linear.

    Voxels of the new grid that the old one does not reach are holes.
    """
    assert grid.affine is not None, "on_right_angles has asked"
    nz, ny, nx = grid.shape
    steps = np.diag(skewed)
    rows = skewed[1, 2] / steps[1] * np.array([0.0, nz - 1.0])
    columns = (
        np.add.outer(skewed[0, 1] * np.array([0.0, ny - 1.0]), skewed[0, 2] * np.array([0.0, nz - 1.0])) / steps[0]
    )
    first = np.floor([columns.min(), rows.min()])
    width = int(math.ceil(nx - 1 + columns.max()) - first[0]) + 1
    height = int(math.ceil(ny - 1 + rows.max()) - first[1]) + 1
    if width * height > MAX_GROWTH * nx * ny:
        raise VolumeError(f"The volume's axes are too skewed: resample it first, or {OR_RAW}.")
    wide = grid.dtype.itemsize > 2 and grid.dtype != np.float32
    dtype: np.dtype[Any] = np.dtype(np.float64 if wide else np.float32)
    origin = grid.affine.array[:, 3] + rotation[:, :2] @ (first * steps[:2])
    affine = Affine.of(np.column_stack([rotation * steps, origin]), grid.affine.letters)
    note = "The axes are skewed: the layers were resampled onto right angles, linearly."
    x, y, z = (float(step) for step in steps)
    slabs = partial(_moved, grid, skewed, (int(first[0]), int(first[1])), (height, width), dtype)
    return replace(
        grid,
        shape=(nz, height, width),
        dtype=dtype,
        spacing=(x, y, z),
        slabs=slabs,
        affine=affine,
        notes=(*grid.notes, note),
        labels=None,  # between two labels is neither
    )


def _moved(
    grid: Grid, skewed: np.ndarray, first: tuple[int, int], size: tuple[int, int], dtype: np.dtype[Any]
) -> Iterator[np.ndarray]:
    """The layers of a skewed grid, each moved to where it is on right angles; (1, height, width) each."""
    k = 0
    for slab in grid.slabs():
        for layer in slab:
            rows = np.arange(size[0]) + first[1] - k * skewed[1, 2] / skewed[1, 1]
            shift = (rows * skewed[0, 1] + k * skewed[0, 2]) / skewed[0, 0]
            columns = np.arange(size[1]) + first[0] - shift[:, None]
            yield _between(layer.astype(np.float64), rows, columns).astype(dtype)[None]
            k += 1


def _between(layer: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Linear values of a ``layer`` at real ``rows`` (h,) and their ``columns`` (h, w); NaN outside of it."""
    ny, nx = layer.shape
    j, i = np.clip(np.floor(rows), 0, ny - 2).astype(int), np.clip(np.floor(columns), 0, nx - 2).astype(int)
    down, right = (rows - j)[:, None], columns - i
    inside = (down >= 0.0) & (down <= 1.0) & (right >= 0.0) & (right <= 1.0)
    upper, lower = layer[j], layer[j + 1]
    beside = [np.take_along_axis(row, i + step, axis=1) for row in (upper, lower) for step in (0, 1)]
    above = beside[0] * (1.0 - right) + beside[1] * right
    below = beside[2] * (1.0 - right) + beside[3] * right
    return np.where(inside, above * (1.0 - down) + below * down, np.nan)
