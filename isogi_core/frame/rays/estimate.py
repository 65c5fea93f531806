"""Sums of rays and paths from the points of a picture, by independent replicas that tell their noise."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.surface_points import pool_noise
from isogi_core.model.environment import LUMINANCE_WEIGHTS

HALVES = 2
"""Independent randomisations, where neighbours tell of noise, too."""


@dataclass(frozen=True, eq=False)
class NoisyLight:
    """What rays bring to points of a picture: ``light`` (m, 3) linear RGB, and its luminance's ``variance`` (m,)."""

    light: np.ndarray
    variance: np.ndarray

    @classmethod
    def of(cls, means: np.ndarray, gbuffer: GBuffer, tiles: Tiles) -> Self:
        """The light of halves' ``means`` (m, 1 or 2, 3); of a single half, neighbouring pixels give the noise.

        Raises Cancelled.
        """
        values, rows, variance = np.ascontiguousarray(means @ LUMINANCE_WEIGHTS), gbuffer.rows, np.empty(len(means))

        def _piece(a: int, b: int) -> None:
            pool_noise(rows, gbuffer.pixels, a, values, variance[a:b])

        tiles.run(_piece, len(means), tiles.even(len(means)))
        return cls(means.mean(axis=1), variance)


@dataclass(frozen=True, eq=False)
class Estimate:
    """The ``sums`` (m, replicas, 3) of ``counts`` (m,) rays, or paths, of each replica from as many points.

    Points whose noise is small enough take no more: the others have as many rays as any.
    """

    sums: np.ndarray
    counts: np.ndarray

    @classmethod
    def none(cls, points: int, replicas: int = HALVES) -> "Estimate":
        """No rays from so many points."""
        return cls(np.zeros((points, replicas, 3)), np.zeros(points, np.int64))

    @property
    def nbytes(self) -> int:
        """Bytes that they take."""
        return self.sums.nbytes + self.counts.nbytes

    @property
    def most(self) -> int:
        """The most rays of each replica that any point has."""
        return int(self.counts.max(initial=0))

    @property
    def version(self) -> bytes:
        """Names the rays that were cast."""
        return repr(int(self.counts.sum())).encode()

    @property
    def means(self) -> np.ndarray:
        """What a ray of each replica brings on the average; (m, replicas, 3)."""
        return np.asarray(self.sums / np.maximum(self.counts, 1)[:, None, None])

    def next(self, rays: int) -> range:
        """The numbers of the rays that points take next: so many, one at least, and at most as many as there are."""
        count = self.most
        return range(count, count + min(max(rays, 1), count or 1))

    def noisy(self, variance: np.ndarray, allowed: float) -> np.ndarray:
        """Rows of the points that are to have more rays: none where the picture's noise is what is ``allowed``, a
        luminance; of points whose own ``variance`` (m,) is more.
        """
        if not len(variance) or float(variance.mean()) <= allowed**2:
            return np.empty(0, np.int64)
        return np.flatnonzero((variance > allowed**2) & (self.counts == self.most))

    def joined(self, places: np.ndarray, added: np.ndarray, last: int) -> "Estimate":
        """The sums with what was ``added`` (k, replicas, 3) to the points in ``places``: these have ``last`` rays."""
        found = replace(self, sums=self.sums.copy(), counts=self.counts.copy())
        found.sums[places] += added
        found.counts[places] = last
        return found
