"""The illumination caches of a scene, one for each of its looks, opened when a frame first reads it."""

import threading
from dataclasses import replace
from pathlib import Path

from isogi_core.bake.look import Look, look_for, look_name
from isogi_core.bake.recipe import Recipe
from isogi_core.cache.kin import adopt
from isogi_core.cache.loader import Loader
from isogi_core.cache.pages import PagePool
from isogi_core.cache.store import ChunkStore


class Caches:
    """The caches of a ``recipe`` under ``root``, a folder or URL; each has ``budget`` bytes of memory.

    Safe to use from many threads.
    """

    def __init__(self, recipe: Recipe, root: str | Path, budget: int) -> None:
        """Open nothing yet."""
        self.recipe = recipe
        self.root = root
        self.budget = budget
        self._looks: dict[str, Look] = {}
        self._stores: dict[str, ChunkStore] = {}
        self._open: dict[str, Loader] = {}
        self._lock = threading.RLock()

    def look(self, shading: str) -> Look:
        """The look that views of this ``shading`` have, with larger layers where the store has these already."""
        name = look_name(shading)
        with self._lock:
            if name not in self._looks:
                look = look_for(self.recipe, name)
                self._looks[name] = replace(look, plan=adopt(look.plan, self.recipe, self.root))
            return self._looks[name]

    def store(self, shading: str) -> ChunkStore:
        """The store of the light that views of this ``shading`` read, its layers opened. Raises StoreError."""
        name = look_name(shading)
        with self._lock:
            if name not in self._stores:
                store = ChunkStore(self.root, self.look(name))
                store.open()
                self._stores[name] = store
            return self._stores[name]

    def of(self, shading: str) -> Loader:
        """The cache that views of this ``shading`` read. Raises StoreError."""
        name = look_name(shading)
        with self._lock:
            if name not in self._open:
                self._open[name] = Loader(self.store(name), PagePool(self.look(name), self.budget))
            return self._open[name]
