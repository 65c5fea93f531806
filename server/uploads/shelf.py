"""The shelf: the folder of uploaded volumes. Only canonical files whose name is their id stand on it."""

import errno
import fcntl
import logging
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from server.errors import FullError, ShelfError
from server.uploads.canonical import Kept, read_facts

log = logging.getLogger("isogi.uploads")

NUMBER = re.compile(r"[0-9a-f]{20}")
"""What ids look like."""

UNFINISHED = ".part"
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def default_folder() -> Path:
    """Where uploads are kept when nobody says where: ``$XDG_DATA_HOME/isogi/volumes``, or below ``~/.local/share``."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "isogi" / "volumes"


class Shelf:
    """The volumes in a ``folder`` of one server, in a table by their ids. Raises ShelfError, and FullError.

    The table is replaced and never changed: whoever walks through it may go on.
    """

    def __init__(self, folder: Path) -> None:
        """Name the place; nothing is opened yet."""
        self.folder = folder
        self.volumes: dict[str, Kept] = {}
        self._lock: IO[bytes] | None = None

    @property
    def held(self) -> int:
        """Bytes that count towards the quota."""
        return sum(kept.held for kept in self.volumes.values())

    def open(self) -> None:
        """Take the folder, for its owner alone; throw away what was half-written, and find what is whole."""
        with named(self.folder):
            self.folder.mkdir(0o700, parents=True, exist_ok=True)
            self.folder.chmod(0o700)
            self._lock = self._take()
            for path in self.folder.glob(f"*{UNFINISHED}"):
                path.unlink()
            self.volumes = {kept.id: kept for kept in map(self._read, sorted(self.folder.glob("*.nrrd"))) if kept}

    def close(self) -> None:
        """Leave the folder to others."""
        if self._lock is not None:
            self._lock.close()

    def place(self, number: str) -> Path:
        """The file of a volume that is on the shelf."""
        return self.folder / f"{self.volumes[number].id}.nrrd"

    @contextmanager
    def drafts(self) -> Iterator[tuple[IO[bytes], IO[bytes]]]:
        """Two files: for what a client sends, which has no name, and for its canonical form. Gone afterwards."""
        with named(self.folder):
            body = tempfile.TemporaryFile(dir=self.folder)  # noqa: SIM115
            draft = tempfile.NamedTemporaryFile(dir=self.folder, suffix=UNFINISHED, delete=False)  # noqa: SIM115
        try:
            with body, draft:
                yield body, draft
        finally:
            Path(draft.name).unlink(missing_ok=True)

    def put(self, draft: IO[bytes], number: str) -> Kept:
        """Have a canonical draft stand on the shelf under its id: once this returns no power cut takes it away."""
        place = self.folder / f"{number}.nrrd"
        with named(self.folder):
            draft.flush()
            os.fsync(draft.fileno())
            os.replace(draft.name, place)
            self._settle()
        kept = self._read(place)
        if kept is None:
            raise ShelfError(f"The volume in {place} did not come out as it went in: check the disk.")
        self.volumes = {**self.volumes, number: kept}
        return kept

    def remove(self, number: str) -> None:
        """Take a volume off the shelf."""
        with named(self.folder):
            self.place(number).unlink(missing_ok=True)
            self.volumes = {key: kept for key, kept in self.volumes.items() if key != number}
            self._settle()

    def _take(self) -> IO[bytes]:
        """The folder's lock, which other servers respect and which ends with the process."""
        lock = (self.folder / "lock").open("wb")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
        except BlockingIOError:
            lock.close()
            sentence = f"Another server keeps its uploads in {self.folder}: choose another folder with --uploads."
            raise ShelfError(sentence) from None

    def _settle(self) -> None:
        """Have the folder's names on the disk."""
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _read(self, path: Path) -> Kept | None:
        kept = read_facts(path) if NUMBER.fullmatch(path.stem) and not path.is_symlink() else None
        if kept is None:
            log.warning("%s is no volume that isogi has kept: it is left alone", path)
        return kept


@contextmanager
def named(folder: Path) -> Iterator[None]:
    """What the system says of a ``folder`` as an error that names it."""
    try:
        yield
    except OSError as error:
        if error.errno in FULL:
            raise FullError(f"The disk of {folder} is full: delete volumes, or make room.") from error
        raise ShelfError(f"The folder of uploads {folder} cannot be used ({error.strerror}).") from error
