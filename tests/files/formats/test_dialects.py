"""Dialects of HDF5: what programs write beside their numbers gives data set, axes, spacing and
direction.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file
from isogi_core.files.grid import Grid, on_right_angles
from tests.files.formats.phantom import letter

h5py = pytest.importorskip("h5py")

F = letter().astype(np.float32)
NZ, NY, NX = F.shape


def opened(path: Path, **chosen: Any) -> Grid:
    """The field on right angles."""
    return on_right_angles(open_file(path, chosen))


def lies(grid: Grid) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Spacing and origin of a grid."""
    assert grid.affine is not None
    return tuple(np.round(grid.spacing, 9)), tuple(np.round(grid.affine.origin, 9))


@pytest.mark.parametrize("of_cells", [False, True])
def test_vtkhdf_has_spacing_and_origin(tmp_path: Path, of_cells: bool) -> None:
    with h5py.File(tmp_path / "f.vtkhdf", "w") as file:
        group = file.create_group("VTKHDF")
        group.attrs.create("Type", np.bytes_("ImageData"))
        extent = [5, 5 + NX - 1 + of_cells, 0, NY - 1 + of_cells, 0, NZ - 1 + of_cells]
        group.attrs.update({"WholeExtent": extent, "Origin": [10.0, 20, 30]})
        group.attrs.update({"Spacing": [1.0, 2, 4], "Direction": np.eye(3).ravel()})
        group.create_dataset(f"{'Cell' if of_cells else 'Point'}Data/rho", data=F)
    grid = opened(tmp_path / "f.vtkhdf")
    half = 0.5 * of_cells
    assert lies(grid) == ((1.0, 2.0, 4.0), (15.0 + half, 20.0 + 2 * half, 30.0 + 4 * half))
    np.testing.assert_array_equal(grid.whole(), F)


@pytest.mark.parametrize("timed", [False, True])
def test_vtkhdf_of_four_axes_has_components_or_steps(tmp_path: Path, timed: bool) -> None:
    """Steps come first and are said in a group of their own; components come last."""
    fields = (F, -F, 2 * F)
    with h5py.File(tmp_path / "f.vtkhdf", "w") as file:
        group = file.create_group("VTKHDF")
        group.attrs.create("Type", np.bytes_("ImageData"))
        group.create_dataset("PointData/rho", data=np.stack(fields, 0 if timed else -1))
        if timed:
            group.create_dataset("Steps/Values", data=np.arange(3.0))
    key = "time" if timed else "channel"
    for number, field in enumerate(fields):
        grid = opened(tmp_path / "f.vtkhdf", **{key: number})
        np.testing.assert_array_equal(grid.whole(), field)
        assert grid.moment == ((number, 3) if timed else (0, 1))


def test_vtkhdf_of_a_mesh_is_named(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.vtkhdf", "w") as file:
        file.create_group("VTKHDF").attrs.create("Type", np.bytes_("UnstructuredGrid"))
    with pytest.raises(VolumeError, match="UnstructuredGrid, which is no even grid: resample"):
        opened(tmp_path / "f.vtkhdf")


@pytest.mark.parametrize("labels", ["zyx", "xyz"])
def test_openpmd_names_its_axes(tmp_path: Path, labels: str) -> None:
    steps = {"x": 1.0, "y": 2.0, "z": 4.0}
    with h5py.File(tmp_path / "f.h5", "w") as file:
        data = file.create_dataset(
            "data/100/meshes/E/x", data=F if labels == "zyx" else F.transpose(2, 1, 0)
        )
        data.attrs["position"] = [0.5, 0.0, 0.0]
        data.parent.attrs.update({"geometry": np.bytes_("cartesian"), "gridUnitSI": 1e-6})
        data.parent.attrs["gridSpacing"] = [steps[name] for name in labels]
        data.parent.attrs["gridGlobalOffset"] = [0.0, 0.0, 0.0]
        data.parent.attrs["axisLabels"] = np.array(list(labels), "S1")
    grid = opened(tmp_path / "f.h5")
    start = (0.0, 0.0, 2.0) if labels == "zyx" else (0.5, 0.0, 0.0)
    assert lies(grid) == ((1.0, 2.0, 4.0), start) and grid.unit == "µm"
    np.testing.assert_array_equal(grid.whole(), F)


def test_nexus_names_its_default_signal(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.nxs", "w") as file:
        file.attrs["default"] = "entry"
        group = file.create_group("entry/rec")
        file["entry"].attrs["default"] = "rec"
        file["entry/flats"] = np.ones((4, 5, 6))
        group.attrs.update({"signal": "data", "axes": ["z", "y", "x"]})
        group["data"] = F
        for name, n, step in (("z", NZ, 4.0), ("y", NY, -2.0), ("x", NX, 1.0)):
            group[name] = np.arange(n) * step
    grid = open_file(tmp_path / "f.nxs", {})
    assert tuple(grid.spacing) == (1.0, 2.0, 4.0)
    assert grid.affine is not None and grid.affine.matrix[1] == (0.0, -2.0, 0.0)
    np.testing.assert_array_equal(grid.whole(), F)


def letters(value: object) -> np.ndarray:
    """A text as Imaris keeps it: an array of letters."""
    return np.array([each.encode() for each in str(value)], "S1")


def imaris(path: Path, channels: int) -> Path:
    """An image of Imaris, padded to chunks of 16."""
    with h5py.File(path, "w") as file:
        file.attrs["ImarisDataSet"] = letters("ImarisDataSet")
        file.attrs["DataSetDirectoryName"] = letters("DataSet")
        file.attrs["DataSetInfoDirectoryName"] = letters("DataSetInfo")
        about = file.create_group("DataSetInfo/Image")
        for n, (size, step) in enumerate(((NX, 0.2), (NY, 0.2), (NZ, 0.5))):
            about.attrs[f"ExtMin{n}"] = letters(0)
            about.attrs[f"ExtMax{n}"] = letters(size * step)
        about.attrs["Unit"] = letters("um")
        for level in (0, 1):
            for channel in range(channels):
                part = (F.astype(np.uint16) + channel)[:: 1 + level, :: 1 + level, :: 1 + level]
                group = file.create_group(
                    f"DataSet/ResolutionLevel {level}/TimePoint 0/Channel {channel}"
                )
                for name, n in zip("ZYX", part.shape, strict=True):
                    group.attrs[f"ImageSize{name}"] = letters(n)
                padded = np.zeros([-(-n // 16) * 16 for n in part.shape], np.uint16)
                padded[tuple(map(slice, part.shape))] = part
                group["Data"] = padded
    return path


def test_padding_of_imaris_is_cut_off(tmp_path: Path) -> None:
    path = imaris(tmp_path / "f.ims", 1)
    grid = opened(path)
    assert lies(grid)[0] == (0.2, 0.2, 0.5) and grid.unit == "µm"
    np.testing.assert_array_equal(grid.whole(), F.astype(np.uint16))
    coarse = opened(path, level=1)
    assert lies(coarse)[0] == (0.4, 0.4, 1.0) and coarse.shape == (NZ // 2, NY // 2, NX // 2)
    with pytest.raises(VolumeError, match="has levels 0 to 1, not 2"):
        opened(path, level=2)


def test_a_channel_of_imaris_is_chosen(tmp_path: Path) -> None:
    path = imaris(tmp_path / "f.ims", 2)
    with pytest.raises(VolumeError, match="has 2 channels: choose one"):
        opened(path)
    np.testing.assert_array_equal(opened(path, channel=1).whole(), F.astype(np.uint16) + 1)


BDV_XML = (
    "<SpimData><SequenceDescription><ImageLoader format='bdv.hdf5'><hdf5 type='relative'>f.h5"
    "</hdf5></ImageLoader><ViewSetups><ViewSetup><id>0</id><voxelSize><unit>micrometer</unit>"
    "<size>0.2 0.2 0.5</size></voxelSize></ViewSetup></ViewSetups></SequenceDescription></SpimData>"
)


def bdv(folder: Path) -> Path:
    """An image of BigDataViewer: numbers without a sign, kept as int16."""
    with h5py.File(folder / "f.h5", "w") as file:
        for level, step in ((0, 1), (1, 2)):
            part = (F.astype(np.uint16) * 60)[::step, ::step, ::step]
            file[f"t00000/s00/{level}/cells"] = part.view(np.int16)
        file["s00/resolutions"] = np.array([[1.0, 1, 1], [2, 2, 2]])
    (folder / "f.xml").write_text(BDV_XML)
    return folder / "f.h5"


def test_numbers_of_bigdataviewer_have_no_sign(tmp_path: Path) -> None:
    path = bdv(tmp_path)
    for given in (path, path.with_suffix(".xml")):
        grid = opened(given)
        assert lies(grid)[0] == (0.2, 0.2, 0.5) and grid.dtype == np.uint16
        np.testing.assert_array_equal(grid.whole(), F.astype(np.uint16) * 60)
    assert lies(opened(path, level=1))[0] == (0.4, 0.4, 1.0)
    path.rename(tmp_path / "g.h5")
    with pytest.raises(VolumeError, match=r"'f.h5' with its voxels is not next to it"):
        opened(tmp_path / "f.xml")


def test_steps_of_bigdataviewer_count_from_zero(tmp_path: Path) -> None:
    """The numbers of steps may begin later, and leave some out."""
    with h5py.File(tmp_path / "f.h5", "w") as file:
        for number in (3, 5, 9):
            file[f"t{number:05}/s00/0/cells"] = np.full_like(F, number)
    for time, number in enumerate((3, 5, 9)):
        grid = opened(tmp_path / "f.h5", time=time)
        assert grid.moment == (time, 3) and grid.whole().max() == number


def test_axistags_name_the_axes(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        data = file.create_dataset("exported_data", data=np.stack([F, 1 - F], -1))
        tags = [{"key": key, "resolution": 0.5 if key != "c" else 0} for key in "zyxc"]
        data.attrs["axistags"] = json.dumps({"axes": tags})
    grid = opened(tmp_path / "f.h5", channel=1)
    assert tuple(grid.spacing) == (0.5, 0.5, 0.5)
    np.testing.assert_array_equal(grid.whole(), 1 - F)


def test_hdf5_after_a_block_of_matlab(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.mat", "w", userblock_size=512) as file:
        file.create_dataset("vol", data=F).attrs["MATLAB_class"] = np.bytes_("single")
    with (tmp_path / "f.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    grid = open_file(tmp_path / "f.mat", {})
    assert "first index there is x" in grid.notes[0]
    np.testing.assert_array_equal(grid.whole(), F)


def netcdf(path: Path, data: np.ndarray, axes: list[tuple[str, Any, dict[str, str]]]) -> Path:
    """A file of one variable with coordinates."""
    with h5py.File(path, "w") as file:
        made = file.create_dataset("v", data=data)
        for place, (name, values, attributes) in enumerate(axes):
            file[name] = np.asarray(values, float)
            file[name].attrs.update(attributes)
            file[name].make_scale(name)
            made.dims[place].attach_scale(file[name])
    return path


METRES = {"units": "m"}
Y, X = np.arange(NY), np.arange(NX)


@pytest.mark.parametrize("chunks", [None, (4, 4, 4)])
def test_dimensions_lie_as_they_are_named(tmp_path: Path, chunks: Any) -> None:
    path = tmp_path / "f.nc"
    netcdf(path, F.T, [("x", X, {}), ("y", Y, {}), ("z", 2.0 * np.arange(NZ), {})])
    if chunks:
        with h5py.File(path, "r+") as file:
            scales = [file[name] for name in "xyz"]
            del file["v"]
            made = file.create_dataset("v", data=F.T, chunks=chunks)
            for place, scale in enumerate(scales):
                made.dims[place].attach_scale(scale)
    grid = opened(path)
    assert tuple(grid.spacing) == (1.0, 1.0, 2.0)
    np.testing.assert_array_equal(grid.whole(), F)


@pytest.mark.parametrize("how", [{"positive": "down", "units": "m"}, {"units": "hPa"}])
def test_what_grows_downwards_lies_downwards(tmp_path: Path, how: dict[str, str]) -> None:
    """Of depth, and of pressure, the affine's z axis points down as the index grows."""
    axes = [("lev", 2.0 * np.arange(NZ), how), ("y", Y, how | {"positive": ""}), ("x", X, METRES)]
    axes[1] = ("y", Y, METRES)
    grid = open_file(netcdf(tmp_path / "f.nc", F, axes), {})
    assert grid.affine is not None and grid.affine.matrix[2][2] < 0.0
    np.testing.assert_array_equal(grid.whole(), F)


def test_units_of_length_are_brought_together(tmp_path: Path) -> None:
    axes = [("z", np.arange(NZ), {"units": "km"}), ("y", Y, METRES), ("x", X, METRES)]
    grid = opened(netcdf(tmp_path / "f.nc", F, axes))
    assert tuple(grid.spacing) == (1.0, 1.0, 1000.0) and grid.unit == "m"


def test_degrees_and_metres_are_cubes_with_a_note(tmp_path: Path) -> None:
    lat = {"units": "degrees_north"}
    axes = [("alt", np.arange(NZ), METRES), ("lat", -Y, lat), ("lon", X, {"units": "degrees_east"})]
    grid = open_file(netcdf(tmp_path / "f.nc", F, axes), {})
    assert tuple(grid.spacing) == (1.0, 1.0, 1.0)
    assert grid.affine is not None and grid.affine.matrix[1][1] == -1.0
    assert "taken as cubes, as its axes are in degrees_east, degrees_north, m" in grid.notes[0]
    assert "#spacing=" in grid.notes[0]


def test_spacing_that_is_not_read_is_told(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file.create_dataset("v", data=F).attrs["voxel_size"] = [4.0, 2.0, 1.0]
    grid = open_file(tmp_path / "f.h5", {})
    assert "attribute 'voxel_size', 4, 2, 1, is not read as spacing: #spacing=" in grid.notes[0]


XDMF = (
    '<?xml version="1.0"?><Xdmf><Domain><Grid Name="g"><Topology TopologyType="{kind}"/>'
    '<Geometry GeometryType="ORIGIN_DXDYDZ"><DataItem>3 2 1</DataItem><DataItem>4 2 1</DataItem>'
    '</Geometry><Attribute Name="rho" Center="{center}"><DataItem Format="HDF">x.h5:/a/rho'
    "</DataItem></Attribute></Grid></Domain></Xdmf>"
)


@pytest.mark.parametrize("center", ["Node", "Cell"])
def test_xdmf_names_its_values_and_their_place(tmp_path: Path, center: str) -> None:
    path = tmp_path / "f.xdmf"
    path.write_text(XDMF.format(kind="3DCoRectMesh", center=center))
    with pytest.raises(VolumeError, match=r"'x.h5' with its voxels is not next to it"):
        opened(path)
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["a/rho"] = F
        file["a/other"] = -F
    grid = opened(path)
    half = 0.5 * (center == "Cell")
    assert lies(grid) == ((1.0, 2.0, 4.0), (1.0 + half, 2.0 + 2 * half, 3.0 + 4 * half))
    np.testing.assert_array_equal(grid.whole(), F)
    path.write_text(XDMF.format(kind="3DSMesh", center=center))
    with pytest.raises(VolumeError, match=r"no one even grid .* give the HDF5 file that it names"):
        opened(path)
