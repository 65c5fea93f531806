"""Meshes of isosurfaces: on the trilinear surface, closed, and anticlockwise from outside."""

import numpy as np
import pytest

from isogi_core.model.volume import make_volume
from isogi_core.prepared.isosurface_mesh import Mesh, isosurface_mesh, vertex_count

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
    """The volume that is enclosed by triangles, positive where they are anticlockwise from outside."""
    a, b, c = (mesh.vertices[triangles_of(mesh)[:, n]].astype(float) for n in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("solid", ["above", "below"])
def test_a_ball_is_closed_and_faces_outwards(solid: str) -> None:
    mesh = mesh_of(ball(), 0.0, solid)
    assert enclosed(mesh) == pytest.approx((1 if solid == "above" else -1) * 4 / 3 * np.pi * RADIUS**3, rel=0.02)
    triangles = triangles_of(mesh)
    sides = np.sort(np.concatenate([triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1)
    _, counts = np.unique(sides, axis=0, return_counts=True)
    assert (counts == 2).all()
    assert len(mesh.vertices) - len(counts) + len(triangles) == 2  # Euler


def test_vertices_lie_on_the_trilinear_surface() -> None:
    values = ball()
    mesh = mesh_of(values, 1.5)
    cell = np.minimum(np.floor(mesh.vertices).astype(int), np.array(values.shape[::-1]) - 2)
    share, found = mesh.vertices - cell, np.zeros(len(mesh.vertices))
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
