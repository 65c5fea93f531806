"""Places: where light is kept, as a person names it. No more than a name, so that it may travel and be told."""

import re
from dataclasses import dataclass
from pathlib import Path

from isogi_core.errors import PlaceError

BUCKETS = frozenset(
    ("s3", "s3a", "gs", "az", "adl", "azure", "abfs", "abfss", "http", "https")  # what obstore knows
)
"""Schemes of object stores."""

SECRET = re.compile(r"://[^/]*@|[?#]")
"""What in a URL may be a password, or a key that is as good as one."""


@dataclass(frozen=True)
class Place:
    """A folder or ``url``; one call to it may take so many ``seconds``, and is tried again so many times (``retries``).

    Both are for object stores. Raises PlaceError where the URL holds a secret: those are each process's own.
    """

    url: str
    seconds: float = 5.0
    retries: int = 2

    def __post_init__(self) -> None:
        if "://" in self.url and SECRET.search(self.url):
            scheme = self.url.partition("://")[0]
            raise PlaceError(
                f"The store's {scheme}:// URL must not hold a password or a key (user:password@, or what follows ?):"
                " put credentials into the environment of the server and of each worker."
            )

    def __str__(self) -> str:
        return self.url

    @classmethod
    def of(cls, name: "str | Path | Place") -> "Place":
        """The place with this name; a place is its own."""
        return name if isinstance(name, Place) else cls(str(name))

    @property
    def scheme(self) -> str:
        """``file`` for a folder, else what the URL begins with."""
        scheme, found, _ = self.url.partition("://")
        return scheme.lower() if found else "file"

    @property
    def name(self) -> str:
        """The folder or URL to which keys can be added after a slash."""
        return self.url.removeprefix("file://").rstrip("/")

    @property
    def folder(self) -> Path:
        """The folder, where it is one."""
        return Path(self.url.removeprefix("file://"))

    @property
    def remote(self) -> bool:
        """Whether it is an object store, where each call is a round trip."""
        return self.scheme in BUCKETS
