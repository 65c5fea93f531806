"""Archives: a ZIP file of slices, of a header with its data, or of one volume."""

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats import archive
from isogi_core.files.formats.opening import libraries_for, open_file, open_upload
from isogi_core.files.grid import on_right_angles
from tests.files.formats.dicom_files import write_series
from tests.files.formats.every_kind import written
from tests.files.formats.phantom import affine, letter

LPS = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine()
F = letter()
HEADER = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 3 2\nencoding: raw\ndata file: {}\n\n"
VOXELS = bytes(range(24))
LOST = HEADER.format("a.raw").encode()
MOST = 1 << 16


def packed(files: dict[str, bytes], how: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A ZIP file of these files."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", how) as whole:
        for name, content in files.items():
            whole.writestr(name, content)
    return data.getvalue()


def uploaded(data: bytes, most: int = MOST) -> np.ndarray:
    """The voxels of an upload, on right angles."""
    return on_right_angles(open_upload(io.BytesIO(data), "a.zip", most)).whole()


def series(folder: Path) -> dict[str, bytes]:
    """The files of a series of slices, in a folder, with what a system left there."""
    pytest.importorskip("pydicom")
    paths = write_series(folder, F, LPS).iterdir()
    slices = {f"scan/{path.stem}": path.read_bytes() for path in paths}
    return {**slices, "scan/DICOMDIR": b"no image", "__MACOSX/scan/._1": b"nor this"}


@pytest.mark.parametrize("how", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_slices_of_dicom_are_one_volume(tmp_path: Path, how: int) -> None:
    data = packed(series(tmp_path / "a"), how)
    whole = open_file(tmp_path / "a", {})
    np.testing.assert_array_equal(uploaded(data), on_right_angles(whole).whole())
    (tmp_path / "a.zip").write_bytes(data)
    again = open_file(tmp_path / "a.zip", {})
    assert again.affine == whole.affine and again.stamp() == again.stamp() != whole.stamp()


def test_slices_of_tiff_are_one_volume() -> None:
    tifffile = pytest.importorskip("tifffile")
    files = {}
    for number, layer in enumerate(F):
        content = io.BytesIO()
        tifffile.imwrite(content, layer)
        files[f"slice{number}.tif"] = content.getvalue()
    np.testing.assert_array_equal(uploaded(packed(files)), F)


def test_a_zip_on_the_disk_opens_as_an_upload(tmp_path: Path) -> None:
    """No reader opens the ZIP itself in place of the file in it, and its state is the ZIP's."""
    for path in written(tmp_path / "files"):
        if path.suffix == ".npz":
            continue
        whole = tmp_path / "a.zip"
        whole.write_bytes(packed({path.name: path.read_bytes()}))
        grid = on_right_angles(open_file(whole, {}))
        np.testing.assert_array_equal(grid.whole(), uploaded(whole.read_bytes()), path.name)
        alone = on_right_angles(open_file(path, {}))
        np.testing.assert_array_equal(grid.whole(), alone.whole(), path.name)
        assert (grid.spacing, grid.affine) == (alone.spacing, alone.affine), path.name
        former = grid.stamp()
        os.utime(whole, (0, 0))
        assert grid.stamp() != former, path.name


def test_a_header_in_a_zip_on_the_disk(tmp_path: Path) -> None:
    whole = tmp_path / "a.zip"
    whole.write_bytes(packed({"a.nhdr": LOST, "a.raw": VOXELS}))
    grid = open_file(whole, {})
    assert grid.whole().tobytes() == VOXELS
    former = grid.stamp()
    whole.write_bytes(packed({"a.nhdr": LOST, "a.raw": VOXELS, "b.txt": b"more"}))
    assert grid.stamp() != former


def test_a_zip_in_a_zip_is_refused(tmp_path: Path) -> None:
    nested = packed({"b.zip": packed({"a.nhdr": LOST, "a.raw": VOXELS})})
    (tmp_path / "a.zip").write_bytes(nested)
    for read in (lambda: uploaded(nested), lambda: open_file(tmp_path / "a.zip", {})):
        with pytest.raises(VolumeError, match=r"'b.zip' is a ZIP file in another one: unpack"):
            read()


def test_a_pair_in_a_zip_on_the_disk_is_refused(tmp_path: Path) -> None:
    """Its voxels are not looked for next to the ZIP."""
    nib = pytest.importorskip("nibabel")
    nib.save(nib.Nifti1Pair(F.T, affine()), tmp_path / "f.img")
    header = (tmp_path / "f.hdr").read_bytes()
    (tmp_path / "f.zip").write_bytes(packed({"f.hdr": header}))
    with pytest.raises(VolumeError, match=r"header whose voxels are in another file"):
        open_file(tmp_path / "f.zip", {})


@pytest.mark.parametrize("folder", ["", "data/"])
def test_a_header_finds_its_data(folder: str) -> None:
    files = {f"{folder}a.nhdr": HEADER.format("a.raw").encode(), f"{folder}a.raw": VOXELS}
    assert uploaded(packed(files)).tobytes() == VOXELS


def test_a_header_in_a_zip_may_end_without_a_blank_line(tmp_path: Path) -> None:
    data = packed({"a.nhdr": LOST.rstrip() + b"\n", "a.raw": VOXELS})
    assert uploaded(data).tobytes() == VOXELS
    (tmp_path / "a.zip").write_bytes(data)
    assert open_file(tmp_path / "a.zip", {}).whole().tobytes() == VOXELS


def test_a_volume_alone_is_found_beside_a_text() -> None:
    attached = HEADER.replace("data file: {}\n", "").encode() + VOXELS
    assert uploaded(packed({"a.nrrd": attached})).tobytes() == VOXELS
    assert uploaded(packed({"a.nrrd": attached, "readme.txt": b"words"})).tobytes() == VOXELS
    with pytest.raises(VolumeError, match=r"holds several volumes \(a.nrrd, b.nrrd\): give one"):
        uploaded(packed({"a.nrrd": attached, "b.nrrd": attached}))


@pytest.mark.parametrize(
    ("files", "said"),
    [
        (
            {"a.nhdr": LOST, "b.raw": VOXELS},
            "no file 'a.raw' in 'a.zip'",
        ),
        ({"a.nhdr": HEADER.format("../a.raw").encode(), "a.raw": VOXELS}, "outside its folder"),
        ({"a.txt": b"1", "b.txt": b"2"}, "holds 2 files .* no one volume: give slices of DICOM"),
        ({"a/zarr.json": b"{}", "a/c/0": b"2"}, "holds a Zarr: unpack it"),
        ({".hidden": b"1"}, "holds 0 files"),
    ],
)
def test_what_is_no_volume_is_refused(files: dict[str, bytes], said: str) -> None:
    with pytest.raises(VolumeError, match=said):
        uploaded(packed(files))


def test_a_header_without_its_data_says_what_to_send() -> None:
    header = io.BytesIO(HEADER.format("skull.raw").encode())
    with pytest.raises(VolumeError, match=r"in another file, skull.raw: send both together"):
        open_upload(header, "a.nhdr", MOST)


def test_sizes_and_counts_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bomb is refused by what it says of itself, before anything of it is unpacked."""
    bomb = packed({"a.raw": bytes(1 << 20), "a.nhdr": HEADER.format("a.raw").encode()})
    with pytest.raises(VolumeError, match=r"unpacks to .* bytes, and .* are the most"):
        uploaded(bomb, most=24)
    monkeypatch.setattr(archive, "MAX_MEMBERS", 1)
    with pytest.raises(VolumeError, match="holds 2 files, and 1 are the most"):
        uploaded(bomb)


def test_a_damaged_archive_is_refused() -> None:
    whole = packed({"a.nrrd": VOXELS})
    with pytest.raises(VolumeError, match="cannot be read as ZIP"):
        uploaded(whole[: len(whole) // 2])
    assert {"zipfile", "pydicom.pixels", "tifffile"} <= set(libraries_for(whole))
