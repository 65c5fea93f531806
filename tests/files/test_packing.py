"""What stored numbers mean: CF's vocabulary against values worked out by hand, and fill values that
no header names.
"""

import base64
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file
from isogi_core.files.grid import Grid
from isogi_core.files.packing import as_stored, climate_packing, find_fill, without_fill
from isogi_core.files.zarr_volume import open_zarr
from tests.loaded import load_scene, read_nrrd

BYTES = np.arange(-128, 128, dtype=np.int8).reshape(4, 8, 8)
NAN = np.nan


def hdf5(path: Path, array: np.ndarray, **attributes: Any) -> Grid:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path / "v.nc", "w") as file:
        file.create_dataset("v", data=array).attrs.update(attributes)
    return open_file(path / "v.nc", {})


def classic(path: Path, array: np.ndarray, **attributes: Any) -> Grid:
    pytest.importorskip("nibabel")
    netcdf = pytest.importorskip("scipy.io").netcdf_file
    with netcdf(path / "c.nc", "w") as file:
        for name, length in zip("zyx", array.shape, strict=True):
            file.createDimension(name, length)
        saved = file.createVariable("v", array.dtype, tuple("zyx"))
        saved[:] = array
        for name, value in attributes.items():
            setattr(saved, name, value)
    return open_file(path / "c.nc", {})


def zarr_array(path: Path, array: np.ndarray, **attributes: Any) -> Grid:
    plain = {
        key: value.tolist() if isinstance(value, np.generic | np.ndarray) else value
        for key, value in attributes.items()
    }
    saved = zarr.create_array(
        path / "v.zarr", shape=array.shape, dtype=array.dtype, chunks=(2, 8, 8)
    )
    saved[:] = array
    saved.attrs.update(plain)
    return open_zarr(path / "v.zarr")


WRITERS = [hdf5, classic, zarr_array]


@pytest.mark.parametrize("write", WRITERS)
def test_a_mark_is_compared_in_the_type_of_the_data(tmp_path: Path, write: Any) -> None:
    array = np.linspace(0, 1, 256, dtype=np.float32).reshape(4, 8, 8)
    array[1, 2:4] = 1e20  # the float32 next to it is 100000002004087734272
    grid = write(tmp_path, array, missing_value=np.float64(1e20))
    found = grid.whole()
    assert np.isnan(found[1, 2:4]).all() and np.nanmax(found) == 1.0
    assert grid.notes == ("Holes are 1e+20 (missing_value).",)


@pytest.mark.parametrize("write", WRITERS)
def test_all_marks_of_a_list_are_holes(tmp_path: Path, write: Any) -> None:
    array = np.arange(256, dtype=np.int16).reshape(4, 8, 8)
    array[0, 0, :3] = -1, -2000, -3
    grid = write(
        tmp_path,
        array,
        missing_value=np.array([-1, -2000], np.int16),
        _FillValue=np.int16(-3),
        scale_factor=0.5,
    )
    np.testing.assert_array_equal(grid.whole()[0, 0, :4], [NAN, NAN, NAN, 1.5])


@pytest.mark.parametrize("write", WRITERS)
def test_unsigned_holes_range_scale_and_offset_in_this_order(tmp_path: Path, write: Any) -> None:
    facts = {
        "_Unsigned": "true",
        "_FillValue": np.int8(-1),
        "valid_range": np.array([1, -3], np.int8),
    }
    grid = write(tmp_path, BYTES, **facts, scale_factor=2.0, add_offset=10.0)
    stored = BYTES.view(np.uint8).astype(float)
    expected = np.where((stored == 255) | (stored < 1) | (stored > 253), NAN, 2 * stored + 10)
    np.testing.assert_array_equal(grid.whole(), expected)
    assert grid.notes == (
        "Whole numbers are read without a sign, as _Unsigned says.",
        "Holes are 255 (_FillValue), what is not from 1 to 253 (the valid range).",
    )


def test_signed_bytes_that_are_unsigned_are_0_to_253(tmp_path: Path) -> None:
    found = hdf5(
        tmp_path, BYTES, _Unsigned="true", missing_value=np.array([-1, -2], np.int8)
    ).whole()
    assert (np.nanmin(found), np.nanmax(found), np.isnan(found).sum()) == (0.0, 253.0, 2)
    found = hdf5(tmp_path, BYTES.view(np.uint8), _Unsigned=b"false").whole()
    np.testing.assert_array_equal(found, BYTES)


@pytest.mark.parametrize(
    ("facts", "low", "high"),
    [
        ({"valid_min": np.int16(5)}, 5, 255),
        ({"valid_max": np.int16(200)}, 0, 200),
        ({"valid_range": np.array([5, 200], np.int16), "scale_factor": 0.1}, 5, 200),
        (
            {"valid_range": np.array([5.0, 20.0]), "scale_factor": 0.1},
            50,
            200,
        ),  # of values, as its type is theirs
        ({"valid_range": np.array([200, 5], np.int16)}, 0, 255),  # no range
        ({"valid_range": np.array([-32768, 32767], np.int16)}, 0, 255),  # all that there may be
    ],
)
def test_a_valid_range_is_of_stored_numbers_or_of_values(
    facts: dict[str, Any], low: int, high: int
) -> None:
    stored = np.arange(256, dtype=np.int16)
    packing = climate_packing(facts, stored.dtype)
    found = packing.apply(stored)
    np.testing.assert_array_equal(np.isnan(found), (stored < low) | (stored > high))
    assert found.dtype == packing.dtype


def test_what_netcdf_fills_with_is_a_hole_where_nobody_wrote(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "v.nc", "w") as file:
        data = file.create_dataset("v", (4, 8, 8), "f4", fillvalue=9.969209968386869e36)
        data[:2] = 1.0
    found = open_file(tmp_path / "v.nc", {}).whole()
    assert (found[:2] == 1.0).all() and np.isnan(found[2:]).all()


@pytest.mark.parametrize("mark", [-9999.0, 1e20])
def test_marks_of_xarray_in_zarr_are_holes(tmp_path: Path, mark: float) -> None:
    array = np.ones((4, 8, 8), np.float32)
    array[0] = mark
    text = base64.standard_b64encode(struct.pack("<d", float(np.float32(mark)))).decode()
    assert np.isnan(zarr_array(tmp_path, array, _FillValue=text).whole()[0]).all()
    second = zarr.create_array(
        tmp_path / "w.zarr",
        shape=array.shape,
        dtype="f4",
        chunks=(2, 8, 8),
        zarr_format=2,
        fill_value=mark,
    )
    second[:] = array
    assert (open_zarr(tmp_path / "w.zarr").whole()[0] == np.float32(mark)).all()
    second.attrs["_ARRAY_DIMENSIONS"] = ["z", "y", "x"]
    assert np.isnan(open_zarr(tmp_path / "w.zarr").whole()[0]).all()


@pytest.mark.parametrize(
    ("value", "kind", "expected"),
    [
        (-1, "u1", 255),
        (65535, "<i2", -1),
        (63536, ">i2", -2000),
        (1e20, "<i2", None),
        (0.5, "u1", None),
        (-300, "u1", None),
    ],
)
def test_the_bits_of_a_mark_count(value: float, kind: str, expected: Any) -> None:
    assert as_stored(value, np.dtype(kind)) == expected


def test_numbers_without_attributes_stay_as_they_are() -> None:
    for kind in ("u1", ">i2", "<f4", "?", "<c8"):
        stored = np.ones(4, kind)
        packing = climate_packing({}, stored.dtype, stored[0])
        assert (
            packing.apply(stored) is stored and packing.dtype == stored.dtype and not packing.notes
        )


@pytest.mark.parametrize("kind", ["u1", ">i2", "<i4", "<f2", ">f4", "<f8"])
def test_numbers_of_every_type_are_scaled(kind: str) -> None:
    stored = np.arange(9).astype(kind)
    packing = climate_packing({"scale_factor": 0.5, "add_offset": 10.0}, stored.dtype)
    found = packing.apply(stored)
    np.testing.assert_array_equal(found, np.arange(9) * 0.5 + 10.0)
    assert found.dtype == packing.dtype


# --- fill values
# --------------------------------------------------------------------------------------------------


Z, Y, X = np.mgrid[:12, :48, :48]
RADIUS = np.hypot(X - 23.5, Y - 23.5)
NOISE = np.random.default_rng(7).normal(0.0, 20.0, RADIUS.shape)
BALL = np.sqrt((X - 23.5) ** 2 + (Y - 23.5) ** 2 + (3 * (Z - 5.5)) ** 2)


def scan(fill: float, air: float = -1000.0) -> np.ndarray:
    """A body with a bone in air, in a round field of view; float64."""
    field = np.where(np.hypot(X - 25.0, 1.4 * (Y - 22.0)) < 17.0, 40.0, air) + NOISE
    field[np.hypot(X - 25.0, Y - 27.0) < 4.0] += 900.0
    return np.where(RADIUS > 23.9, fill, field)


@pytest.mark.parametrize("kind", ["<i2", ">i4", "<f4", "<f8"])
@pytest.mark.parametrize("fill", [-3024, -2000, -1762])
def test_what_lies_outside_of_a_round_scan_is_a_hole(fill: int, kind: str) -> None:
    array = scan(fill).round().astype(kind)
    grid = without_fill(Grid.of(array))
    np.testing.assert_array_equal(np.isnan(grid.whole()), array == fill)
    np.testing.assert_array_equal(grid.whole()[array != fill], array[array != fill])
    assert f"{fill}" in grid.notes[0] and grid.read_as.endswith(f"{fill} is a fill value")


def test_a_scan_that_is_cut_out_of_a_turned_box_has_holes() -> None:
    array = (
        np.where(np.abs(X - 23.5) + np.abs(Y - 23.5) + Z > 36, -2048.0, scan(-1024.0))
        .round()
        .astype(np.int16)
    )
    assert find_fill(Grid.of(array)) == -2048


def test_slabs_make_no_difference_to_a_fill_value() -> None:
    array = scan(-2000.0).round().astype(np.int16)
    grid = Grid(
        array.shape,
        array.dtype,
        (1.0, 1.0, 1.0),
        lambda: (array[z : z + 5] for z in range(0, 12, 5)),
    )
    assert find_fill(grid) == -2000


def test_holes_of_a_file_stay_beside_a_fill_value() -> None:
    array = scan(-2000.0)
    array[4, 20, 20:24] = np.nan
    array[0, 0, 0] = np.nan
    assert find_fill(Grid.of(array)) == -2000.0


SHELL = np.where(RADIUS < 16, 300.0 + NOISE, -1000.0)
OBJECTS = {
    "a phantom in air of exactly 0": np.where(BALL < 18, 1000.0 + NOISE, 0.0),
    "a sky of zeros around a round simulation": np.where(RADIUS < 23, 5.0 + np.abs(NOISE), 0.0),
    "a mask": np.where(RADIUS < 20, 255.0, -255.0),
    "labels with a background of -1": np.where(BALL < 18, (X // 8) % 5, -1.0),
    "a noisy cylinder in exact air": SHELL,
    "the same cylinder with a bone in it": SHELL + np.where(RADIUS < 5, 900.0, 0.0),
    "a skull in exact air": np.where(BALL < 18, np.where(BALL > 15, 1200.0, 40.0) + NOISE, -1000.0),
    "a body that was cut out along its skin": np.where(
        BALL + 3 * np.sin(X) < 18, 20.0 + BALL + NOISE, -2000.0
    ),
    "a distance that is cut off": np.maximum(18.0 - BALL, -4.0),
    "noise around zero with one low corner": np.where(X + Y + Z == 0, -9999.0, NOISE),
    "air that is no darker than its fill value": scan(-1024.0),
    "a room that is cold along its walls": np.where(
        (X % 47 == 0) | (Y % 47 == 0), -5.0, 20.0 + NOISE / 100
    ),
    "a single value": np.full((4, 5, 6), -3.0),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_are_not_taken_for_a_field_of_view(name: str) -> None:
    grid = Grid.of(OBJECTS[name])
    assert without_fill(grid) is grid


@pytest.mark.parametrize("shape", [(0, 4, 4), (4, 0, 4), (1, 4, 4)])
def test_grids_without_cells_have_no_fill_value(shape: tuple[int, ...]) -> None:
    assert find_fill(Grid.of(np.zeros(shape, np.float32))) is None


def test_a_damaged_source_is_said_by_its_next_reading() -> None:
    def slabs() -> Iterator[np.ndarray]:
        yield scan(-2000.0)[:4]
        raise VolumeError("The voxels are damaged.")

    grid = Grid((12, 48, 48), np.dtype(float), (1.0, 1.0, 1.0), slabs)
    assert without_fill(grid) is grid
    with pytest.raises(VolumeError, match="damaged"):
        grid.whole()


def test_no_shared_volume_has_a_fill_value(shared_data: Path) -> None:
    files = sorted(shared_data.glob("*.nhdr"))
    assert len(files) > 10
    assert not [file.name for file in files if find_fill(Grid.of(read_nrrd(file)[0])) is not None]


def test_a_scene_opens_a_scan_without_its_shell(tmp_path: Path) -> None:
    nrrd.write(str(tmp_path / "ct.nrrd"), scan(-3024.0).round().astype(np.int16), index_order="C")
    scene = load_scene(tmp_path / "ct.nrrd")
    assert scene.volume.value_range[0] > -1200.0 and scene.isovalue > -900.0
    assert scene.volume.holes == (RADIUS > 23.9).sum()
    assert "-3024" in scene.volume.orientation.read_as


@pytest.mark.parametrize("missing", ["[]", "-30000"])
def test_a_scene_that_lists_what_is_missing_is_obeyed(tmp_path: Path, missing: str) -> None:
    nrrd.write(str(tmp_path / "ct.nrrd"), scan(-3024.0).round().astype(np.int16), index_order="C")
    (tmp_path / "s.toml").write_text(f'volume = "ct.nrrd"\nmissing = {missing}\n')
    volume = load_scene(tmp_path / "s.toml").volume
    assert volume.value_range[0] == -3024.0 and volume.holes == 0
