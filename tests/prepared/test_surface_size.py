"""Area and volume of isosurfaces: closed forms, sums by chance, and errors that say how far off they are."""

from itertools import pairwise

import numpy as np
import pytest

import isogi_core.prepared.isosurface_mesh as module
from isogi_core.model.volume import make_volume
from isogi_core.prepared.isosurface_mesh import SurfaceSize, surface_size

SHEAR = np.array([[0.8, 0.2, 0.0], [0.0, 1.1, -0.3], [0.1, 0.0, 1.4]])
EVEN = np.eye(3)
SHAPE = (26, 25, 24)


def places(matrix: np.ndarray = EVEN) -> np.ndarray:
    """World places (nz, ny, nx, 3) of voxels."""
    z, y, x = np.indices(SHAPE).astype(float)
    return np.asarray(np.stack([x, y, z], axis=-1) @ matrix.T)


def size_of(values: np.ndarray, isovalue: float, matrix: np.ndarray = EVEN, solid: str = "above") -> SurfaceSize:
    volume = make_volume(values.astype(np.float32), solid=solid)
    return surface_size(volume.voxels, volume.normalise_isovalue(isovalue), matrix)


def ball(radius: float, matrix: np.ndarray) -> np.ndarray:
    """How deep voxels are in a ball around a place beside the middle, in the world."""
    at = places(matrix)
    return radius - np.linalg.norm(at - at.reshape(-1, 3).mean(axis=0) - 0.17, axis=-1)


@pytest.mark.parametrize("matrix", [EVEN, SHEAR, np.diag([1.0, -1.0, 1.0])], ids=["plain", "sheared", "mirrored"])
@pytest.mark.parametrize("radius", [3.1, 5.4, 7.9])
def test_a_ball_is_as_large_as_its_errors_say(radius: float, matrix: np.ndarray) -> None:
    size = size_of(ball(radius, matrix), 0.0, matrix)
    area, volume = 4 * np.pi * radius**2, 4 / 3 * np.pi * radius**3
    assert abs(size.area - area) < 1.6 * size.area_error < 0.1 * area
    assert abs(size.volume - volume) < 1.6 * size.volume_error < 0.16 * volume
    assert not size.is_open


def test_finer_voxels_make_smaller_errors() -> None:
    sizes = [size_of(ball(radius, EVEN), 0.0) for radius in (2.7, 5.4, 10.8)]
    for name in ("area", "volume"):
        shares = [getattr(size, f"{name}_error") / getattr(size, name) for size in sizes]
        assert all(2.5 < coarse / fine < 6.5 for coarse, fine in pairwise(shares)), "four, where steps are halved"


def test_a_plane_is_exact_and_open() -> None:
    """It cuts a box in two: all lengths are known."""
    at = places(SHEAR)
    size = size_of(at[..., 0] + 2.0 * at[..., 1] - at[..., 2], 7.0, SHEAR)
    assert size.is_open
    assert size.area_error < 1e-3 and size.volume_error < 1e-2, "float32 alone"
    flat = size_of(places()[..., 2], 10.25)
    assert flat.area == pytest.approx(23 * 24, rel=1e-5)
    assert flat.volume == pytest.approx(23 * 24 * 14.75, rel=1e-5)


def test_below_and_above_share_a_surface_and_fill_the_box() -> None:
    values = np.random.default_rng(3).normal(size=(9, 8, 7))
    above, below = (size_of(values, 0.2, solid=solid) for solid in ("above", "below"))
    assert above.area == pytest.approx(below.area, rel=1e-5)
    assert above.volume + below.volume == pytest.approx(8 * 7 * 6, rel=1e-5)


def trilinear(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The field at places (n, 3; x, y, z in voxels), from its definition."""
    low = np.minimum(at.astype(int), np.array(values.shape)[::-1] - 2)
    share, total = at - low, np.zeros(len(at))
    for corner in np.indices((2, 2, 2)).reshape(3, -1).T:
        weight = np.where(corner == 1, share, 1.0 - share).prod(axis=1)
        total += weight * values[tuple((low + corner).T[::-1])]
    return total


def waves() -> np.ndarray:
    """A smooth field of 10 × 9 × 8 voxels."""
    z, y, x = np.indices((10, 9, 8)).astype(float)
    return np.asarray(np.cos(0.7 * x + 0.3 * y) + np.cos(0.6 * y - 0.4 * z) + np.cos(0.5 * z + 0.3 * x))


@pytest.mark.parametrize(
    ("values", "off"),
    [(waves(), (0.006, 0.04)), (np.random.default_rng(4).normal(size=(6, 7, 8)), (0.03, 0.08))],
    ids=["smooth", "rough"],
)
def test_fields_agree_with_sums_by_chance(values: np.ndarray, off: tuple[float, float]) -> None:
    """Volume: the share of random places above. Area: a thin shell's volume over its thickness, |∇f| counted."""
    box, count, thin, step = np.array(values.shape[::-1]) - 1.0, 400_000, 0.03, 1e-5
    at = np.random.default_rng(5).random((count, 3)) * (box - 2 * step) + step
    field = trilinear(values, at)
    near = at[np.abs(field - 0.3) < thin]
    slopes = [trilinear(values, near + step * way) - trilinear(values, near - step * way) for way in EVEN]
    area = box.prod() * (np.linalg.norm(slopes, axis=0) / (2 * step)).sum() / count / (2 * thin)
    found = size_of(values, 0.3)
    assert found.volume == pytest.approx(box.prod() * (field > 0.3).mean(), rel=off[0])
    assert found.area == pytest.approx(area, rel=off[1])


def test_cells_beside_a_hole_are_left_out() -> None:
    values = places()[..., 2]
    whole = size_of(values, 10.25)
    values[10:12, 5, 6] = np.nan
    holed = size_of(values, 10.25)
    assert holed.area == pytest.approx(whole.area - 4.0, abs=1e-3)
    assert holed.volume == pytest.approx(whole.volume - 4 * (0.75 + 1.0), abs=1e-2)


def test_some_cells_stand_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = size_of(ball(7.9, EVEN), 0.0)
    monkeypatch.setattr(module, "MAX_TRIED_CELLS", 150)
    part = size_of(ball(7.9, EVEN), 0.0)
    assert part.area == pytest.approx(whole.area, rel=5e-4)
    assert part.volume == pytest.approx(whole.volume, rel=5e-4)
    assert part != whole


def test_where_no_surface_is_there_is_no_area() -> None:
    size = size_of(places()[..., 2], 30.0)
    assert (size.area, size.volume, size.is_open) == (0.0, 0.0, False)
    assert size_of(places()[..., 2], -1.0).volume == pytest.approx(23 * 24 * 25)
