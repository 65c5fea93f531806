"""MetaImage and VTI, by libraries that may be missing: several numbers a voxel, lines that end as
on other systems.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files import grid as grid_module
from isogi_core.files.formats.opening import open_file
from tests.files.formats.phantom import letter
from tests.loaded import load_scene

F = letter()
FIELDS = np.stack([F, F + 1, F * 2], axis=-1)


def metaimage(path: Path, array: np.ndarray, end: str = "\n", **changes: Any) -> Path:
    """An image of int16, of one or several numbers a voxel."""
    pytest.importorskip("SimpleITK")
    nz, ny, nx, *each = array.shape
    lines = {"ObjectType": "Image", "NDims": 3, "BinaryData": True, "BinaryDataByteOrderMSB": False}
    lines |= {
        "DimSize": f"{nx} {ny} {nz}",
        "ElementSpacing": "1 1.25 1.5",
        "ElementType": "MET_SHORT",
    }
    if each:
        lines |= {"ElementNumberOfChannels": each[0]}
    lines |= changes
    if lines["BinaryDataByteOrderMSB"]:
        order = ">i2"
    else:
        order = "<i2"
    body = array.astype(order).tobytes()
    if path.suffix == ".mha":
        name = "LOCAL"
    else:
        name = "beside it.raw"
    header = (
        end.join(f"{key} = {value}" for key, value in {**lines, "ElementDataFile": name}.items())
        + end
    )
    path.write_bytes(header.encode() + (body if name == "LOCAL" else b""))
    if name != "LOCAL":
        (path.parent / name).write_bytes(body)
    return path


def vti(path: Path, array: np.ndarray, of_cells: bool = False) -> Path:
    """An image of VTK, of one or several numbers a point or a cell."""
    pytest.importorskip("vtk")
    writer = import_module("vtkmodules.vtkIOXML").vtkXMLImageDataWriter()
    image = import_module("vtkmodules.vtkCommonDataModel").vtkImageData()
    nz, ny, nx, *each = array.shape
    image.SetDimensions(*(n + of_cells for n in (nx, ny, nz)))
    image.SetSpacing(1.0, 1.25, 1.5)
    image.SetOrigin(10.0, 0.0, -3.0)
    values = import_module("vtkmodules.util.numpy_support").numpy_to_vtk(
        array.reshape(-1, *each), deep=True
    )
    values.SetName("value")
    (image.GetCellData() if of_cells else image.GetPointData()).AddArray(values)
    writer.SetFileName(str(path))
    writer.SetInputData(image)
    writer.Write()
    return path


@pytest.mark.parametrize("size", [1 << 25, 1 << 12])
def test_values_of_cells_are_voxels_at_their_middles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    monkeypatch.setattr(grid_module, "SLAB_BYTES", size)
    grid = open_file(vti(tmp_path / "f.vti", F, of_cells=True), {})
    np.testing.assert_array_equal(grid.whole(), F)
    assert grid.affine is not None and grid.affine.origin == (10.5, 0.625, -2.25)
    (tmp_path / "g.vti").write_text(
        '<VTKFile type="ImageData"><ImageData WholeExtent="0 1 0 1 0 1"/></VTKFile>'
    )
    with pytest.raises(VolumeError, match="holds no array of values"):
        open_file(tmp_path / "g.vti", {})


@pytest.mark.parametrize("write", [metaimage, vti])
def test_one_of_several_numbers_is_chosen(tmp_path: Path, write: Any) -> None:
    path = write(tmp_path / ("f.vti" if write is vti else "f.mha"), FIELDS)
    with pytest.raises(VolumeError, match=r"has 3 channels: choose one by channel = 0 to 2"):
        open_file(path, {})
    for number in range(3):
        np.testing.assert_array_equal(
            open_file(path, {"channel": number}).whole(), FIELDS[..., number]
        )


@pytest.mark.parametrize("suffix", [".mha", ".mhd"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("big", [False, True])
def test_lines_and_bytes_of_other_systems_are_read(
    tmp_path: Path, suffix: str, end: str, big: bool
) -> None:
    folder = tmp_path / "a#1 %41 æøå"
    folder.mkdir()
    path = metaimage(folder / f"an f#2{suffix}", F, end, BinaryDataByteOrderMSB=big)
    np.testing.assert_array_equal(open_file(path, {}).whole(), F)


@pytest.mark.parametrize("steps", ["0 1 1", "nan 1 1", "inf 1 1"])
def test_spacing_that_cannot_be_is_refused(tmp_path: Path, steps: str) -> None:
    path = metaimage(tmp_path / "f.mha", F, ElementSpacing=steps)
    with pytest.raises(VolumeError, match=r"spacing|cannot be read|no direction"):
        load_scene(path)


def rectilinear(path: Path, z: np.ndarray) -> Path:
    """A rectilinear grid of VTK, with coordinates along z."""
    pytest.importorskip("vtk")
    convert = import_module("vtkmodules.util.numpy_support").numpy_to_vtk
    made = import_module("vtkmodules.vtkCommonDataModel").vtkRectilinearGrid()
    nz, ny, nx = F.shape
    made.SetDimensions(nx, ny, nz)
    made.SetXCoordinates(convert(5.0 + np.arange(nx), deep=1))
    made.SetYCoordinates(convert(2.0 * np.arange(ny), deep=1))
    made.SetZCoordinates(convert(z, deep=1))
    values = convert(F.ravel(), deep=1)
    values.SetName("value")
    made.GetPointData().AddArray(values)
    writer = import_module("vtkmodules.vtkIOXML").vtkXMLRectilinearGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(made)
    writer.Write()
    return path


def test_rectilinear_grids_lie_by_their_coordinates(tmp_path: Path) -> None:
    grid = open_file(rectilinear(tmp_path / "f.vtr", 0.5 * np.arange(len(F))), {})
    np.testing.assert_array_equal(grid.whole(), F)
    assert tuple(grid.spacing) == (1.0, 2.0, 0.5)
    assert grid.affine is not None and grid.affine.origin == (5.0, 0.0, 0.0)
    uneven = open_file(rectilinear(tmp_path / "f.vtr", 1.5 ** np.arange(len(F))), {})
    assert tuple(uneven.spacing) == (1.0, 1.0, 1.0) and "are uneven" in uneven.notes[0]


def test_pieces_of_an_image_are_one(tmp_path: Path) -> None:
    path = vti(tmp_path / "f.vti", F)
    text = path.read_bytes()
    head = text[: text.index(b"<ImageData")]
    extent = b"0 %d 0 %d 0 %d" % tuple(n - 1 for n in F.shape[::-1])
    listed = (
        head.replace(b'type="ImageData"', b'type="PImageData"')
        + b'<PImageData WholeExtent="%s" GhostLevel="0" Origin="0 0 0" Spacing="1 1.25 1.5">'
        b'<PPointData><PDataArray type="Int16" Name="value"/></PPointData>'
        b'<Piece Extent="%s" Source="f.vti"/></PImageData></VTKFile>\n' % (extent, extent)
    )
    (tmp_path / "f.pvti").write_bytes(listed)
    grid = open_file(tmp_path / "f.pvti", {})
    np.testing.assert_array_equal(grid.whole(), open_file(path, {}).whole())
    path.unlink()
    with pytest.raises(VolumeError, match=r"'f.vti' is not there: put it there"):
        open_file(tmp_path / "f.pvti", {})
