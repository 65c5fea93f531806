"""Texels of walls: a lattice on each side of a wall, lit for the isovalue that is shown.

The first texels are few and coarse. If interpolation is the larger part of their error, as at edges
of shadows and in caustics, twice as many along each axis replace them there, and twice as many
again.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from isogi_core.bake.bake_spec import path_weights
from isogi_core.bake.refine import add_paths, seeds_of, starts_at, starts_between
from isogi_core.bake.texel_light import round_light
from isogi_core.cache.wall_store import Planes, Side, planes_of, wall_layer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.pixel_filter import beyond_noise
from isogi_core.frame.rays.pixel_rays import BINOMIAL, PATH_POINTS
from isogi_core.frame.rays.point_paths import add_glow
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.transport import streams
from isogi_core.kernels.transport.matter.matter_paths import Through
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.prepared.prepared_scene import Surface

COARSE_WALL_TEXELS = 16
FINE_WALL_TEXELS = 64
MAX_WALL_TEXELS = 256
"""Texels along the longest edge of any wall: of the first picture, of all others, and at most."""

EDGY = 1.0 / 12.0
"""Variance by interpolation next to an edge, over the squared second differences of the texels'
light.

For an edge of height h anywhere between two texels, the squares of the second differences sum to 2
h², and a ramp in place of the edge has the mean squared error h² / 6. Where light is smooth the
error is a tenth of this.
"""

NOISE_IN_BENDS = 0.25
"""Share of the variance by noise below which variance by interpolation may be noise alone: on even
light, second differences show 0.2 of it, as they cannot be negative.
"""

BLUR = BINOMIAL / BINOMIAL.sum()
"""Weights of texels from two before one to two after it."""

FILTER_STEPS = ((1, 1.0), (2, 2.7))
"""For each pass of the filter, the distance in texels between those that it mixes; and by how much
the variance of their mean is larger than that of independent ones, on even light.
"""

FIRST_PATHS = 8
MAX_PATHS = 1 << 12
"""Paths of each half of a texel at first, and at most."""


def light_starts(
    light: RotatedLight,
    surface: Surface,
    starts: PathStarts,
    rules: PathRules,
    samples: SampleRange,
    tiles: Tiles,
) -> np.ndarray:
    """Trace a ``SampleRange`` of paths from ``starts`` about a ``surface``; return sums (g, 3) of
    E/π, of glow, too. See ``add_paths``.

    Raises Cancelled.
    """
    traced = surface.traced(tiles.run)
    sums = np.zeros((len(starts.seeds), 3))
    prepared = light.spec.prepared
    met = prepared.met(light.seen.albedo, traced.cells, tiles.run)

    def _piece(a: int, b: int) -> None:
        some = starts_between(starts, a, b)
        add_paths(met, some, samples, rules, light.surroundings, sums[a:b])
        # No glow is gathered in scenes of matter that light passes.
        if not isinstance(met, Through):
            add_glow(sums[a:b], light, traced, some, rules, samples)

    tiles.run(_piece, len(sums), PATH_POINTS)
    return sums


@dataclass(frozen=True, eq=False)
class WallTexels:
    """Texels on one side of a wall.

    - ``wall``: number of the wall; ``side``: 1 for its front, -1 for its back.
    - ``albedo`` (3,), ``radiance`` (3,): reflected share, and emitted light, of the wall.
    - ``means`` (rows, columns, 2, 3): E/π by two halves of ``count`` paths; rows are along the
      second edge of the wall.
    - ``across``: number of texels along the longest edge of any wall.
    - ``settled`` (rows, columns): NaN for texels that paths start from, which are ``asked``. All
      others are interpolated from coarser texels; it is the variance that interpolation had there.
    - ``made_of``: name of the texels that these were mixed of, from two other isovalues; empty if
      they have paths of their own.
    - ``moved`` (rows, columns): variance that mixing adds, as light changes between the isovalues;
      None if they are not mixed.
    """

    wall: int
    side: int
    albedo: np.ndarray
    radiance: np.ndarray
    means: np.ndarray
    across: int
    settled: np.ndarray
    count: int = 0
    made_of: str = ""
    moved: np.ndarray | None = None

    @classmethod
    def begun(cls, light: RotatedLight, wall: int, side: int, across: int) -> "WallTexels":
        """Return texels without paths, ``across`` of them along the longest edge of any wall,
        and as dense on all others.
        """
        room = light.spec.prepared.room(light.seen.albedo)
        edges = np.linalg.norm(room.edges, axis=2)
        sizes = np.maximum(np.ceil(across * edges[wall] / edges.max()), 2)
        columns, rows = sizes.astype(int).tolist()
        means = np.zeros((rows, columns, 2, 3))
        settled = np.full((rows, columns), np.nan)
        return cls(wall, side, room.albedos[wall], room.radiances[wall], means, across, settled)

    @classmethod
    def restored(
        cls, light: RotatedLight, side: Side, kept: Mapping[int, Planes]
    ) -> "WallTexels | None":
        """Return the texels on a ``side`` of a wall that were ``kept``, as fine as these are; None
        if none were.

        ``kept`` is by the number of texels across. Where finer texels were not asked, coarser ones
        are interpolated.
        """
        found: WallTexels | None = None
        # Go from coarse to fine: at each fineness, kept texels replace those that are interpolated
        # from the coarser ones.
        for across, (means, counts) in sorted(kept.items()):
            begun = cls.begun(light, *side, across)
            rows, columns = begun.settled.shape
            there = planes_of(side), slice(rows), slice(columns)
            asked = counts[there][0] > 0
            # The coarsest texels must be complete; finer ones may be in parts.
            if not asked.any() or (found is None and not asked.all()):
                break
            if found is not None:
                begun = found.finer(light, asked)
            some = np.where(asked[..., None, None], np.moveaxis(means[there], 0, 2), begun.means)
            found = replace(begun, means=some, count=int(counts[there].max()))
        return found

    @property
    def fine(self) -> bool:
        """True if the texels are as fine as those that stay."""
        return self.across >= FINE_WALL_TEXELS

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes, those found later included."""
        return 2 * self.means.nbytes

    @property
    def paths(self) -> int:
        """The number of paths of both halves that were traced from these texels."""
        return 2 * self.count * int(self.asked.sum())

    @property
    def version(self) -> str:
        """A name of the texels' light, for the versions of pictures that show it: another one as
        soon as paths are added.
        """
        if self.made_of:
            return self.made_of
        # Texels of the usual density are named by their paths alone, others by both numbers.
        if self.across == FINE_WALL_TEXELS:
            return f"-{self.count:x}"
        return f"-{self.count:x}a{self.across:x}"

    @cached_property
    def variance(self) -> np.ndarray:
        """Variance by noise of the luminance that leaves each texel, pooled with its
        neighbours; (rows, columns).
        """
        halves = self.means @ (LUMINANCE_WEIGHTS * self.albedo)
        return pooled(((halves[..., 0] - halves[..., 1]) / 2.0) ** 2)

    @cached_property
    def unsharp(self) -> np.ndarray:
        """Variance by interpolation of the luminance between texels; (rows, columns).

        It is estimated from second differences. At an edge, those between next texels are half as
        large as those between texels two apart; if they are smaller, light is smoother than an
        edge.
        """
        near = self._bends(1)
        far = self._bends(2)
        found = EDGY * near * np.minimum(2.0 * near / np.maximum(far, 1e-30), 1.0)
        return np.where(self.asked, found, self.settled)

    def _bends(self, step: int) -> np.ndarray:
        """Return the squared second differences of light between texels ``step`` apart, along
        both axes, less those that noise makes.
        """
        light = self.luminance
        found = np.zeros(self.settled.shape)
        for axis in (0, 1):
            if light.shape[axis] > 2 * step:
                low, here, high = (
                    light.take(np.arange(k * step, light.shape[axis] - (2 - k) * step), axis)
                    for k in range(3)
                )
                # Second differences of independent noise have 1 + 4 + 1 times its variance.
                ends = [(step * int(a == axis),) * 2 for a in range(2)]
                found += np.pad((low - 2.0 * here + high) ** 2, ends) - 6.0 * self.variance
        return np.maximum(pooled(found), 0.0)

    @property
    def asked(self) -> np.ndarray:
        """Mark the texels that paths start from; (rows, columns) bool."""
        return np.isnan(self.settled)

    @property
    def luminance(self) -> np.ndarray:
        """The luminance that the wall reflects at each texel; (rows, columns)."""
        return np.asarray(self.means.mean(axis=2) @ (LUMINANCE_WEIGHTS * self.albedo))

    def relative(self, variance: np.ndarray) -> float:
        """Return the relative error of all texels together with a ``variance`` (rows, columns);
        0 if no light arrives.
        """
        mean = float(self.luminance.mean())
        if mean > 0.0:
            return math.sqrt(float(variance.mean())) / mean
        return 0.0

    @property
    def error(self) -> float:
        """The relative error of all texels together, by noise, interpolation and mixing."""
        return self.relative(self._all_variance)

    @property
    def _all_variance(self) -> np.ndarray:
        """Variance of the luminance of each texel by noise, interpolation and mixing; (rows,
        columns).
        """
        if self.moved is None:
            return self.variance + self.unsharp
        return self.variance + self.unsharp + self.moved

    def final(self, target: float) -> bool:
        """Return True if their error is within a ``target``, or as small as it can become."""
        return (
            self.fine
            and self.count > 0
            and self.has_enough_paths(target)
            and not self.too_coarse(target)
        )

    def has_enough_paths(self, target: float) -> bool:
        """Return True if their noise is within a ``target``, or if they have all paths that
        they may take.
        """
        return self.count >= MAX_PATHS or self.relative(self.variance) <= target

    def too_coarse(self, target: float) -> bool:
        """Return True if interpolation has a larger error than noise, and more than half of a
        ``target``; finer texels would help then.
        """
        if not FINE_WALL_TEXELS <= self.across < MAX_WALL_TEXELS:
            return False
        if self.unsharp.mean() <= self.variance.mean():
            return False
        return self.relative(self.unsharp) > 0.5 * target

    def steps_left(self, target: float) -> list[float]:
        """Return the number of paths that each step (see ``nearer``) still ahead will trace, in
        both halves, until the texels are final at a ``target``.

        Noise falls with the square root of the number of paths. Along an edge, twice as fine texels
        are twice as many, and halve the variance by interpolation. Edges that the noise of the
        first paths hides are not foreseen.
        """
        noise = self.relative(self.variance)
        # Interpolation is known as far as second differences show more than noise.
        unsharp = self.unsharp - NOISE_IN_BENDS * self.variance
        blur = self.relative(np.maximum(unsharp.mean(), 0.0))
        asked = float(self.asked.sum())
        count = self.count
        across = self.across
        steps = list[float]()
        # Fine texels begin with the first paths.
        if not self.fine:
            asked *= (FINE_WALL_TEXELS / across) ** 2
            blur *= (across / FINE_WALL_TEXELS) ** 0.5
            across = FINE_WALL_TEXELS
            count = FIRST_PATHS
            steps.append(2.0 * asked * count)
        # Their paths double until their noise is within the target.
        while noise > target and count < MAX_PATHS:
            steps.append(2.0 * asked * count)
            noise *= 0.5**0.5
            count *= 2
        # Finer texels replace those at edges, and take as many paths each.
        edgy = unsharp.size - self._smooth_texels(
            np.sort(np.maximum(unsharp, 0.0), axis=None), target
        )
        while across < MAX_WALL_TEXELS and blur > max(noise, 0.5 * target):
            asked = 4.0 * edgy * across / self.across
            blur *= 0.5**0.5
            across *= 2
            steps.append(2.0 * asked * count)
        return steps

    def nearer(
        self, light: RotatedLight, surface: Surface, target: float, tiles: Tiles
    ) -> "WallTexels":
        """Return the texels a step nearer to a ``target``: fine ones, more paths, or twice as
        fine ones. Raises Cancelled.
        """
        # Begin fine texels first, then reduce noise, then interpolation.
        if not self.fine:
            fine = WallTexels.begun(light, self.wall, self.side, FINE_WALL_TEXELS)
            return fine.grown(light, surface, tiles)
        if not self.has_enough_paths(target):
            return self.grown(light, surface, tiles, self.count)
        finer = self.finer(light, self._unsharp_places(light, target))
        return finer.grown(light, surface, tiles, self.count)

    def _unsharp_places(self, light: RotatedLight, target: float) -> np.ndarray:
        """Mark those of the next finer texels, about twice as many along each axis, from which
        paths are to start; (finer rows, finer columns) bool.

        All others stay interpolated: the error of the wall by these together is below a quarter of
        the ``target``.
        """
        errors = np.sort(self.unsharp, axis=None)
        first = self._smooth_texels(errors, target)
        finer = WallTexels.begun(light, self.wall, self.side, 2 * self.across)
        return np.asarray(self.unsharp[self._near(finer)] >= errors[first])

    def _smooth_texels(self, errors: np.ndarray, target: float) -> int:
        """Return the number of texels that may stay as they are: those with the smallest of the
        ``errors`` (n,), variances by interpolation in ascending order, as long as their sum is
        allowed by the ``target``.

        The last texel never counts, so that a step changes something.
        """
        allowed = errors.size * (0.25 * target * float(self.luminance.mean())) ** 2
        return min(int(np.searchsorted(np.cumsum(errors), allowed)), errors.size - 1)

    def finer(self, light: RotatedLight, asked: np.ndarray) -> "WallTexels":
        """Return twice as many texels along each axis: dark if they are ``asked``, else
        interpolated from these.
        """
        finer = WallTexels.begun(light, self.wall, self.side, 2 * self.across)
        settled = np.where(asked, np.nan, self.unsharp[self._near(finer)])
        known = np.where(asked[..., None, None], 0.0, between(self.means, *self._places(finer)))
        return replace(finer, means=known, settled=settled)

    def _places(self, finer: "WallTexels") -> list[np.ndarray]:
        """Return the positions of the rows and the columns of ``finer`` texels, counted in
        those of these.
        """
        sizes = zip(finer.settled.shape, self.settled.shape, strict=True)
        return [(np.arange(a) + 0.5) * b / a - 0.5 for a, b in sizes]

    def _near(self, finer: "WallTexels") -> tuple[np.ndarray, ...]:
        """Return the index of the texels that are nearest to ``finer`` ones."""
        return np.ix_(*(np.rint(each).astype(int) for each in self._places(finer)))

    def mixed(self, other: "WallTexels", share: float, made_of: str) -> "WallTexels":
        """Interpolate between these texels and those at an ``other`` isovalue, which has this
        ``share``.

        Where the light differs, it is taken to change somewhere between the two, all at once. A
        mean of both then has the squared error share · (1 - share) times the squared difference
        (variance of Bernoulli's distribution).
        """
        means = (1.0 - share) * self.means + share * other.means
        # Take the noise of both out of their squared difference.
        apart = (self.luminance - other.luminance) ** 2 - self.variance - other.variance
        moved = share * (1.0 - share) * np.maximum(pooled(apart), 0.0)
        return replace(self, means=means, count=0, made_of=made_of, moved=moved)

    def grown(
        self, light: RotatedLight, surface: Surface, tiles: Tiles, more: int = FIRST_PATHS
    ) -> "WallTexels":
        """Return the texels after ``more`` paths of each half of those that are asked, rounded as
        the store keeps them.

        Raises Cancelled.
        """
        plan = light.spec.plan
        asked = self.asked
        count = self.count + more
        # Trace more samples of the same sequences, from the texels that are asked alone.
        rules = PathRules(path_weights(np.ones(3), plan.bounces, 1.0), plan.survival)
        starts = self._starts(light, surface)
        samples = SampleRange(self.count, more)
        added = light_starts(light, surface, starts, rules, samples, tiles).reshape(-1, 2, 3)
        means = self.means.copy()
        layer = wall_layer(light.spec.prepared.scene)
        # Update the running means, rounded as if they had been read from the store.
        updated = (means[asked] * self.count + added) / count
        means[asked] = round_light(updated[..., None], layer)[..., 0]
        return replace(self, means=means, count=count)

    def _starts(self, light: RotatedLight, surface: Surface) -> PathStarts:
        """Return the starts of the paths of both halves of each asked texel, row by row, with the
        two halves of a texel next to each other.
        """
        room = light.spec.prepared.room(light.seen.albedo)
        (rows, columns) = self.settled.shape
        row, column, half = np.nonzero(np.repeat(self.asked[..., None], 2, axis=2))
        # Start in the middle of each texel, on the side of these texels. Edges are lengths in the
        # world; paths start at points in voxels.
        edges = room.edges[self.wall]
        points = room.corners[self.wall] + np.outer((column + 0.5) / columns, edges[0])
        points += np.outer((row + 0.5) / rows, edges[1])
        points /= surface.field.spacing
        normals = np.tile(self.side * room.normals[self.wall], (len(points), 1))
        # Wall, side, row, column and half select the random sequence, so that further paths
        # continue it.
        words = np.column_stack(
            [
                np.full(len(row), streams.WALLS_STREAM + 2 * self.wall + (self.side < 0)),
                row,
                column,
                half,
            ]
        )
        # The number of the wall tells that the starts are on it: without one they would be moved
        # off the isosurface.
        return starts_at(points, normals, surface.isovalue, seeds_of(words), self.wall)

    @cached_property
    def leaving(self) -> np.ndarray:
        """Linear RGB that leaves each texel, filtered, and the variance of its luminance; (texels,
        4) float32.
        """
        reflected, variance = filter_wall(self.albedo * self.means.mean(axis=2), self.variance)
        light = np.minimum(self.radiance + reflected, np.finfo(np.float32).max)
        # Filtering changes noise alone; whether texels are final is decided before it.
        variance = self._all_variance - self.variance + variance
        leaving = np.concatenate([light, variance[..., None]], axis=2, dtype=np.float32)
        return leaving.reshape(-1, 4)


def between(values: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Interpolate ``values`` (h, w, …) linearly at positions between ``rows`` and ``columns``;
    beyond the ends, return the values at the ends.
    """
    for axis, places in enumerate((rows, columns)):
        first = np.clip(np.floor(places).astype(int), 0, values.shape[axis] - 2)
        way = np.clip(places - first, 0.0, 1.0).reshape(-1, *(1,) * (values.ndim - axis - 1))
        values = (1.0 - way) * values.take(first, axis) + way * values.take(first + 1, axis)
    return values


def filter_wall(light: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Filter the ``light`` (rows, columns, 3) of texels whose luminance has the ``variance`` (rows,
    columns); return it, and the variance that its luminance has then.

    This is the filter of pixels (``pixel_filter.filter_pixels``) on a plane: each pass keeps as
    much of a texel's difference from the plane fitted around it as is more than noise. A slope of
    the light does not count as a difference.
    """
    for step, shared in FILTER_STEPS:
        rows, columns = (fitted_weights(size, step) for size in variance.shape)
        # The spread around each texel, less the part that a plane explains, is noise and structure.
        shown = light @ LUMINANCE_WEIGHTS
        noise = rows.mean @ variance @ columns.mean.T
        spread = rows.mean @ shown**2 @ columns.mean.T - (rows.mean @ shown @ columns.mean.T) ** 2
        spread -= (rows.slope @ shown @ columns.mean.T) ** 2
        spread -= (rows.mean @ shown @ columns.slope.T) ** 2
        kept = beyond_noise(spread, noise)
        plane = np.einsum("ij,jkc,lk->ilc", rows.here, light, columns.here, optimize=True)
        light = plane + kept[..., None] * (light - plane)
        taken = shared * (rows.here**2 @ variance @ (columns.here**2).T)
        variance = np.minimum(kept * noise + (1.0 - kept) ** 2 * taken, variance)
    return light, variance


class FittedWeights(NamedTuple):
    """Weights (n, n) of n texels in a row around each of them: of the ``mean``, of the ``slope`` of
    a fitted line over one standard deviation of the distance, and of the line's value ``here``.
    """

    mean: np.ndarray
    slope: np.ndarray
    here: np.ndarray


@cache
def fitted_weights(size: int, step: int) -> FittedWeights:
    """Return the weights of ``size`` texels in a row, of which those a ``step`` apart are mixed by
    the weights BLUR. Texels at the ends have neighbours on one side alone.
    """
    away = np.arange(size) - np.arange(size)[:, None]
    near = (away % step == 0) & (np.abs(away) <= 2 * step)
    weights = np.where(near, BLUR[np.clip(away // step + 2, 0, 4)], 0.0)
    mean = weights / weights.sum(axis=1, keepdims=True)
    # A line fitted by least squares passes through the mean at the mean distance.
    middle = (mean * away).sum(axis=1, keepdims=True)
    deviation = np.sqrt((mean * (away - middle) ** 2).sum(axis=1, keepdims=True))
    slope = mean * (away - middle) / np.maximum(deviation, 1e-30)
    return FittedWeights(mean, slope, mean - middle / np.maximum(deviation, 1e-30) * slope)


def pooled(variance: np.ndarray) -> np.ndarray:
    """Average ``variance`` (rows, columns) over neighbours, by the weights BLUR."""
    for axis in (0, 1):
        padded = np.pad(variance, [(2 * int(a == axis),) * 2 for a in range(2)], "edge")
        variance = np.lib.stride_tricks.sliding_window_view(padded, len(BLUR), axis) @ BLUR
    return variance
