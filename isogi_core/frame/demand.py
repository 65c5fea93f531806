"""Demands: the texels of one chunk whose light a picture still needs, and how much they count
in it.
"""

import math
from dataclasses import dataclass

import numpy as np

from isogi_core.bake.noise import Effort
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index


@dataclass(frozen=True, eq=False)
class Demand:
    """Texels of one chunk whose light is to become final for a view.

    - ``index``: the chunk.
    - ``offsets`` (k,) int32: places of the texels in the chunk, ascending.
    - ``weight``: squared visible error of the pixels that read the chunk; central ones count more.
    - ``effort``: samples that its texels have taken and will take.
    - ``footprints`` (k,) float32: how much of each texel is seen, see ``ViewTexels.footprints``.
    - ``shown``: isosurface that the texels are projected onto; None if they lie on their own.
    - ``bits``: the chunk has 1 << ``bits`` texels along each side; 0 if all of them are to have
      their first light together, see ``first_texels``.
    """

    index: Index
    offsets: np.ndarray
    weight: float
    effort: Effort
    footprints: np.ndarray
    shown: Isovalue | None = None
    bits: int = 0

    def joined(self, other: "Demand") -> "Demand":
        """Return the demand of two views for the same chunk.

        The effort counts texels that both demand once: it is scaled by the share of distinct
        texels.
        """
        offsets = np.union1d(self.offsets, other.offsets)
        # Texels that both views demand are counted twice in the sum of the efforts.
        share = len(offsets) / (len(self.offsets) + len(other.offsets))
        unlit, *rest = (
            share * (mine + theirs) for mine, theirs in zip(self.effort, other.effort, strict=True)
        )
        seen = most_seen(
            offsets, (self.offsets, self.footprints), (other.offsets, other.footprints)
        )
        effort = Effort(math.ceil(unlit), *rest)
        return Demand(
            self.index, offsets, self.weight + other.weight, effort, seen, self.shown, self.bits
        )


def first_texels(offsets: np.ndarray, bits: int) -> np.ndarray:
    """Mark the texels at ``offsets`` that get light first: those whose indices z, y and x are all
    even or all odd; (m,) bool.

    They form a body-centred lattice: each cell has two of them among its corners, so every other
    texel has neighbours with light.
    """
    z, y, x = (offsets >> bits * axis & 1 for axis in (2, 1, 0))
    return np.asarray((z == y) & (y == x))


def most_seen(offsets: np.ndarray, *views: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the largest footprint of each texel at ``offsets`` in any of several ``views``,
    each given as (offsets, footprints); (m,) float32. The ``offsets`` ascend, and contain those of
    each view.
    """
    seen = np.zeros(len(offsets), np.float32)
    for offsets_of_view, footprints in views:
        at = np.searchsorted(offsets, offsets_of_view)
        seen[at] = np.maximum(seen[at], footprints)
    return seen
