"""Fill values that no header names: what is one, and what only looks like one."""

from collections.abc import Iterator
from pathlib import Path

import nrrd
import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid
from isogi_core.files.packing import find_fill, without_fill
from tests.loaded import load_scene, read_nrrd

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
    array = np.where(np.abs(X - 23.5) + np.abs(Y - 23.5) + Z > 36, -2048.0, scan(-1024.0)).round().astype(np.int16)
    assert find_fill(Grid.of(array)) == -2048


def test_slabs_make_no_difference_to_a_fill_value() -> None:
    array = scan(-2000.0).round().astype(np.int16)
    grid = Grid(array.shape, array.dtype, (1.0, 1.0, 1.0), lambda: (array[z : z + 5] for z in range(0, 12, 5)))
    assert find_fill(grid) == -2000


def test_holes_of_a_file_stay_beside_a_fill_value() -> None:
    array = scan(-2000.0)
    array[4, 20, 20:24], array[0, 0, 0] = np.nan, np.nan
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
    "a body that was cut out along its skin": np.where(BALL + 3 * np.sin(X) < 18, 20.0 + BALL + NOISE, -2000.0),
    "a distance that is cut off": np.maximum(18.0 - BALL, -4.0),
    "noise around zero with one low corner": np.where(X + Y + Z == 0, -9999.0, NOISE),
    "air that is no darker than its fill value": scan(-1024.0),
    "a room that is cold along its walls": np.where((X % 47 == 0) | (Y % 47 == 0), -5.0, 20.0 + NOISE / 100),
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
