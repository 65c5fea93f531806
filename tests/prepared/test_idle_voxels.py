"""Voxels that no isosurface of a range is drawn by: what is drawn stays as it is, to the bit."""

import numpy as np
import pytest

from isogi_core.prepared.active_cell_maps import IdleVoxels

LOW, HIGH = 0.45, 0.5


def volume(holes: bool) -> np.ndarray:
    """Waves with an inside and an outside that are several voxels thick; (z, y, x) float32."""
    z, y, x = np.mgrid[:14, :17, :40]
    field = 0.5 + 0.4 * np.sin(0.16 * x) * np.cos(0.1 * y) + 0.02 * np.sin(3.0 * (x + y + z))
    values = field.astype(np.float32)
    if holes:
        values[4:6, 3:6, 8:12] = np.nan
    return values


def cells_of(values: np.ndarray) -> np.ndarray:
    """The eight corners of each cell; (8, z, y, x)."""
    nz, ny, nx = values.shape
    corners = [(k >> 2, k >> 1 & 1, k & 1) for k in range(8)]
    return np.stack([values[c : nz - 1 + c, b : ny - 1 + b, a : nx - 1 + a] for c, b, a in corners])


@pytest.mark.parametrize("holes", [False, True], ids=["whole", "holes"])
@pytest.mark.parametrize("layers", [3, 14])
def test_what_isosurfaces_of_the_range_read_stays(holes: bool, layers: int) -> None:
    values = volume(holes)
    idle = IdleVoxels(values, LOW, HIGH)
    slabs = [idle.flattened(a, min(a + layers, len(values))) for a in range(0, len(values), layers)]
    flat = np.concatenate(slabs)
    corners = cells_of(values)
    with np.errstate(invalid="ignore"):
        active = (corners.min(axis=0) <= HIGH) & (corners.max(axis=0) >= LOW)
    assert 0.05 < active.mean() < 0.6
    for z, y, x in np.argwhere(active).tolist():
        about = tuple(slice(max(i - 1, 0), i + 3) for i in (z, y, x))
        np.testing.assert_array_equal(flat[about], values[about])


@pytest.mark.parametrize("isovalue", [LOW, 0.48, HIGH])
def test_sides_and_holes_stay_where_voxels_are_idle(isovalue: float) -> None:
    values = volume(holes=True)
    flat = IdleVoxels(values, LOW, HIGH).flattened(0, len(values))
    np.testing.assert_array_equal(np.isnan(flat), np.isnan(values))
    np.testing.assert_array_equal(flat > isovalue, values > isovalue)
    changed = (flat != values) & ~np.isnan(values)
    assert changed.mean() > 0.2 and len(np.unique(flat[changed])) == 2


def test_a_volume_on_one_side_of_the_range_is_one_number() -> None:
    values = np.linspace(0.0, 0.3, 60, dtype=np.float32).reshape(3, 4, 5)
    assert np.unique(IdleVoxels(values, LOW, HIGH).flattened(0, 3)).tolist() == [np.float32(0.3)]
