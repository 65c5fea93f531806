"""The illumination caches of a scene, one for each of its looks, opened when a frame first reads it."""

import threading
from collections import OrderedDict
from dataclasses import replace

from isogi_core.bake.look import LOOKS, Look, look_for, look_name
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.kin import adopt
from isogi_core.cache.loader import Loader
from isogi_core.cache.pages import PagePool, page_bytes
from isogi_core.cache.root import Root, Where
from isogi_core.cache.store import ChunkStore

SHARP = 2
"""Isovalues whose sharp light is held in memory at once: those that were shown last."""


class Caches:
    """The caches of a ``recipe`` at ``root``; they have ``budget`` bytes of memory together.

    It is shared so that each has room for as many texels; sharp light has half of what is for the scene's own. Safe to
    use from many threads.
    """

    def __init__(self, recipe: Recipe, root: Where, budget: int) -> None:
        """Open nothing yet."""
        self.recipe = recipe
        self.root = Root.of(root)
        self.budget = budget
        self._looks: dict[str, Look] = {}
        self._stores: dict[str, ChunkStore] = {}
        self._open: dict[str, Loader] = {}
        self._sharp: OrderedDict[float, Loader] = OrderedDict()
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
                self._open[name] = Loader(self.store(name), PagePool(self.look(name), self._share(name)))
            return self._open[name]

    def sharp(self, shown: float) -> Loader:
        """The cache of the scene's own look with texels on the isosurface ``shown``, a normalised isovalue.

        Nothing of it is made in the store before there is light.
        """
        with self._lock:
            if shown not in self._sharp:
                look = replace(self.look("gi"), shown=shown)
                self._sharp[shown] = Loader(ChunkStore(self.root, look), PagePool(look, self._share("gi") // SHARP))
            self._sharp.move_to_end(shown)
            while len(self._sharp) > SHARP:
                self._sharp.popitem(last=False)
            return self._sharp[shown]

    def refresh(self, name: str, index: Index, shown: float | None = None) -> None:
        """Say that the store has new light of a chunk in a look, sharp where an isosurface is ``shown``."""
        with self._lock:
            loader = self.of(name) if shown is None else self._sharp.get(shown)
        if loader is not None:
            loader.refresh(index)

    def _share(self, name: str) -> int:
        """Bytes of the budget that are for a look; as many again are for sharp light of the scene's own."""
        sizes = {each: page_bytes(self.look(each)) for each in LOOKS}
        whole = sum(sizes.values()) + (sizes["gi"] if self.recipe.scene.sharpen else 0)
        return self.budget * sizes[name] // whole
