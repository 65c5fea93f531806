"""Any other store that Zarr opens by its URL (fsspec's file systems, memory) as a backend."""

import math
from collections.abc import AsyncIterator, Iterator

from zarr.abc.store import Store
from zarr.core.buffer import default_buffer_prototype
from zarr.core.sync import sync
from zarr.storage._common import make_store

from isogi_core.errors import ChangedError
from isogi_core.storage.backend import Entry, StoredObject
from isogi_core.storage.url import StoreUrl


class FileSystem:
    """Objects under a store URL that Zarr opens."""

    def __init__(self, store_url: StoreUrl, sentinel: str) -> None:
        """Open the store as Zarr does."""
        self.sentinel = sentinel
        self._store: Store = sync(make_store(store_url.url, mode="a"))

    def get(self, key: str, known: StoredObject | None = None) -> StoredObject | None:
        """Read an object; None where there is none."""
        stored = sync(self._store.get(key, default_buffer_prototype()))
        return None if stored is None else StoredObject(stored.to_bytes())

    def put(self, key: str, data: bytes, former: StoredObject | None) -> None:
        """Write an object; ChangedError where another is found right before."""
        if self.get(key) != former:
            raise ChangedError(f"Another writer has changed {key} meanwhile: read it again.")
        self._set(key, data)

    def create_sentinel(self, data: bytes) -> None:
        """Write the sentinel; ChangedError where there is one."""
        self.put(self.sentinel, data, None)

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        sync(self._store.delete(key))

    def folders(self, folder: str) -> list[str]:
        """List the names of the folders right under ``folder``; names with a dot are objects here."""
        names = {name.partition("/")[0] for name in sync(listed(self._store.list_dir(folder)))}
        return sorted(name for name in names if "." not in name)

    def keys(self, folder: str) -> Iterator[str]:
        """List the keys of all objects under ``folder``."""
        yield from sync(listed(self._store.list_prefix(folder)))

    def entries(self) -> Iterator[Entry]:
        """List all objects; the times of writing are unknown."""
        for key in self.keys(""):
            yield Entry(key, sync(self._store.getsize(key)), math.nan)

    def move(self, key: str, to: str) -> None:
        """Copy an object, if it is there, and then delete it."""
        found = self.get(key)
        if found is not None:
            self._set(to, found.data)
            self.delete(key)

    def check_writable(self, data: bytes) -> None:
        """Write the sentinel once more."""
        self._set(self.sentinel, data)

    def _set(self, key: str, data: bytes) -> None:
        """Write the object ``key``, whatever is there."""
        sync(self._store.set(key, default_buffer_prototype().buffer.from_bytes(data)))


async def listed(names: AsyncIterator[str]) -> list[str]:
    """Collect the names."""
    return [name async for name in names]
