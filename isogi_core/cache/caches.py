"""The illumination caches of a scene, one for each of its looks, opened when a frame first reads it."""

import threading
from pathlib import Path

from isogi_core.bake.look import look_for, look_name
from isogi_core.bake.recipe import Recipe
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
        self._open: dict[str, Loader] = {}
        self._lock = threading.Lock()

    def of(self, shading: str) -> Loader:
        """The cache that views of this ``shading`` read. Raises StoreError."""
        name = look_name(shading)
        with self._lock:
            if name not in self._open:
                look = look_for(self.recipe, shading)
                store = ChunkStore(self.root, look)
                store.open()
                self._open[name] = Loader(store, PagePool(look, self.budget))
            return self._open[name]
