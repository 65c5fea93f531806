"""Normals of texels: at their positions, which all views share, and on the isosurface of one
view.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.texel_normals import (
    fill_texel_normals,
    keep_normals,
    look_up_normals,
)
from isogi_core.prepared.prepared_scene import PreparedScene

TEXELS_A_PIECE = 4096
"""Texels whose normals one thread finds in one go."""


MAX_TABLE_TEXELS = 1 << 21
"""Largest number of texels in a table."""


ENTRY = 20
"""Bytes of a texel in the table: 8 for its number, and 12 for its normal."""


class LatticeNormals:
    """A hash table of the outward unit world normals of a lattice's texels at their positions. No
    isovalue, camera or light changes these, so all views share it.

    Safe to use from many threads.
    """

    def __init__(self, budget: int) -> None:
        """Make a table of at most ``budget`` bytes, or of one entry if the budget is smaller than
        that. It is allocated when the first normals are asked for.
        """
        # The number of entries is the largest power of two that fits, so that a mask of bits takes
        # hashes to places.
        fitting = max(budget // ENTRY, 1)
        self._room = min(1 << (fitting.bit_length() - 1), MAX_TABLE_TEXELS)
        # Fuller tables are slow to search.
        self._full = self._room // 2
        self._held = 0
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """The size of the table in bytes."""
        if "_keys" in vars(self):
            return self._room * ENTRY
        return 0

    @cached_property
    def _keys(self) -> np.ndarray:
        """The number of the texel in each entry plus one, 0 in an empty one; (entries,) uint64."""
        return np.zeros(self._room, np.uint64)

    @cached_property
    def _normals(self) -> np.ndarray:
        """The normal in each entry; (entries, 3)."""
        return np.empty((self._room, 3), np.float32)

    def of(
        self, numbers: np.ndarray, find: Callable[[np.ndarray], np.ndarray], tiles: Tiles
    ) -> np.ndarray:
        """Return the normals of the texels with the distinct ``numbers`` (m,) uint64; (m, 3)
        float32.

        ``find`` computes those that the table lacks: it takes their rows in ``numbers``, and
        returns their normals. As many of these as fit are kept for the next call. Raises Cancelled.
        """
        normals = np.empty((len(numbers), 3), np.float32)
        found = np.empty(len(numbers), np.bool_)

        def _piece(a: int, b: int) -> None:
            look_up_normals(numbers[a:b], *table, normals[a:b], found[a:b])

        with self._lock:
            # Look up all texels in parallel, then compute together those that the table lacks.
            table = self._keys, self._normals
            tiles.run(_piece, len(numbers), TEXELS_A_PIECE)
            new = np.flatnonzero(~found)
            if len(new):
                normals[new] = find(new)
                self._keep(numbers[new[: self._full]], normals[new[: self._full]])
        return normals

    def _keep(self, numbers: np.ndarray, normals: np.ndarray) -> None:
        """Put new ``normals`` into the table; empty it before if it would become too full."""
        if self._held + len(numbers) > self._full:
            self._keys[:] = 0
            self._held = 0
        keep_normals(numbers, normals, self._keys, self._normals)
        self._held += len(numbers)


@dataclass(eq=False)
class TexelNormals:
    """Outward unit world normals of a view's texels: ``at_positions`` (texels, 3) float32 those at
    their positions.

    Projected texels are lit at a point of the view's isosurface instead: their normals there are
    found when they are first asked for.
    """

    at_positions: np.ndarray
    _on_surface: np.ndarray = field(repr=False)
    _known: np.ndarray = field(repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.at_positions.nbytes + self._on_surface.nbytes + self._known.nbytes

    def select(
        self, projected: np.ndarray, texels: ViewTexels, prepared: PreparedScene, tiles: Tiles
    ) -> np.ndarray:
        """Return the normal at the point at which each of the view's ``texels`` was lit: on its
        isosurface for those that are ``projected`` (texels,) bool, at their positions for all
        others; (texels, 3) float32. Raises Cancelled.
        """
        if not projected.any():
            return self.at_positions
        with self._lock:
            # Find the normals on the surface that no earlier call has found.
            new = np.flatnonzero(projected & ~self._known)
            self._on_surface[new] = normals_of(texels, texels.places[new], True, prepared, tiles)
            self._known[new] = True
            return np.where(projected[:, None], self._on_surface, self.at_positions)


def find_texel_normals(
    texels: ViewTexels, known: LatticeNormals, prepared: PreparedScene, tiles: Tiles
) -> TexelNormals:
    """Return the normals of a view's texels at their positions, looking them up in ``known``."""
    normals = normals_at_positions(texels, texels.places, known, prepared, tiles)
    return TexelNormals(normals, np.zeros_like(normals), np.zeros(len(normals), np.bool_))


def normals_at_positions(
    texels: ViewTexels,
    places: np.ndarray,
    known: LatticeNormals,
    prepared: PreparedScene,
    tiles: Tiles,
) -> np.ndarray:
    """Return the normals of the texels at some ``places`` (k,), looking them up in ``known``;
    (k, 3) float32.
    """
    numbers = texels.numbers(places)
    return known.of(
        numbers, lambda new: normals_of(texels, places[new], False, prepared, tiles), tiles
    )


def nearby_normals(texels: ViewTexels, tiles: Tiles) -> np.ndarray:
    """Return for each texel of a view the normal of a surface point that reads it, (texels, 3)
    float32.

    Unshadowed light makes the same picture about any normals, and these are at hand.
    """
    normals = np.empty((len(texels.places), 3), np.float32)
    normals[texels.corners] = texels.gbuffer.normals(tiles)[:, None]
    return normals


def normals_of(
    texels: ViewTexels, places: np.ndarray, projected: bool, prepared: PreparedScene, tiles: Tiles
) -> np.ndarray:
    """Find the normals of a view's texels at ``places`` (k,), on its isosurface if they are
    ``projected``; (k, 3) float32.
    """
    normals = np.empty((len(places), 3), np.float32)
    level = texels.gbuffer.isovalue
    positions = texels.positions_of(places)

    def _piece(a: int, b: int) -> None:
        fill_texel_normals(
            prepared.field, prepared.step, level, projected, positions[a:b], normals[a:b]
        )

    tiles.run(_piece, len(places), TEXELS_A_PIECE)
    return normals
