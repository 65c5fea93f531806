"""Files of light, as other readers take them: PLY, binary glTF, and VTK's image files."""

import json
from pathlib import Path

import nrrd
import numpy as np
import pytest

from isogi_core.files.light_files import LitMesh, glb_bytes, nrrd_bytes, ply_bytes, vti_bytes

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
VERTICES = np.array([[1e5, 0.0, 3.0], [1e5 + 1, 2.0, 3.0], [1e5, 2.0, 3.5], [1e5, 0.0, 7.0]])
COLOURS = np.array([[0.0, 0.5, 1.0], [0.2, 0.2, 0.2], [2.0, 0.0, 0.001], [1.0, 1.0, 1.0]])
MESH = LitMesh(VERTICES, np.tile([0.0, 0.0, 1.0], (4, 1)), COLOURS, np.array([[0, 1, 2], [0, 2, 3]]))


def test_ply_has_its_colours_in_srgb() -> None:
    head, _, body = ply_bytes(MESH).partition(b"end_header\n")
    assert b"element vertex 4\n" in head and b"element face 2\n" in head
    points = np.frombuffer(body, [("place", "<f4", 6), ("colour", "u1", 3)], 4)
    np.testing.assert_allclose(points["place"][:, :3], VERTICES, rtol=1e-6)
    assert points["colour"].tolist() == [[0, 188, 255], [124, 124, 124], [255, 0, 3], [255, 255, 255]]
    faces = np.frombuffer(body, [("count", "u1"), ("corners", "<i4", 3)], 2, points.nbytes)
    np.testing.assert_array_equal(faces["corners"], MESH.triangles)


def test_glb_is_unlit_linear_and_upright() -> None:
    data = glb_bytes(MESH)
    magic, version, size, length, kind = np.frombuffer(data, "<u4", 5).tolist()
    assert (magic, version, size, kind) == (0x46546C67, 2, len(data), 0x4E4F534A)
    document = json.loads(data[20 : 20 + length])
    assert document["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    binary = data[28 + length :]
    assert len(binary) == np.frombuffer(data, "<u4", 1, 20 + length)[0] >= document["buffers"][0]["byteLength"]

    def read(number: int, kind: str) -> np.ndarray:
        view = document["bufferViews"][document["accessors"][number]["bufferView"]]
        return np.frombuffer(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]], kind).reshape(-1, 3)

    np.testing.assert_allclose(read(2, "<f4"), np.clip(COLOURS, 0, 1), rtol=1e-6)
    np.testing.assert_array_equal(read(3, "<u4"), MESH.triangles)
    x, y, z, w = document["nodes"][0]["rotation"]
    turn = np.array([[1, 0, 0], [0, w * w - x * x, -2 * x * w], [0, 2 * x * w, w * w - x * x]])
    assert (y, z) == (0, 0)
    placed = read(0, "<f4") @ turn.T + document["nodes"][0]["translation"]
    np.testing.assert_allclose(placed, np.column_stack([VERTICES[:, 0], VERTICES[:, 2], -VERTICES[:, 1]]), atol=1e-5)


def test_vti_is_read_by_vtk_where_it_lies(tmp_path: Path) -> None:
    pytest.importorskip("vtk")
    from isogi_core.files.formats.opening import open_file

    value, light = np.arange(24.0).reshape(2, 3, 4), np.random.default_rng(3).random((2, 3, 4, 3))
    affine = np.column_stack([TURN * (1.0, 2.0, 0.5), (5.0, -6.0, 7.0)])
    (tmp_path / "a.vti").write_bytes(vti_bytes({"value": value, "light": light}, affine))
    grid = open_file(tmp_path / "a.vti", {})
    np.testing.assert_array_equal(grid.whole(), value)
    assert grid.affine is not None
    np.testing.assert_allclose(grid.affine.array, affine)


def test_nrrd_holds_values_and_light_together(tmp_path: Path) -> None:
    value, light = np.arange(24.0).reshape(2, 3, 4), np.random.default_rng(3).random((2, 3, 4, 3))
    affine = np.column_stack([TURN * (1.0, 2.0, 0.5), (5.0, -6.0, 7.0)])
    (tmp_path / "a.nrrd").write_bytes(nrrd_bytes({"value": value, "light": light}, affine))
    found, header = nrrd.read(str(tmp_path / "a.nrrd"), index_order="C")
    np.testing.assert_allclose(found, np.concatenate([value[..., None], light], axis=-1), rtol=1e-6)
    np.testing.assert_allclose(header["space directions"][1:], affine[:, :3].T)
    np.testing.assert_allclose(header["space origin"], affine[:, 3])
