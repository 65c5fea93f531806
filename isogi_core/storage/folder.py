"""Folders as backends of a store: on a local disk, on a network drive, or behind an fsspec file
system.

A folder of this machine also keeps copies of a remote store's objects, so that unchanged objects
are not sent again.
"""

import fcntl
import logging
import math
import os
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, contextmanager, suppress
from hashlib import blake2b
from pathlib import Path

import google_crc32c
from zarr.abc.store import Store
from zarr.core.buffer import default_buffer_prototype
from zarr.core.sync import sync
from zarr.storage._common import make_store

from isogi_core.errors import ChangedError
from isogi_core.storage.atomic_file import (
    PARTIAL_SUFFIX,
    partial_file,
    sync_folder,
    user_cache,
    write_whole,
)
from isogi_core.storage.backend import Entry, StoredObject, StoreUrl

ABSENT_ERRORS = (FileNotFoundError, NotADirectoryError)
TRIAL_OBJECT = bytes(1 << 16)
"""Bytes that are written and deleted to test if there is room."""

FOLDER_TRIES = 64
FOLDER_PAUSE = 1e-3
"""Tries of making a folder for an object while others delete it as empty, and seconds between two
of them, so that no deleter keeps step.
"""


class Folder:
    """Objects as files under ``path``. Each is written to a partial file and then renamed, so it is
    whole or absent.

    A writer locks the file ``sentinel`` while it compares and replaces an object, so that no other
    writes in between.
    """

    def __init__(self, path: Path, sentinel: str) -> None:
        """Set up without touching the disk."""
        self.path = path
        self.sentinel = sentinel

    def get(self, key: str, known: StoredObject | None = None) -> StoredObject | None:
        """Read an object; None if there is none."""
        try:
            with open(f"{self.path}/{key}", "rb", buffering=0) as file:
                return StoredObject(file.read())
        except ABSENT_ERRORS:
            return None

    def put(self, key: str, data: bytes, former: StoredObject | None) -> None:
        """Write an object in place of ``former``.

        Raises ChangedError if another was written meanwhile.
        """
        path = self.path / key
        # Open the sentinel first: that fails if the store is gone, and takes no lock yet. Lock it
        # after the data is written, which takes long: under the lock are one read and one rename.
        with (
            open_descriptor(self.path / self.sentinel, os.O_RDWR) as sentinel,
            self._partial(path, data) as written,
        ):
            fcntl.flock(sentinel, fcntl.LOCK_EX)
            if self.get(key) != former:
                raise ChangedError(f"Another writer has changed {key} meanwhile: read it again.")
            os.replace(written, path)

    @contextmanager
    def _partial(self, path: Path, data: bytes) -> Iterator[Path]:
        """Yield a partial file for ``path``, in its folder, which is made if it is missing.

        If a deleter removes the folder as empty in between, make it again.
        """
        for left in reversed(range(FOLDER_TRIES)):
            with ExitStack() as stack:
                try:
                    path.parent.mkdir(parents=True, exist_ok=True)
                    written = stack.enter_context(partial_file(path, data))
                except (FileNotFoundError, FileExistsError):
                    if not left:
                        raise
                    time.sleep(FOLDER_PAUSE)
                    continue
                yield written
                return

    def create_sentinel(self, data: bytes) -> None:
        """Write the sentinel, and bring it to the disk before anything else.

        Raises ChangedError if there is one.
        """
        # The sentinel marks the store as present, so it must survive a loss of power if light does.
        self.path.mkdir(parents=True, exist_ok=True)
        with partial_file(self.path / self.sentinel, data, sync=True) as written:
            try:
                # Unlike a rename, a hard link fails if the name is taken.
                os.link(written, self.path / self.sentinel)
            except FileExistsError:
                raise ChangedError(
                    f"Another process has written {self.sentinel} meanwhile."
                ) from None
            except OSError:  # a file system without hard links
                os.replace(written, self.path / self.sentinel)
        sync_folder(self.path)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there, and folders that become empty."""
        (self.path / key).unlink(missing_ok=True)
        self._remove_empty((self.path / key).parent)

    def _remove_empty(self, folder: Path) -> None:
        """Remove empty folders from ``folder`` up to the store's top, which stays.

        A writer makes its folder again.
        """
        with suppress(OSError):
            while folder != self.path:
                folder.rmdir()
                folder = folder.parent

    def folders(self, folder: str) -> list[str]:
        """List the names of the folders right under ``folder``."""
        try:
            with os.scandir(self.path / folder) as entries:
                return sorted(entry.name for entry in entries if entry.is_dir())
        except ABSENT_ERRORS:
            return []

    def keys(self, folder: str) -> Iterator[str]:
        """List the keys of all objects under ``folder``, without half-written ones, in no fixed
        order.

        A folder that is missing or cannot be read counts as empty.
        """
        for base, _, files in os.walk(self.path / folder):
            for name in files:
                if not name.endswith(PARTIAL_SUFFIX):
                    yield Path(base, name).relative_to(self.path).as_posix()

    def entries(self) -> Iterator[Entry]:
        """List all files, without those that vanish meanwhile. Links are not followed."""
        for base, _, files in os.walk(self.path):
            for path in (Path(base, name) for name in files):
                with suppress(FileNotFoundError):
                    state = path.lstat()
                    yield Entry(
                        path.relative_to(self.path).as_posix(), state.st_size, state.st_mtime
                    )

    def move(self, key: str, to: str) -> None:
        """Rename a file, if it is there: it is whole under one of its names at any time."""
        (self.path / to).parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            os.replace(self.path / key, self.path / to)

    def check_writable(self, data: bytes) -> None:
        """Raise the error that a write would raise, by writing TRIAL_OBJECT and deleting it again.

        ``data`` is ignored: unlike the short sentinel, TRIAL_OBJECT shows if the disk is full.
        """
        with partial_file(self.path / "probe", TRIAL_OBJECT):
            pass


@contextmanager
def open_descriptor(path: Path, flags: int) -> Iterator[int]:
    """Open a file for the block and yield its descriptor. Closing it releases its lock."""
    descriptor = os.open(path, flags)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


class FileSystem:
    """Objects under a store URL that Zarr opens, such as those of fsspec.

    Methods raise the errors of that file system, of many kinds. Objects have no tags.
    """

    def __init__(self, store_url: StoreUrl, sentinel: str) -> None:
        """Open the store as Zarr does."""
        self.sentinel = sentinel
        self._store: Store = sync(make_store(store_url.url, mode="a"))

    def get(self, key: str, known: StoredObject | None = None) -> StoredObject | None:
        """Read an object; None if there is none.

        ``known`` is ignored: without tags, the store cannot say that an object is unchanged.
        """
        stored = sync(self._store.get(key, default_buffer_prototype()))
        if stored is None:
            return None
        return StoredObject(stored.to_bytes())

    def put(self, key: str, data: bytes, former: StoredObject | None) -> None:
        """Write an object in place of ``former``.

        Raises ChangedError if there is another object than ``former``. The check and the write are
        separate calls: an object that is written between them is lost.
        """
        if self.get(key) != former:
            raise ChangedError(f"Another writer has changed {key} meanwhile: read it again.")
        self._set(key, data)

    def create_sentinel(self, data: bytes) -> None:
        """Write the sentinel. Raises ChangedError if there is one."""
        self.put(self.sentinel, data, None)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        sync(self._store.delete(key))

    def folders(self, folder: str) -> list[str]:
        """List the names of the folders right under ``folder``.

        Zarr lists objects and folders alike. Those with a dot in their names, such as zarr.json,
        are taken for objects, all others for folders.
        """
        names = {name.partition("/")[0] for name in sync(listed(self._store.list_dir(folder)))}
        return sorted(name for name in names if "." not in name)

    def keys(self, folder: str) -> Iterator[str]:
        """List the keys of all objects under ``folder``."""
        yield from sync(listed(self._store.list_prefix(folder)))

    def entries(self) -> Iterator[Entry]:
        """List all objects. Their times of writing are unknown."""
        for key in self.keys(""):
            yield Entry(key, sync(self._store.getsize(key)), math.nan)

    def move(self, key: str, to: str) -> None:
        """Copy an object, if it is there, and then delete it."""
        found = self.get(key)
        if found is not None:
            self._set(to, found.data)
            self.delete(key)

    def check_writable(self, data: bytes) -> None:
        """Write the sentinel once more, unchanged."""
        self._set(self.sentinel, data)

    def _set(self, key: str, data: bytes) -> None:
        """Write the object ``key``, regardless of a former one."""
        sync(self._store.set(key, default_buffer_prototype().buffer.from_bytes(data)))


async def listed(names: AsyncIterator[str]) -> list[str]:
    """Return the names as a list."""
    return [name async for name in names]


log = logging.getLogger("isogi.cache")

ROOM_MADE = 0.9
"""Share of the room that stays filled when the oldest copies are deleted,
so that a scan serves many writes.
"""


class Copies:
    """Copies of objects of the store ``url`` in ``folder``, at most ``most`` bytes together with
    other stores' there.

    The longest unused are deleted first. Several processes may share the folder. A copy that cannot
    be written is left out, and a damaged one is not used. Safe to use from many threads.
    """

    def __init__(self, url: str, most: int, folder: Path | None = None) -> None:
        """Set up without touching the disk."""
        self._url = url
        self._most = most
        self._folder = folder or user_cache("chunks")
        self._lock = threading.Lock()
        self._grown = most  # as if full: the first put scans the folder

    def get(self, key: str) -> StoredObject | None:
        """Read the copy of an object; None if there is none, or if it is damaged."""
        path = self._path(key)
        try:
            kept = path.read_bytes()
            # The time of the file orders copies by their last use.
            os.utime(path)
        except OSError:
            return None
        # A copy is a line with the checksum, a line with the tag, and the data.
        checksum, _, checked = kept.partition(b"\n")
        tag, _, data = checked.partition(b"\n")
        if checksum == checksum_of(checked):
            return StoredObject(data, tag.decode())
        return None

    def put(self, key: str, found: StoredObject) -> None:
        """Write a copy of an object. One without a tag is not copied, as the store could not
        confirm the copy.
        """
        if not found.tag:
            return
        # The checksum covers the line with the tag and the data, as ``get`` reads them.
        checked = found.tag.encode() + b"\n" + found.data
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_whole(self._path(key), checksum_of(checked) + b"\n" + checked)
            self._make_room(len(checked))
        except OSError as error:
            log.info("A copy of light cannot be written to %s: %s", self._folder, error)

    def _path(self, key: str) -> Path:
        """Return the file of a copy, named by a digest of the store's URL and the key."""
        return self._folder / blake2b(f"{self._url}/{key}".encode(), digest_size=16).hexdigest()

    def _make_room(self, size: int) -> None:
        """Delete the longest unused copies, but only each time
        that a tenth of the room was filled since the last scan.
        """
        with self._lock:
            self._grown += size
            if self._grown <= (1.0 - ROOM_MADE) * self._most:
                return
            # Scan the folder, which other processes may share, and delete the longest unused copies
            # of any store.
            self._grown = 0
            with os.scandir(self._folder) as entries:
                files = sorted(
                    (entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in entries
                )
            total = sum(kept for _, kept, _ in files)
            for _, kept, path in files:
                if total <= ROOM_MADE * self._most:
                    return
                Path(path).unlink(missing_ok=True)
                total -= kept


def checksum_of(data: bytes) -> bytes:
    """Return the checksum that a copy begins with."""
    return b"%08x" % google_crc32c.value(data)
