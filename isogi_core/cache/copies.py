"""Copies of a remote store's objects on this machine's disk, so that what is read again does not travel again.

Each is kept with the tag that the store knew it by, and is used only where the store says that it still stands.
"""

import logging
import os
import threading
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from uuid import uuid4

import google_crc32c

from isogi_core.cache.shelf import Found

log = logging.getLogger("isogi.cache")

ROOM_MADE = 0.9
"""How much of the room is left taken when the oldest copies were deleted."""


def default_copies() -> Path:
    """Where copies are kept: ``$XDG_CACHE_HOME/isogi/chunks`` or ``~/.cache/isogi/chunks``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isogi" / "chunks"


class Copies:
    """At most ``most`` bytes of objects of the store ``url`` in ``folder``, the oldest of any store deleted first.

    Several processes may share the folder. What cannot be kept is not, and what is damaged is none. Safe to use from
    many threads.
    """

    def __init__(self, url: str, most: int, folder: Path | None = None) -> None:
        """Look at nothing yet."""
        self._url = url
        self._most = most
        self._folder = folder or default_copies()
        self._lock = threading.Lock()
        self._grown = most  # as if full: the first that is put has the folder looked at

    def get(self, key: str) -> Found | None:
        """The copy of an object, or None."""
        path = self._path(key)
        try:
            kept = path.read_bytes()
            os.utime(path)
        except OSError:
            return None
        checksum, _, rest = kept.partition(b"\n")
        tag, _, data = rest.partition(b"\n")
        return Found(data, tag.decode()) if checksum == checksum_of(rest) else None

    def put(self, key: str, found: Found) -> None:
        """Keep a copy; one without a tag could never be used."""
        if not found.tag:
            return
        rest = found.tag.encode() + b"\n" + found.data
        path = self._path(key)
        written = path.with_suffix(f".{uuid4().hex}.partial")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            written.write_bytes(checksum_of(rest) + b"\n" + rest)
            os.replace(written, path)
            self._make_room(len(rest))
        except OSError as error:
            log.info("A copy of light cannot be kept at %s: %s", self._folder, error)
            with suppress(OSError):
                written.unlink()

    def _path(self, key: str) -> Path:
        return self._folder / blake2b(f"{self._url}/{key}".encode(), digest_size=16).hexdigest()

    def _make_room(self, size: int) -> None:
        """Delete the oldest once a tenth of the room was filled since the folder was last looked at."""
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
