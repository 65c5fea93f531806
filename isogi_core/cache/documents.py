"""Documents beside the light: small JSON objects, each written whole or not at all. Raises StoreError."""

import json
from contextlib import suppress
from typing import Any

from isogi_core.cache.root import Root, Where
from isogi_core.errors import ChangedError, StoreError

MOST_TRIES = 5
"""How often a document is written anew when others write it too."""


class Documents:
    """The documents in one ``folder`` of the store at ``root``. Call from no event loop: it blocks."""

    def __init__(self, root: Where, folder: str) -> None:
        """Name the place; nothing is opened or made yet."""
        self.root = Root.of(root)
        self.folder = folder

    def place(self, name: str) -> str:
        """Where a document is, for people."""
        return f"{self.root.place.name}/{self._key(name)}"

    def read(self, name: str) -> dict[str, Any] | None:
        """A document; None where there is none. StoreError where it is no JSON object."""
        found = self.root.get(self._key(name))
        try:
            document = None if found is None else json.loads(found.data)
        except ValueError as error:
            raise StoreError(f"{self.place(name)} is damaged ({error}): move it away.") from error
        if document is not None and not isinstance(document, dict):
            raise StoreError(f"{self.place(name)} is damaged (no JSON object): move it away.")
        return document

    def write(self, name: str, document: dict[str, Any]) -> None:
        """Keep a document in place of the former one, whoever wrote that."""
        key, content = self._key(name), json.dumps(document, indent=1, allow_nan=False).encode()
        for _ in range(MOST_TRIES):
            with suppress(ChangedError):
                return self.root.put(key, content, self.root.get(key))
        raise StoreError(f"Others keep writing {self.place(name)}; it is tried again later.")

    def names(self) -> list[str]:
        """The names of all documents, sorted."""
        found = (key.rpartition("/")[2] for key in self.root.keys(self.folder))
        return sorted(name.removesuffix(".json") for name in found if name.endswith(".json"))

    def _key(self, name: str) -> str:
        return f"{self.folder}/{name}.json"
