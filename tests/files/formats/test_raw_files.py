"""Bare voxels: what they are is in their names, or given; files that hold anything else are
refused.
"""

import bz2
import gzip
import io
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import VolumeError
from isogi_core.files.formats.opening import open_file, open_upload
from tests.files.formats.phantom import letter
from tests.loaded import load_scene

F = letter()
SIZE = "16x20x12"


@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress])
@pytest.mark.parametrize(
    ("name", "kind"),
    [
        (f"f_{SIZE}_uint8.raw", "u1"),
        (f"f-{SIZE}-int16.RAW", "<i2"),
        (f"an f {SIZE} big uint16.bin", ">u2"),
        (f"f.{SIZE}.float.dat", "<f4"),
        (f"f_{SIZE}_double_be.vol", ">f8"),
        (f"f_{SIZE}.raw", "u1"),
    ],
)
def test_a_name_says_what_voxels_are(tmp_path: Path, name: str, kind: str, pack: type) -> None:
    array = (F // 8).astype(kind)
    path = tmp_path / (
        name + {"compress": ".gz" if pack is gzip.compress else ".bz2"}.get(pack.__name__, "")
    )
    path.write_bytes(pack(array.tobytes()))
    grid = open_file(path, {})
    np.testing.assert_array_equal(grid.whole(), array)
    assert (
        grid.dtype == np.dtype(kind)
        and "16 × 20 × 12 voxels" in grid.notes[0]
        and "by its name" in grid.notes[0]
    )
    upload = open_upload(io.BytesIO(path.read_bytes()), path.name, 1 << 20)
    np.testing.assert_array_equal(upload.whole(), array)


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        (f"{SIZE},uint8", "u1"),
        (f"{SIZE}, int16, big", ">i2"),
        (f"{SIZE},float32,little", "<f4"),
        (f"{SIZE},int16", "<i2"),
    ],
)
def test_what_voxels_are_is_given(tmp_path: Path, given: str, kind: str) -> None:
    array = (F // 8).astype(kind)
    (tmp_path / "f 9x9x9 int8.raw").write_bytes(array.tobytes())
    grid = open_file(tmp_path / "f 9x9x9 int8.raw", {"raw": given})
    np.testing.assert_array_equal(grid.whole(), array)
    assert "as given" in grid.notes[0]


@pytest.mark.parametrize(
    "given", ["16x20", f"{SIZE}", f"{SIZE},quad", f"{SIZE},uint8,middle", "uint8", f"-{SIZE},uint8"]
)
def test_what_says_too_little_is_refused(tmp_path: Path, given: str) -> None:
    (tmp_path / "f.raw").write_bytes(F.tobytes())
    with pytest.raises(
        VolumeError,
        match="need their sizes, a type and a byte order: raw = '256x256x128,uint8,little'",
    ):
        open_file(tmp_path / "f.raw", {"raw": given})


@pytest.mark.parametrize("more", [-1, 1])
def test_a_file_of_another_length_is_refused(tmp_path: Path, more: int) -> None:
    body = (F.tobytes() + b"\0")[: F.nbytes + more]
    path = tmp_path / f"f_{SIZE}_int16.raw"
    path.write_bytes(body)
    with pytest.raises(
        VolumeError,
        match=rf"has {F.nbytes + more} bytes, and 16 × 20 × 12 voxels of int16 take 7680",
    ):
        open_file(path, {})
    packed = tmp_path / f"f_{SIZE}_int16.raw.gz"
    packed.write_bytes(gzip.compress(body))
    with pytest.raises(
        VolumeError,
        match="goes on after its last voxel" if more > 0 else "ends before its last voxel",
    ):
        open_file(packed, {}).whole()


def test_a_file_that_says_nothing_is_refused_with_what_to_do(tmp_path: Path) -> None:
    for name in ("f.raw", "f.raw.gz", "16x20x12.txt", "f_16x20.bin"):
        (tmp_path / name).write_bytes(F.tobytes())
        with pytest.raises(
            VolumeError, match=r"--raw 256x256x128,uint8,little|no volume that is known"
        ):
            open_file(tmp_path / name, {})


@pytest.mark.parametrize("name", ["f.raw", "f#1.raw", "f %41 æ.raw", "f#1.bin"])
def test_a_scene_says_what_voxels_are(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(F.astype(">i2").tobytes())
    (tmp_path / "s.toml").write_text(f'volume = "{name}"\nraw = "{SIZE},int16,big"\n')
    scene = load_scene(tmp_path / "s.toml")
    assert scene.volume.value_range == (0.0, float(F.max()))
    (tmp_path / "t.toml").write_text(f'volume = "{name}#raw={SIZE},int16,big"\n')
    asked = (
        tmp_path / "t.toml",
        f"{tmp_path / name}#raw={SIZE},int16,big",
        f"{tmp_path / name}#raw={SIZE}%2Cint16%2Cbig",
    )
    assert {load_scene(each).volume.digest for each in asked} == {scene.volume.digest}
