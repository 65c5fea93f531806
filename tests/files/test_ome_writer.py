"""OME-Zarr images that are written: what is read back is what was there, where it was; coarser levels are means."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Affine, Grid, LabelName, on_right_angles
from isogi_core.files.ome import TURNED_AXES_NOTE, halved, write_image
from isogi_core.files.zarr_volume import open_zarr
from isogi_core.model.orientation import Orientation
from isogi_core.model.value_survey import no_progress
from tests.files.formats.phantom import WAYS, landmarks, letter, lying, world


def grid_of(array: np.ndarray, placed: Any = None, letters: str = "", **more: Any) -> Grid:
    """An array as a grid in slabs of five layers, placed by an affine."""
    affine = None if placed is None else Affine.of(placed, letters)
    steps = (1.0, 1.0, 1.0) if placed is None else tuple(np.linalg.norm(placed[:3, :3], axis=0).tolist())
    parts = range(0, len(array), 5)
    return Grid(array.shape, array.dtype, steps, lambda: (array[z : z + 5] for z in parts), affine=affine, **more)


@pytest.mark.parametrize("way", WAYS[::5], ids=str)
def test_what_is_written_lies_where_it_was(tmp_path: Path, way: Any) -> None:
    array, placed = lying(*way)
    assert not write_image(grid_of(array, placed, "RAS", unit="mm"), tmp_path / "v.zarr", no_progress)
    read = open_zarr(tmp_path / "v.zarr")
    grid = on_right_angles(read)
    voxels, orientation = grid.whole(), Orientation.of(grid)
    assert (grid.unit, orientation.letters) == ("mm", "RAS")
    assert np.allclose(orientation.matrix, np.eye(3)), "axes of the file ascend in the world"
    for index, place in zip(landmarks(), world(landmarks()), strict=True):
        x, y, z = np.rint(np.array(orientation.point_to_box(tuple(place))) / np.array(grid.spacing)).astype(int)
        assert voxels[z, y, x] == letter()[tuple(index[::-1])]


@pytest.mark.parametrize("kind", ["u1", "i2", ">u2", "f4", "f8", "?"])
def test_numbers_of_all_types_are_kept(tmp_path: Path, kind: str) -> None:
    array = (np.random.default_rng(1).random((70, 9, 130)) * 3).astype(kind)
    write_image(grid_of(array), tmp_path / "v.zarr", no_progress)
    np.testing.assert_array_equal(open_zarr(tmp_path / "v.zarr").whole(), array)
    coarse = open_zarr(tmp_path / "v.zarr", level=1)
    assert coarse.shape == (35, 5, 65) and tuple(coarse.spacing) == (2.0, 2.0, 2.0)
    inside = array[:, :8].astype(float).reshape(35, 2, 4, 2, 65, 2).mean(axis=(1, 3, 5))
    expected = np.rint(inside) if np.dtype(kind).kind != "f" else inside
    np.testing.assert_allclose(coarse.whole()[:, :4].astype(float), expected, rtol=1e-6)
    last = open_zarr(tmp_path / "v.zarr", level=2)
    assert last.shape == (18, 5, 33) and tuple(last.spacing) == (4.0, 2.0, 4.0), "thin sides are not halved"
    with pytest.raises(VolumeError, match="levels 0 to 2"):
        open_zarr(tmp_path / "v.zarr", level=3)


def test_holes_stay_holes_and_make_no_others() -> None:
    block = np.arange(16, dtype=np.float32).reshape(2, 2, 4)
    block[0, 0, 0] = np.nan
    block[:, :, 2:] = np.nan
    found = halved(block, [True, True, True])
    assert found.shape == (1, 1, 2) and np.isnan(found[0, 0, 1])
    assert found[0, 0, 0] == np.nanmean(block[:, :, :2])


def test_labels_are_never_mixed_and_keep_their_names(tmp_path: Path) -> None:
    array = np.random.default_rng(2).choice([0, 3, 900], (66, 66, 66)).astype(np.uint16)
    names = (LabelName(3, "left", "#ff0010"), LabelName(900, "right"))
    write_image(grid_of(array, labels=names), tmp_path / "v.zarr", no_progress)
    coarse = open_zarr(tmp_path / "v.zarr", level=1)
    assert coarse.labels == names and coarse.affine is None
    np.testing.assert_array_equal(coarse.whole(), array[::2, ::2, ::2])


def test_a_turned_volume_is_written_without_its_place(tmp_path: Path) -> None:
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    placed = np.column_stack([turn * np.sign(np.linalg.det(turn)), [1.0, 2.0, 3.0]])
    assert write_image(grid_of(letter(), placed, "RAS"), tmp_path / "v.zarr", no_progress) == (TURNED_AXES_NOTE,)
    grid = open_zarr(tmp_path / "v.zarr")
    np.testing.assert_array_equal(grid.whole(), letter())
    assert grid.affine is None


def test_nothing_is_left_of_what_fails_and_nothing_is_replaced(tmp_path: Path) -> None:
    def broken() -> Any:
        yield letter()[:5]
        raise VolumeError("The source is damaged.")

    failing = Grid(letter().shape, letter().dtype, (1.0, 1.0, 1.0), broken)
    with pytest.raises(VolumeError, match="is damaged"):
        write_image(failing, tmp_path / "v.zarr", no_progress)
    assert not list(tmp_path.iterdir())
    write_image(grid_of(letter()), tmp_path / "v.zarr", no_progress)
    with pytest.raises(VolumeError, match="already: remove it"):
        write_image(grid_of(letter()), tmp_path / "v.zarr", no_progress)


def test_others_read_the_image(tmp_path: Path) -> None:
    """By the names that NGFF 0.5 gives, without isogi's reader."""
    write_image(grid_of(letter(), unit="µm"), tmp_path / "v.zarr", no_progress)
    group = zarr.open_group(tmp_path / "v.zarr", mode="r")
    held: Any = group.attrs["ome"]
    (image,) = held["multiscales"]
    assert (held["version"], [axis["name"] for axis in image["axes"]]) == ("0.5", ["z", "y", "x"])
    assert {axis["unit"] for axis in image["axes"]} == {"micrometer"}
    found: Any = group[image["datasets"][0]["path"]]
    np.testing.assert_array_equal(found[:], letter())


def test_progress_counts_the_layers_of_all_levels(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    array = np.zeros((70, 70, 70), np.uint8)
    write_image(grid_of(array), tmp_path / "v.zarr", lambda done, total: seen.append((done, total)))
    assert seen[-1] == (105, 105) and [done for done, _ in seen] == sorted({done for done, _ in seen})
