"""Volumes with values and light, as other readers take them: VTK's image files, NRRD, NIfTI and OME-Zarr."""

from dataclasses import replace
from pathlib import Path

import nrrd
import numpy as np
import pytest
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.light_volumes import LitVolume, nifti_bytes, nrrd_bytes, vti_bytes, write_zarr
from isogi_core.files.zarr_volume import open_zarr

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
VALUE, LIGHT = np.arange(24.0).reshape(2, 3, 4), np.random.default_rng(3).random((2, 3, 4, 3))
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
    np.testing.assert_allclose(image.get_fdata()[:, :, :, 0].transpose(2, 1, 0, 3), TOGETHER, rtol=1e-6)
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
