"""The texels under a view: which chunks it touches, which texels it reads, and what of it is not baked yet."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.chunk import TEXELS
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.kernels.lattice import count_pixels, find_corners, mark_texels


@dataclass(frozen=True, eq=False)
class Demand:
    """What a view wants of one chunk: the texels at ``offsets``, seen by ``area`` pixels (centre ones count more)."""

    index: Index
    offsets: np.ndarray
    area: float


@dataclass(frozen=True, eq=False)
class ViewTexels:
    """The texels that a G-buffer reads, numbered 0 … m - 1.

    ``chunks`` lists the chunks touched; texel t is at ``offset[t]`` of chunk ``chunks[chunk[t]]``;
    ``corners`` (points, 8) numbers the texels around each point; ``area`` weighs each chunk.
    """

    chunks: tuple[Index, ...]
    chunk: np.ndarray
    offset: np.ndarray
    corners: np.ndarray
    area: np.ndarray

    @cached_property
    def demands(self) -> tuple[Demand, ...]:
        """One demand for each chunk, of all texels that the view reads there."""
        first = np.searchsorted(self.chunk, np.arange(len(self.chunks) + 1))
        return tuple(
            Demand(index, self.offset[a:b], float(area))
            for index, a, b, area in zip(self.chunks, first[:-1], first[1:], self.area, strict=True)
        )


def find_texels(gbuffer: GBuffer, recipe: Recipe) -> ViewTexels:
    """Collect the texels around every surface point of ``gbuffer``."""
    area = np.zeros(recipe.chunks, np.float32)
    count_pixels(recipe.lattice, gbuffer.points, centre_weights(gbuffer), area)
    touched = np.argwhere(area)
    slots = np.full(recipe.chunks, -1, np.int32)
    slots[tuple(touched.T)] = np.arange(len(touched))
    read = np.zeros((len(touched), TEXELS), np.bool_)
    mark_texels(recipe.lattice, gbuffer.points, slots, read)
    chunk, offset = (part.astype(np.int32) for part in np.nonzero(read))
    numbers = np.full(read.shape, -1, np.int32)
    numbers[read] = np.arange(len(chunk))
    corners = np.empty((len(gbuffer.points), 8), np.int32)
    find_corners(recipe.lattice, gbuffer.points, slots, numbers, corners)
    chunks = tuple((int(z), int(y), int(x)) for z, y, x in touched)
    return ViewTexels(chunks, chunk, offset, corners, area[tuple(touched.T)])


def centre_weights(gbuffer: GBuffer) -> np.ndarray:
    """How much each point counts in the order of work: 2 in the middle of the picture, 1 at its corners; (m,)."""
    height, width = gbuffer.shape
    y, x = np.divmod(gbuffer.pixels, width)
    aside = ((2 * x + 1) / width - 1.0) ** 2 + ((2 * y + 1) / height - 1.0) ** 2
    return (2.0 - aside / 2.0).astype(np.float32)
