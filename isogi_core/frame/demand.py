"""Demands: the texels of one chunk whose light a picture still needs, and how urgent it is."""

import math
from dataclasses import dataclass

import numpy as np

from isogi_core.bake.noise import Effort
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Index


@dataclass(frozen=True, eq=False)
class Demand:
    """What a view wants of one chunk: the texels at ``offsets``, whose light is to become final.

    ``weight`` is the squared visible error of the pixels that read it (centre ones count more),
    ``effort`` what its texels have taken and will, and ``footprints`` how much of each is seen, see
    ``ViewTexels.footprints``. Where an isosurface is ``shown``, the texels are projected onto it. A
    chunk has 1 << ``bits`` texels a side; 0 where all of them are to have their first light
    together, see ``first_texels``.
    """

    index: Index
    offsets: np.ndarray
    weight: float
    effort: Effort
    footprints: np.ndarray
    shown: Isovalue | None = None
    bits: int = 0

    def joined(self, other: "Demand") -> "Demand":
        """What this and ``other`` want of the chunk; texels of both are taken to be as those of
        one.
        """
        offsets = np.union1d(self.offsets, other.offsets)
        each = len(offsets) / (len(self.offsets) + len(other.offsets))
        sums = (
            each * (mine + theirs) for mine, theirs in zip(self.effort, other.effort, strict=True)
        )
        unlit, *rest = sums
        seen = most_seen(
            offsets, (self.offsets, self.footprints), (other.offsets, other.footprints)
        )
        effort = Effort(math.ceil(unlit), *rest)
        return Demand(
            self.index, offsets, self.weight + other.weight, effort, seen, self.shown, self.bits
        )


def first_texels(offsets: np.ndarray, bits: int) -> np.ndarray:
    """Which texels at ``offsets`` have light first: those whose indices z, y, x are all even or all
    odd; (m,) bool.

    Of the corners of each cell that is one each, so that all others have neighbours in light: a
    body-centred lattice.
    """
    z, y, x = (offsets >> bits * axis & 1 for axis in (2, 1, 0))
    return np.asarray((z == y) & (y == x))


def most_seen(offsets: np.ndarray, *views: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The footprints of the texels at ``offsets`` in that of several views, (offsets, footprints),
    that sees most.
    """
    seen = np.zeros(len(offsets), np.float32)
    for own, footprints in views:
        at = np.searchsorted(offsets, own)
        seen[at] = np.maximum(seen[at], footprints)
    return seen
