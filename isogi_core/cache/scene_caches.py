"""The illumination caches of a scene, opened when a frame first reads them.

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
"""Seconds after which an absent chunk is read again: another machine may have baked it."""

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

    def ensure(self, chunks: Sequence[Index], check: Callable[[], object] = lambda: None) -> None:
        """Load the newest light of ``chunks`` into the pool.

        Calls ``check`` between batches, which may raise Cancelled. Raises StoreError when the store
        cannot be read, or the pool cannot hold them all at once, and StoreAwayError when a remote
        store gives nothing for longer than one call may take.
        """
        missing = [index for index in self.pool.missing(chunks) if self._due(index)]
        if missing:
            together = frozenset(chunks)
        else:
            together = frozenset()
        newer = {index: self.chunk_store.fresh.newer(index) for index in missing}
        fresh = [chunk for chunk in newer.values() if chunk is not None]
        stored = [index for index, chunk in newer.items() if chunk is None]
        with self._reading() as refreshed, closing(self._shown(stored)) as shown:
            if fresh:
                shown_fresh = self.chunk_store.show_fresh(fresh)
                self._take([chunk.index for chunk in fresh], shown_fresh, together, refreshed)
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
        """Around a reading: the chunks that are refreshed meanwhile. What was read of them may be
        older.
        """
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

    def _shown(
        self, indices: Sequence[Index]
    ) -> Generator[tuple[Sequence[Index], Chunks], None, None]:
        """Batches of the chunks with the light that the store has of them, in order; several are
        read at once.
        """
        batches = self._batches(indices)
        store = self.chunk_store.store
        if len(batches) > 1 or (batches and store.url.remote):
            if not store.url.remote:
                store.check_reachable()
            with closing(
                ahead(store.readers, self._brought, batches, partial(patiently, store))
            ) as brought:
                yield from zip(batches, brought, strict=True)
        elif batches:
            yield indices, self._brought(indices)

    def _batches(self, indices: Sequence[Index]) -> list[Sequence[Index]]:
        """The chunks in batches: as many as there are threads, none of few chunks, nor of more than
        BATCH_BYTES.
        """
        if self.chunk_store.store.url.remote:
            least = 1
        else:
            least = CHUNKS_OF_ONE_READER
        size = max(
            min(
                BATCH_BYTES // self.chunk_store.chunk_bytes,
                max(-(-len(indices) // self.chunk_store.store.most_readers), least),
            ),
            1,
        )
        return [indices[i : i + size] for i in range(0, len(indices), size)]

    def _brought(self, indices: Sequence[Index]) -> Chunks:
        """Read and decode some chunks."""
        return self.chunk_store.show(indices, list(map(self.chunk_store.objects, indices)))

    def _take(
        self,
        indices: Sequence[Index],
        found: Chunks,
        together: frozenset[Index],
        refreshed: set[Index],
    ) -> None:
        """Put the chunks that were found into the pool, and note the absent ones; but for those
        ``refreshed``.
        """
        if found.indices:
            self.pool.insert(found, together)
        with self._lock:
            old = refreshed & {*indices}
            absent = {*indices} - {*found.indices} - old
            self._absent.update(dict.fromkeys(absent, time.monotonic()))
        for index in old:
            self.pool.outdate(index)


def patiently(store: Store, reading: Future[Made]) -> Made:
    """What is read from a ``store``, once it is; StoreAwayError where it is remote and silent for a
    call's time.
    """
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
    """The results of ``work`` for the items, in order; MAX_BATCHES_AHEAD are begun, and cancelled
    on closing.
    """
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


PROJECTED_ISOVALUES = 2
"""Isovalues whose projected texels are held in memory at once: those that were shown last."""


class Caches:
    """The caches of a ``prepared`` scene in a ``store``, with ``budget`` bytes of memory together.

    Each has room for as many texels; projected ones of an isovalue have half of what the scene's
    own have. Safe to use from many threads.
    """

    def __init__(
        self, prepared: PreparedScene, store: StoreLike, budget: int, makes: bool = True
    ) -> None:
        """Open nothing yet. Layers are made when they are opened; where it ``makes`` none, with
        their first light.
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
        """The bake spec of views of this ``shading``, with larger layers where the store has these
        already.
        """
        name = spec_name(shading)
        with self._lock:
            if name not in self._specs:
                spec = spec_for(self.prepared, name)
                self._specs[name] = replace(spec, plan=adopt(spec.plan, self.prepared, self.store))
            return self._specs[name]

    def chunk_store(self, shading: str) -> ChunkStore:
        """The chunk store that views of this ``shading`` read, its layers opened. Raises
        StoreError.
        """
        name = spec_name(shading)
        with self._lock:
            if name not in self._chunk_stores:
                chunk_store = ChunkStore(self.store, self.spec(name))
                if self._makes:
                    chunk_store.open()
                self._chunk_stores[name] = chunk_store
            return self._chunk_stores[name]

    def chunk_store_of(self, shown: Isovalue | None) -> ChunkStore:
        """The chunk store of the scene's own light, or of texels projected onto the isosurface
        ``shown``.
        """
        if shown is None:
            return self.chunk_store("gi")
        return self.projected(shown).chunk_store

    def of(self, shading: str) -> Loader:
        """The loader of views of this ``shading``. Raises StoreError."""
        name = spec_name(shading)
        with self._lock:
            if name not in self._loaders:
                self._loaders[name] = Loader(
                    self.chunk_store(name), PagePool(self.spec(name), self._share(name))
                )
            return self._loaders[name]

    def projected(self, shown: Isovalue) -> Loader:
        """The loader of the scene's own spec with texels projected onto the isosurface ``shown``.

        Nothing is made in the store before there is light.
        """
        with self._lock:
            if shown not in self._projected:
                spec = replace(self.spec("gi"), shown=shown)
                self._projected[shown] = Loader(
                    ChunkStore(self.store, spec),
                    PagePool(spec, self._share("gi") // PROJECTED_ISOVALUES),
                )
            self._projected.move_to_end(shown)
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
        """Note that the store has new light of a chunk, of a spec or of the isosurface
        ``shown``.
        """
        with self._lock:
            loader = self.of(name) if shown is None else self._projected.get(shown)
        if loader is not None:
            loader.refresh(index)

    def _share(self, name: str) -> int:
        """Bytes of the budget for a spec; as many again are for projected texels of the scene's
        own.
        """
        sizes = {each: page_bytes(self.spec(each)) for each in SPECS}
        whole = sum(sizes.values()) + (sizes["gi"] if self.prepared.scene.projection.any else 0)
        return self.budget * sizes[name] // whole
