"""Copies of a remote store's objects on this machine's disk: an object that is read again is not sent again."""

import logging
import os
import threading
from hashlib import blake2b
from pathlib import Path

import google_crc32c

from isogi_core.storage.atomic_file import write_whole
from isogi_core.storage.backend import StoredObject

log = logging.getLogger("isogi.cache")

ROOM_MADE = 0.9
"""Share of the room that stays filled when the oldest copies are deleted."""


def default_copies() -> Path:
    """The default folder of copies: ``$XDG_CACHE_HOME/isogi/chunks`` or ``~/.cache/isogi/chunks``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isogi" / "chunks"


class Copies:
    """At most ``most`` bytes of objects of the store ``url`` in ``folder``; the oldest of any store are deleted first.

    Several processes may share the folder. A copy that cannot be written is left out, and a damaged one is not used.
    Safe to use from many threads.
    """

    def __init__(self, url: str, most: int, folder: Path | None = None) -> None:
        """Touch nothing yet."""
        self._url = url
        self._most = most
        self._folder = folder or default_copies()
        self._lock = threading.Lock()
        self._grown = most  # as if full: the first put scans the folder

    def get(self, key: str) -> StoredObject | None:
        """Read the copy of an object; None where there is none."""
        path = self._path(key)
        try:
            kept = path.read_bytes()
            os.utime(path)
        except OSError:
            return None
        checksum, _, rest = kept.partition(b"\n")
        tag, _, data = rest.partition(b"\n")
        return StoredObject(data, tag.decode()) if checksum == checksum_of(rest) else None

    def put(self, key: str, found: StoredObject) -> None:
        """Write a copy. An object without a tag gets none: it could never be used."""
        if not found.tag:
            return
        rest = found.tag.encode() + b"\n" + found.data
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_whole(self._path(key), checksum_of(rest) + b"\n" + rest)
            self._make_room(len(rest))
        except OSError as error:
            log.info("A copy of light cannot be kept at %s: %s", self._folder, error)

    def _path(self, key: str) -> Path:
        return self._folder / blake2b(f"{self._url}/{key}".encode(), digest_size=16).hexdigest()

    def _make_room(self, size: int) -> None:
        """Delete the oldest copies, each time that a tenth of the room was filled since the last scan."""
        with self._lock:
            self._grown += size
            if self._grown <= (1.0 - ROOM_MADE) * self._most:
                return
            self._grown = 0
            with os.scandir(self._folder) as entries:
                files = sorted((entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in entries)
            total = sum(kept for _, kept, _ in files)
            for _, kept, path in files:
                if total <= ROOM_MADE * self._most:
                    return
                Path(path).unlink(missing_ok=True)
                total -= kept


def checksum_of(data: bytes) -> bytes:
    """The checksum that a copy begins with."""
    return b"%08x" % google_crc32c.value(data)
