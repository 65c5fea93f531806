"""Store URLs: the folder or URL at which light is kept, as a person writes it."""

import re
from dataclasses import dataclass
from pathlib import Path

from isogi_core.errors import StoreUrlError

BUCKET_SCHEMES = frozenset(
    ("s3", "s3a", "gs", "az", "adl", "azure", "abfs", "abfss", "http", "https")  # what obstore knows
)
"""Schemes of object stores."""

SECRET_PARTS = re.compile(r"://[^/]*@|[?#]")
"""Parts of a URL that may hold a password, or a key that is as good as one."""


@dataclass(frozen=True)
class StoreUrl:
    """A folder or ``url``, the ``seconds`` that one call to an object store may take, and its ``retries``.

    Raises StoreUrlError where the URL holds a secret: each process has credentials of its own.
    """

    url: str
    seconds: float = 5.0
    retries: int = 2

    def __post_init__(self) -> None:
        if "://" in self.url and SECRET_PARTS.search(self.url):
            scheme = self.url.partition("://")[0]
            raise StoreUrlError(
                f"The store's {scheme}:// URL must not hold a password or a key (user:password@, or what follows ?):"
                " put credentials into the environment of the server and of each worker."
            )

    def __str__(self) -> str:
        return self.url

    @classmethod
    def of(cls, name: "str | Path | StoreUrl") -> "StoreUrl":
        """The store URL of this name; a StoreUrl is returned as it is."""
        return name if isinstance(name, StoreUrl) else cls(str(name))

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
        """The path of the folder, where it is one."""
        return Path(self.url.removeprefix("file://"))

    @property
    def remote(self) -> bool:
        """Whether it is an object store, where each call is a round trip."""
        return self.scheme in BUCKET_SCHEMES
