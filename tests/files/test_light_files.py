"""Meshes with their light, as other readers take them: PLY, binary glTF and OBJ."""

import json

import numpy as np

from isogi_core.files.light_files import LitMesh, glb_bytes, obj_bytes, ply_bytes

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
VERTICES = np.array([[1e5, 0.0, 3.0], [1e5 + 1, 2.0, 3.0], [1e5, 2.0, 3.5], [1e5, 0.0, 7.0]])
COLOURS = np.array([[0.0, 0.5, 1.0], [0.2, 0.2, 0.2], [2.0, 0.0, 0.001], [1.0, 1.0, 1.0]])
MESH = LitMesh(VERTICES, np.tile([0.0, 0.0, 1.0], (4, 1)), COLOURS, np.array([[0, 1, 2, 3]]))


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


def test_obj_has_its_colours_behind_the_vertices() -> None:
    rows = [line.split() for line in obj_bytes(MESH).decode().splitlines()]
    found = {kind: [row[1:] for row in rows if row[0] == kind] for kind in ("v", "vn", "f")}
    points = np.array(found["v"], float)
    np.testing.assert_allclose(points[:, :3], VERTICES, rtol=1e-6)
    np.testing.assert_allclose(points[0, 3:], [0, 188 / 255, 1], atol=1e-4)
    assert found["vn"][0] == ["0", "0", "1"]
    assert found["f"] == [["1//1", "2//2", "3//3"], ["1//1", "3//3", "4//4"]]
