"""The shelf: what is on it is whole, and nothing else ever is."""

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from server.errors import FullError, ShelfError
from server.uploads.canonical import write
from server.uploads.shelf import Shelf, default_folder
from tests.server.uploads.files import names

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def shelf(tmp_path: Path) -> Iterator[Shelf]:
    shelf = Shelf(tmp_path / "volumes")
    shelf.open()
    yield shelf
    shelf.close()


def put(shelf: Shelf, value: int = 1) -> str:
    """A volume on the shelf; its id."""
    with shelf.drafts() as (_, draft):
        return shelf.put(draft, write(draft, np.full((2, 2, 2), value, np.uint8), (1.0, 1.0, 1.0), "a")).id


def test_a_volume_is_found_again(shelf: Shelf) -> None:
    numbers = {put(shelf, 1), put(shelf, 2)}
    shelf.close()
    again = Shelf(shelf.folder)
    again.open()
    assert set(again.volumes) == numbers and again.volumes == shelf.volumes
    assert names(shelf.folder) == {f"{number}.nrrd" for number in numbers}
    again.close()


def test_it_is_the_owners_alone(shelf: Shelf) -> None:
    put(shelf)
    assert shelf.folder.stat().st_mode & 0o777 == 0o700
    assert all(path.stat().st_mode & 0o077 == 0 for path in shelf.folder.glob("*.nrrd"))


def test_what_was_removed_is_gone(shelf: Shelf) -> None:
    shelf.remove(put(shelf))
    assert not shelf.volumes and not shelf.held and not names(shelf.folder)


def test_what_is_half_written_is_thrown_away_and_what_is_foreign_left(shelf: Shelf, tmp_path: Path) -> None:
    number = put(shelf)
    shelf.close()
    (shelf.folder / "x.part").write_bytes(b"half")
    (shelf.folder / "notes.nrrd").write_bytes(b"NRRD0004\n")
    (shelf.folder / f"{'0' * 20}.nrrd").symlink_to(shelf.folder / f"{number}.nrrd")
    shelf.open()
    assert set(shelf.volumes) == {number}
    assert names(shelf.folder) == {f"{number}.nrrd", "notes.nrrd", f"{'0' * 20}.nrrd"}


def test_a_folder_has_one_server(shelf: Shelf) -> None:
    with pytest.raises(ShelfError, match=r"Another server .* --uploads"):
        Shelf(shelf.folder).open()


def test_a_file_and_then_its_name_are_on_the_disk_before_it_counts(
    shelf: Shelf, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    fsync, replace = os.fsync, os.replace

    def noted(number: int) -> None:
        done.append("folder" if os.path.isdir(f"/proc/self/fd/{number}") else "file")
        fsync(number)

    monkeypatch.setattr(os, "fsync", noted)
    monkeypatch.setattr(os, "replace", lambda *paths: (done.append("name"), replace(*paths)))
    put(shelf)
    assert done == ["file", "name", "folder"]


def test_a_disk_that_is_full_says_so_and_nothing_is_left(shelf: Shelf, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FullError, match="disk"):
        put(shelf)
    assert not names(shelf.folder) and not shelf.volumes


KILLED = """
import sys, time
from pathlib import Path
from server.uploads.shelf import Shelf
shelf = Shelf(Path(sys.argv[1]))
shelf.open()
with shelf.drafts() as (body, draft):
    for file in (body, draft):
        file.write(bytes(1 << 20))
        file.flush()
    print("half", flush=True)
    time.sleep(60)
"""


def test_a_kill_in_the_middle_leaves_nothing(shelf: Shelf) -> None:
    number = put(shelf)
    shelf.close()
    command = [sys.executable, "-c", KILLED, str(shelf.folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, text=True) as server:
        assert server.stdout and server.stdout.readline() == "half\n"
        server.send_signal(signal.SIGKILL)
    shelf.open()
    assert names(shelf.folder) == {f"{number}.nrrd"}


def test_the_users_own_folder_is_taken_where_none_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "isogi" / "volumes"
