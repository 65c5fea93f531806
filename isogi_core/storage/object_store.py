"""A bucket of an object store (S3, Google, Azure, or read by HTTP)
as a backend, by means of obstore.
"""

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any

from isogi_core.errors import ChangedError, StoreError
from isogi_core.storage.backend import Entry, StoredObject, StoreUrl

CONNECT_SECONDS = 2.0
"""Seconds within which a connection must be made, or less if the whole call has less."""

FIRST_PAUSE = timedelta(milliseconds=100)
LONGEST_PAUSE = timedelta(seconds=1)
"""Shortest and longest pause between two tries of a call."""

VARIABLE_PREFIXES = {"s3": "AWS", "s3a": "AWS", "gs": "GOOGLE", "http": "HTTP", "https": "HTTP"}
"""Prefixes of environment variables by scheme; AZURE for all others."""

CALL_VARIABLES = (
    "ALLOW_HTTP",
    "ALLOW_INVALID_CERTIFICATES",
    "PROXY_URL",
    "PROXY_CA_CERTIFICATE",
    "PROXY_EXCLUDES",
)
"""Environment variables, without their prefix, of options of calls;
obstore reads the others by itself.
"""

FULL_ANSWERS = ("status code: 507", "QuotaExceeded", "StorageFull", "storage quota")
"""Words in the answers of object stores that have no room."""

NOT_IMPLEMENTED = "status code: 501"
"""Words in the answer to a conditional write from a store that has none."""

READ_ONLY_ANSWERS = ("status code: 405", NOT_IMPLEMENTED)
"""Words in the answers of HTTP servers that are read-only."""


DAMAGED_LIST = "invalid list response"
"""Words of the error that a list raises which cannot be parsed."""


class Bucket:
    """Objects under a bucket's prefix.

    Methods raise OSError with EACCES, ENOSPC or EROFS, and with EIO for all other causes.
    """

    def __init__(self, store_url: StoreUrl, sentinel: str) -> None:
        """Set up without a connection.

        Raises StoreError if obstore is not installed, or rejects the URL or the environment.
        """
        try:
            import obstore  # noqa: PLC0415 (an extra)
            from obstore.store import from_url  # noqa: PLC0415
        except ImportError:
            raise StoreError(
                f"A store at {store_url.scheme}:// needs a library that is not installed: pip "
                "install 'isogi[s3]'."
            ) from None
        self.sentinel = sentinel
        self._obstore: Any = obstore
        # This checks the URL and the environment, and opens no connection.
        try:
            connect: Any = from_url
            self._store = connect(
                store_url.url,
                client_options=call_options(store_url),
                retry_config=retry_options(store_url),
            )
        except Exception as error:
            raise StoreError(
                f"The store at {store_url} cannot be used: {sentence(error)}."
            ) from None

    def get(self, key: str, known: StoredObject | None = None) -> StoredObject | None:
        """Read an object; None if it or the bucket does not exist.

        Return ``known`` if its tag is still that of the object.
        """
        errors = self._obstore.exceptions
        with self._translated_errors():
            try:
                # Ask the store to send the object only if its tag is another one.
                if known is not None and known.tag:
                    options = {"if_none_match": known.tag}
                else:
                    options = None
                got = self._obstore.get(self._store, key, options=options)
                return StoredObject(bytes(got.bytes()), got.meta["e_tag"] or "")
            except errors.NotModifiedError:
                return known
            except FileNotFoundError:
                return None

    def put(self, key: str, data: bytes, former: StoredObject | None) -> None:
        """Write an object in place of ``former``. Raises ChangedError if another was written
        meanwhile.

        A store without conditional writes takes the object in any case.
        """
        errors = self._obstore.exceptions
        # Write only if there is no object, or only if its tag is that of ``former``; without tags
        # nothing can be compared.
        mode: Any = "overwrite"
        if former is None:
            mode = "create"
        elif former.tag:
            mode = {"e_tag": former.tag}
        with self._translated_errors():
            try:
                self._put(key, data, mode)
            except (errors.AlreadyExistsError, errors.PreconditionError):
                raise ChangedError(
                    f"Another writer has changed {key} meanwhile: read it again."
                ) from None

    def _put(self, key: str, data: bytes, mode: Any) -> None:
        """Write an object, without the condition ``mode``
        if the store has no conditional writes.
        """
        try:
            self._obstore.put(self._store, key, data, mode=mode, use_multipart=False)
        except (self._obstore.exceptions.GenericError, NotImplementedError) as error:
            # Only a store without conditional writes is written to without the condition.
            if not isinstance(error, NotImplementedError) and NOT_IMPLEMENTED not in str(error):
                raise
            self._obstore.put(self._store, key, data, use_multipart=False)

    def create_sentinel(self, data: bytes) -> None:
        """Write the sentinel. Raises ChangedError if there is one."""
        self.put(self.sentinel, data, None)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        with self._translated_errors():
            self._obstore.delete(self._store, key)

    def folders(self, folder: str) -> list[str]:
        """List the names of the folders right under ``folder``."""
        with self._translated_errors():
            try:
                listed = self._obstore.list_with_delimiter(self._store, folder or None)
            except Exception as error:
                # The answer was damaged on its way: a server must not fail to start for that.
                if DAMAGED_LIST not in str(error):
                    raise
                listed = self._obstore.list_with_delimiter(self._store, folder or None)
            prefixes = listed["common_prefixes"]
        return sorted(prefix.rstrip("/").rpartition("/")[2] for prefix in prefixes)

    def keys(self, folder: str) -> Iterator[str]:
        """List the keys of all objects under ``folder``, page by page."""
        with self._translated_errors():
            for page in self._obstore.list(self._store, folder or None):
                yield from (each["path"] for each in page)

    def entries(self) -> Iterator[Entry]:
        """List all objects, page by page, in no fixed order.

        A bucket never lists half-written ones.
        """
        with self._translated_errors():
            for page in self._obstore.list(self._store):
                yield from (
                    Entry(each["path"], each["size"], each["last_modified"].timestamp())
                    for each in page
                )

    def move(self, key: str, to: str) -> None:
        """Copy an object, if it is there, and then delete it."""
        with self._translated_errors():
            try:
                self._obstore.copy(self._store, key, to)
            except FileNotFoundError:
                return
            self._obstore.delete(self._store, key)

    def check_writable(self, data: bytes) -> None:
        """Raise the error that a write would raise, by writing the sentinel once more.

        ``data`` is the sentinel's content, so it is not changed, and nothing need be deleted
        afterwards. Without a sentinel nothing is written, and no error is raised.
        """
        found = self.get(self.sentinel)
        if found is not None:
            # If another process has written the sentinel meanwhile, the bucket takes writes.
            with suppress(ChangedError):
                self.put(self.sentinel, data, found)

    @contextmanager
    def _translated_errors(self) -> Iterator[None]:
        """Raise obstore's errors as OSErrors, in one sentence and without credentials."""
        errors = self._obstore.exceptions
        try:
            yield
        except (errors.PermissionDeniedError, errors.UnauthenticatedError) as error:
            raise PermissionError(errno.EACCES, sentence(error)) from None
        except (errors.BaseError, FileNotFoundError, NotImplementedError) as error:
            # All other causes come in one class of errors: the words of the answer tell a full or
            # read-only store from one that cannot be reached.
            message = str(error)
            number = errno.EIO
            if any(words in message for words in FULL_ANSWERS):
                number = errno.ENOSPC
            elif any(words in message for words in READ_ONLY_ANSWERS):
                number = errno.EROFS
            raise OSError(number, sentence(error)) from None


def call_options(store_url: StoreUrl) -> dict[str, Any]:
    """Return the options of calls: time limits from the store URL, all others from the environment.

    Plain HTTP is used for http:// URLs, and if AWS_ALLOW_HTTP is set.
    """
    connecting = timedelta(seconds=min(CONNECT_SECONDS, store_url.seconds))
    prefix = VARIABLE_PREFIXES.get(store_url.scheme, "AZURE")
    given = {
        name.lower(): value
        for name in CALL_VARIABLES
        if (value := os.environ.get(f"{prefix}_{name}"))
    }
    if store_url.scheme == "http":
        plain = {"allow_http": "true"}
    else:
        plain = {}
    # Options from the environment win over the default for http://, and the store URL's time limits
    # over both.
    return {
        **plain,
        **given,
        "timeout": timedelta(seconds=store_url.seconds),
        "connect_timeout": connecting,
    }


def retry_options(store_url: StoreUrl) -> dict[str, Any]:
    """Return the options of retries:
    how often a failed call is tried again, and after which pauses.
    """
    return {
        "max_retries": store_url.retries,
        "retry_timeout": timedelta(seconds=store_url.seconds * (1 + store_url.retries)),
        "backoff": {"init_backoff": FIRST_PAUSE, "max_backoff": LONGEST_PAUSE, "base": 2},
    }


CONNECTION_FAULTS = {
    "error sending request": "the connection broke before an answer",
    "request or response body error": "the connection broke in the middle of an answer",
    "error decoding response body": "the connection broke in the middle of an answer",
    "operation timed out": "no answer came in time",
}
"""Words in errors of calls without a whole answer, and the sentence that a person reads instead."""


def sentence(error: Exception) -> str:
    """Return the server's answer in an error of obstore,
    without addresses, queries, documents and debug text.
    """
    if broken := next(
        (said for words, said in CONNECTION_FAULTS.items() if words in str(error)), None
    ):
        return broken
    # The answer is on the first line, after the last dash and before a document or a nested error.
    first = re.split(r": [<{]", str(error).partition("\n")[0])[0].rpartition(" - ")[2]
    return re.sub(r"\?\S+", "?…", first).strip().rstrip(".") or type(error).__name__
