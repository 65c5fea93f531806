"""Paths from points of a picture: where they start, and sums of what they bring by replicas that
show the noise.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from isogi_core.bake.refine import add_glow_paths, seeds_of, starts_at
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.surface_points import SurfacePoints, pool_noise
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.transport.matter.sight import START_BACK_VOXELS
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.model.environment import LUMINANCE_WEIGHTS


def path_starts(traced: TracedSurface, points: SurfacePoints, replicas: range) -> PathStarts:
    """Where paths of some ``replicas``, by number, start from the points of a picture: all of a
    point side by side.
    """
    each, replica = (part.ravel() for part in np.indices((len(points.pixels), len(replicas))))
    seeds = seeds_of(np.column_stack([points.pixels[each], replicas.start + replica]))
    return starts_at(points.points[each], points.normals[each], traced.isovalue, seeds)


def sight_lines(gbuffer: GBuffer) -> SurfacePoints:
    """Where the eye's rays are just before the points of a G-buffer, and their unit world ways as
    normals; float64.

    In glass rays soon part from those that start a rounding beside.
    """
    spacing = np.array(gbuffer.spacing)
    ways = (gbuffer.points - np.array(gbuffer.eye)) * spacing
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    along = ways / spacing
    before = gbuffer.points - START_BACK_VOXELS * along / np.abs(along).max(axis=1, keepdims=True)
    return SurfacePoints(before, ways, gbuffer.pixels)


def add_glow(
    sums: np.ndarray,
    light: RotatedLight,
    traced: TracedSurface,
    starts: PathStarts,
    rules: PathRules,
    samples: SampleRange,
) -> None:
    """Add a ``SampleRange`` of E/π of what glows at ``starts`` about a surface to ``sums`` (g, 3),
    where there is any.

    Bounces count as in ``light_in_room``, the first weight of the ``rules`` all.
    """
    prepared = light.spec.prepared
    if not prepared.scene.lighting.glowing.any:
        return
    radiances = light.glow * prepared.scene.lighting.glowing.radiances
    own = np.zeros((len(sums), radiances.size))
    add_glow_paths(prepared, traced.cells, light.seen.albedo, starts, samples, rules, own)
    sums += np.einsum("gkc,kc->gc", own.reshape(-1, *radiances.shape), radiances)


HALVES = 2
"""Independent randomisations, where neighbours tell of noise, too."""


@dataclass(frozen=True, eq=False)
class NoisyLight:
    """What rays bring to points of a picture: ``light`` (m, 3) linear RGB, and its luminance's
    ``variance`` (m,).
    """

    light: np.ndarray
    variance: np.ndarray

    @classmethod
    def of(cls, means: np.ndarray, gbuffer: GBuffer, tiles: Tiles) -> Self:
        """The light of halves' ``means`` (m, 1 or 2, 3); of a single half, neighbouring pixels give
        the noise.

        Raises Cancelled.
        """
        values = np.ascontiguousarray(means @ LUMINANCE_WEIGHTS)
        rows = gbuffer.rows
        variance = np.empty(len(means))

        def _piece(a: int, b: int) -> None:
            pool_noise(rows, gbuffer.pixels, a, values, variance[a:b])

        tiles.run(_piece, len(means), tiles.even(len(means)))
        return cls(means.mean(axis=1), variance)


@dataclass(frozen=True, eq=False)
class Estimate:
    """The ``sums`` (m, replicas, 3) of ``counts`` (m,) rays, or paths, of each replica from as many
    points.

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
        """The numbers of the rays that points take next: so many, one at least, and at most as many
        as there are.
        """
        count = self.most
        return range(count, count + min(max(rays, 1), count or 1))

    def noisy(self, variance: np.ndarray, allowed: float) -> np.ndarray:
        """Rows of the points that are to have more rays: none where the picture's noise is what is
        ``allowed``, a luminance; of points whose own ``variance`` (m,) is more.
        """
        if not len(variance) or float(variance.mean()) <= allowed**2:
            return np.empty(0, np.int64)
        return np.flatnonzero((variance > allowed**2) & (self.counts == self.most))

    def joined(self, places: np.ndarray, added: np.ndarray, last: int) -> "Estimate":
        """The sums with what was ``added`` (k, replicas, 3) to the points in ``places``: these have
        ``last`` rays.
        """
        found = replace(self, sums=self.sums.copy(), counts=self.counts.copy())
        found.sums[places] += added
        found.counts[places] = last
        return found
