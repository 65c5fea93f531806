"""Any other store that Zarr opens by its URL (fsspec's file systems, memory), as a shelf of objects.

It cannot say whether what is replaced is what was read: of two that write one object at once the last one stays.
"""

import math
from collections.abc import AsyncIterator, Iterator

from zarr.abc.store import Store
from zarr.core.buffer import default_buffer_prototype
from zarr.core.sync import sync
from zarr.storage._common import make_store

from isogi_core.cache.place import Place
from isogi_core.cache.shelf import Entry, Found
from isogi_core.errors import ChangedError


class FileSystem:
    """Objects under the URL of a place."""

    def __init__(self, place: Place, guard: str) -> None:
        """Open the store as Zarr does."""
        self.guard = guard
        self._store: Store = sync(make_store(place.url, mode="a"))

    def get(self, key: str, known: Found | None = None) -> Found | None:
        """The object, or None where there is none."""
        stored = sync(self._store.get(key, default_buffer_prototype()))
        return None if stored is None else Found(stored.to_bytes())

    def put(self, key: str, data: bytes, former: Found | None) -> None:
        """Write an object; ChangedError where another stood there right before."""
        if self.get(key) != former:
            raise ChangedError(f"Somebody else has written {key} meanwhile: read it again.")
        self.prove(data, key)

    def found(self, data: bytes) -> None:
        """Write the sentinel; ChangedError where there is one."""
        self.put(self.guard, data, None)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        sync(self._store.delete(key))

    def names(self, folder: str) -> list[str]:
        """Names of the folders right under ``folder``: those of objects, and of no folder, have a dot in them here."""
        names = {name.partition("/")[0] for name in sync(listed(self._store.list_dir(folder)))}
        return sorted(name for name in names if "." not in name)

    def keys(self, folder: str) -> Iterator[str]:
        """Keys of all objects under ``folder``."""
        yield from sync(listed(self._store.list_prefix(folder)))

    def entries(self) -> Iterator[Entry]:
        """All objects; when they were written is not known."""
        for key in self.keys(""):
            yield Entry(key, sync(self._store.getsize(key)), math.nan)

    def move(self, key: str, to: str) -> None:
        """Copy an object, if it is there, and then delete it."""
        found = self.get(key)
        if found is not None:
            self.prove(found.data, to)
            self.delete(key)

    def prove(self, data: bytes, key: str = "") -> None:
        """Write the sentinel, or the object ``key``, whatever stands there."""
        sync(self._store.set(key or self.guard, default_buffer_prototype().buffer.from_bytes(data)))


async def listed(names: AsyncIterator[str]) -> list[str]:
    """All of the names."""
    return [name async for name in names]
