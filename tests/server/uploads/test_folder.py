"""The folder of uploads: what it holds is whole."""

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from isogi_core.files.grid import Grid
from server.errors import FullError, UploadFolderError
from server.uploads.folder import UploadFolder, default_folder, write
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


def test_what_was_removed_is_gone(folder: UploadFolder) -> None:
    folder.remove(put(folder))
    assert not folder.uploads and not folder.held and not names(folder.path)


def test_unfinished_files_are_deleted_and_foreign_ones_left(folder: UploadFolder, tmp_path: Path) -> None:
    number = put(folder)
    folder.close()
    (folder.path / "x.part").write_bytes(b"half")
    (folder.path / "notes.nrrd").write_bytes(b"NRRD0004\n")
    (folder.path / f"{'0' * 20}.nrrd").symlink_to(folder.path / f"{number}.nrrd")
    folder.open()
    assert set(folder.uploads) == {number}
    assert names(folder.path) == {f"{number}.nrrd", "notes.nrrd", f"{'0' * 20}.nrrd"}


def test_a_folder_has_one_server(folder: UploadFolder) -> None:
    with pytest.raises(UploadFolderError, match=r"Another server .* --uploads"):
        UploadFolder(folder.path).open()


def test_a_file_is_on_the_disk_before_its_name_is(folder: UploadFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    fsync, replace = os.fsync, os.replace

    def noted(number: int) -> None:
        done.append("folder" if os.path.isdir(f"/proc/self/fd/{number}") else "file")
        fsync(number)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "replace", lambda *paths: (done.append("name"), replace(*paths)))
    put(folder)
    assert done == ["file", "name", "folder"]


def test_a_disk_that_is_full_says_so_and_nothing_is_left(folder: UploadFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FullError, match="disk"):
        put(folder)
    assert not names(folder.path) and not folder.uploads


KILLED = """
import sys, time
from pathlib import Path
from server.uploads.folder import UploadFolder
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


def test_the_users_own_folder_is_taken_where_none_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "isogi" / "volumes"
