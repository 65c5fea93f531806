"""A folder of this machine's disk, or of a network's, as a shelf of objects."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from isogi_core.cache.shelf import Entry, Found
from isogi_core.errors import ChangedError

ABSENT = (FileNotFoundError, NotADirectoryError)
TRIAL = bytes(1 << 16)
"""What is written to see whether there is room."""


class Folder:
    """Objects as files under ``path``. Each is written beside its place and renamed, so that it is whole or absent.

    Who replaces an object holds the lock of the file ``guard`` meanwhile: what is compared is what is replaced.
    """

    def __init__(self, path: Path, guard: str) -> None:
        """Touch nothing yet."""
        self.path = path
        self.guard = guard

    def get(self, key: str, known: Found | None = None) -> Found | None:
        """The object, or None where there is none."""
        try:
            with open(f"{self.path}/{key}", "rb", buffering=0) as file:
                return Found(file.read())
        except ABSENT:
            return None

    def put(self, key: str, data: bytes, former: Found | None) -> None:
        """Write an object in place of the ``former``; ChangedError where another stands there by now."""
        path = self.path / key
        with opened(self.path / self.guard, os.O_RDWR) as guard:
            path.parent.mkdir(parents=True, exist_ok=True)
            with partial(path, data) as written:
                fcntl.flock(guard, fcntl.LOCK_EX)
                if self.get(key) != former:
                    raise ChangedError(f"Somebody else has written {key} meanwhile: read it again.")
                os.replace(written, path)

    def found(self, data: bytes) -> None:
        """Make the guard, and have it on the disk before there is anything else; ChangedError where there is one."""
        self.path.mkdir(parents=True, exist_ok=True)
        with partial(self.path / self.guard, data, sync=True) as written:
            try:
                os.link(written, self.path / self.guard)
            except FileExistsError:
                raise ChangedError(f"There is a {self.guard} by now.") from None
            except OSError:  # a file system without hard links
                os.replace(written, self.path / self.guard)
        with opened(self.path, os.O_RDONLY) as folder:
            os.fsync(folder)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there, and the folders that it leaves empty."""
        (self.path / key).unlink(missing_ok=True)
        self._remove_empty((self.path / key).parent)

    def _remove_empty(self, folder: Path) -> None:
        """Remove folders from here up that are empty, but for the root; who writes into one makes it again."""
        with suppress(OSError):
            while folder != self.path:
                folder.rmdir()
                folder = folder.parent

    def names(self, folder: str) -> list[str]:
        """Names of the folders right under ``folder``."""
        try:
            with os.scandir(self.path / folder) as entries:
                return sorted(entry.name for entry in entries if entry.is_dir())
        except ABSENT:
            return []

    def keys(self, folder: str) -> Iterator[str]:
        """Keys of all objects under ``folder``, those that are half written left out."""
        for base, _, files in os.walk(self.path / folder):
            for name in files:
                if not name.endswith(".partial"):
                    yield Path(base, name).relative_to(self.path).as_posix()

    def entries(self) -> Iterator[Entry]:
        """All files, those that vanish meanwhile left out; links are not followed."""
        for base, _, files in os.walk(self.path):
            for path in (Path(base, name) for name in files):
                with suppress(FileNotFoundError):
                    facts = path.lstat()
                    yield Entry(path.relative_to(self.path).as_posix(), facts.st_size, facts.st_mtime)

    def move(self, key: str, to: str) -> None:
        """Rename a file, if it is there: it is whole under one of its names at any time."""
        (self.path / to).parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            os.replace(self.path / key, self.path / to)

    def prove(self, data: bytes) -> None:
        """Raise what writing would; nothing is left of it."""
        with partial(self.path / "probe", TRIAL):
            pass


@contextmanager
def partial(path: Path, data: bytes, sync: bool = False) -> Iterator[Path]:
    """A file beside ``path`` with this in it, for the block to rename; gone afterwards. ``sync`` has it on the disk."""
    written = path.with_suffix(f".{uuid4().hex}.partial")
    try:
        with written.open("xb") as file:
            file.write(data)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        yield written
    finally:
        written.unlink(missing_ok=True)


@contextmanager
def opened(path: Path, flags: int) -> Iterator[int]:
    """The descriptor of a file or folder while the block runs; closing it gives its lock back."""
    descriptor = os.open(path, flags)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
