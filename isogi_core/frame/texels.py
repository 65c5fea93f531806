"""The texels under a view: which chunks it touches, which texels it reads, and what of it is not baked yet."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from isogi_core.bake.recipe import Index, Recipe
from isogi_core.cache.chunk import TEXELS
from isogi_core.frame.gbuffer import POINTS, GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.lattice import find_corners, mark_texels, number_texels, touch_chunks, weigh_chunks


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
    ``corners`` (points, 8) numbers the texels around each point.
    """

    gbuffer: GBuffer
    chunks: tuple[Index, ...]
    chunk: np.ndarray
    offset: np.ndarray
    corners: np.ndarray

    @cached_property
    def demands(self) -> tuple[Demand, ...]:
        """One demand for each chunk, of all texels that the view reads there."""
        area = np.zeros(len(self.chunks), np.float32)
        weigh_chunks(self.corners, self.chunk, centre_weights(self.gbuffer), area)
        first = np.searchsorted(self.chunk, np.arange(len(self.chunks) + 1))
        return tuple(
            Demand(index, self.offset[a:b], float(weight))
            for index, a, b, weight in zip(self.chunks, first[:-1], first[1:], area, strict=True)
        )


def find_texels(gbuffer: GBuffer, recipe: Recipe, tiles: Tiles, cancelled: threading.Event | None) -> ViewTexels:
    """Collect the texels around every surface point of ``gbuffer``."""
    points, lattice = gbuffer.points, recipe.lattice

    def _over_points(kernel: Callable[..., None], *arguments: Any) -> None:
        tiles.run(lambda a, b: kernel(lattice, points[a:b], *arguments), len(points), POINTS, cancelled)

    touched = np.zeros(recipe.chunks, np.bool_)
    _over_points(touch_chunks, touched)
    indices = np.argwhere(touched)
    slots = np.full(recipe.chunks, -1, np.int32)
    slots[touched] = np.arange(len(indices))
    read = np.zeros(len(indices) * TEXELS, np.bool_)
    _over_points(mark_texels, slots, read)
    numbers, places = np.empty(read.shape, np.int32), np.empty(read.shape, np.int32)
    places = places[: number_texels(read, numbers, places)]
    corners = np.empty((len(points), 8), np.int32)
    tiles.run(
        lambda a, b: find_corners(lattice, points[a:b], slots, numbers, corners[a:b]), len(points), POINTS, cancelled
    )
    chunk, offset = np.divmod(places, np.int32(TEXELS))
    return ViewTexels(gbuffer, tuple((int(z), int(y), int(x)) for z, y, x in indices), chunk, offset, corners)


def centre_weights(gbuffer: GBuffer) -> np.ndarray:
    """How much each point counts in the order of work: 2 in the middle of the picture, 1 at its corners; (m,)."""
    height, width = gbuffer.shape
    y, x = np.divmod(gbuffer.pixels, width)
    aside = ((2 * x + 1) / width - 1.0) ** 2 + ((2 * y + 1) / height - 1.0) ** 2
    return (2.0 - aside / 2.0).astype(np.float32)
