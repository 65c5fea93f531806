"""Small JSON documents beside the light, each written whole or not at all."""

import json
from contextlib import suppress
from typing import Any

from isogi_core.errors import ChangedError, StoreError
from isogi_core.storage.store import Store, StoreLike

MAX_TRIES = 5
"""Tries of a write while others write the same document."""


class Documents:
    """The documents in one ``folder`` of a ``store``. Methods block: do not call them in an event loop."""

    def __init__(self, store: StoreLike, folder: str) -> None:
        """Touch nothing yet."""
        self.store = Store.of(store)
        self.folder = folder

    def path_of(self, name: str) -> str:
        """The path or URL of a document, for messages."""
        return f"{self.store.url.name}/{self._key(name)}"

    def read(self, name: str) -> dict[str, Any] | None:
        """Read a document; None where there is none. StoreError where it is no JSON object."""
        found = self.store.get(self._key(name))
        try:
            document = None if found is None else json.loads(found.data)
        except ValueError as error:
            raise StoreError(f"{self.path_of(name)} is damaged ({error}): move it away.") from error
        if document is not None and not isinstance(document, dict):
            raise StoreError(f"{self.path_of(name)} is damaged (no JSON object): move it away.")
        return document

    def write(self, name: str, document: dict[str, Any]) -> None:
        """Write a document in place of the former one. StoreError where others keep writing it at the same time."""
        key, content = self._key(name), json.dumps(document, indent=1, allow_nan=False).encode()
        for _ in range(MAX_TRIES):
            with suppress(ChangedError):
                return self.store.put(key, content, self.store.get(key))
        raise StoreError(f"Others keep writing {self.path_of(name)}; it is tried again later.")

    def names(self) -> list[str]:
        """List the names of all documents, sorted."""
        found = (key.rpartition("/")[2] for key in self.store.keys(self.folder))
        return sorted(name.removesuffix(".json") for name in found if name.endswith(".json"))

    def _key(self, name: str) -> str:
        return f"{self.folder}/{name}.json"
