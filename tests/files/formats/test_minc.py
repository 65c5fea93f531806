"""MINC: slices of slopes of their own, in the world of a patient, in time, of both versions."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import on_right_angles
from isogi_core.model.volume import Orientation

h5py = pytest.importorskip("h5py")
nibabel = pytest.importorskip("nibabel")

STORED = np.random.default_rng(6).integers(-500, 501, (5, 6, 7)).astype(np.int16)
LOW = np.linspace(-3.0, 2.0, 5)
HIGH = np.linspace(10.0, 90.0, 5)
VALUES = (STORED + 500.0) / 1000.0 * (HIGH - LOW)[:, None, None] + LOW[:, None, None]
"""From -500 to 500, as the file says, to what each slice says: by hand."""

PLACES = {
    "zspace": (3.0, -20.0),
    "yspace": (-2.0, 30.0),
    "xspace": (1.5, -40.0),
    "time": (2.0, 0.0),
}


def write(path: Path, order: str = "zspace,yspace,xspace", stored: np.ndarray = STORED) -> Path:
    with h5py.File(path, "w") as file:
        for name, (step, start) in PLACES.items():
            at = file.create_dataset(f"minc-2.0/dimensions/{name}", data=0)
            at.attrs["step"], at.attrs["start"] = step, start
            if name != "time":
                at.attrs["direction_cosines"] = np.eye(3)[
                    ["xspace", "yspace", "zspace"].index(name)
                ]
        image = file.create_dataset("minc-2.0/image/0/image", data=stored)
        image.attrs["dimorder"] = np.bytes_(order)
        image.attrs["valid_range"] = np.array([-500.0, 500.0])
        along = order.split(",")[: stored.ndim - 2]
        for name, ends in (("min", LOW), ("max", HIGH)):
            if stored.ndim == 3:
                values = ends
            else:
                values = np.stack([ends] * len(stored))
            data = file.create_dataset(f"minc-2.0/image/0/image-{name}", data=values)
            data.attrs["dimorder"] = np.bytes_(",".join(along))
    return path


def test_slices_have_slopes_of_their_own(tmp_path: Path) -> None:
    """From the file, an upload, and a ZIP file."""
    path = write(tmp_path / "a.mnc")
    whole = tmp_path / "a.zip"
    with zipfile.ZipFile(whole, "w") as made:
        made.write(path, path.name)
    with path.open("rb") as file:
        for grid in (
            open_file(path, {}),
            open_upload(file, "a.mnc", 1 << 16),
            open_file(whole, {}),
        ):
            np.testing.assert_allclose(grid.whole(), VALUES, rtol=1e-6)
            assert (grid.spacing, grid.unit, grid.dtype) == ((1.5, 2.0, 3.0), "mm", np.float32)
            assert (
                grid.read_as
                == "MINC, each slice of a slope of its own, of int16; placed by its dimensions"
            )


def test_it_lies_where_its_dimensions_say(tmp_path: Path) -> None:
    """Along y it is mirrored: its steps are negative."""
    grid = on_right_angles(open_file(write(tmp_path / "a.mnc"), {}))
    orientation = Orientation.of(grid)
    values = grid.whole()
    assert orientation.letters == "RAS"
    for place in ((0, 0, 0), (4, 2, 1), (1, 5, 6)):
        z, y, x = place
        world = (-40.0 + 1.5 * x, 30.0 - 2.0 * y, -20.0 + 3.0 * z)
        box = np.array(orientation.point_to_box(world)) / grid.spacing
        at = tuple(np.rint(box).astype(int)[::-1])
        np.testing.assert_allclose(box, np.rint(box), atol=1e-6)
        np.testing.assert_allclose(values[at], VALUES[place], rtol=1e-6)


def test_a_series_opens_at_its_first_step(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mnc", "time,zspace,yspace,xspace", np.stack([STORED, STORED[::-1]]))
    first = open_file(path, {})
    second = open_file(path, {"time": "1"})
    assert (first.moment, first.unchosen, second.moment) == ((0, 2), True, (1, 2))
    np.testing.assert_allclose(first.whole(), VALUES, rtol=1e-6)
    assert not np.allclose(second.whole(), VALUES)
    with pytest.raises(VolumeError, match="which has 0 to 1"):
        open_file(path, {"time": "2"})


def test_other_axes_and_damage_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        VolumeError, match="has the axes zspace, yspace, time: save z, y and x alone"
    ):
        open_file(write(tmp_path / "a.mnc", "zspace,yspace,time"), {})
    for begin in (b"CDF\x01", b"\x89HDF\r\n\x1a\n"):
        (tmp_path / "b.mnc").write_bytes(begin + bytes(200))
        with pytest.raises(VolumeError, match="cannot be read as MINC"):
            open_file(tmp_path / "b.mnc", {})


@pytest.mark.parametrize(
    "name", ["small", "tiny", "minc1_1_scale", "minc1_4d", "minc2_4d", "minc2-4d-d"]
)
def test_others_files_are_read_as_nibabel_shows_them(name: str) -> None:
    path = Path(nibabel.__file__).parent / "tests" / "data" / f"{name}.mnc"
    if not path.is_file():
        pytest.skip("nibabel's test files are not installed")
    grid = open_file(path, {})
    shown = grid.whole()
    image: Any = nibabel.load(path)  # keeps the file open, and locks it otherwise
    values = image.get_fdata()
    np.testing.assert_allclose(
        shown, values if values.ndim == 3 else values[0], rtol=1e-5, atol=1e-6
    )
    assert grid.affine is not None
    np.testing.assert_allclose(grid.affine.array, image.affine[:3, [2, 1, 0, 3]])
