"""Backends: the operations that every kind of store offers
on objects by key, and the meaning of its errors.
"""

import errno
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from isogi_core.errors import StoreAwayError, StoreFullError, StoreReadOnlyError, StoreUrlError

BUCKET_SCHEMES = frozenset(
    (
        "s3",
        "s3a",
        "gs",
        "az",
        "adl",
        "azure",
        "abfs",
        "abfss",
        "http",
        "https",
    )  # what obstore knows
)
"""Schemes of object stores."""

SECRET_PARTS = re.compile(r"://[^/]*@|[?#]")
"""Parts of a URL that may hold a password, or a key that gives the same access."""


@dataclass(frozen=True)
class StoreUrl:
    """The folder or ``url`` of a store, the ``seconds`` that one call to an object store may take,
    and its ``retries``.

    Raises StoreUrlError if the URL holds a secret: URLs are logged and passed on, while each
    process has credentials of its own.
    """

    url: str
    seconds: float = 5.0
    retries: int = 2

    def __post_init__(self) -> None:
        if "://" in self.url and SECRET_PARTS.search(self.url):
            scheme = self.url.partition("://")[0]
            raise StoreUrlError(
                f"The store's {scheme}:// URL must not hold a password or a key "
                "(user:password@, or a query after ?): put credentials into the environment of the "
                "server and of each worker."
            )

    def __str__(self) -> str:
        return self.url

    @classmethod
    def of(cls, name: "str | Path | StoreUrl") -> "StoreUrl":
        """Return the store URL of a folder or URL; a StoreUrl is returned as it is."""
        if isinstance(name, StoreUrl):
            return name
        return cls(str(name))

    @property
    def scheme(self) -> str:
        """``file`` for a folder, else the URL's scheme."""
        scheme, found, _ = self.url.partition("://")
        return scheme.lower() if found else "file"

    @property
    def name(self) -> str:
        """The folder or URL without a slash at its end: append a slash and a key to it."""
        return self.url.removeprefix("file://").rstrip("/")

    @property
    def folder(self) -> Path:
        """The path of the folder, if the store is one."""
        return Path(self.url.removeprefix("file://"))

    @property
    def remote(self) -> bool:
        """True if the store is an object store, where each call is a round trip."""
        return self.scheme in BUCKET_SCHEMES


@dataclass(frozen=True)
class StoredObject:
    """The bytes of an object, and the ``tag`` (ETag) of this content;
    empty if the store has no tags.
    """

    data: bytes
    tag: str = field(default="", compare=False)


class Entry(NamedTuple):
    """An object in a listing: key, size in bytes, and time of writing by the store's calendar, in
    seconds since 1970 (UTC), NaN if unknown.

    Ages serve display and cleaning up. They never decide which writer may write.
    """

    key: str
    size: int
    written: float

    def age(self, now: float) -> float:
        """Return the seconds between the writing of the object and ``now``, in seconds since 1970;
        NaN if the former is unknown.
        """
        return now - self.written


class Backend(Protocol):
    """Objects by keys such as ``a/b``.

    Methods raise OSError, with an errno if the cause is known.
    """

    def get(self, key: str, known: StoredObject | None = None) -> StoredObject | None:
        """Read an object; None if there is none.

        Return ``known`` itself if the store says that it is unchanged.
        """
        ...

    def put(self, key: str, data: bytes, former: StoredObject | None) -> None:
        """Write an object in place of ``former``, None if there was none.

        Raises ChangedError if another was written meanwhile and the backend can tell.
        """
        ...

    def create_sentinel(self, data: bytes) -> None:
        """Write the sentinel. Raises ChangedError if there is one."""
        ...

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        ...

    def folders(self, folder: str) -> list[str]:
        """List the names of the folders right under ``folder``;
        an empty ``folder`` is the top of the store.
        """
        ...

    def keys(self, folder: str) -> Iterator[str]:
        """List the keys of all objects under ``folder``."""
        ...

    def entries(self) -> Iterator[Entry]:
        """List all objects, half-written ones included."""
        ...

    def move(self, key: str, to: str) -> None:
        """Rename an object, if it is there."""
        ...

    def check_writable(self, data: bytes) -> None:
        """Raise the error that a write would raise, and change nothing.

        ``data`` is the sentinel's content.
        """
        ...


FULL_ERRNOS = (errno.ENOSPC, errno.EDQUOT)
READ_ONLY_ERRNOS = (errno.EACCES, errno.EPERM, errno.EROFS)

WRITING_VERBS = ("write", "make", "delete", "move")
"""First words of the actions whose refusal means that the store is read-only. All actions that
write begin with one of them: see ``store_error``.
"""


def store_error(action: str, store_url: StoreUrl, error: Exception) -> StoreAwayError:
    """Return our error for a backend's ``error``. ``action`` completes "Cannot … the store", such
    as "write a/b to".

    It is StoreFullError if there is no room, whatever the action, and StoreReadOnlyError if
    permission is lacking and ``action`` begins with one of WRITING_VERBS; both are kinds of
    StoreAwayError, which it is else.
    """
    if isinstance(error, OSError):
        number = error.errno
    else:
        number = None
    sentence = f"Cannot {action} the store at {store_url}: {one_line(error)}"
    if number in FULL_ERRNOS:
        return StoreFullError(f"{sentence}; the store is full: make room, and baking goes on.")
    # A refused read does not mean that the store is read-only.
    if number in READ_ONLY_ERRNOS and action.startswith(WRITING_VERBS):
        return StoreReadOnlyError(
            f"{sentence}; the light that is there is served, and nothing more is baked."
        )
    return StoreAwayError(f"{sentence}.")


def one_line(error: Exception) -> str:
    """Return the message of a foreign error on one line, without full stop and errno."""
    if isinstance(error, OSError) and error.strerror:
        message = error.strerror
    else:
        message = str(error)
    return " ".join(message.split()).rstrip(".") or type(error).__name__
