"""Ends of rows, and the outermost points of surfaces, against all cells of them."""

import numpy as np
import pytest

from isogi_core.kernels.tracing.extents import fill_row_ends
from isogi_core.kernels.tracing.macrocells import fill_macrocells, macrocell_shape
from isogi_core.model.volume import make_volume
from isogi_core.prepared import isosurface_mesh
from isogi_core.prepared.isosurface_mesh import cells_of, outermost_points
from isogi_core.prepared.prepared_scene import make_field


def blobs(shape: tuple[int, int, int]) -> np.ndarray:
    """Smooth noise, with a few holes."""
    rng = np.random.default_rng(sum(shape))
    values = rng.normal(size=shape).astype(np.float32)
    for axis in range(3):
        values = values + np.roll(values, 1, axis)
    values[tuple(rng.integers(0, n, 5) for n in shape)] = np.nan
    return values


@pytest.mark.parametrize("shape", [(2, 2, 2), (9, 10, 17), (20, 3, 33)])
@pytest.mark.parametrize("level", [-3.0, 0.3, 2.5, 40.0])
def test_rows_end_where_their_cells_do(shape: tuple[int, int, int], level: float) -> None:
    voxels = blobs(shape)
    low, high = np.empty((2, *macrocell_shape(shape)), np.float32)
    fill_macrocells(voxels, low, high)
    ends = np.empty((2, shape[0] - 1, shape[1] - 1), np.int32)
    fill_row_ends(voxels, low, high, level, ends)
    cells, _ = cells_of(voxels, level)
    expected = np.full_like(ends, -1)
    for x, y, z in cells:
        seen = expected[1, z, y] >= 0
        expected[0, z, y] = min(expected[0, z, y], x) if seen else x
        expected[1, z, y] = max(expected[1, z, y], x)
    assert (ends == expected).all()


@pytest.mark.parametrize("rows", [0, 1 << 15])
@pytest.mark.parametrize("level", [0.5, 1.5])
def test_outermost_points_have_the_hull_of_the_surface(
    level: float, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In every direction they reach as far as the vertices of the whole mesh do: where few rows
    count, to a voxel.
    """
    monkeypatch.setattr(isosurface_mesh, "MAX_HULL_ROWS", rows)
    volume = make_volume(blobs((18, 25, 30)))
    isovalue = volume.normalise_isovalue(level)
    points = outermost_points(make_field(volume), isovalue)
    directions = np.random.default_rng(3).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    reached = (points @ directions.T).max(axis=0)
    vertices = isosurface_mesh.isosurface_mesh(volume.voxels, isovalue).vertices
    short = (vertices @ directions.T).max(axis=0) - reached
    assert short.max() < (1.0 if rows == 0 else 0.05)
    assert short.min() > -1.0
