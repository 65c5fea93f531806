"""Classic NetCDF, written by SciPy: fields, steps in time, coordinates, and files that are
damaged.
"""

import io
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload
from tests.files.formats.every_kind import write_classic
from tests.files.formats.phantom import letter

pytest.importorskip("nibabel")
pytest.importorskip("scipy")

F = letter()
EVEN = {
    "x": (-5.0 + 0.5 * np.arange(16), "m"),
    "y": (2.0 * np.arange(20), "m"),
    "z": (10.0 + np.arange(12), "m"),
}


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("kind", ["i1", "i2", "i4", "f4", "f8"])
def test_a_field_of_classic_netcdf_is_read(tmp_path: Path, version: int, kind: str) -> None:
    field = (F // 8).astype(kind)
    write_classic(tmp_path / "f.nc", {"v": field}, version)
    np.testing.assert_array_equal(open_file(tmp_path / "f.nc", {}).whole(), field)
    with (tmp_path / "f.nc").open("rb") as file:
        np.testing.assert_array_equal(open_upload(file, "f.nc", 1 << 20).whole(), field)


def test_coordinates_of_classic_netcdf_place_it(tmp_path: Path) -> None:
    write_classic(tmp_path / "f.nc", {"v": F}, x=EVEN["x"], y=EVEN["y"], z=EVEN["z"])
    grid = open_file(tmp_path / "f.nc", {})
    assert (tuple(grid.spacing), grid.unit) == ((0.5, 2.0, 1.0), "m")
    assert grid.affine is not None and grid.affine.origin == (-5.0, 0.0, 10.0)
    assert grid.read_as.endswith("placed by the coordinates of its axes")


def test_levels_that_are_uneven_are_cubes(tmp_path: Path) -> None:
    write_classic(
        tmp_path / "f.nc", {"v": F}, x=EVEN["x"], y=EVEN["y"], z=(1.5 ** np.arange(12), "m")
    )
    grid = open_file(tmp_path / "f.nc", {})
    assert tuple(grid.spacing) == (1.0, 1.0, 1.0)
    assert "taken as cubes, as the coordinates of its axes are uneven: #spacing=" in grid.notes[0]


@pytest.mark.parametrize("step", [0, 2])
def test_records_of_classic_netcdf_are_a_series(tmp_path: Path, step: int) -> None:
    series = np.stack([F, F + 1, F + 2])
    write_classic(
        tmp_path / "f.nc", {"v": series, "w": -series}, t=(np.arange(3.0), "days since 1970-01-01")
    )
    grid = open_file(tmp_path / "f.nc", {"part": "w", "time": step})
    np.testing.assert_array_equal(grid.whole(), -series[step])
    assert grid.moment == (step, 3) and not grid.unchosen
    assert open_file(tmp_path / "f.nc", {"part": "v"}).unchosen


@pytest.mark.parametrize("name", ["time", "days since 1970-01-01"])
@pytest.mark.parametrize("kind", ["classic", "netcdf-4"])
def test_maps_in_time_are_layers_and_it_says_so(tmp_path: Path, kind: str, name: str) -> None:
    unit = "" if name == "time" else name
    if kind == "classic":
        with pytest.importorskip("scipy.io").netcdf_file(tmp_path / "f.nc", "w") as file:
            for dimension, length in zip(
                ("time" if name == "time" else "m", "y", "x"), F.shape, strict=True
            ):
                file.createDimension(dimension, length)
            if unit:
                file.createVariable("m", "f8", ("m",)).units = unit
            file.createVariable("v", F.dtype, ("time" if name == "time" else "m", "y", "x"))[:] = F
    else:
        with pytest.importorskip("h5py").File(tmp_path / "f.nc", "w") as file:
            data = file.create_dataset("v", data=F)
            file.create_dataset("m", data=np.arange(12.0)).attrs["units"] = unit
            file["m"].make_scale("time" if name == "time" else "m")
            data.dims[0].attach_scale(file["m"])
    grid = open_file(tmp_path / "f.nc", {})
    np.testing.assert_array_equal(grid.whole(), F)
    assert grid.notes == ("Its planes are steps in time: they are shown as layers.",)


def test_one_of_several_fields_is_to_be_chosen(tmp_path: Path) -> None:
    write_classic(tmp_path / "f.nc", {"v": F, "w": -F})
    with pytest.raises(
        VolumeError, match=r"holds several volumes: choose of '.*f.nc#v', '.*f.nc#w'"
    ):
        open_file(tmp_path / "f.nc", {})
    with pytest.raises(VolumeError, match="has no volume 'u'"):
        open_file(tmp_path / "f.nc", {"part": "u"})


def test_axes_of_time_alone_are_layers_and_rows(tmp_path: Path) -> None:
    with pytest.importorskip("scipy.io").netcdf_file(tmp_path / "f.nc", "w") as file:
        for name, length in zip(("year", "month", "lon"), F.shape, strict=True):
            file.createDimension(name, length)
        file.createVariable("v", "f4", ("year", "month", "lon"))[:] = F
    grid = open_file(tmp_path / "f.nc", {})
    np.testing.assert_array_equal(grid.whole(), F)
    assert grid.notes == ("Its planes are steps in time: they are shown as layers.",)


def test_a_file_without_a_field_is_named(tmp_path: Path) -> None:
    with pytest.importorskip("h5py").File(tmp_path / "f.h5", "w") as file:
        file["mesh/points"] = np.zeros((5, 3))
    with pytest.raises(VolumeError, match="no dataset of three axes or more: give a file that"):
        open_file(tmp_path / "f.h5", {})


def test_months_are_steps_in_time(tmp_path: Path) -> None:
    with pytest.importorskip("scipy.io").netcdf_file(tmp_path / "f.nc", "w") as file:
        for name, length in zip(("month", "level", "lat", "lon"), (2, *F.shape), strict=True):
            file.createDimension(name, length)
        file.createVariable("u", "f4", ("month", "level", "lat", "lon"))[:] = np.stack([F, -F])
    grid = open_file(tmp_path / "f.nc", {"time": 1})
    np.testing.assert_array_equal(grid.whole(), -F)


def test_the_only_field_in_space_needs_no_choice(tmp_path: Path) -> None:
    with pytest.importorskip("scipy.io").netcdf_file(tmp_path / "f.nc", "w") as file:
        for name, length in zip(("time", "lev", "lat", "lon"), (2, *F.shape), strict=True):
            file.createDimension(name, length)
        for name, dimensions in (
            ("ta", ("time", "lev", "lat", "lon")),
            ("ps", ("time", "lat", "lon")),
        ):
            made = file.createVariable(name, "f4", dimensions)
            made[:] = np.broadcast_to(F if name == "ta" else F[0], made.shape)
    grid = open_file(tmp_path / "f.nc", {})
    np.testing.assert_array_equal(grid.whole(), F)
    assert grid.moment == (0, 2) and grid.unchosen


def test_what_nobody_wrote_is_a_hole(tmp_path: Path) -> None:
    field = F.copy()
    field[3, 4, 5] = -32767  # what NetCDF fills short numbers with
    write_classic(tmp_path / "f.nc", {"v": field})
    grid = open_file(tmp_path / "f.nc", {})
    assert grid.notes == ("Holes are -32767 (NetCDF's default).",)
    assert np.argwhere(np.isnan(grid.whole())).tolist() == [[3, 4, 5]]


def test_netcdf_of_64_bits_is_named() -> None:
    with pytest.raises(VolumeError, match=r"\(CDF-5\): write it as NetCDF-4, by nccopy"):
        open_upload(io.BytesIO(b"CDF\x05" + bytes(64)), "f.nc", 1 << 20)


def test_classic_netcdf_that_is_cut_short_is_refused(tmp_path: Path) -> None:
    write_classic(tmp_path / "f.nc", {"v": F}, x=EVEN["x"])
    whole = (tmp_path / "f.nc").read_bytes()
    for length in range(3, len(whole) - 4, 97):
        with pytest.raises(VolumeError):
            open_upload(io.BytesIO(whole[:length]), "f.nc", 1 << 20).whole()
