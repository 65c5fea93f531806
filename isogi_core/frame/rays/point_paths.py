"""Paths from points of a picture: where they start, and sums of their light by replicas, which
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
    """Return the starts of paths of some ``replicas``, by number, from the points of a picture:
    all replicas of a point in turn.
    """
    each, replica = (part.ravel() for part in np.indices((len(points.pixels), len(replicas))))
    seeds = seeds_of(np.column_stack([points.pixels[each], replicas.start + replica]))
    return starts_at(points.points[each], points.normals[each], traced.isovalue, seeds)


def sight_lines(gbuffer: GBuffer) -> SurfacePoints:
    """Return the eye's rays as starts of paths through glass: points START_BACK_VOXELS before those
    of a G-buffer, with the unit world directions of the rays in place of normals; float64.

    Rays through glass diverge so fast that a rounding error of their start shows: paths must meet
    the surface by the rays that filled the G-buffer.
    """
    spacing = np.array(gbuffer.spacing)
    directions = (gbuffer.points - np.array(gbuffer.eye)) * spacing
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # Step back in index space, where the largest component counts voxels.
    steps = directions / spacing
    before = gbuffer.points - START_BACK_VOXELS * steps / np.abs(steps).max(axis=1, keepdims=True)
    return SurfacePoints(before, directions, gbuffer.pixels)


def add_glow(
    sums: np.ndarray,
    light: RotatedLight,
    traced: TracedSurface,
    starts: PathStarts,
    rules: PathRules,
    samples: SampleRange,
) -> None:
    """Trace a ``SampleRange`` of paths that gather glow at ``starts`` about a surface, and add
    their E/π to ``sums`` (g, 3); do nothing if nothing glows.

    The weights of the ``rules`` count bounces as in ``light_in_room``.
    """
    prepared = light.spec.prepared
    if not prepared.scene.lighting.glowing.any:
        return
    radiances = light.glow * prepared.scene.lighting.glowing.radiances
    # Paths gather each glow as if of radiance 1, so that its strength and colour come last.
    gathered = np.zeros((len(sums), radiances.size))
    add_glow_paths(prepared, traced.cells, light.seen.albedo, starts, samples, rules, gathered)
    sums += np.einsum("gkc,kc->gc", gathered.reshape(-1, *radiances.shape), radiances)


HALVES = 2
"""Number of independent randomisations if neighbours show noise, too."""


@dataclass(frozen=True, eq=False)
class NoisyLight:
    """Light that rays bring to points of a picture: ``light`` (m, 3) linear RGB, and the
    ``variance`` (m,) of its luminance.
    """

    light: np.ndarray
    variance: np.ndarray

    @classmethod
    def of(cls, means: np.ndarray, gbuffer: GBuffer, tiles: Tiles) -> Self:
        """Return the light by the ``means`` (m, 1 or 2, 3) of halves; if there is one half,
        neighbouring pixels show the noise.

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
    """The ``sums`` (m, replicas, 3) of the light of rays, or paths, from m points; ``counts`` (m,)
    are their numbers in each replica.

    The numbers differ while points with fewer catch up with the others, or if points whose noise is
    small, or whose rays are from another view, take no more.
    """

    sums: np.ndarray
    counts: np.ndarray

    @classmethod
    def none(cls, points: int, replicas: int = HALVES) -> "Estimate":
        """Return an estimate without rays from ``points`` points."""
        return cls(np.zeros((points, replicas, 3)), np.zeros(points, np.int64))

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.sums.nbytes + self.counts.nbytes

    def part(self, rows: np.ndarray) -> "Estimate":
        """Return the estimate of the points in these ``rows``, numbers or a mask."""
        return Estimate(self.sums[rows], self.counts[rows])

    @property
    def most(self) -> int:
        """The largest number of rays of each replica from any point."""
        return int(self.counts.max(initial=0))

    @property
    def fewest(self) -> int:
        """The smallest number of rays of each replica from any point; 0 if there are no points."""
        return int(self.counts.min()) if len(self.counts) else 0

    @property
    def unequal(self) -> bool:
        """True if some points have fewer rays than others."""
        return self.fewest < self.most

    @property
    def version(self) -> bytes:
        """A name of the rays that were cast."""
        return repr(int(self.counts.sum())).encode()

    @property
    def means(self) -> np.ndarray:
        """The mean light of a ray of each replica; (m, replicas, 3)."""
        return np.asarray(self.sums / np.maximum(self.counts, 1)[:, None, None])

    def next(self, rays: int) -> range:
        """Return the numbers of the rays that points take next: ``rays`` of them, at least one,
        and at most as many as there are.
        """
        count = self.most
        return range(count, count + min(max(rays, 1), count or 1))

    def noisy(self, variance: np.ndarray, allowed: float) -> np.ndarray:
        """Return the rows of the points that are to have more rays: none if the root of the
        mean ``variance`` (m,) is at most ``allowed``, a luminance; else points with more than
        that.
        """
        if not len(variance) or float(variance.mean()) <= allowed**2:
            return np.empty(0, np.int64)
        return np.flatnonzero((variance > allowed**2) & (self.counts == self.most))

    def joined(self, places: np.ndarray, added: np.ndarray, last: int) -> "Estimate":
        """Return the sums with the light ``added`` (k, replicas, 3) to the points in rows
        ``places``, which have ``last`` rays then.
        """
        found = replace(self, sums=self.sums.copy(), counts=self.counts.copy())
        found.sums[places] += added
        found.counts[places] = last
        return found
