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
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.kin import former
from isogi_core.cache.layer import LayerStore
from isogi_core.errors import DamagedChunkError
from isogi_core.model.plan import Layer

log = logging.getLogger("isogi.cache")


def default_store() -> Path:
    """Where light is kept when nobody says where: ``$XDG_CACHE_HOME/isogi/light`` or ``~/.cache/isogi/light``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "isogi" / "light"


class ChunkStore:
    """Chunks of all layers of a ``look`` under ``root``, a folder or a URL that Zarr opens. Raises StoreError."""

    def __init__(self, root: str | Path, look: Look) -> None:
        """Name the layers' places; nothing is opened or made yet."""
        self.look = look
        self.root = root
        self.layers = tuple(LayerStore(root, look.recipe, layer) for layer in look.plan.layers)

    def open(self) -> None:
        """Open the layers' arrays, or make them, and look for smaller ones, now and not with the first chunk."""
        for layer in self.layers:
            layer.array  # noqa: B018
        self.formers  # noqa: B018

    def read(self, index: Index) -> Chunk | None:
        """The chunk; None where no layer has anything of it. What is damaged counts as absent, and is told."""
        return self._chunk(index, [self._read(layer, index) for layer in self.layers])

    @cached_property
    def formers(self) -> tuple[LayerStore | None, ...]:
        """For each layer the smaller one that an earlier plan left."""
        return tuple(former(layer.layer, self.look.recipe, self.root) for layer in self.layers)

    def show(self, index: Index) -> Chunk | None:
        """``read``, and where a texel is not baked, as if with no samples, what a smaller layer knows of it."""
        found = [self._read(layer, index) for layer in self.layers]
        for number, (layer, kin) in enumerate(zip(self.layers, self.formers, strict=True)):
            if kin is not None:
                found[number] = completed(*found[number], *self._read(kin, index), layer.layer)
        return self._chunk(index, found)

    def load(self, index: Index) -> Chunk:
        """The chunk, empty where it is absent or damaged: what is lost is baked again."""
        return self.read(index) or Chunk.empty(index, self.look.plan)

    def save(self, chunk: Chunk, changed: Sequence[bool] | None = None) -> None:
        """Write the parts of a chunk, or those that ``changed``: one object each, atomically."""
        for number, (layer, part) in enumerate(zip(self.layers, chunk.light.parts, strict=True)):
            if changed is None or changed[number]:
                layer.save(chunk.index, chunk.offsets, part)

    def _chunk(self, index: Index, found: Sequence[tuple[np.ndarray, Part]]) -> Chunk | None:
        if not any(len(offsets) for offsets, _ in found):
            return None
        return Chunk.of_parts(index, self.look.plan.layers, found)

    def _read(self, layer: LayerStore, index: Index) -> tuple[np.ndarray, Part]:
        stored = layer.read(index)
        try:
            if stored is not None:
                return layer.decode(index, stored)
        except DamagedChunkError as error:
            log.warning("%s", error)
        return np.empty(0, np.int32), Part.dark(layer.layer, 0)


def completed(offsets: np.ndarray, part: Part, others: np.ndarray, kin: Part, layer: Layer) -> tuple[np.ndarray, Part]:
    """A ``part`` of texels at ``offsets``, and what ``kin`` says of others; these are void, or have no samples."""
    lacking = ~np.isin(others, offsets)
    union = np.union1d(offsets, others[lacking]).astype(np.int32)
    whole, rows = Part.dark(layer, len(union)), np.searchsorted(union, others[lacking])
    whole.coefficients[rows, :, : kin.layer.order**2] = kin.coefficients[lacking]
    whole.samples[rows] = np.where(kin.samples[lacking] == VOID, VOID, 0)
    whole.put(np.searchsorted(union, offsets), part)
    return union, whole
