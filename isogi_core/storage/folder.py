"""A folder, on this machine's disk or on a network's, as a backend."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from isogi_core.errors import ChangedError
from isogi_core.storage.atomic_file import PARTIAL_SUFFIX, partial_file, sync_folder
from isogi_core.storage.backend import Entry, StoredObject

ABSENT_ERRORS = (FileNotFoundError, NotADirectoryError)
TRIAL_OBJECT = bytes(1 << 16)
"""Bytes that are written, and deleted, to see whether there is room."""

FOLDER_TRIES = 9
"""Times that a folder is made for an object while others delete it."""


class Folder:
    """Objects as files under ``path``. Each is written beside its path and then renamed: it is whole or absent.

    A writer locks the file ``sentinel`` while it compares and replaces, so that nobody writes in between.
    """

    def __init__(self, path: Path, sentinel: str) -> None:
        """Touch nothing yet."""
        self.path = path
        self.sentinel = sentinel

    def get(self, key: str, known: StoredObject | None = None) -> StoredObject | None:
        """Read an object; None where there is none."""
        try:
            with open(f"{self.path}/{key}", "rb", buffering=0) as file:
                return StoredObject(file.read())
        except ABSENT_ERRORS:
            return None

    def put(self, key: str, data: bytes, former: StoredObject | None) -> None:
        """Write an object in place of ``former``; ChangedError where another was written meanwhile."""
        path = self.path / key
        with open_descriptor(self.path / self.sentinel, os.O_RDWR) as lock, self._partial(path, data) as written:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if self.get(key) != former:
                raise ChangedError(f"Another writer has changed {key} meanwhile: read it again.")
            os.replace(written, path)

    @contextmanager
    def _partial(self, path: Path, data: bytes) -> Iterator[Path]:
        """A partial file for ``path``; its folder is made, and made again where a deleter removes it meanwhile."""
        for left in reversed(range(FOLDER_TRIES)):
            with ExitStack() as stack:
                try:
                    path.parent.mkdir(parents=True, exist_ok=True)
                    written = stack.enter_context(partial_file(path, data))
                except (FileNotFoundError, FileExistsError):
                    if left:
                        continue
                    raise
                yield written
                return

    def create_sentinel(self, data: bytes) -> None:
        """Write the sentinel, and bring it to the disk before anything else; ChangedError where there is one."""
        self.path.mkdir(parents=True, exist_ok=True)
        with partial_file(self.path / self.sentinel, data, sync=True) as written:
            try:
                os.link(written, self.path / self.sentinel)
            except FileExistsError:
                raise ChangedError(f"There is a {self.sentinel} by now.") from None
            except OSError:  # a file system without hard links
                os.replace(written, self.path / self.sentinel)
        sync_folder(self.path)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there, and the folders that are empty then."""
        (self.path / key).unlink(missing_ok=True)
        self._remove_empty((self.path / key).parent)

    def _remove_empty(self, folder: Path) -> None:
        """Remove empty folders from here up to the top, which stays; a writer makes its folder again."""
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
        """List the keys of all objects under ``folder``, but for half-written ones."""
        for base, _, files in os.walk(self.path / folder):
            for name in files:
                if not name.endswith(PARTIAL_SUFFIX):
                    yield Path(base, name).relative_to(self.path).as_posix()

    def entries(self) -> Iterator[Entry]:
        """List all files, but for those that vanish meanwhile; links are not followed."""
        for base, _, files in os.walk(self.path):
            for path in (Path(base, name) for name in files):
                with suppress(FileNotFoundError):
                    state = path.lstat()
                    yield Entry(path.relative_to(self.path).as_posix(), state.st_size, state.st_mtime)

    def move(self, key: str, to: str) -> None:
        """Rename a file, if it is there: it is whole under one of its names at any time."""
        (self.path / to).parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            os.replace(self.path / key, self.path / to)

    def check_writable(self, data: bytes) -> None:
        """Raise the error that a write would raise. The file that is written for this is deleted again."""
        with partial_file(self.path / "probe", TRIAL_OBJECT):
            pass


@contextmanager
def open_descriptor(path: Path, flags: int) -> Iterator[int]:
    """Open a file for the block and yield its descriptor; closing it gives its lock back."""
    descriptor = os.open(path, flags)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
