"""The texels under a view: which chunks it touches, which texels it reads, and what of it is not baked yet."""

import math
import threading
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from isogi_core.bake.effort import Effort
from isogi_core.bake.recipe import Index, Recipe
from isogi_core.frame.finder import Finder, positions_of
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.wide import Cells, WideCells, find_wide
from isogi_core.kernels.chunks import find_corners, mark_texels, weigh_chunks
from isogi_core.kernels.footprints import add_footprints
from isogi_core.kernels.lattice import Lattice
from isogi_core.kernels.planes import Planes
from isogi_core.kernels.wide import mark_around

LEAST_SEEN = 1 / 16
"""Share of the mean footprint that every texel counts as at least."""


@dataclass(frozen=True, eq=False)
class Demand:
    """What a view wants of one chunk: the texels at ``offsets``, whose light is to become final.

    ``weight`` is the squared visible error of the pixels that read it (centre ones count more), ``effort`` what its
    texels have taken and will, and ``footprints`` how much of each is seen, see ``ViewTexels.footprints``.
    """

    index: Index
    offsets: np.ndarray
    weight: float
    effort: Effort
    footprints: np.ndarray

    def joined(self, other: "Demand") -> "Demand":
        """What this and ``other`` want of the chunk; texels of both are taken to be as those of one."""
        offsets = np.union1d(self.offsets, other.offsets)
        each = len(offsets) / (len(self.offsets) + len(other.offsets))
        sums = (each * (mine + theirs) for mine, theirs in zip(self.effort, other.effort, strict=True))
        unlit, taken, left = sums
        seen = most_seen(offsets, (self.offsets, self.footprints), (other.offsets, other.footprints))
        return Demand(self.index, offsets, self.weight + other.weight, Effort(math.ceil(unlit), taken, left), seen)


@dataclass(frozen=True, eq=False)
class ViewTexels:
    """The texels of a ``lattice`` that a G-buffer reads, numbered 0 … m - 1, chunk by chunk.

    ``chunks`` lists the chunks touched; texel t is at ``places[t]`` = i · texels of a chunk + offset, those
    of chunk i are ``bounds[i]`` … ``bounds[i + 1]``; ``corners`` (points, 8) numbers the texels around each point.
    Where the scene is adaptive texels of the ``wide`` cells that points lie in are among them, else there are none.
    """

    gbuffer: GBuffer
    lattice: Lattice
    chunks: tuple[Index, ...]
    places: np.ndarray
    bounds: np.ndarray
    corners: np.ndarray
    wide: WideCells | None = None

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, without its G-buffer; offsets and footprints are counted before they are found."""
        wide = 0 if self.wide is None else self.wide.nbytes
        return 3 * self.places.nbytes + self.bounds.nbytes + self.corners.nbytes + len(self.corners) + wide

    @property
    def positions(self) -> np.ndarray:
        """Lattice indices (m, 3; z, y, x) int32 of the texels."""
        return positions_of(self.places, np.array(self.chunks, np.int32).reshape(-1, 3), self.lattice)

    @cached_property
    def narrow(self) -> Cells:
        """The cells of one texel that points lie in."""
        return Cells(self.corners, np.zeros(len(self.corners), np.bool_))

    @cached_property
    def offsets(self) -> tuple[np.ndarray, ...]:
        """Where in its chunk each texel is, chunk by chunk; (m,) int32 each."""
        offsets = (self.places % self.lattice.texels).astype(np.int32)
        return tuple(offsets[a:b] for a, b in pairwise(self.bounds.tolist()))

    @cached_property
    def footprints(self) -> tuple[np.ndarray, ...]:
        """What each texel's variance counts in the sum of the pixels', chunk by chunk; (m,) float32 each.

        It is the sum of the squares of a texel's shares in them, see ``add_footprints``; where there are wide cells, in
        pictures that are read from these and in others alike. One that is hardly seen counts as LEAST_SEEN of the mean,
        for it is to become final too.
        """
        seen = np.zeros(len(self.places))
        for cells in (self.narrow,) if self.wide is None else (self.narrow, self.wide.whole):
            add_footprints(self.lattice, self.gbuffer.points, *cells, seen)
        seen = np.maximum(seen, LEAST_SEEN * seen.mean()).astype(np.float32)
        return tuple(seen[a:b] for a, b in pairwise(self.bounds.tolist()))

    def read(self, wide: np.ndarray) -> np.ndarray:
        """The texels that points read where some were read ``wide`` (points,); (points, 8), as ``corners``."""
        if self.wide is None:
            return self.corners
        return np.where(wide[:, None], self.wide.corners[self.wide.numbers], self.corners)

    def weights(self, planes: Planes, wide: np.ndarray) -> np.ndarray:
        """The squared visible error that the pixels of a picture have left in each chunk, see ``weigh_chunks``.

        Some of them were read ``wide`` (points,).
        """
        weight = np.zeros(len(self.chunks))
        height, width = self.gbuffer.shape
        weigh_chunks(self.lattice, self.read(wide), self.places, self.gbuffer.pixels, width, height, planes, weight)
        return weight


def find_texels(gbuffer: GBuffer, recipe: Recipe, tiles: Tiles, cancelled: threading.Event | None) -> ViewTexels:
    """Collect the texels around every surface point of ``gbuffer``."""
    finder = Finder(gbuffer.points, recipe, tiles, cancelled)
    read, around = finder.mark(mark_texels), None
    if recipe.scene.adaptive:
        around = find_wide(finder)
        mark_around(recipe.lattice, around.lowest, finder.slots, read)
    first, places = finder.count(read)
    corners = np.empty((len(gbuffer.points), 8), np.uint32)
    finder.over_points(find_corners, lambda a, b: (finder.slots, read, first, corners[a:b]))
    chunks = tuple((z, y, x) for z, y, x in finder.indices.tolist())
    wide = None if around is None else around.numbered(finder, read, first)
    return ViewTexels(gbuffer, recipe.lattice, chunks, places, first[:: recipe.lattice.rows].copy(), corners, wide)


def most_seen(offsets: np.ndarray, *views: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The footprints of the texels at ``offsets`` in that of several views, (offsets, footprints), that sees most."""
    seen = np.zeros(len(offsets), np.float32)
    for own, footprints in views:
        at = np.searchsorted(offsets, own)
        seen[at] = np.maximum(seen[at], footprints)
    return seen
