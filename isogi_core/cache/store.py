"""The store of a look's light: its layers, read and written chunk by chunk."""

import logging
import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from isogi_core.bake.light import Part
from isogi_core.bake.look import Look
from isogi_core.bake.precision import VOID
from isogi_core.bake.recipe import Index
from isogi_core.cache.chunk import Chunk, Chunks
from isogi_core.cache.kin import former
from isogi_core.cache.layer import LayerStore
from isogi_core.cache.root import Root, Where
from isogi_core.cache.use import Use
from isogi_core.errors import DamagedChunkError
from isogi_core.model.plan import Layer

log = logging.getLogger("isogi.cache")

Objects = tuple[bytes | None, ...]
"""The objects of one chunk, None for each that is not there."""


def default_store() -> Path:
    """Where light is kept when nobody says where: ``$XDG_CACHE_HOME/isogi/light`` or ``~/.cache/isogi/light``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isogi" / "light"


class ChunkStore:
    """Chunks of all layers of a ``look`` at ``root``, a folder, a URL or a root that is open. Raises StoreError.

    ``damaged`` counts the objects that were read and could not be used.
    """

    def __init__(self, root: Where, look: Look) -> None:
        """Name the layers' places; nothing is opened or made yet."""
        self.look = look
        self.root = Root.of(root)
        self.damaged = 0
        self.layers = tuple(LayerStore(self.root, look.recipe, layer, look.shown) for layer in look.plan.layers)
        self.use = Use(self.root, [layer.digest for layer in self.layers])

    def open(self) -> None:
        """Open the layers' arrays, or make them, and look for smaller ones, now and not with the first chunk."""
        for layer in self.layers:
            layer.open()
        self.formers  # noqa: B018

    @property
    def made(self) -> bool:
        """Whether any layer was: until then there is nothing to read."""
        return any(layer.made for layer in self.layers)

    def read(self, index: Index) -> Chunk | None:
        """The chunk; None where no layer has anything of it. What is damaged counts as absent, and is told."""
        return self._chunk(index, [self._decoded(layer, index, layer.read(index)) for layer in self.layers])

    @cached_property
    def formers(self) -> tuple[LayerStore | None, ...]:
        """For each layer the smaller one that an earlier plan left."""
        return tuple(former(layer.layer, self.look.recipe, self.root, self.look.shown) for layer in self.layers)

    @property
    def chunk_bytes(self) -> int:
        """Bytes of the records of a whole chunk."""
        return sum(layer.size for layer in self.layers)

    def objects(self, index: Index) -> Objects:
        """The objects of a chunk as they are stored: of each layer, and then of each smaller one."""
        return tuple(None if layer is None else layer.read(index) for layer in (*self.layers, *self.formers))

    def show(self, indices: Sequence[Index], objects: Sequence[Objects]) -> Chunks:
        """Those of the chunks that any layer has something of, as ``read`` has them, out of their ``objects``.

        Where a texel is not baked there is, as if with no samples, what a smaller layer knows of it.
        """
        self.use.tell()
        stored = list(zip(*objects, strict=True))
        found = [layer.decode_all(indices, own, self._tell) for layer, own in zip(self.layers, stored, strict=False)]
        for number, (layer, kin) in enumerate(zip(self.layers, self.formers, strict=True)):
            if kin is not None:
                smaller = kin.decode_all(indices, stored[len(self.layers) + number], self._tell)
                found[number] = completed(*found[number], *smaller, layer.layer)
        return Chunks.of_parts(indices, self.look.recipe.lattice.texels, self.look.plan.layers, found)

    def load(self, index: Index) -> Chunk:
        """The chunk, empty where it is absent or damaged: what is lost is baked again."""
        return self.read(index) or Chunk.empty(index, self.look.plan)

    def save(self, chunk: Chunk, changed: Sequence[bool] | None = None) -> bool:
        """Write the parts of a chunk, or those that ``changed``: one object each, atomically; see LayerStore.save.

        Returns whether others were found to have been at the same.
        """
        met = False
        for number, (layer, part) in enumerate(zip(self.layers, chunk.light.parts, strict=True)):
            if changed is None or changed[number]:
                met |= layer.save(chunk.index, chunk.offsets, part)
        return met

    def _chunk(self, index: Index, found: Sequence[tuple[np.ndarray, Part]]) -> Chunk | None:
        if not any(len(offsets) for offsets, _ in found):
            return None
        return Chunk.of_parts(index, self.look.plan.layers, found)

    def _decoded(self, layer: LayerStore, index: Index, stored: bytes | None) -> tuple[np.ndarray, Part]:
        try:
            if stored is not None:
                return layer.decode(index, stored)
        except DamagedChunkError as error:
            self._tell(error)
        return np.empty(0, np.int32), Part.dark(layer.layer, 0)

    def _tell(self, error: DamagedChunkError) -> None:
        self.damaged += 1
        log.warning("%s", error)


def completed(offsets: np.ndarray, part: Part, others: np.ndarray, kin: Part, layer: Layer) -> tuple[np.ndarray, Part]:
    """A ``part`` of texels at ``offsets``, and what ``kin`` says of others; these are void, or have no samples."""
    lacking = ~np.isin(others, offsets)
    union = np.union1d(offsets, others[lacking]).astype(np.int32)
    whole, rows = Part.dark(layer, len(union)), np.searchsorted(union, others[lacking])
    whole.coefficients[rows, :, : kin.layer.order**2] = kin.coefficients[lacking]
    whole.samples[rows] = np.where(kin.samples[lacking] == VOID, VOID, 0)
    whole.put(np.searchsorted(union, offsets), part)
    return union, whole
