"""One chunk of the cache: which of its texels are baked, and their light."""

from dataclasses import dataclass

import numpy as np

from isogi_core.bake.light import SAMPLES, Light
from isogi_core.bake.recipe import Index
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.plan import ScenePlan

TEXELS = CHUNK**3
"""Texels of a whole chunk."""


@dataclass(frozen=True, eq=False)
class Chunk:
    """Baked texels of one chunk: ``offsets`` (m,) int32 ascending, inside the chunk; ``light`` has a row for each."""

    index: Index
    offsets: np.ndarray
    light: Light

    @classmethod
    def empty(cls, index: Index, plan: ScenePlan) -> "Chunk":
        """A chunk in which nothing is baked."""
        return cls(index, np.empty(0, np.int32), Light.dark(plan, 0))

    @classmethod
    def from_block(cls, index: Index, plan: ScenePlan, block: np.ndarray) -> "Chunk":
        """The baked texels of a full ``block`` (CHUNK, CHUNK, CHUNK, planes), in which NaN marks the others."""
        flat = block.reshape(TEXELS, -1)
        offsets = np.flatnonzero(~np.isnan(flat[:, SAMPLES])).astype(np.int32)
        return cls(index, offsets, Light(plan, flat[offsets]))

    def block(self) -> np.ndarray:
        """The chunk as it is stored: (CHUNK, CHUNK, CHUNK, planes) float32, NaN where nothing is baked."""
        flat = np.full((TEXELS, self.light.planes.shape[1]), np.nan, np.float32)
        flat[self.offsets] = self.light.planes
        return flat.reshape(CHUNK, CHUNK, CHUNK, -1)

    def with_texels(self, offsets: np.ndarray) -> "Chunk":
        """This chunk and, dark as yet, the texels at ``offsets`` that it does not have."""
        union = np.union1d(self.offsets, offsets).astype(np.int32)
        light = Light.dark(self.light.plan, len(union))
        light.planes[np.searchsorted(union, self.offsets)] = self.light.planes
        return Chunk(self.index, union, light)

    def rows_of(self, offsets: np.ndarray) -> np.ndarray:
        """Rows of ``light`` that belong to texels at ``offsets``, all of which the chunk must have."""
        return np.searchsorted(self.offsets, offsets)

    def positions(self, offsets: np.ndarray) -> np.ndarray:
        """Lattice indices (z, y, x) of texels at ``offsets``; (m, 3) int32."""
        inside = np.stack(np.unravel_index(offsets, (CHUNK, CHUNK, CHUNK)), axis=-1)
        return (inside + np.array(self.index) * CHUNK).astype(np.int32)
