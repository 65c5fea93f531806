"""NRRD with axes that are none of space, voxels in several files or written out, and segmentations of 3D Slicer."""

import gzip
import os
from pathlib import Path
from typing import Any
from unicodedata import normalize

import nrrd
import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file
from isogi_core.files.grid import LabelName

RAMP = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
BIG = np.dtype(">i2")


def written(path: Path, array: np.ndarray, **header: Any) -> Path:
    nrrd.write(str(path), array, {"encoding": "raw", **header}, index_order="C")
    return path


def detached(folder: Path, lines: str, name: str = "v.nhdr", endian: str = "endian: big\n") -> Path:
    """A header of RAMP as int16, whose voxels are elsewhere."""
    fields = f"NRRD0004\ntype: int16\ndimension: 3\nsizes: 4 3 2\n{endian}{lines}\n"
    (folder / name).write_bytes(fields.encode())
    return folder / name


@pytest.mark.parametrize("encoding", ["ascii", "text", "TXT"])
def test_numbers_written_out_have_no_byte_order(tmp_path: Path, encoding: str) -> None:
    words = " ".join(map(str, RAMP.ravel() - 7)).replace(" 3 ", ",3\n\t")
    path = detached(tmp_path, f"encoding: {encoding}\n\n{words}", endian="")
    np.testing.assert_array_equal(open_file(path, {}).whole(), RAMP - 7)


def test_written_floats_are_what_numpy_reads(tmp_path: Path) -> None:
    floats = np.random.default_rng(3).normal(size=RAMP.shape).astype(np.float32)
    fields = "NRRD0004\ntype: float\ndimension: 3\nsizes: 4 3 2\nencoding: ascii\n\n"
    (tmp_path / "v.nrrd").write_text(fields + "\n".join(f"{value:.9g}" for value in floats.ravel()))
    np.testing.assert_array_equal(open_file(tmp_path / "v.nrrd", {}).whole(), floats)


@pytest.mark.parametrize(
    ("shape", "kinds"),
    [
        ((2, 3, 4, 1), ["list", "domain", "domain", "domain"]),
        ((1, 2, 3, 4), ["space", "space", "space", "time"]),
        ((2, 3, 4, 1), ["vector", "???", "???", "???"]),
        ((1, 2, 3, 4, 1), None),
    ],
)
def test_axes_of_one_element_are_dropped(tmp_path: Path, shape: tuple[int, ...], kinds: Any) -> None:
    path = written(tmp_path / "v.nrrd", RAMP.reshape(shape), **({"kinds": kinds} if kinds else {}))
    grid = open_file(path, {})
    np.testing.assert_array_equal(grid.whole(), RAMP)
    assert not grid.unchosen


@pytest.mark.parametrize("last", [True, False])
def test_one_of_several_numbers_a_voxel_is_chosen(tmp_path: Path, last: bool) -> None:
    fields = np.stack([RAMP, RAMP * 2, RAMP * 3], axis=-1 if last else 0)
    kinds = ["vector", "domain", "domain", "domain"] if last else ["domain", "domain", "domain", "list"]
    path = written(tmp_path / "v.nrrd", fields, kinds=kinds)
    with pytest.raises(VolumeError, match=r"has 3 channels: choose one by channel = 0 to 2"):
        open_file(path, {})
    for number in range(3):
        np.testing.assert_array_equal(open_file(path, {"channel": number}).whole(), RAMP * (number + 1))
    with pytest.raises(VolumeError, match="channel = 3 is not in"):
        open_file(path, {"channel": 3})


def test_an_axis_without_direction_is_a_channel(tmp_path: Path) -> None:
    directions = np.array([[np.nan] * 3, [0, 2, 0], [3, 0, 0], [0, 0, 4.0]])
    path = tmp_path / "v.nrrd"
    header = {"space": "LPS", "space directions": directions, "space origin": [1.0, 2.0, 3.0]}
    written(path, np.stack([RAMP, RAMP * 2], axis=-1), **header)
    grid = open_file(path, {"channel": 1})
    np.testing.assert_array_equal(grid.whole(), RAMP * 2)
    assert grid.spacing == (2.0, 3.0, 4.0) and grid.affine is not None
    np.testing.assert_array_equal(grid.affine.array, [[0, -3, 0, -1], [-2, 0, 0, -2], [0, 0, 4, 3]])


def test_an_axis_of_time_is_a_series(tmp_path: Path) -> None:
    fields = np.stack([RAMP, RAMP + 1, RAMP + 2])
    path = written(tmp_path / "v.nrrd", fields, kinds=["domain", "domain", "domain", "time"], encoding="gzip")
    grid = open_file(path, {})
    assert (grid.moment, grid.unchosen) == ((0, 3), True)
    np.testing.assert_array_equal(grid.whole(), RAMP)
    later = open_file(path, {"time": 2})
    assert (later.moment, later.unchosen) == ((2, 3), False)
    np.testing.assert_array_equal(later.whole(), RAMP + 2)


def test_a_list_of_slicer_that_is_time_is_a_series(tmp_path: Path) -> None:
    fields = np.stack([RAMP, RAMP + 1], axis=-1)
    path = tmp_path / "v.seq.nrrd"
    written(path, fields, kinds=["list", "domain", "domain", "domain"], **{"axis 0 index type": "numeric"})
    assert open_file(path, {}).moment == (0, 2)
    np.testing.assert_array_equal(open_file(path, {"time": 1}).whole(), RAMP + 1)


def test_colours_of_nrrd_are_shown_as_luminance(tmp_path: Path) -> None:
    colours = np.zeros((*RAMP.shape, 3), np.uint8)
    colours[..., 1] = 100
    path = written(tmp_path / "v.nrrd", colours, kinds=["RGB-color", "domain", "domain", "domain"])
    grid = open_file(path, {})
    np.testing.assert_allclose(grid.whole(), 71.52, rtol=1e-6)
    assert "colours" in grid.notes[0]
    np.testing.assert_array_equal(open_file(path, {"channel": 1}).whole(), 100)


def test_an_axis_between_those_of_space_is_refused(tmp_path: Path) -> None:
    kinds = ["domain", "domain", "vector", "domain"]
    path = written(tmp_path / "v.nrrd", np.stack([RAMP, RAMP], axis=1), kinds=kinds)
    with pytest.raises(VolumeError, match="kind 'vector' between those of space"):
        open_file(path, {})


SLICES = {
    "pattern": "data file: sl%03d.raw 1 2 1\n",
    "backwards": "data file: sl%03d.raw 2 1 -1 2\n",
    "list": "data file: LIST\nsl001.raw\nsl002.raw\n",
    "list of planes": "data file: LIST 2\nsl001.raw\nsl002.raw\n",
}


@pytest.mark.parametrize("encoding", ["raw", "gzip"])
@pytest.mark.parametrize("way", SLICES)
def test_voxels_in_several_files_are_read_in_order(tmp_path: Path, way: str, encoding: str) -> None:
    pack = gzip.compress if encoding == "gzip" else bytes
    for number, layer in enumerate(RAMP if way != "backwards" else RAMP[::-1], 1):
        (tmp_path / f"sl{number:03}.raw").write_bytes(pack(layer.astype(BIG).tobytes()))
    path = detached(tmp_path, f"encoding: {encoding}\n{SLICES[way]}")
    grid = open_file(path, {})
    np.testing.assert_array_equal(grid.whole(), RAMP)
    before = grid.stamp()
    (tmp_path / "sl002.raw").write_bytes(pack(RAMP[1].astype(BIG).tobytes()[:-1]))
    assert grid.stamp() != before
    with pytest.raises(VolumeError, match="holds fewer than the 24 bytes"):
        grid.whole()


@pytest.mark.parametrize("lines", [SLICES["list"], SLICES["pattern"], "data file: sl002.raw\n"])
def test_a_pipe_among_data_files_is_refused(tmp_path: Path, lines: str) -> None:
    """To open it would wait for ever."""
    (tmp_path / "sl001.raw").write_bytes(RAMP[0].astype(BIG).tobytes())
    os.mkfifo(tmp_path / "sl002.raw")
    with pytest.raises(VolumeError, match="it is a device, a pipe or a socket"):
        open_file(detached(tmp_path, f"encoding: raw\n{lines}"), {})


NAMES = ["with blanks.raw", "a#1.raw", "a%41.raw", "æøå.raw", "50% of it.raw", "LISTED.raw"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_data_files_have_any_names(tmp_path: Path, name: str, form: Any) -> None:
    (tmp_path / normalize(form, name)).write_bytes(RAMP.astype(BIG).tobytes())
    for number, other in enumerate(("NFC", "NFD")):
        lines = f"encoding: raw\ndata file: {normalize(other, name)}\n"  # type: ignore[arg-type]
        path = detached(tmp_path, lines, name=f"{number} {name}.nhdr")
        np.testing.assert_array_equal(open_file(path, {}).whole(), RAMP)


def slicer(path: Path, array: np.ndarray, **more: Any) -> Path:
    """A segmentation as 3D Slicer writes it."""
    facts = {
        "Segment0_ID": "Segment_1",
        "Segment0_Name": "left kidney",
        "Segment0_Color": "0.5 0 1",
        "Segment0_LabelValue": "1",
        "Segment0_Layer": "0",
        "Segment1_Name": "tumour",
        "Segment1_Color": "0.0196 0.6784 1",
        "Segment1_LabelValue": "3",
        "Segment1_Layer": "0",
    }
    return written(path, array, **{**facts, **more})


def test_a_segmentation_of_slicer_names_its_labels(tmp_path: Path) -> None:
    grid = open_file(slicer(tmp_path / "v.seg.nrrd", RAMP % 4), {})
    assert grid.labels == (LabelName(1, "left kidney", "#8000ff"), LabelName(3, "tumour", "#05adff"))
    assert open_file(written(tmp_path / "v.nrrd", RAMP), {}).labels is None


def test_layers_of_a_segmentation_are_chosen(tmp_path: Path) -> None:
    layers = np.stack([RAMP % 2, RAMP % 3], axis=-1)
    path = slicer(tmp_path / "v.seg.nrrd", layers, kinds=["list", "domain", "domain", "domain"], Segment1_Layer="1")
    grid = open_file(path, {})
    np.testing.assert_array_equal(grid.whole(), RAMP % 2)
    assert grid.labels == (LabelName(1, "left kidney", "#8000ff"),)
    assert "2 layers: the first is shown" in grid.notes[0]
    other = open_file(path, {"channel": 1})
    np.testing.assert_array_equal(other.whole(), RAMP % 3)
    assert other.labels == (LabelName(3, "tumour", "#05adff"),)
