"""Files that are no volumes: each is told for what it seems to be, whatever it is called."""

import io
import zipfile
from pathlib import Path

import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload

WRONG = [
    ("a.nrrd", b"\x89PNG\r\n\x1a\n", "a picture"),
    ("a.tif", b"%PDF-1.4", "a PDF document"),
    ("a.hdr", b"#?RADIANCE\n", "a light probe"),
    ("a.stl", b"\x00" * 84, "a mesh"),
    ("a.bin", b"solid cube\n", "a mesh"),
    ("a.raw", b"\x01\x02\x03", "bare voxels"),
    ("a.nii", b"<!DOCTYPE html>", "a web page"),
    ("a.nrrd", b"version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS"),
]


@pytest.mark.parametrize(("name", "content", "sort"), WRONG)
def test_a_wrong_file_is_told_for_what_it_seems(tmp_path: Path, name: str, content: bytes, sort: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(VolumeError, match=f"seems to be {sort}"):
        open_file(tmp_path / name, {})
    with pytest.raises(VolumeError, match=f"seems to be {sort}"):
        open_upload(io.BytesIO(content), name, 1 << 20)


def test_a_zip_file_without_arrays_says_to_unpack_it(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "image.ome.zarr.zip", "w") as whole:
        whole.writestr("zarr.json", "{}")
    with pytest.raises(VolumeError, match="is a ZIP file without an array of NumPy: unpack it"):
        open_file(tmp_path / "image.ome.zarr.zip", {})
