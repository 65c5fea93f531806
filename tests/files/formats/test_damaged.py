"""Damaged files and files that are no volumes: each is refused in a sentence, or read; nothing
crashes.
"""

import io
import random
import warnings
import zipfile
from pathlib import Path

import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload
from isogi_core.files.grid import on_right_angles
from tests.files.formats.every_kind import metaimage, written

VOXELS = 1 << 16
EACH = 24


def damaged(whole: bytes, rng: random.Random) -> bytes:
    """A file cut short, or with some bytes changed, as often in its head as anywhere."""
    data = bytearray(whole)
    kind = rng.randrange(4)
    if kind == 0:
        return whole[: rng.randrange(len(whole))]
    if kind == 1:
        within = min(600, len(data))
    else:
        within = len(data)
    for _ in range(rng.choice((1, 8, 200)) if kind < 3 else 0):
        data[rng.randrange(within)] = rng.choice((0, 127, 128, 255, rng.randrange(256)))
    if kind == 3:
        start = rng.randrange(len(data))
    else:
        start = len(data)
    data[start : start + 64] = bytes(len(data[start : start + 64]))
    return bytes(data)


@pytest.mark.filterwarnings("ignore")
def test_damaged_files_are_refused_or_read(tmp_path: Path) -> None:
    rng = random.Random(7)
    ends = {"read": 0, "refused": 0}
    for path in (*written(tmp_path / "files"), *metaimage(tmp_path / "files")):
        whole = path.read_bytes()
        for _ in range(EACH):
            try:
                with warnings.catch_warnings():
                    grid = on_right_angles(
                        open_upload(io.BytesIO(damaged(whole, rng)), path.name, VOXELS)
                    )
                    assert grid.whole().shape == grid.shape
                    ends["read"] += 1
            except VolumeError as error:
                assert str(error).endswith(".")
                ends["refused"] += 1
    assert min(ends.values()) > EACH


def test_an_image_of_vtk_that_is_cut_is_no_volume(tmp_path: Path) -> None:
    pytest.importorskip("vtk")
    (path,) = (path for path in written(tmp_path) if path.suffix == ".vti")
    whole = path.read_bytes()
    begin = path.read_bytes().index(b'">_') + 3
    short = whole[:begin] + (100).to_bytes(8, "little") + whole[begin + 8 :]
    for data, why in ((whole[: len(whole) // 2], "ends too early"), (short, "damaged image file")):
        with pytest.raises(VolumeError, match=why):
            open_upload(io.BytesIO(data), path.name, VOXELS).whole()
        path.write_bytes(data)
        with pytest.raises(VolumeError, match=why):
            open_file(path, {}).whole()


# --- files that are no volumes
# ----------------------------------------------------------------------------------------


WRONG = [
    ("a.nrrd", b"\x89PNG\r\n\x1a\n", "a picture"),
    ("a.tif", b"%PDF-1.4", "a PDF document"),
    ("a.hdr", b"#?RADIANCE\n", "a light probe"),
    ("a.stl", b"\x00" * 84, "a mesh"),
    ("a.bin", b"solid cube\n facet normal 0 0 1\n", "a mesh"),
    ("a.raw", b"\x01\x02\x03", "bare voxels"),
    ("a.nii", b"<!DOCTYPE html>", "a web page"),
    ("a.nrrd", b"version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS"),
]


@pytest.mark.parametrize(("name", "content", "sort"), WRONG)
def test_a_wrong_file_is_told_for_what_it_seems(
    tmp_path: Path, name: str, content: bytes, sort: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(VolumeError, match=f"seems to be {sort}"):
        open_file(tmp_path / name, {})
    with pytest.raises(VolumeError, match=f"seems to be {sort}"):
        open_upload(io.BytesIO(content), name, 1 << 20)


def test_a_zip_file_of_a_zarr_says_to_unpack_it(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "image.ome.zarr.zip", "w") as whole:
        whole.writestr("zarr.json", "{}")
    with pytest.raises(VolumeError, match="holds a Zarr: unpack it"):
        open_file(tmp_path / "image.ome.zarr.zip", {})
