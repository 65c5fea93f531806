"""Meshes with their light as a texture, in packages of USD: archive, texture, and what USD's own reader finds."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from isogi_core.errors import VolumeError
from isogi_core.files.light_files import (
    BLOCK_TEXELS,
    MAX_TEXTURE_SIDE,
    LitMesh,
    light_texture,
    texture_places,
    usdz_package,
)
from server.exports.lit_files import usdz_bytes

RNG = np.random.default_rng(7)
VERTICES = np.array([[1e5, 0.0, 3.0], [1e5 + 1, 0.0, 3.0], [1e5 + 1, 2.0, 3.5], [1e5, 2.0, 7.0], [1e5, 4.0, 7.0]])
QUADS = np.array([[0, 1, 2, 3], [3, 2, 4, 4], [0, 3, 2, 1]])
MESH = LitMesh(VERTICES, np.tile([0.0, 0.0, 1.0], (5, 1)), RNG.random((5, 3)), QUADS, "mm")


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
    x, y = places[:, 0] * width - 0.5, (1.0 - places[:, 1]) * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = (x - column)[:, None], (y - row)[:, None]
    top = (1 - a) * texture[row, column] + a * texture[row, column + 1]
    return (1 - b) * top + b * ((1 - a) * texture[row + 1, column] + a * texture[row + 1, column + 1])


@pytest.mark.parametrize("count", [1, 2, 5, 37])
def test_a_texture_has_the_light_of_corners_and_between(count: int) -> None:
    quads = RNG.integers(0, 5, (count, 4))
    mesh = LitMesh(VERTICES, VERTICES, MESH.colours, quads)
    texture, places = light_texture(mesh).astype(float), texture_places(count)
    share = MESH.colours[quads]
    expected = 255 * np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)
    for corner in range(4):
        np.testing.assert_allclose(bilinear(texture, places[:, corner]), expected[:, corner], atol=0.51)
    middle = bilinear(texture, places.mean(axis=1))
    np.testing.assert_allclose(middle, expected.mean(axis=1), atol=0.51)


def test_a_texture_too_large_for_any_card_is_refused() -> None:
    count = (MAX_TEXTURE_SIDE // BLOCK_TEXELS) ** 2 + 1
    mesh = LitMesh(VERTICES, VERTICES, MESH.colours, np.broadcast_to(QUADS[:1], (count, 4)))
    with pytest.raises(VolumeError, match="too large"):
        light_texture(mesh)


def test_usd_itself_finds_mesh_texture_and_place(tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom, UsdShade

    (tmp_path / "a.usdz").write_bytes(usdz_bytes(MESH))
    stage = usd.Stage.Open(str(tmp_path / "a.usdz"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1e-3 and UsdGeom.GetStageUpAxis(stage) == "Y"
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Isosurface/Surface"))
    assert UsdGeom.Mesh.ValidateTopology(mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetFaceVertexCountsAttr().Get(), 5)
    np.testing.assert_array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4), QUADS)
    placing = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(mesh.GetPrim()))
    points = np.column_stack([np.array(mesh.GetPointsAttr().Get(), float), np.ones(5)]) @ placing
    upright = np.column_stack([VERTICES[:, 0], VERTICES[:, 2], -VERTICES[:, 1]])
    np.testing.assert_allclose(points[:, :3], upright, atol=1e-5)
    places = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    np.testing.assert_allclose(np.array(places.Get()).reshape(-1, 4, 2), texture_places(3), atol=1e-6)
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    texture = UsdShade.Shader(stage.GetPrimAtPath(material.GetPath().AppendChild("Texture")))
    assert texture.GetInput("file").Get().path == "light.png"


def test_the_validators_of_usd_find_nothing(tmp_path: Path) -> None:
    validation = pytest.importorskip("pxr.UsdValidation")
    from pxr import Usd

    (tmp_path / "a.usdz").write_bytes(usdz_bytes(MESH))
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    errors = validation.ValidationContext(validators).Validate(Usd.Stage.Open(str(tmp_path / "a.usdz")))
    assert len(validators) > 20 and [error.GetMessage() for error in errors] == []


def test_a_package_holds_the_texture_as_png() -> None:
    with zipfile.ZipFile(io.BytesIO(usdz_bytes(MESH))) as archive:
        assert archive.read("isosurface.usda").startswith(b"#usda 1.0\n")
        picture = np.asarray(Image.open(io.BytesIO(archive.read("light.png"))))
    np.testing.assert_array_equal(picture, light_texture(MESH))
