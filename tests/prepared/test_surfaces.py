"""Isosurfaces: what rays meet at an isovalue, meshes, and area and volume against closed forms."""

from itertools import pairwise

import numpy as np
import pytest

import isogi_core.prepared.isosurface_mesh as module
from isogi_core.model.volume import Isovalue, make_volume
from isogi_core.prepared.isosurface_mesh import (
    Mesh,
    SurfaceSize,
    isosurface_mesh,
    surface_size,
    vertex_count,
)
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.frame.conftest import scene_of

VALUES = np.random.default_rng(4).integers(100, 4000, (9, 10, 11))


def test_near_surfaces_share_cells_until_forgotten() -> None:
    prepared = PreparedScene(scene_of(make_volume(VALUES), 2000.0))
    one, other = prepared.surface(2000.0), prepared.surface(2001.0)
    field, cells, isovalue = one.traced()
    assert field is prepared.field and isovalue == one.isovalue
    assert other.cells() is cells
    prepared.maps.forget()
    assert one.cells() is not cells


# --- meshes
# --------------------------------------------------------------------------------------------------


RADIUS = 7.3


def ball() -> np.ndarray:
    z, y, x = np.mgrid[:20, :22, :24] - np.array([9.6, 10.3, 11.1])[:, None, None, None]
    return RADIUS - np.sqrt(x**2 + y**2 + z**2)


def mesh_of(values: np.ndarray, isovalue: float, solid: str = "above") -> Mesh:
    volume = make_volume(values.astype(np.float32), solid=solid)
    return isosurface_mesh(volume.voxels, volume.normalise_isovalue(isovalue))


def triangles_of(mesh: Mesh) -> np.ndarray:
    return np.concatenate([mesh.quads[:, [0, 1, 2]], mesh.quads[:, [0, 2, 3]]])


def enclosed(mesh: Mesh) -> float:
    """The volume that is enclosed by triangles, positive where they are anticlockwise from
    outside.
    """
    a, b, c = (mesh.vertices[triangles_of(mesh)[:, n]].astype(float) for n in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("solid", ["above", "below"])
def test_a_ball_is_closed_and_faces_outwards(solid: str) -> None:
    mesh = mesh_of(ball(), 0.0, solid)
    assert enclosed(mesh) == pytest.approx(
        (1 if solid == "above" else -1) * 4 / 3 * np.pi * RADIUS**3, rel=0.02
    )
    triangles = triangles_of(mesh)
    sides = np.sort(
        np.concatenate([triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1
    )
    _, counts = np.unique(sides, axis=0, return_counts=True)
    assert (counts == 2).all()
    assert len(mesh.vertices) - len(counts) + len(triangles) == 2  # Euler


def test_vertices_lie_on_the_trilinear_surface() -> None:
    values = ball()
    mesh = mesh_of(values, 1.5)
    cell = np.minimum(np.floor(mesh.vertices).astype(int), np.array(values.shape[::-1]) - 2)
    share = mesh.vertices - cell
    found = np.zeros(len(mesh.vertices))
    for x, y, z in np.ndindex(2, 2, 2):
        weight = np.where(np.array([x, y, z]) == 1, share, 1.0 - share).prod(axis=1)
        found += weight * values[cell[:, 2] + z, cell[:, 1] + y, cell[:, 0] + x]
    np.testing.assert_allclose(found, 1.5, atol=2e-3)
    volume = make_volume(values.astype(np.float32))
    assert vertex_count(volume.voxels, volume.normalise_isovalue(1.5)) == len(mesh.vertices)


def test_there_is_no_surface_beside_a_hole_or_beyond_the_values() -> None:
    values = ball()
    values[9, 10, 17] = np.nan
    mesh = mesh_of(values, 0.0)
    assert np.abs(mesh.vertices - (17, 10, 9)).max(axis=1).min() >= 1.0
    assert len(mesh.quads) and not len(mesh_of(ball(), 100.0).quads)


# --- area and volume
# --------------------------------------------------------------------------------------------------


SHEAR = np.array([[0.8, 0.2, 0.0], [0.0, 1.1, -0.3], [0.1, 0.0, 1.4]])
EVEN = np.eye(3)
SHAPE = (26, 25, 24)


def places(matrix: np.ndarray = EVEN) -> np.ndarray:
    """World places (nz, ny, nx, 3) of voxels."""
    z, y, x = np.indices(SHAPE).astype(float)
    return np.asarray(np.stack([x, y, z], axis=-1) @ matrix.T)


def size_of(
    values: np.ndarray, isovalue: float, matrix: np.ndarray = EVEN, solid: str = "above"
) -> SurfaceSize:
    volume = make_volume(values.astype(np.float32), solid=solid)
    return surface_size(volume.voxels, volume.normalise_isovalue(isovalue), matrix)


def placed_ball(radius: float, matrix: np.ndarray) -> np.ndarray:
    """How deep voxels are in a ball around a place beside the middle, in the world."""
    at = places(matrix)
    return radius - np.linalg.norm(at - at.reshape(-1, 3).mean(axis=0) - 0.17, axis=-1)


@pytest.mark.parametrize(
    "matrix", [EVEN, SHEAR, np.diag([1.0, -1.0, 1.0])], ids=["plain", "sheared", "mirrored"]
)
@pytest.mark.parametrize("radius", [3.1, 5.4, 7.9])
def test_a_ball_is_as_large_as_its_errors_say(radius: float, matrix: np.ndarray) -> None:
    size = size_of(placed_ball(radius, matrix), 0.0, matrix)
    area = 4 * np.pi * radius**2
    volume = 4 / 3 * np.pi * radius**3
    assert abs(size.area - area) < 1.6 * size.area_error < 0.1 * area
    assert abs(size.volume - volume) < 1.6 * size.volume_error < 0.16 * volume
    assert not size.is_open


def test_finer_voxels_make_smaller_errors() -> None:
    sizes = [size_of(placed_ball(radius, EVEN), 0.0) for radius in (2.7, 5.4, 10.8)]
    for name in ("area", "volume"):
        shares = [getattr(size, f"{name}_error") / getattr(size, name) for size in sizes]
        assert all(2.5 < coarse / fine < 6.5 for coarse, fine in pairwise(shares)), (
            "four, where steps are halved"
        )


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
    share = at - low
    total = np.zeros(len(at))
    for corner in np.indices((2, 2, 2)).reshape(3, -1).T:
        weight = np.where(corner == 1, share, 1.0 - share).prod(axis=1)
        total += weight * values[tuple((low + corner).T[::-1])]
    return total


def waves() -> np.ndarray:
    """A smooth field of 10 × 9 × 8 voxels."""
    z, y, x = np.indices((10, 9, 8)).astype(float)
    return np.asarray(
        np.cos(0.7 * x + 0.3 * y) + np.cos(0.6 * y - 0.4 * z) + np.cos(0.5 * z + 0.3 * x)
    )


@pytest.mark.parametrize(
    ("values", "off"),
    [(waves(), (0.006, 0.04)), (np.random.default_rng(4).normal(size=(6, 7, 8)), (0.03, 0.08))],
    ids=["smooth", "rough"],
)
def test_fields_agree_with_sums_by_chance(values: np.ndarray, off: tuple[float, float]) -> None:
    """Volume: the share of random places above. Area: a thin shell's volume over its thickness,
    |∇f| counted.
    """
    box = np.array(values.shape[::-1]) - 1.0
    count = 400_000
    thin = 0.03
    step = 1e-5
    at = np.random.default_rng(5).random((count, 3)) * (box - 2 * step) + step
    field = trilinear(values, at)
    near = at[np.abs(field - 0.3) < thin]
    slopes = [
        trilinear(values, near + step * way) - trilinear(values, near - step * way) for way in EVEN
    ]
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
    whole = size_of(placed_ball(7.9, EVEN), 0.0)
    monkeypatch.setattr(module, "MAX_TRIED_CELLS", 150)
    part = size_of(placed_ball(7.9, EVEN), 0.0)
    assert part.area == pytest.approx(whole.area, rel=5e-4)
    assert part.volume == pytest.approx(whole.volume, rel=5e-4)
    assert part != whole


def test_a_plane_between_two_layers_has_its_area() -> None:
    """No layer is left to compare with if every other one is dropped."""
    voxels = np.zeros((2, 5, 5), np.float32)
    voxels[1] = 1.0
    assert surface_size(voxels, Isovalue(0.5), np.eye(3)).area == pytest.approx(16.0)


def test_where_no_surface_is_there_is_no_area() -> None:
    size = size_of(places()[..., 2], 30.0)
    assert (size.area, size.volume, size.is_open) == (0.0, 0.0, False)
    assert size_of(places()[..., 2], -1.0).volume == pytest.approx(23 * 24 * 25)
