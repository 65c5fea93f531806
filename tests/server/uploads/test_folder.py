"""The folder of uploads: what it holds is whole, what goes in comes out, and what isogi did not
write is none.
"""

import dataclasses
import errno
import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.formats.opening import open_file
from isogi_core.files.grid import Grid, LabelName
from isogi_server.errors import FullError
from isogi_server.uploads.folder import (
    UploadFolder,
    default_folder,
    read_volume,
    write,
)
from tests.loaded import read_nrrd
from tests.server.uploads.files import names

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[UploadFolder]:
    folder = UploadFolder(tmp_path / "volumes")
    folder.open()
    yield folder
    folder.close()


def put(folder: UploadFolder, value: int = 1) -> str:
    """A volume in the folder; its id."""
    with folder.drafts() as (_, draft):
        return folder.put(draft, write(draft, Grid.of(np.full((2, 2, 2), value, np.uint8)), "a")).id


def test_a_volume_is_found_again(folder: UploadFolder) -> None:
    numbers = {put(folder, 1), put(folder, 2)}
    folder.close()
    again = UploadFolder(folder.path)
    again.open()
    assert set(again.uploads) == numbers and again.uploads == folder.uploads
    assert names(folder.path) == {f"{number}.nrrd" for number in numbers}
    again.close()


def test_a_volume_of_an_earlier_version_keeps_its_shorter_id(folder: UploadFolder) -> None:
    number = put(folder)
    assert len(number) == 32, "128 bits"
    folder.close()
    (folder.path / f"{number}.nrrd").rename(folder.path / f"{number[:20]}.nrrd")
    (folder.path / f"{number}.nrrd.nrrd").touch()
    again = UploadFolder(folder.path)
    again.open()
    assert set(again.uploads) == {number[:20]}
    again.close()


def test_it_is_the_owners_alone(folder: UploadFolder) -> None:
    put(folder)
    assert folder.path.stat().st_mode & 0o777 == 0o700
    assert all(path.stat().st_mode & 0o077 == 0 for path in folder.path.glob("*.nrrd"))


def test_unfinished_files_are_deleted_and_foreign_ones_left(
    folder: UploadFolder, tmp_path: Path
) -> None:
    number = put(folder)
    folder.close()
    (folder.path / "x.part").write_bytes(b"half")
    (folder.path / "notes.nrrd").write_bytes(b"NRRD0004\n")
    (folder.path / f"{'0' * 20}.nrrd").symlink_to(folder.path / f"{number}.nrrd")
    folder.open()
    assert set(folder.uploads) == {number}
    assert names(folder.path) == {f"{number}.nrrd", "notes.nrrd", f"{'0' * 20}.nrrd"}
    folder.remove(number)
    assert not folder.uploads and not folder.held


def test_a_file_is_on_the_disk_before_its_name_is(
    folder: UploadFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    fsync = os.fsync
    replace = os.replace

    def noted(number: int) -> None:
        done.append("folder" if os.path.isdir(f"/proc/self/fd/{number}") else "file")
        fsync(number)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "replace", lambda *paths: (done.append("name"), replace(*paths)))
    put(folder)
    assert done == ["file", "name", "folder"]


def test_a_disk_that_is_full_says_so_and_nothing_is_left(
    folder: UploadFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FullError, match="disk"):
        put(folder)
    assert not names(folder.path) and not folder.uploads


KILLED = """
import sys, time
from pathlib import Path
from isogi_server.uploads.folder import UploadFolder
folder = UploadFolder(Path(sys.argv[1]))
folder.open()
with folder.drafts() as (body, draft):
    for file in (body, draft):
        file.write(bytes(1 << 20))
        file.flush()
    print("half", flush=True)
    time.sleep(60)
"""


def test_a_kill_in_the_middle_leaves_nothing(folder: UploadFolder) -> None:
    number = put(folder)
    folder.close()
    command = [sys.executable, "-c", KILLED, str(folder.path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, text=True) as server:
        assert server.stdout and server.stdout.readline() == "half\n"
        server.send_signal(signal.SIGKILL)
    folder.open()
    assert names(folder.path) == {f"{number}.nrrd"}


def test_the_users_own_folder_is_taken_where_none_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "isogi" / "volumes"


RAMP = np.arange(24).reshape(2, 3, 4)


def kept(
    folder: Path, array: np.ndarray, name: str = "a", labels: tuple[LabelName, ...] | None = None
) -> Path:
    """The canonical file of an array, under its id."""
    file = io.BytesIO()
    number = write(file, dataclasses.replace(Grid.of(array, (1.0, 2.0, 0.1)), labels=labels), name)
    path = folder / f"{number}.nrrd"
    path.write_bytes(file.getvalue())
    return path


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
def test_a_volume_is_read_as_it_was(tmp_path: Path, kind: str, order: str) -> None:
    path = kept(tmp_path, RAMP.astype(np.dtype(kind).newbyteorder(order)))
    array, spacing = read_nrrd(path)
    np.testing.assert_array_equal(array, RAMP)
    assert (array.dtype.newbyteorder("="), spacing) == (np.dtype(kind), (1.0, 2.0, 0.1))
    facts = read_volume(path)
    assert facts and (facts.id, facts.size, facts.bytes) == (
        path.stem,
        (4, 3, 2),
        path.stat().st_size,
    )


def test_the_id_is_of_the_voxels_and_not_of_order_layout_or_name(tmp_path: Path) -> None:
    same = [RAMP.astype("<i2"), RAMP.astype(">i2"), np.asfortranarray(RAMP.astype("<i2"))]
    assert (
        len({kept(tmp_path, array, name).stem for array, name in zip(same, "abc", strict=True)})
        == 1
    )
    assert kept(tmp_path, RAMP.astype("<i4")).stem != kept(tmp_path, same[0]).stem


@pytest.mark.parametrize(
    "name", ["Zwei Kugeln é 球", "a\\nb: c", "<script>", "sizes: 1 1 1", "%41", "x" * 80]
)
def test_a_name_is_kept_whatever_is_in_it(tmp_path: Path, name: str) -> None:
    facts = read_volume(kept(tmp_path, RAMP.astype("u1"), name))
    assert facts and facts.name == name


def test_what_has_no_name_is_called_after_its_id(tmp_path: Path) -> None:
    facts = read_volume(kept(tmp_path, RAMP.astype("u1"), ""))
    assert facts and facts.name == f"volume {facts.id[:6]}"


def test_the_quota_counts_what_the_server_holds(tmp_path: Path) -> None:
    ramp = np.arange(1000).reshape(10, 10, 10)
    small, wide = (read_volume(kept(tmp_path, ramp.astype(kind))) for kind in ("u1", "f8"))
    assert small and wide
    beside = small.held - 4 * 1000
    assert 1 << 17 <= beside <= 1 << 19, "its scene takes memory, too"
    assert wide.held - beside == wide.bytes > 8 * 1000


LABELS = (
    LabelName(1, "Leber é", "#dd8265"),
    LabelName(2, "odd\nSegment7_Name:=x\\ne", ""),
    LabelName(9, "x" * 300, "#000001"),
)


MARKED = RAMP.astype("u1")


def test_labels_keep_their_names_and_colours(tmp_path: Path) -> None:
    """What a name may not hold is left out of it: it makes no line of its own."""
    path = kept(tmp_path, MARKED, "a", LABELS)
    assert read_volume(path)
    odd = LabelName(2, "oddSegment7_Name:=xne", "")
    assert open_file(path, {}).labels == (LABELS[0], odd, LabelName(9, "x" * 64, "#000001"))
    bare = kept(tmp_path, MARKED)
    assert open_file(bare, {}).labels is None and bare.stem != path.stem
    assert open_file(kept(tmp_path, MARKED, "a", ()), {}).labels is not None
    many = kept(
        tmp_path, MARKED, "a", tuple(LabelName(n, "ä" * 64, "#123456") for n in range(1, 400))
    )
    assert read_volume(many) and len(open_file(many, {}).labels or ()) == 255


def test_what_isogi_did_not_write_is_none(tmp_path: Path) -> None:
    whole = kept(tmp_path, RAMP.astype("u1")).read_bytes()
    others = [
        whole[:-1],
        whole + b"x",
        whole.replace(b"raw", b"gzip"),
        b"",
        whole.replace(b"uint8", b"uint9"),
    ]
    detached = whole.replace(b"name:=a", b"data file: /etc/passwd")
    for text in (*others, detached):
        (tmp_path / "a.nrrd").write_bytes(text)
        assert read_volume(tmp_path / "a.nrrd") is None, text
