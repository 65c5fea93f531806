"""The wide cells of a view: which of its points are read at half the lattice's density, and which ask for all of it.

A point is read from the wide cell about it, of two texels along each side, until the texels of its cell of one are as
good. These are asked for where the light that the wide cell's own eight bring differs by so much that interpolation is
expected to err by more than the target: the rest of the lattice is left out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from isogi_core.frame.finder import Finder, positions_of
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.planes import Planes
from isogi_core.kernels.wide import ask_texels, choose_cells, find_around, mark_wide, number_wide

COARSENESS = 0.2
"""Error of a pixel's light for each voxel of a wide cell's edge, over the spread of its texels' light.

Held against 2 % it has 39 to 71 % of the lights of a view baked, for 1.02 to 1.4 times the error of interpolation
(``docs/accuracy-lattice.md``).
"""


Picture = tuple[np.ndarray, Planes]
"""The pixels of points, (points,) uint32, and the planes that these are of."""


class Cells(NamedTuple):
    """Lattice cells that points are read from: ``corners`` (points, 8) numbers their texels, x fastest.

    ``wide`` (points,) says which of them have two texels along each side.
    """

    corners: np.ndarray
    wide: np.ndarray


@dataclass(frozen=True, eq=False)
class WideCells:
    """The wide cells that a view's points lie in: ``numbers`` (points,) of them, and ``corners`` (cells, 8) of texels.

    There are so many ``texels`` in the view.
    """

    numbers: np.ndarray
    corners: np.ndarray
    texels: int

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.numbers.nbytes + self.corners.nbytes

    @property
    def whole(self) -> Cells:
        """Those cells, point by point."""
        return Cells(self.corners[self.numbers], np.ones(len(self.numbers), np.bool_))

    def cells(self, narrow: np.ndarray, grade: np.ndarray, tiles: Tiles) -> Cells:
        """What points are read from: cells of one texel, ``narrow`` (points, 8), where their ``grade`` allows."""
        found = Cells(np.empty_like(narrow), np.empty(len(narrow), np.bool_))

        def _piece(a: int, b: int) -> None:
            choose_cells(narrow[a:b], self.numbers[a:b], self.corners, grade, *(each[a:b] for each in found))

        tiles.run(_piece, len(narrow), tiles.even(len(narrow)))
        return found

    def spread(self, kernel: Callable[..., None], tiles: Tiles) -> np.ndarray:
        """How much the light of each cell's texels differs, by a ``kernel`` of ``kernels.wide``; (cells,) float32."""
        found = np.empty(len(self.corners), np.float32)
        tiles.run(lambda a, b: kernel(self.corners[a:b], found[a:b]), len(found), tiles.even(len(found)))
        return found

    def ask(self, narrow: np.ndarray, cells: Cells, split: np.ndarray, picture: Picture, tiles: Tiles) -> np.ndarray:
        """Which texels a view wants where some cells are ``split`` (cells,); (texels,) bool.

        Its points were read from ``cells``. What is not final for want of ``narrow`` ones is marked in its picture.
        """
        asked = np.zeros(self.texels, np.bool_)
        pixels, planes = picture

        def _piece(a: int, b: int) -> None:
            place = (narrow[a:b], self.numbers[a:b], split, *(each[a:b] for each in cells), pixels[a:b])
            ask_texels(*place, planes, asked)

        tiles.run(_piece, len(narrow), tiles.even(len(narrow)))
        return asked


@dataclass(frozen=True, eq=False)
class Around:
    """Wide cells before a view's texels are numbered: their ``lowest`` (cells, 3; z, y, x) ones, and ``numbers``."""

    lowest: np.ndarray
    numbers: np.ndarray

    def numbered(self, finder: Finder, read: np.ndarray, first: np.ndarray) -> WideCells:
        """The cells with the numbers of their texels, which ``read`` marks; ``first`` are those of rows."""
        corners = np.empty((len(self.lowest), 8), np.uint32)
        find_around(finder.lattice, self.lowest, finder.slots, read, first, corners)
        return WideCells(self.numbers, corners, int(first[-1]))


def find_wide(finder: Finder) -> Around:
    """Find the wide cells that points lie in."""
    bits = finder.mark(mark_wide)
    first, places = finder.count(bits)
    numbers = np.empty(len(finder.points), np.uint32)
    finder.over_points(number_wide, lambda a, b: (finder.slots, bits, first, numbers[a:b]))
    return Around(positions_of(places, finder.indices, finder.lattice), numbers)
