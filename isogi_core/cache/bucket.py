"""A bucket of an object store (S3, Google, Azure, or read by HTTP) as a shelf of objects, by obstore.

Credentials and endpoint are of this process's own environment (``AWS_ACCESS_KEY_ID``, ``AWS_ENDPOINT_URL``, …), and
are told to nobody.
"""

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any

from isogi_core.cache.place import Place
from isogi_core.cache.shelf import Entry, Found
from isogi_core.errors import ChangedError, StoreError

CONNECTING = 2.0
"""Seconds in which a connection has to stand, or the whole time of a call where that is less."""

FIRST_PAUSE, LONGEST_PAUSE = timedelta(milliseconds=100), timedelta(seconds=1)
"""Between two tries of a call."""

PREFIXES = {"s3": "AWS", "s3a": "AWS", "gs": "GOOGLE", "http": "HTTP", "https": "HTTP"}
"""What variables of the environment begin with; for all others, AZURE."""

WAYS = ("ALLOW_HTTP", "ALLOW_INVALID_CERTIFICATES", "PROXY_URL", "PROXY_CA_CERTIFICATE", "PROXY_EXCLUDES")
"""What these say of how calls are made; obstore reads the others by itself."""

FULL = ("status code: 507", "QuotaExceeded", "StorageFull", "storage quota")
"""What object stores say when they have no room."""

UNKNOWN = "status code: 501"
"""What they say to a write on a condition where they know of none."""

CLOSED = ("status code: 405", UNKNOWN)
"""What HTTP servers say that only give."""


class Bucket:
    """Objects under the prefix that a place names. Raises OSError, with EACCES, ENOSPC, or EIO for all else."""

    def __init__(self, place: Place, guard: str) -> None:
        """Connect to nothing yet. StoreError where obstore is missing, or the environment is not enough."""
        try:
            import obstore  # noqa: PLC0415 (an extra)
            from obstore.store import from_url  # noqa: PLC0415
        except ImportError:
            raise StoreError(
                f"A store at {place.scheme}:// needs a library that is not installed: pip install 'isogi[s3]'."
            ) from None
        self.guard = guard
        self._obstore: Any = obstore
        try:
            connect: Any = from_url
            self._store = connect(place.url, client_options=calls(place), retry_config=retries(place))
        except Exception as error:
            raise StoreError(f"The store at {place} cannot be used: {sentence(error)}.") from None

    def get(self, key: str, known: Found | None = None) -> Found | None:
        """The object; None where it, or the bucket, is not there."""
        errors = self._obstore.exceptions
        with self._told():
            try:
                options = {"if_none_match": known.tag} if known is not None and known.tag else None
                got = self._obstore.get(self._store, key, options=options)
                return Found(bytes(got.bytes()), got.meta["e_tag"] or "")
            except errors.NotModifiedError:
                return known
            except FileNotFoundError:
                return None

    def put(self, key: str, data: bytes, former: Found | None) -> None:
        """Write an object in place of the ``former``; a store without conditional writes has it written in any case."""
        errors = self._obstore.exceptions
        mode: Any = "create" if former is None else {"e_tag": former.tag} if former.tag else "overwrite"
        with self._told():
            try:
                self._put(key, data, mode)
            except (errors.AlreadyExistsError, errors.PreconditionError):
                raise ChangedError(f"Somebody else has written {key} meanwhile: read it again.") from None

    def _put(self, key: str, data: bytes, mode: Any) -> None:
        try:
            self._obstore.put(self._store, key, data, mode=mode, use_multipart=False)
        except (self._obstore.exceptions.GenericError, NotImplementedError) as error:
            if not isinstance(error, NotImplementedError) and UNKNOWN not in str(error):
                raise
            self._obstore.put(self._store, key, data, use_multipart=False)

    def found(self, data: bytes) -> None:
        """Write the sentinel; ChangedError where there is one."""
        self.put(self.guard, data, None)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        with self._told():
            self._obstore.delete(self._store, key)

    def names(self, folder: str) -> list[str]:
        """Names of the folders right under ``folder``."""
        with self._told():
            prefixes = self._obstore.list_with_delimiter(self._store, folder or None)["common_prefixes"]
        return sorted(prefix.rstrip("/").rpartition("/")[2] for prefix in prefixes)

    def keys(self, folder: str) -> Iterator[str]:
        """Keys of all objects under ``folder``, page by page."""
        with self._told():
            for page in self._obstore.list(self._store, folder or None):
                yield from (each["path"] for each in page)

    def entries(self) -> Iterator[Entry]:
        """All objects, page by page."""
        with self._told():
            for page in self._obstore.list(self._store):
                yield from (Entry(each["path"], each["size"], each["last_modified"].timestamp()) for each in page)

    def move(self, key: str, to: str) -> None:
        """Copy an object, if it is there, and then delete it."""
        with self._told():
            try:
                self._obstore.copy(self._store, key, to)
            except FileNotFoundError:
                return
            self._obstore.delete(self._store, key)

    def prove(self, data: bytes) -> None:
        """Write the sentinel once more, as it is and where it is: an object that nobody has to delete."""
        found = self.get(self.guard)
        if found is not None:
            with suppress(ChangedError):
                self.put(self.guard, data, found)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Tell obstore's errors as OSErrors, in one sentence and without what belongs to this process alone."""
        errors = self._obstore.exceptions
        try:
            yield
        except (errors.PermissionDeniedError, errors.UnauthenticatedError) as error:
            raise PermissionError(errno.EACCES, sentence(error)) from None
        except (errors.BaseError, FileNotFoundError, NotImplementedError) as error:
            said = str(error)
            full, closed = any(word in said for word in FULL), any(word in said for word in CLOSED)
            raise OSError(errno.ENOSPC if full else errno.EROFS if closed else errno.EIO, sentence(error)) from None


def calls(place: Place) -> dict[str, Any]:
    """How calls are made: in the time that the place gives them, and else as the environment says.

    Plain HTTP is for a person who wrote it so, or set AWS_ALLOW_HTTP.
    """
    connecting = timedelta(seconds=min(CONNECTING, place.seconds))
    prefix = PREFIXES.get(place.scheme, "AZURE")
    told = {name.lower(): value for name in WAYS if (value := os.environ.get(f"{prefix}_{name}"))}
    plain = {"allow_http": "true"} if place.scheme == "http" else {}
    return {**plain, **told, "timeout": timedelta(seconds=place.seconds), "connect_timeout": connecting}


def retries(place: Place) -> dict[str, Any]:
    """How often a call that failed is tried again, and when."""
    return {
        "max_retries": place.retries,
        "retry_timeout": timedelta(seconds=place.seconds * (1 + place.retries)),
        "backoff": {"init_backoff": FIRST_PAUSE, "max_backoff": LONGEST_PAUSE, "base": 2},
    }


def sentence(error: Exception) -> str:
    """What an error of obstore says to a person: the server's answer, without addresses, queries and debug text."""
    first = str(error).partition("\n")[0].partition(": <")[0].rpartition(" - ")[2]
    return re.sub(r"\?\S+", "?…", first).strip().rstrip(".") or type(error).__name__
