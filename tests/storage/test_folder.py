"""A folder as a store, at its worst moments: writers that fail, die or delete beside each other
lose nothing.
"""

import errno
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from isogi_core.errors import StoreError, StoreFullError
from isogi_core.storage import folder as folder_module
from isogi_core.storage.atomic_file import write_whole
from isogi_core.storage.backend import StoredObject
from isogi_core.storage.store import Store

KEY = "layer/c/0/0/0/0"
OTHER = "layer/c/0/0/1/0"
OLD = b"old light"
NEW = b"new light"

DIES = """
import os, signal, sys
from pathlib import Path
from isogi_core.storage.folder import Folder

folder, key = Folder(Path(sys.argv[1]), sys.argv[2]), sys.argv[3]
found = folder.get(key)
setattr(os, sys.argv[4], lambda *_: os.kill(os.getpid(), signal.SIGKILL))
folder.put(key, b"new light", found)
"""
"""Writes an object, and is killed when it calls the function of `os` that its last argument
names.
"""


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A store of one object."""
    store = Store(tmp_path / "light")
    store.put(KEY, OLD, None)
    return store


def files(store: Store) -> list[str]:
    """The files of a store, half-written ones included."""
    return [entry.key for entry in store.entries()]


class Narrow:
    """A file on a disk that is full after four bytes."""

    def __init__(self, path: Path, mode: str) -> None:
        self._file = open(path, mode)  # noqa: SIM115

    def __enter__(self) -> "Narrow":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def write(self, data: bytes) -> None:
        self._file.write(data[:4])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Has files that are new take no more than that."""
    plain = Path.open
    monkeypatch.setattr(
        Path,
        "open",
        lambda path, mode="r", **more: (Narrow if mode == "xb" else plain)(path, mode, **more),
    )


def failing(name: str) -> Callable[[pytest.MonkeyPatch], None]:
    """Has a function of ``os``, or of ``fcntl``, fail as on a disk that breaks."""

    def fail(*_: Any) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    return lambda monkeypatch: monkeypatch.setattr(f"isogi_core.storage.{name}", fail)


@pytest.mark.parametrize(
    ("step", "raised"),
    [
        (no_room, StoreFullError),
        (failing("folder.fcntl.flock"), StoreError),
        (failing("folder.os.replace"), StoreError),
    ],
    ids=["write", "lock", "rename"],
)
def test_a_write_that_fails_at_any_step_changes_nothing(
    store: Store,
    monkeypatch: pytest.MonkeyPatch,
    step: Callable[[pytest.MonkeyPatch], None],
    raised: type[StoreError],
) -> None:
    kept = files(store)
    with monkeypatch.context() as patch, pytest.raises(raised):
        step(patch)
        store.put(KEY, NEW, StoredObject(OLD))
    assert files(store) == kept and store.get(KEY) == StoredObject(OLD)
    store.put(KEY, NEW, StoredObject(OLD))
    assert store.get(KEY) == StoredObject(NEW)


@pytest.mark.parametrize("moment", ["replace", "close"])
@pytest.mark.parametrize("key", [KEY, OTHER])
def test_a_writer_that_is_killed_leaves_objects_whole(store: Store, key: str, moment: str) -> None:
    """Before it renames the file and while it has the lock, or right after."""
    code = [sys.executable, "-c", DIES, str(store.url), "isogi.json", key, moment]
    assert subprocess.run(code, check=False).returncode == -signal.SIGKILL
    again = Store(store.url, make=False)
    former = StoredObject(OLD) if key == KEY else None
    found = again.get(key)
    assert found == (former if moment == "replace" else StoredObject(NEW))
    assert again.get(KEY) == (found if key == KEY else StoredObject(OLD))
    assert sorted(again.keys("layer")) == sorted({KEY} | ({key} if found else set()))
    halves = [name for name in files(again) if name.endswith(".partial")]
    assert len(halves) == (moment == "replace"), "what is left of it is listed, to be cleaned up"
    again.put(key, b"newer light", found)
    assert again.get(key) == StoredObject(b"newer light")


def test_who_deletes_the_last_of_a_folder_hinders_no_writer(store: Store) -> None:
    """The folder of an object goes with it, also between a writer's making it and its file
    there.
    """
    stopped = threading.Event()

    def delete() -> None:
        while not stopped.is_set():
            store.delete(OTHER)

    deleting = threading.Thread(target=delete)
    deleting.start()
    try:
        for number in range(300):
            store.put("layer/c/0/0/1/1", b"%d" % number, None)
            store.delete("layer/c/0/0/1/1")
    finally:
        stopped.set()
        deleting.join()
    assert files(store) == ["isogi.json", KEY]


def test_a_writer_makes_the_folder_again_that_went(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    went = list[str]()
    partial_file = folder_module.partial_file

    def late(path: Path, data: bytes) -> Any:
        if not went:
            path.parent.rmdir()
            went.append(path.parent.name)
        return partial_file(path, data)

    monkeypatch.setattr(folder_module, "partial_file", late)
    store.put("layer/c/0/0/1/1", NEW, None)
    assert went == ["1"] and store.get("layer/c/0/0/1/1") == StoredObject(NEW)


def test_readers_of_a_file_that_is_written_see_old_or_new(tmp_path: Path) -> None:
    path = tmp_path / "file"
    contents = [bytes([number]) * (1 << 16) for number in range(2)]
    write_whole(path, contents[0])
    stopped = threading.Event()
    seen = set[bytes]()

    def read() -> None:
        while not stopped.is_set():
            seen.add(path.read_bytes())

    reading = threading.Thread(target=read)
    reading.start()
    for number in range(400):
        write_whole(path, contents[number % 2])
    stopped.set()
    reading.join()
    assert seen <= {*contents} and [each.name for each in tmp_path.iterdir()] == ["file"]
