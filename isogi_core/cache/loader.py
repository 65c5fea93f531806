"""The loader: brings the chunks that a view reads from the store into the page pool."""

import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from functools import partial
from typing import TypeVar

from isogi_core.cache.chunk_record import Chunks
from isogi_core.cache.chunk_store import ChunkStore
from isogi_core.cache.page_pool import PagePool
from isogi_core.prepared.prepared_scene import Index
from isogi_core.storage.store import Store

ASK_AGAIN = 1.0
"""Seconds after which an absent chunk is read again: another machine may have baked it."""

REMOTE_READERS = 16
"""Batches read at once from a remote store, where the network takes the time."""

LOCAL_READERS = 4
"""Batches read at once from a store on this machine, where unpacking takes the time."""

MAX_BATCHES_AHEAD = 2 * REMOTE_READERS
"""Most batches of a view that are being read, or wait in memory."""

BATCH_BYTES = 1 << 23
"""Most bytes of records that are unpacked together: each call is then for thousands of texels."""

CHUNKS_OF_ONE_READER = 8
"""Chunks for fewer of which no further thread is woken, where the store is on this machine."""

Item = TypeVar("Item")
Made = TypeVar("Made")


class Loader:
    """Keeps the page pool in step with the store. Safe to use from many threads."""

    def __init__(self, chunk_store: ChunkStore, pool: PagePool) -> None:
        """Load from ``chunk_store`` into ``pool``."""
        self.chunk_store = chunk_store
        self.pool = pool
        self._absent: dict[Index, float] = {}
        self._readers: list[set[Index]] = []
        self._lock = threading.Lock()
        self._many = REMOTE_READERS if chunk_store.store.url.remote else LOCAL_READERS
        self._hands = ThreadPoolExecutor(self._many, "loader")

    def ensure(self, chunks: Sequence[Index], check: Callable[[], object] = lambda: None) -> None:
        """Load the newest light of ``chunks`` into the pool.

        Calls ``check`` between batches, which may raise Cancelled. Raises StoreError when the store cannot be read, or
        the pool cannot hold them all at once, and StoreAwayError when a remote store gives nothing for longer than one
        call may take.
        """
        missing = [index for index in self.pool.missing(chunks) if self._due(index)]
        together = frozenset(chunks) if missing else frozenset()
        with self._reading() as refreshed, closing(self._shown(missing)) as shown:
            for indices, found in shown:
                check()
                self._take(indices, found, together, refreshed)

    def refresh(self, index: Index) -> None:
        """Note that the store has new light of a chunk, also for those that are reading it now."""
        with self._lock:
            self._absent.pop(index, None)
            for refreshed in self._readers:
                refreshed.add(index)
        self.pool.outdate(index)

    @contextmanager
    def _reading(self) -> Iterator[set[Index]]:
        """Around a reading: the chunks that are refreshed meanwhile. What was read of them may be older."""
        refreshed = set[Index]()
        with self._lock:
            self._readers.append(refreshed)
        try:
            yield refreshed
        finally:
            with self._lock:
                self._readers = [each for each in self._readers if each is not refreshed]

    def _due(self, index: Index) -> bool:
        """Whether an absent chunk should be read again."""
        with self._lock:
            return time.monotonic() - self._absent.get(index, -ASK_AGAIN) >= ASK_AGAIN

    def _shown(self, indices: Sequence[Index]) -> Generator[tuple[Sequence[Index], Chunks], None, None]:
        """Batches of the chunks with the light that the store has of them, in order; several are read at once."""
        batches, store = self._batches(indices), self.chunk_store.store
        if len(batches) > 1 or (batches and store.url.remote):
            if not store.url.remote:
                store.check_reachable()
            with closing(ahead(self._hands, self._brought, batches, partial(patiently, store))) as brought:
                yield from zip(batches, brought, strict=True)
        elif batches:
            yield indices, self._brought(indices)

    def _batches(self, indices: Sequence[Index]) -> list[Sequence[Index]]:
        """The chunks in batches: as many as there are threads, none of few chunks, nor of more than BATCH_BYTES."""
        least = 1 if self.chunk_store.store.url.remote else CHUNKS_OF_ONE_READER
        size = max(min(BATCH_BYTES // self.chunk_store.chunk_bytes, max(-(-len(indices) // self._many), least)), 1)
        return [indices[i : i + size] for i in range(0, len(indices), size)]

    def _brought(self, indices: Sequence[Index]) -> Chunks:
        """Read and decode some chunks."""
        return self.chunk_store.show(indices, list(map(self.chunk_store.objects, indices)))

    def _take(self, indices: Sequence[Index], found: Chunks, together: frozenset[Index], refreshed: set[Index]) -> None:
        """Put the chunks that were found into the pool, and note the absent ones; but for those ``refreshed``."""
        if found.indices:
            self.pool.insert(found, together)
        with self._lock:
            old = refreshed & {*indices}
            absent = {*indices} - {*found.indices} - old
            self._absent.update(dict.fromkeys(absent, time.monotonic()))
        for index in old:
            self.pool.outdate(index)


def patiently(store: Store, reading: Future[Made]) -> Made:
    """What is read from a ``store``, once it is; StoreAwayError where it is remote and silent for a call's time."""
    while store.url.remote:
        try:
            return reading.result(store.url.seconds)
        except TimeoutError:
            if store.quiet >= store.url.seconds:
                raise store.silent() from None
    return reading.result()


def ahead(
    hands: Executor,
    work: Callable[[Item], Made],
    items: Sequence[Item],
    wait: Callable[[Future[Made]], Made] = lambda reading: reading.result(),
) -> Generator[Made, None, None]:
    """The results of ``work`` for the items, in order; MAX_BATCHES_AHEAD are begun, and cancelled on closing."""
    waiting: deque[Future[Made]] = deque()
    try:
        for item in items:
            waiting.append(hands.submit(work, item))
            if len(waiting) >= MAX_BATCHES_AHEAD:
                yield wait(waiting.popleft())
        while waiting:
            yield wait(waiting.popleft())
    finally:
        for future in waiting:
            future.cancel()
