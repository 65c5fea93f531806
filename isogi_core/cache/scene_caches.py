"""The caches of a scene's light, opened when a frame first reads them.

A loader brings the chunks that a view reads from the store into the page pool.
"""

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from typing import TypeVar

from isogi_core.bake.bake_spec import SPECS, BakeSpec, spec_for, spec_name
from isogi_core.cache.chunk_record import Chunks
from isogi_core.cache.chunk_store import ChunkStore, adopt
from isogi_core.cache.page_pool import PagePool, page_bytes
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.storage.store import REMOTE_READERS, Store, StoreLike

ASK_AGAIN = 1.0
"""Seconds after which an absent chunk is read again, as another machine may have baked it."""

MAX_BATCHES_AHEAD = 2 * REMOTE_READERS
"""Most batches of a view that are being read or wait in memory:
enough to keep all readers busy, while memory stays bounded.
"""

BATCH_BYTES = 1 << 23
"""Most bytes of records that are unpacked in one call.
That is thousands of texels, so the cost of the call itself does not matter.
"""

CHUNKS_OF_ONE_READER = 8
"""Fewest chunks for which another thread is woken, if the store is on this machine."""

Item = TypeVar("Item")
Made = TypeVar("Made")


class Loader:
    """Loads chunks from the store into the page pool when frames need them.

    Safe to use from many threads.
    """

    def __init__(self, chunk_store: ChunkStore, pool: PagePool) -> None:
        """Load from ``chunk_store`` into ``pool``."""
        self.chunk_store = chunk_store
        self.pool = pool
        # The times at which chunks were found absent; and a set for each thread that reads chunks
        # now, of those that were refreshed since it began.
        self._absent: dict[Index, float] = {}
        self._refreshed_sets: list[set[Index]] = []
        self._lock = threading.Lock()

    def ensure(self, chunks: Sequence[Index], check: Callable[[], object] = lambda: None) -> None:
        """Load the newest light of ``chunks`` into the pool.

        Calls ``check`` between batches, which may raise Cancelled. Raises StoreError if the store
        cannot be read or the pool cannot hold all chunks together, and StoreAwayError if a remote
        store gives nothing for longer than one call may take.
        """
        # Read the chunks that the pool lacks or has outdated, but not those that the store lacked a
        # moment ago.
        missing = [index for index in self.pool.missing(chunks) if self._is_due(index)]
        if not missing:
            return
        # The chunks of this view must be in the pool together, so none of them is dropped for
        # another.
        together = frozenset(chunks)
        with self._reading() as refreshed:
            # Light that this process has not written yet is newer than the store's.
            newer = {index: self.chunk_store.fresh.newer(index) for index in missing}
            fresh = [chunk for chunk in newer.values() if chunk is not None]
            stored = [index for index, chunk in newer.items() if chunk is None]
            if fresh:
                shown_fresh = self.chunk_store.show_fresh(fresh)
                self._insert([chunk.index for chunk in fresh], shown_fresh, together, refreshed)
            with closing(self._read_in_batches(stored)) as shown:
                for indices, found in shown:
                    check()
                    self._insert(indices, found, together, refreshed)

    def refresh(self, index: Index) -> None:
        """Note that the store has new light of a chunk,
        even for threads that are reading it now.
        """
        with self._lock:
            self._absent.pop(index, None)
            # Threads that are reading may have got the older light.
            for refreshed in self._refreshed_sets:
                refreshed.add(index)
        self.pool.outdate(index)

    @contextmanager
    def _reading(self) -> Iterator[set[Index]]:
        """Yield a set to which ``refresh`` adds the chunks that change while the block reads.

        Those may have been read just before they changed, and must be read again.
        """
        refreshed = set[Index]()
        with self._lock:
            self._refreshed_sets.append(refreshed)
        try:
            yield refreshed
        finally:
            with self._lock:
                # Sets are told apart by identity: those of two threads may be equal.
                self._refreshed_sets = [
                    each for each in self._refreshed_sets if each is not refreshed
                ]

    def _is_due(self, index: Index) -> bool:
        """Return True if a chunk may be read:
        it was not found absent in the last ASK_AGAIN seconds.
        """
        with self._lock:
            return time.monotonic() - self._absent.get(index, -ASK_AGAIN) >= ASK_AGAIN

    def _read_in_batches(
        self, indices: Sequence[Index]
    ) -> Generator[tuple[Sequence[Index], Chunks], None, None]:
        """Yield the chunks in batches, in order, each with the light that the store has of them.

        Several batches are read at once.
        """
        batches = self._batches(indices)
        store = self.chunk_store.store
        # A single batch of a local store is read by this thread, which is faster. Reads of a remote
        # store go to other threads, so that this one can stop waiting.
        if len(batches) > 1 or (batches and store.url.remote):
            if not store.url.remote:
                store.check_reachable()
            with closing(
                read_ahead(store.readers, self._read_batch, batches, partial(wait_for_read, store))
            ) as results:
                yield from zip(batches, results, strict=True)
        elif batches:
            yield indices, self._read_batch(indices)

    def _batches(self, indices: Sequence[Index]) -> list[Sequence[Index]]:
        """Split the chunks into batches for the reading threads.

        There is a batch for each thread, but none of more than BATCH_BYTES, and none of fewer than
        CHUNKS_OF_ONE_READER chunks if the store is local.
        """
        if self.chunk_store.store.url.remote:
            least = 1
        else:
            least = CHUNKS_OF_ONE_READER
        size = max(-(-len(indices) // self.chunk_store.store.most_readers), least)
        size = max(min(size, BATCH_BYTES // self.chunk_store.chunk_bytes), 1)
        return [indices[i : i + size] for i in range(0, len(indices), size)]

    def _read_batch(self, indices: Sequence[Index]) -> Chunks:
        """Read and decode some chunks."""
        return self.chunk_store.show(indices, list(map(self.chunk_store.objects, indices)))

    def _insert(
        self,
        indices: Sequence[Index],
        found: Chunks,
        together: frozenset[Index],
        refreshed: set[Index],
    ) -> None:
        """Put the chunks that were ``found`` into the pool, and note the other ``indices`` as
        absent.

        Chunks that were ``refreshed`` meanwhile are marked as stale instead.
        """
        if found.indices:
            self.pool.insert(found, together)
        # Note when chunks were found absent, so that they are not read again soon. A chunk
        # refreshed during the read may exist by now.
        with self._lock:
            old = refreshed & {*indices}
            absent = {*indices} - {*found.indices} - old
            self._absent.update(dict.fromkeys(absent, time.monotonic()))
        for index in old:
            self.pool.outdate(index)


def wait_for_read(store: Store, reading: Future[Made]) -> Made:
    """Wait for a ``reading`` of the ``store``, and return its result.

    Raises StoreAwayError if the store is remote, and has answered no read of any thread for as long
    as one call may take. So a long queue of reads does not count as silence.
    """
    if not store.url.remote:
        return reading.result()
    while True:
        try:
            return reading.result(store.url.seconds)
        except TimeoutError:
            # While the store answers other reads it is slow, but not silent: keep waiting.
            if store.seconds_silent >= store.url.seconds:
                raise store.note_silence() from None


def read_ahead(
    threads: Executor,
    work: Callable[[Item], Made],
    items: Sequence[Item],
    wait: Callable[[Future[Made]], Made] = lambda reading: reading.result(),
) -> Generator[Made, None, None]:
    """Yield the results of ``work`` for the items, in order, computed by ``threads``.

    At most MAX_BATCHES_AHEAD items are begun before their results are taken. Those that wait are
    cancelled when the generator is closed.
    """
    waiting: deque[Future[Made]] = deque()
    try:
        for item in items:
            waiting.append(threads.submit(work, item))
            if len(waiting) >= MAX_BATCHES_AHEAD:
                yield wait(waiting.popleft())
        while waiting:
            yield wait(waiting.popleft())
    finally:
        for future in waiting:
            future.cancel()


PROJECTED_ISOVALUES = 2
"""Number of isovalues whose projected texels are in memory at once: those that were shown last."""


class Caches:
    """The caches of a ``prepared`` scene in a ``store``, with ``budget`` bytes of memory together.

    The budget is divided so that each cache has room for as many texels; projected texels of an
    isovalue have half of that. Safe to use from many threads.
    """

    def __init__(
        self, prepared: PreparedScene, store: StoreLike, budget: int, makes: bool = True
    ) -> None:
        """Open nothing yet.

        If ``makes``, layers are created when they are opened, else with their first light.
        """
        self._makes = makes
        self.prepared = prepared
        self.store = Store.of(store)
        self.budget = budget
        self._specs: dict[str, BakeSpec] = {}
        self._chunk_stores: dict[str, ChunkStore] = {}
        self._loaders: dict[str, Loader] = {}
        self._projected: OrderedDict[Isovalue, Loader] = OrderedDict()
        self._lock = threading.RLock()

    def spec(self, shading: str) -> BakeSpec:
        """Return the bake spec of views of this ``shading``,
        with larger layers if the store has light of these only.
        """
        name = spec_name(shading)
        with self._lock:
            if name not in self._specs:
                spec = spec_for(self.prepared, name)
                self._specs[name] = replace(spec, plan=adopt(spec.plan, self.prepared, self.store))
            return self._specs[name]

    def chunk_store(self, shading: str) -> ChunkStore:
        """Return the chunk store that views of this ``shading`` read, the same one each time.

        Its layers are opened or created first if these caches make layers, see ``__init__``. Raises
        StoreError if that fails; the next call tries again.
        """
        name = spec_name(shading)
        with self._lock:
            if name not in self._chunk_stores:
                chunk_store = ChunkStore(self.store, self.spec(shading))
                if self._makes:
                    chunk_store.open()
                self._chunk_stores[name] = chunk_store
            return self._chunk_stores[name]

    def chunk_store_of(self, shown: Isovalue | None) -> ChunkStore:
        """Return the chunk store of the scene's light, or,
        with ``shown``, of texels projected onto that isosurface.
        """
        if shown is None:
            return self.chunk_store("gi")
        return self.projected(shown).chunk_store

    def of(self, shading: str) -> Loader:
        """Return the loader of views of this ``shading``. Raises StoreError."""
        name = spec_name(shading)
        with self._lock:
            if name not in self._loaders:
                self._loaders[name] = Loader(
                    self.chunk_store(name), PagePool(self.spec(name), self._share(name))
                )
            return self._loaders[name]

    def projected(self, shown: Isovalue) -> Loader:
        """Return the loader of the scene's light in texels that are projected onto the isosurface
        ``shown``.

        Nothing is created in the store before there is light.
        """
        with self._lock:
            if shown not in self._projected:
                spec = replace(self.spec("gi"), shown=shown)
                self._projected[shown] = Loader(
                    ChunkStore(self.store, spec),
                    PagePool(spec, self._share("gi") // PROJECTED_ISOVALUES),
                )
            self._projected.move_to_end(shown)
            # Drop the caches of isovalues that were shown longest ago.
            while len(self._projected) > PROJECTED_ISOVALUES:
                self._projected.popitem(last=False)
            return self._projected[shown]

    @property
    def nbytes(self) -> int:
        """Bytes of memory that light takes."""
        with self._lock:
            return sum(
                loader.pool.nbytes
                for loader in (*self._loaders.values(), *self._projected.values())
            )

    def refresh(self, name: str, index: Index, shown: Isovalue | None = None) -> None:
        """Note that the store has new light of a chunk:
        in the spec ``name``, or in texels projected onto ``shown``.
        """
        with self._lock:
            loader = self.of(name) if shown is None else self._projected.get(shown)
        if loader is not None:
            loader.refresh(index)

    def _share(self, name: str) -> int:
        """Return the bytes of the budget for a spec.

        Projected texels of the scene's light get as many as that light.
        """
        sizes = {each: page_bytes(self.spec(each)) for each in SPECS}
        whole = sum(sizes.values())
        if self.prepared.scene.projection.any:
            whole += sizes["gi"]
        return self.budget * sizes[name] // whole
