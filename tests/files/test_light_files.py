"""Meshes and volumes with their light, as other readers take them."""

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import nrrd
import numpy as np
import pytest
import zarr
from PIL import Image

from isogi_core.errors import VolumeError
from isogi_core.files.light_files import (
    LitMesh,
    LitVolume,
    glb_bytes,
    light_texture,
    nifti_bytes,
    nrrd_bytes,
    obj_bytes,
    ply_bytes,
    texture_places,
    usdz_package,
    vti_bytes,
    write_zarr,
)
from isogi_core.files.zarr_volume import open_zarr
from isogi_server.exports.lit_files import usdz_bytes

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
VERTICES = np.array([[1e5, 0.0, 3.0], [1e5 + 1, 2.0, 3.0], [1e5, 2.0, 3.5], [1e5, 0.0, 7.0]])
COLOURS = np.array([[0.0, 0.5, 1.0], [0.2, 0.2, 0.2], [2.0, 0.0, 0.001], [1.0, 1.0, 1.0]])
MESH = LitMesh(VERTICES, np.tile([0.0, 0.0, 1.0], (4, 1)), COLOURS, np.array([[0, 1, 2, 3]]))


def test_ply_has_its_colours_in_srgb() -> None:
    head, _, body = ply_bytes(MESH).partition(b"end_header\n")
    assert b"element vertex 4\n" in head and b"element face 2\n" in head
    points = np.frombuffer(body, [("place", "<f4", 6), ("colour", "u1", 3)], 4)
    np.testing.assert_allclose(points["place"][:, :3], VERTICES, rtol=1e-6)
    assert points["colour"].tolist() == [
        [0, 188, 255],
        [124, 124, 124],
        [255, 0, 3],
        [255, 255, 255],
    ]
    faces = np.frombuffer(body, [("count", "u1"), ("corners", "<i4", 3)], 2, points.nbytes)
    np.testing.assert_array_equal(faces["corners"], MESH.triangles)


def test_glb_is_unlit_linear_and_upright() -> None:
    data = glb_bytes(MESH)
    magic, version, size, length, kind = np.frombuffer(data, "<u4", 5).tolist()
    assert (magic, version, size, kind) == (0x46546C67, 2, len(data), 0x4E4F534A)
    document = json.loads(data[20 : 20 + length])
    assert document["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    binary = data[28 + length :]
    assert (
        len(binary)
        == np.frombuffer(data, "<u4", 1, 20 + length)[0]
        >= document["buffers"][0]["byteLength"]
    )

    def read(number: int, kind: str) -> np.ndarray:
        view = document["bufferViews"][document["accessors"][number]["bufferView"]]
        return np.frombuffer(
            binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]], kind
        ).reshape(-1, 3)

    np.testing.assert_allclose(read(2, "<f4"), np.clip(COLOURS, 0, 1), rtol=1e-6)
    np.testing.assert_array_equal(read(3, "<u4"), MESH.triangles)
    x, y, z, w = document["nodes"][0]["rotation"]
    turn = np.array([[1, 0, 0], [0, w * w - x * x, -2 * x * w], [0, 2 * x * w, w * w - x * x]])
    assert (y, z) == (0, 0)
    placed = read(0, "<f4") @ turn.T + document["nodes"][0]["translation"]
    np.testing.assert_allclose(
        placed, np.column_stack([VERTICES[:, 0], VERTICES[:, 2], -VERTICES[:, 1]]), atol=1e-5
    )


def test_obj_has_its_colours_behind_the_vertices() -> None:
    rows = [line.split() for line in obj_bytes(MESH).decode().splitlines()]
    found = {kind: [row[1:] for row in rows if row[0] == kind] for kind in ("v", "vn", "f")}
    points = np.array(found["v"], float)
    np.testing.assert_allclose(points[:, :3], VERTICES, rtol=1e-6)
    np.testing.assert_allclose(points[0, 3:], [0, 188 / 255, 1], atol=1e-4)
    assert found["vn"][0] == ["0", "0", "1"]
    assert found["f"] == [["1//1", "2//2", "3//3"], ["1//1", "3//3", "4//4"]]


# --- packages of USD
# --------------------------------------------------------------------------------------------------


RNG = np.random.default_rng(7)
CORNERS = np.array(
    [[1e5, 0.0, 3.0], [1e5 + 1, 0.0, 3.0], [1e5 + 1, 2.0, 3.5], [1e5, 2.0, 7.0], [1e5, 4.0, 7.0]]
)
QUADS = np.array([[0, 1, 2, 3], [3, 2, 4, 4], [0, 3, 2, 1]])
QUAD_MESH = LitMesh(CORNERS, np.tile([0.0, 0.0, 1.0], (5, 1)), RNG.random((5, 3)), QUADS, "mm")


def test_files_of_a_package_are_stored_and_aligned() -> None:
    files = {"a.usda": b"#usda 1.0\n", "light.png": bytes(range(100)), "b": b""}
    package = usdz_package(files)
    with zipfile.ZipFile(io.BytesIO(package)) as archive:
        assert archive.testzip() is None and archive.namelist() == list(files)
        for entry in archive.infolist():
            name, extra = np.frombuffer(package, "<u2", 2, entry.header_offset + 26).tolist()
            start = entry.header_offset + 30 + name + extra
            assert start % 64 == 0 and entry.compress_type == zipfile.ZIP_STORED
            assert package[start : start + entry.file_size] == files[entry.filename]


def bilinear(texture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """A texture at places u, v (n, 2) from its lower left, filtered as graphics processors do."""
    height, width = texture.shape[:2]
    x = places[:, 0] * width - 0.5
    y = (1.0 - places[:, 1]) * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = (x - column)[:, None], (y - row)[:, None]
    top = (1 - a) * texture[row, column] + a * texture[row, column + 1]
    return (1 - b) * top + b * (
        (1 - a) * texture[row + 1, column] + a * texture[row + 1, column + 1]
    )


@pytest.mark.parametrize("count", [1, 2, 5, 37])
def test_a_texture_has_the_light_of_corners_and_between(count: int) -> None:
    quads = RNG.integers(0, 5, (count, 4))
    mesh = LitMesh(CORNERS, CORNERS, QUAD_MESH.colours, quads)
    texture = light_texture(mesh).astype(float)
    places = texture_places(count)
    share = QUAD_MESH.colours[quads]
    expected = 255 * np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)
    for corner in range(4):
        np.testing.assert_allclose(
            bilinear(texture, places[:, corner]), expected[:, corner], atol=0.51
        )
    middle = bilinear(texture, places.mean(axis=1))
    np.testing.assert_allclose(middle, expected.mean(axis=1), atol=0.51)


def test_a_texture_too_large_for_any_card_is_refused() -> None:
    # Four texels along each side of a face, and 16384 along each side of the texture.
    count = 4096**2 + 1
    mesh = LitMesh(CORNERS, CORNERS, QUAD_MESH.colours, np.broadcast_to(QUADS[:1], (count, 4)))
    with pytest.raises(VolumeError, match="too large"):
        light_texture(mesh)


def test_usd_itself_finds_mesh_texture_and_place(tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom, UsdShade

    (tmp_path / "a.usdz").write_bytes(usdz_bytes(QUAD_MESH))
    stage = usd.Stage.Open(str(tmp_path / "a.usdz"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1e-3 and UsdGeom.GetStageUpAxis(stage) == "Y"
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Isosurface/Surface"))
    assert UsdGeom.Mesh.ValidateTopology(
        mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetFaceVertexCountsAttr().Get(), 5
    )
    np.testing.assert_array_equal(
        np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4), QUADS
    )
    placing = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(mesh.GetPrim()))
    points = np.column_stack([np.array(mesh.GetPointsAttr().Get(), float), np.ones(5)]) @ placing
    upright = np.column_stack([CORNERS[:, 0], CORNERS[:, 2], -CORNERS[:, 1]])
    np.testing.assert_allclose(points[:, :3], upright, atol=1e-5)
    places = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    np.testing.assert_allclose(
        np.array(places.Get()).reshape(-1, 4, 2), texture_places(3), atol=1e-6
    )
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    texture = UsdShade.Shader(stage.GetPrimAtPath(material.GetPath().AppendChild("Texture")))
    assert texture.GetInput("file").Get().path == "light.png"


def test_the_validators_of_usd_find_nothing(tmp_path: Path) -> None:
    validation = pytest.importorskip("pxr.UsdValidation")
    from pxr import Usd

    (tmp_path / "a.usdz").write_bytes(usdz_bytes(QUAD_MESH))
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    errors = validation.ValidationContext(validators).Validate(
        Usd.Stage.Open(str(tmp_path / "a.usdz"))
    )
    assert len(validators) > 20 and [error.GetMessage() for error in errors] == []


def test_a_package_holds_the_texture_as_png() -> None:
    with zipfile.ZipFile(io.BytesIO(usdz_bytes(QUAD_MESH))) as archive:
        assert archive.read("isosurface.usda").startswith(b"#usda 1.0\n")
        picture = np.asarray(Image.open(io.BytesIO(archive.read("light.png"))))
    np.testing.assert_array_equal(picture, light_texture(QUAD_MESH))


# --- volumes
# --------------------------------------------------------------------------------------------------


VALUE = np.arange(24.0).reshape(2, 3, 4)
LIGHT = np.random.default_rng(3).random((2, 3, 4, 3))
AFFINE = np.column_stack([TURN * (1.0, 2.0, 0.5), (5.0, -6.0, 7.0)])
LIT = LitVolume({"value": VALUE, "light": LIGHT}, AFFINE, "mm")
TOGETHER = np.concatenate([VALUE[..., None], LIGHT], axis=-1)


def test_vti_is_read_by_vtk_where_it_lies(tmp_path: Path) -> None:
    vtk = pytest.importorskip("vtk")
    from vtk.util import numpy_support

    from isogi_core.files.formats.opening import open_file

    colour = (255 * LIGHT).astype(np.uint8)
    (tmp_path / "a.vti").write_bytes(vti_bytes(LitVolume({**LIT.arrays, "colour": colour}, AFFINE)))
    grid = open_file(tmp_path / "a.vti", {})
    np.testing.assert_array_equal(grid.whole(), VALUE)
    assert grid.affine is not None
    np.testing.assert_allclose(grid.affine.array, AFFINE)
    reader = vtk.vtkXMLImageDataReader()
    reader.SetFileName(str(tmp_path / "a.vti"))
    reader.Update()
    found = numpy_support.vtk_to_numpy(reader.GetOutput().GetPointData().GetArray("colour"))
    assert found.dtype == np.uint8 and np.array_equal(found, colour.reshape(-1, 3))


def test_nrrd_holds_values_and_light_together(tmp_path: Path) -> None:
    (tmp_path / "a.nrrd").write_bytes(nrrd_bytes(LIT))
    assert b"space: right-anterior-superior" in nrrd_bytes(replace(LIT, patient=True))
    found, header = nrrd.read(str(tmp_path / "a.nrrd"), index_order="C")
    np.testing.assert_allclose(found, TOGETHER, rtol=1e-6)
    np.testing.assert_allclose(header["space directions"][1:], AFFINE[:, :3].T)
    np.testing.assert_allclose(header["space origin"], AFFINE[:, 3])


def test_nifti_is_a_vector_image_in_millimetres(tmp_path: Path) -> None:
    nib = pytest.importorskip("nibabel")
    (tmp_path / "a.nii.gz").write_bytes(nifti_bytes(LIT))
    image = nib.load(tmp_path / "a.nii.gz")
    np.testing.assert_allclose(
        image.get_fdata()[:, :, :, 0].transpose(2, 1, 0, 3), TOGETHER, rtol=1e-6
    )
    np.testing.assert_allclose(image.affine[:3], AFFINE)
    assert image.header.get_intent()[0] == "vector" and image.header.get_xyzt_units()[0] == "mm"


def test_ome_zarr_lies_along_the_worlds_axes(tmp_path: Path) -> None:
    write_zarr(tmp_path / "a.zarr", LIT)
    image = zarr.open_group(tmp_path / "a.zarr", mode="r").attrs["ome"]
    (entry,) = image["multiscales"][0]["datasets"]  # type: ignore[index, call-overload]
    (_, *scale), (_, *place) = (each[each["type"]] for each in entry["coordinateTransformations"])  # type: ignore[index, call-overload]
    for index in np.ndindex(2, 3, 4):
        there = AFFINE @ [*index[::-1], 1.0]
        at = np.rint((there[::-1] - place) / scale).astype(int)  # type: ignore[operator]
        found = [open_zarr(tmp_path / "a.zarr", channel=c).whole()[tuple(at)] for c in (0, 3)]
        np.testing.assert_allclose(found, TOGETHER[index][[0, 3]], rtol=1e-6)
    with pytest.raises(VolumeError, match="is there already"):
        write_zarr(tmp_path / "a.zarr", LIT)


def test_ome_zarr_says_no_oblique_turns(tmp_path: Path) -> None:
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    with pytest.raises(VolumeError, match="obliquely"):
        write_zarr(tmp_path / "a.zarr", LitVolume(LIT.arrays, np.column_stack([turn, np.zeros(3)])))
    assert not any(tmp_path.iterdir())
