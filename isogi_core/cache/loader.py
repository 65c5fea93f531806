"""The loader: brings the chunks that a view reads from the store into the page pool."""

import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import closing
from typing import TypeVar

from isogi_core.bake.recipe import Index
from isogi_core.cache.chunk import Chunks
from isogi_core.cache.pages import PagePool
from isogi_core.cache.store import ChunkStore
from isogi_core.errors import Cancelled

ASK_AGAIN = 1.0
"""Seconds after which an absent chunk is asked for again: another machine may have baked it."""

READERS = 16
"""Batches of a remote store that are brought at once: what takes long there is the way."""

UNPACKERS = 4
"""Batches of a store on this machine that are: what takes long is unpacking, but for what Python does alone."""

AHEAD = 2 * READERS
"""Batches of a view that are under way, or wait in memory to be taken, at most."""

BATCH = 1 << 23
"""Bytes of records that are unpacked in one go, at most: each call is then for thousands of texels."""

Item = TypeVar("Item")
Made = TypeVar("Made")


class Loader:
    """Keeps the page pool in step with the store. Safe to use from many threads."""

    def __init__(self, store: ChunkStore, pool: PagePool) -> None:
        """Load from ``store`` into ``pool``."""
        self.store = store
        self.pool = pool
        self._absent: dict[Index, float] = {}
        self._lock = threading.Lock()
        self._many = READERS if store.root.place.remote else UNPACKERS
        self._hands = ThreadPoolExecutor(self._many, "loader")

    def ensure(self, chunks: Sequence[Index], cancelled: threading.Event | None = None) -> None:
        """Bring the newest light of ``chunks`` into the pool.

        Raises StoreError when the store cannot be read, or the pool cannot hold them all at once, and Cancelled when
        ``cancelled`` is set on the way.
        """
        missing = [index for index in self.pool.missing(chunks) if self._due(index)]
        together = frozenset(chunks) if missing else frozenset()
        with closing(self._shown(missing)) as shown:
            for indices, found in shown:
                if cancelled is not None and cancelled.is_set():
                    raise Cancelled("Nobody waits for this light any more.")
                self._take(indices, found, together)

    def refresh(self, index: Index) -> None:
        """Say that the store has new light of a chunk."""
        self.pool.outdate(index)
        with self._lock:
            self._absent.pop(index, None)

    def _due(self, index: Index) -> bool:
        """Whether a chunk may be there by now."""
        with self._lock:
            return time.monotonic() - self._absent.get(index, -ASK_AGAIN) >= ASK_AGAIN

    def _shown(self, indices: Sequence[Index]) -> Generator[tuple[Sequence[Index], Chunks], None, None]:
        """Some of the chunks, and what the store has of these, in their order; several hands are at it at once."""
        batches = self._batches(indices)
        if len(batches) > 1:
            self.store.root.alive()
            with closing(ahead(self._hands, self._brought, batches)) as brought:
                yield from zip(batches, brought, strict=True)
        elif batches:
            yield indices, self._brought(indices)

    def _batches(self, indices: Sequence[Index]) -> list[Sequence[Index]]:
        """The chunks in batches: for all hands, and none of more than BATCH bytes."""
        size = min(BATCH // self.store.chunk_bytes, -(-len(indices) // self._many))
        return [indices[i : i + max(size, 1)] for i in range(0, len(indices), max(size, 1))]

    def _brought(self, indices: Sequence[Index]) -> Chunks:
        """What the store has of some chunks."""
        return self.store.show(indices, list(map(self.store.objects, indices)))

    def _take(self, indices: Sequence[Index], found: Chunks, together: frozenset[Index]) -> None:
        """Put what was found into the pool, and note of which there was nothing."""
        if found.indices:
            self.pool.insert(found, together)
        absent = {*indices} - {*found.indices}
        if absent:
            with self._lock:
                self._absent.update(dict.fromkeys(absent, time.monotonic()))


def ahead(hands: Executor, work: Callable[[Item], Made], items: Sequence[Item]) -> Generator[Made, None, None]:
    """What ``work`` makes of the items, in their order; AHEAD of them are under way, and no more once nobody asks."""
    waiting: deque[Future[Made]] = deque()
    try:
        for item in items:
            waiting.append(hands.submit(work, item))
            if len(waiting) >= AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
