"""One chunk of the cache: which of its texels are baked, and their light."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.recipe import Index
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.plan import Layer, ScenePlan


@dataclass(frozen=True, eq=False)
class Chunk:
    """Texels of one chunk: ``offsets`` (m,) int32 ascending, inside the chunk; ``light`` has a row for each."""

    index: Index
    offsets: np.ndarray
    light: Light

    @classmethod
    def empty(cls, index: Index, plan: ScenePlan) -> "Chunk":
        """A chunk in which nothing is baked."""
        return cls(index, np.empty(0, np.int32), Light.dark(plan, 0))

    @classmethod
    def of_parts(cls, index: Index, layers: Sequence[Layer], found: Sequence[tuple[np.ndarray, Part]]) -> "Chunk":
        """The chunk of what was ``found`` in each layer: offsets and their part."""
        offsets = reduce(np.union1d, [own for own, _ in found]).astype(np.int32)
        parts = [Part.dark(layer, len(offsets)) for layer in layers]
        for part, (own, baked) in zip(parts, found, strict=True):
            part.put(np.searchsorted(offsets, own), baked)
        return cls(index, offsets, Light(tuple(parts)))

    def with_texels(self, offsets: np.ndarray) -> "Chunk":
        """This chunk and, dark as yet, the texels at ``offsets`` that it does not have."""
        union = np.union1d(self.offsets, offsets).astype(np.int32)
        light = Light(tuple(Part.dark(part.layer, len(union)) for part in self.light.parts))
        light.put(np.searchsorted(union, self.offsets), self.light)
        return Chunk(self.index, union, light)

    def rows_of(self, offsets: np.ndarray) -> np.ndarray:
        """Rows of ``light`` that belong to texels at ``offsets``, all of which the chunk must have."""
        return np.searchsorted(self.offsets, offsets)

    def positions(self, offsets: np.ndarray) -> np.ndarray:
        """Lattice indices (z, y, x) of texels at ``offsets``; (m, 3) int32."""
        inside = np.stack(np.unravel_index(offsets, (CHUNK, CHUNK, CHUNK)), axis=-1)
        return (inside + np.array(self.index) * CHUNK).astype(np.int32)
