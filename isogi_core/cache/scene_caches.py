"""The illumination caches of a scene, opened when a frame first reads them."""

import threading
from collections import OrderedDict
from dataclasses import replace

from isogi_core.bake.bake_spec import SPECS, BakeSpec, spec_for, spec_name
from isogi_core.cache.chunk_store import ChunkStore, adopt
from isogi_core.cache.loader import Loader
from isogi_core.cache.page_pool import PagePool, page_bytes
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index, PreparedScene
from isogi_core.storage.store import Store, StoreLike

PROJECTED_ISOVALUES = 2
"""Isovalues whose projected texels are held in memory at once: those that were shown last."""


class Caches:
    """The caches of a ``prepared`` scene in a ``store``, with ``budget`` bytes of memory together.

    Each has room for as many texels; projected ones of an isovalue have half of what the scene's own have. Safe to
    use from many threads.
    """

    def __init__(self, prepared: PreparedScene, store: StoreLike, budget: int, makes: bool = True) -> None:
        """Open nothing yet. Layers are made when they are opened; where it ``makes`` none, with their first light."""
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
        """The bake spec of views of this ``shading``, with larger layers where the store has these already."""
        name = spec_name(shading)
        with self._lock:
            if name not in self._specs:
                spec = spec_for(self.prepared, name)
                self._specs[name] = replace(spec, plan=adopt(spec.plan, self.prepared, self.store))
            return self._specs[name]

    def chunk_store(self, shading: str) -> ChunkStore:
        """The chunk store that views of this ``shading`` read, its layers opened. Raises StoreError."""
        name = spec_name(shading)
        with self._lock:
            if name not in self._chunk_stores:
                chunk_store = ChunkStore(self.store, self.spec(name))
                if self._makes:
                    chunk_store.open()
                self._chunk_stores[name] = chunk_store
            return self._chunk_stores[name]

    def chunk_store_of(self, shown: Isovalue | None) -> ChunkStore:
        """The chunk store of the scene's own light, or of texels projected onto the isosurface ``shown``."""
        return self.chunk_store("gi") if shown is None else self.projected(shown).chunk_store

    def of(self, shading: str) -> Loader:
        """The loader of views of this ``shading``. Raises StoreError."""
        name = spec_name(shading)
        with self._lock:
            if name not in self._loaders:
                self._loaders[name] = Loader(self.chunk_store(name), PagePool(self.spec(name), self._share(name)))
            return self._loaders[name]

    def projected(self, shown: Isovalue) -> Loader:
        """The loader of the scene's own spec with texels projected onto the isosurface ``shown``.

        Nothing is made in the store before there is light.
        """
        with self._lock:
            if shown not in self._projected:
                spec = replace(self.spec("gi"), shown=shown)
                self._projected[shown] = Loader(
                    ChunkStore(self.store, spec), PagePool(spec, self._share("gi") // PROJECTED_ISOVALUES)
                )
            self._projected.move_to_end(shown)
            while len(self._projected) > PROJECTED_ISOVALUES:
                self._projected.popitem(last=False)
            return self._projected[shown]

    @property
    def nbytes(self) -> int:
        """Bytes of memory that light takes."""
        with self._lock:
            return sum(loader.pool.nbytes for loader in (*self._loaders.values(), *self._projected.values()))

    def refresh(self, name: str, index: Index, shown: Isovalue | None = None) -> None:
        """Note that the store has new light of a chunk, of a spec or of the isosurface ``shown``."""
        with self._lock:
            loader = self.of(name) if shown is None else self._projected.get(shown)
        if loader is not None:
            loader.refresh(index)

    def _share(self, name: str) -> int:
        """Bytes of the budget for a spec; as many again are for projected texels of the scene's own."""
        sizes = {each: page_bytes(self.spec(each)) for each in SPECS}
        whole = sum(sizes.values()) + (sizes["gi"] if self.prepared.scene.projection.any else 0)
        return self.budget * sizes[name] // whole
