"""Maps: which cells may hold the isosurfaces of a range of isovalues, kept for the isovalues that come next."""

import threading
from collections.abc import Callable
from itertools import pairwise
from typing import Protocol

import numpy as np

from isogi_core.bake.levels import find_levels
from isogi_core.errors import Cancelled
from isogi_core.kept import OVERHEAD, Kept
from isogi_core.kernels.bricks import Bricks, brick_ranges, make_bricks

KEPT = 768 << 20
"""Bytes of maps that are kept (for each 64 cells and map 4 bytes, and 16 more where any of them is marked)."""

USUAL = 6
"""Bytes that a map which is yet to be made is taken to have for each 64 cells."""

NARROW = 2
"""Levels across which the maps of a bake reach, as long as all that it asks for are kept.

Through maps 12 levels wide paths in a volume of 1024³ voxels took 1.7 times as long: they look at more cells.
"""

LAYERS = 4
"""Layers of bricks that are marked in one go."""

Piece = Callable[[int, int], object]


class Run(Protocol):
    """Whoever calls a function over the ranges of a whole, as ``frame.tiles.Tiles.run`` does."""

    def __call__(self, piece: Piece, total: int, size: int, cancelled: threading.Event | None = None) -> None:
        """Call ``piece(first, last)`` for ranges of ``size`` up to ``total``; Cancelled once ``cancelled`` is set."""


def serially(piece: Piece, total: int, size: int, cancelled: threading.Event | None = None) -> None:
    """Run one piece after the other, on the thread that asks."""
    for first in range(0, total, size):
        if cancelled is not None and cancelled.is_set():
            raise Cancelled("Nobody waits for this any more.")
        piece(first, min(first + size, total))


class Maps:
    """The maps of one volume. Safe to use from many threads; two that want the same map make it once.

    ``levels`` are where maps begin and end, normalised isovalues from -inf to inf.
    """

    def __init__(self, voxels: np.ndarray, run: Run = serially, most: int = KEPT) -> None:
        """Find the ranges of the ``voxels``' bricks; keep maps of at most ``most`` bytes, made by means of ``run``."""
        self._voxels = voxels
        self._ranges = brick_ranges(voxels)
        self.levels = find_levels(voxels)
        self._run = run
        self._kept: Kept[tuple[int, int]] = Kept(most)
        self._most, self._sizes, self._lock = most, dict[tuple[int, int], int](), threading.Lock()
        self._width, self._asked = NARROW, np.zeros(len(self.levels) - 1, np.bool_)

    def get(self, lowest: float, highest: float, cancelled: threading.Event | None = None) -> Bricks:
        """The map for normalised isovalues from ``lowest`` to ``highest``, widened to levels.

        Raises Cancelled where it must be made and ``cancelled`` is set.
        """
        first = int(np.searchsorted(self.levels, lowest, "right")) - 1
        last = max(int(np.searchsorted(self.levels, highest)), first + 1)
        return self._kept.get((first, last), lambda: self._make(first, last, cancelled))

    def groups(self, isovalues: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For isovalues (m,), none NaN: the number of the group that each is in; and the groups' ends.

        Groups are NARROW, or so wide that the maps of all that were asked for are kept: each may be needed again and
        again. They become wider as more is asked for; each call has its own.
        """
        with self._lock:
            self._asked[np.searchsorted(self.levels, isovalues, "right") - 1] = True
            ends = self.levels[self._edges()]
        return np.searchsorted(ends, isovalues, "right") - 1, ends

    def forget(self) -> None:
        """Keep no map, as if every isovalue were new."""
        self._kept.clear()

    def _make(self, first: int, last: int, cancelled: threading.Event | None) -> Bricks:
        """The map from one level to another."""

        def run(piece: Piece, total: int) -> None:
            self._run(piece, total, LAYERS, cancelled)

        ends = float(self.levels[first]), float(self.levels[last])
        made = make_bricks(self._voxels, self._ranges, *ends, run)
        with self._lock:
            self._sizes[first, last] = made.nbytes
            while self._together() > self._most and self._width < len(self._asked):
                self._width += 1
        return made

    def _edges(self) -> np.ndarray:
        """Places of the groups' ends among the levels."""
        last = len(self._asked)
        return np.array([0, *range(1, last, self._width), last])

    def _together(self) -> int:
        """Bytes of the maps of all groups that were asked for, as far as their sizes are known."""
        edges, usual = self._edges().tolist(), USUAL * self._ranges[0].size
        asked = [ends for ends in pairwise(edges) if self._asked[slice(*ends)].any()]
        return sum(self._sizes.get(ends, usual) + OVERHEAD for ends in asked)
