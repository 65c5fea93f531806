"""The loader: brings the chunks that a view reads from the store into the page pool."""

import threading
import time
from collections.abc import Sequence

from isogi_core.bake.recipe import Index
from isogi_core.cache.pages import PagePool
from isogi_core.cache.store import ChunkStore

ASK_AGAIN = 1.0
"""Seconds after which an absent chunk is asked for again: another machine may have baked it."""


class Loader:
    """Keeps the page pool in step with the store. Safe to use from many threads."""

    def __init__(self, store: ChunkStore, pool: PagePool) -> None:
        """Load from ``store`` into ``pool``."""
        self.store = store
        self.pool = pool
        self._absent: dict[Index, float] = {}
        self._lock = threading.Lock()

    def ensure(self, chunks: Sequence[Index]) -> None:
        """Bring the newest light of ``chunks`` into the pool.

        Raises StoreError when the store cannot be read, or the pool cannot hold them all at once.
        """
        missing = self.pool.missing(chunks)
        together = frozenset(chunks) if missing else frozenset()
        for index in missing:
            self._load(index, together)

    def refresh(self, index: Index) -> None:
        """Say that the store has new light of a chunk."""
        self.pool.outdate(index)
        with self._lock:
            self._absent.pop(index, None)

    def _load(self, index: Index, together: frozenset[Index]) -> None:
        with self._lock:
            if time.monotonic() - self._absent.get(index, -ASK_AGAIN) < ASK_AGAIN:
                return
        chunk = self.store.show(index)
        if chunk is not None:
            self.pool.insert(chunk, together)
            return
        with self._lock:
            self._absent[index] = time.monotonic()
