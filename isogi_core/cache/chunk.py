"""Chunks of the cache: their baked texels, and the light of these."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import compress

import numpy as np

from isogi_core.bake.texel_light import Light, Part
from isogi_core.model.scene_plan import Layer, ScenePlan
from isogi_core.prepared.prepared_scene import Index


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
        """The chunk of the offsets and the part that were ``found`` in each layer."""
        return cls(index, *united(layers, found))

    def with_texels(self, offsets: np.ndarray) -> "Chunk":
        """This chunk with the texels at ``offsets`` added where it lacks them; added texels are dark."""
        union = np.union1d(self.offsets, offsets).astype(np.int32)
        light = Light(tuple(Part.dark(part.layer, len(union)) for part in self.light.parts))
        light.put(np.searchsorted(union, self.offsets), self.light)
        return Chunk(self.index, union, light)

    def rows_of(self, offsets: np.ndarray) -> np.ndarray:
        """Rows of ``light`` for texels at ``offsets``, all of which the chunk must have."""
        return np.searchsorted(self.offsets, offsets)


@dataclass(frozen=True, eq=False)
class Chunks:
    """Texels of several chunks: those of ``indices[i]`` are the rows ``bounds[i]`` … ``bounds[i + 1]`` of ``light``.

    ``bounds`` (chunks + 1,) int64; ``offsets`` (m,) int32, ascending in each chunk.
    """

    indices: tuple[Index, ...]
    bounds: np.ndarray
    offsets: np.ndarray
    light: Light

    @classmethod
    def of_one(cls, chunk: Chunk) -> "Chunks":
        """A single chunk."""
        return cls((chunk.index,), np.array([0, len(chunk.offsets)]), chunk.offsets, chunk.light)

    @classmethod
    def of_parts(
        cls, indices: Sequence[Index], texels: int, layers: Sequence[Layer], found: Sequence[tuple[np.ndarray, Part]]
    ) -> "Chunks":
        """The chunks that have texels, of the places and the part that were ``found`` in each layer.

        A place is the number of the chunk among ``indices`` times the ``texels`` of one plus the offset in it.
        """
        places, light = united(layers, found)
        bounds = np.searchsorted(places, np.arange(len(indices) + 1, dtype=np.int32) * np.int32(texels))
        there = tuple(compress(indices, (np.diff(bounds) > 0).tolist()))
        return cls(there, np.unique(bounds), places % np.int32(texels), light)


def united(layers: Sequence[Layer], found: Sequence[tuple[np.ndarray, Part]]) -> tuple[np.ndarray, Light]:
    """The places ``found`` in any of the layers, ascending, and their light; a part is dark where it lacks a place."""
    first, parts = found[0][0], [part for _, part in found]
    if all(np.array_equal(own, first) for own, _ in found):
        return first.astype(np.int32), Light(tuple(parts))
    places = reduce(np.union1d, [own for own, _ in found]).astype(np.int32)
    wholes = [Part.dark(layer, len(places)) for layer in layers]
    for whole, (own, part) in zip(wholes, found, strict=True):
        whole.put(np.searchsorted(places, own), part)
    return places, Light(tuple(wholes))
