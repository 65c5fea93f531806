"""The finder: numbers what a view's points read of a lattice, chunk by chunk and row by row, on several threads."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from isogi_core.bake.recipe import Recipe
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.chunks import find_places, touch_chunks
from isogi_core.kernels.lattice import Lattice
from isogi_core.kernels.wide import touch_wide


@dataclass(frozen=True, eq=False)
class Finder:
    """Looks for what surface ``points`` (m, 3) read, on the threads of ``tiles``."""

    points: np.ndarray
    recipe: Recipe
    tiles: Tiles
    cancelled: threading.Event | None = None

    @property
    def lattice(self) -> Lattice:
        """The lattice that is read."""
        return self.recipe.lattice

    @cached_property
    def indices(self) -> np.ndarray:
        """The chunks that are touched, (slots, 3; z, y, x)."""
        touched = np.zeros(self.recipe.chunks, np.bool_)
        self.over_points(touch_wide if self.recipe.scene.adaptive else touch_chunks, lambda a, b: (touched,))
        return np.argwhere(touched)

    @cached_property
    def slots(self) -> np.ndarray:
        """The number of each chunk (z, y, x) among those, -1 where it is not touched."""
        slots = np.full(self.recipe.chunks, -1, np.int32)
        slots[tuple(self.indices.T)] = np.arange(len(self.indices))
        return slots

    def over_points(
        self, kernel: Callable[..., None], each: Callable[[int, int], tuple[Any, ...]], size: int | None = None
    ) -> None:
        """Call a ``kernel`` with the lattice, ``size`` points, and what is for them from one to before another."""
        lattice, points = self.lattice, self.points
        size = size or self.tiles.even(len(points))
        self.tiles.run(lambda a, b: kernel(lattice, points[a:b], *each(a, b)), len(points), size, self.cancelled)

    def mark(self, kernel: Callable[..., None]) -> np.ndarray:
        """The bits that a ``kernel`` sets for all points in words for rows; (slots · rows,) uint32."""
        share = self.tiles.even(len(self.points), 1)
        marks = np.zeros((-(-len(self.points) // share), len(self.indices) * self.lattice.rows), np.uint32)
        self.over_points(kernel, lambda a, b: (self.slots, marks[a // share]), share)
        return np.asarray(np.bitwise_or.reduce(marks, axis=0))

    def count(self, bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is set in ``bits``, numbered: the first number of each row and the end, and the place of each."""
        first = np.zeros(len(bits) + 1, np.uint32)
        np.cumsum(np.bitwise_count(bits), out=first[1:])
        places = np.empty(first[-1], np.uint32)
        lattice, size = self.lattice, self.tiles.even(len(bits))
        self.tiles.run(lambda a, b: find_places(lattice, a, b, bits, first, places), len(bits), size, self.cancelled)
        return first, places


def positions_of(places: np.ndarray, indices: np.ndarray, lattice: Lattice) -> np.ndarray:
    """Lattice indices (m, 3; z, y, x) int32 of texels at ``places`` (m,) of the chunks ``indices`` (slots, 3)."""
    bits, side = lattice.bits, lattice.chunk - 1
    inside = np.stack([places >> bits * axis & side for axis in (2, 1, 0)], axis=-1).astype(np.int32)
    return np.asarray(indices.astype(np.int32)[places >> 3 * bits] * lattice.chunk + inside)
