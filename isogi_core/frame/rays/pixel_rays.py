"""Trace whole paths from the surface points of pixels, and estimate their noise."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isogi_core.bake.bake_spec import path_weights
from isogi_core.bake.refine import add_path_light
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.point_paths import add_glow, path_starts, sight_lines
from isogi_core.frame.rays.shine import add_shine
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.transport.light_paths import Open
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.plan.budget import survival_for

PATH_POINTS = 256
MAX_PATHS = 1 << 16
"""Surface points of a tile if each of them sends paths, and paths of a tile, at most: some 30
ms until it can be cancelled.
"""

PASS_PATHS = 1 << 21
PASS_POINTS = 1 << 18
"""Paths and points of one pass of a picture, at most: about a second of two cores. Between two
passes other work may go first, and sums take memory for one.
"""

BINOMIAL = np.array([1.0, 4.0, 6.0, 4.0, 1.0])
"""Weights of neighbours along an axis, where variances are pooled."""

POOLED_REACH = len(BINOMIAL) // 2
POOLED_PIXELS = 1 << 20
"""Distance along an axis of the farthest neighbours, in pixels; and number of pixels that are
pooled together.
"""


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths from the surface points of a ``gbuffer`` under a ``light``, on the threads of
    ``tiles``.

    They have ``bounces`` bounces, by default those of the plan.
    """

    light: RotatedLight
    gbuffer: GBuffer
    tiles: Tiles
    bounces: int | None = None

    @cached_property
    def survival(self) -> float:
        """The probability that a path continues after its second and later hits."""
        plan = self.light.spec.prepared.scene.plan
        if self.bounces is None:
            return plan.survival
        return survival_for(self.light.reflecting, self.bounces)

    @cached_property
    def weights(self) -> np.ndarray:
        """The weight R^(k + 1) of light after k = 0 … bounces, over the probability to get there;
        (bounces + 1, 3) float64.

        Paths that carry the albedo of each hit start with the weight 1, and nothing else of the
        weights is read. Through glass, the eye's ray takes one bounce more, to the first surface
        that reflects it.
        """
        scene = self.light.spec.prepared.scene
        if self.bounces is None:
            bounces = scene.plan.bounces
        else:
            bounces = self.bounces
        if scene.surfaces.material.refracts:
            return path_weights(np.ones(3), bounces + 1, 1.0)
        if self.light.coloured or scene.surfaces.material.scatters:
            return path_weights(np.ones(3), bounces, 1.0)
        return path_weights(self.light.albedo, bounces, self.survival, leaving=1)

    def of(self, rows: np.ndarray) -> "Paths":
        """Return the paths from the points in these ascending ``rows`` alone."""
        return replace(self, gbuffer=self.gbuffer.part(rows, self.tiles))

    def add(
        self,
        sums: np.ndarray,
        stream: int,
        first: int,
        count: int,
        progress: Callable[[int], object] | None = None,
    ) -> None:
        """Trace the ``count`` samples of each replica that begin with number ``first``, and add
        their light to ``sums`` (points, replicas, 3) float64.

        Replicas are the randomisations from number ``stream`` on. ``progress`` is called with the
        number of paths that each piece traced. If the surface shines, as many rays of shine are
        traced. Raises Cancelled.
        """
        gbuffer = self.gbuffer
        prepared = self.light.spec.prepared
        replicas = range(stream, stream + sums.shape[1])
        # Colours and shine change the light of the new paths, so it is summed apart: the light in
        # ``sums`` has been changed already.
        changed = self.light.shine is not None or self.light.coloured
        if changed:
            new = np.zeros_like(sums)
        else:
            new = sums
        # Through glass, paths start on the eye's rays just before the surface.
        if prepared.scene.surfaces.material.refracts:
            points = sight_lines(gbuffer)
        else:
            points = gbuffer.shown(self.tiles)
        traced = gbuffer.surface.traced(self.tiles.run)
        around = self.light.surroundings
        met = prepared.met(self.light.seen.albedo, traced.cells, self.tiles.run)
        rules = PathRules(self.weights, self.survival)
        samples = SampleRange(first, count)

        # Trace all replicas of some points together, and add them to the sums of these points.
        def _piece(a: int, b: int) -> None:
            starts = path_starts(traced, points.part(slice(a, b)), replicas)
            here = new[a:b].reshape(-1, 3)
            if isinstance(met, Open):
                added = here
            else:
                added = np.zeros_like(here)
            add_path_light(met, starts, samples, rules, around, added)
            # Over one surface in the open each sample was added to the sums in turn. In all other
            # scenes the samples of this call come as one sum; the two differ by rounding alone.
            if added is not here:
                here += added
            add_glow(here, self.light, traced, starts, rules, samples)
            if progress is not None:
                progress((b - a) * sums.shape[1] * count)

        self.tiles.run(
            _piece, len(sums), max(min(PATH_POINTS, MAX_PATHS // (sums.shape[1] * count)), 1)
        )
        # Reflect by the colours of the surface, and let it shine.
        if self.light.coloured:
            new *= gbuffer.albedos(prepared.colours, self.tiles)[: len(new), None]
        if self.light.shine is not None:
            numbers = range(first, first + count)
            bounces = len(self.weights) - 1
            add_shine(new, self.light, gbuffer, stream, numbers, bounces, self.tiles)
        if changed:
            sums += new

    def prepare(self) -> None:
        """Do all that comes before the first paths, by tracing one: find normals, map active
        cells, and compile.
        """
        self.add(np.zeros((min(len(self.gbuffer.points), 1), 1, 3)), 0, 0, 1)


def passes(points: int, samples: int, tiles: Tiles) -> Iterator[slice]:
    """Yield consecutive slices of ``points`` points that send ``samples`` paths each, one for each
    pass.

    Other work may go first between two of them. Raises Cancelled.
    """
    size = max(min(PASS_PATHS // samples, PASS_POINTS), 1)
    for first in range(0, points, size):
        if first:
            tiles.give_way()
        yield slice(first, min(first + size, points))


def variance_of_mean(means: np.ndarray) -> np.ndarray:
    """Return the variance of the luminance of the mean over independent replicas ``means`` (m,
    replicas, 3); (m,) float64.
    """
    return np.asarray((means @ LUMINANCE_WEIGHTS).var(axis=1, ddof=1) / means.shape[1])


def split_into_replicas(samples: int) -> tuple[int, int]:
    """Return the number of replicas that share the ``samples`` paths of a pixel, and the number of
    paths of each, rounded up.

    More replicas estimate the error better, and make it larger, since each is a shorter sequence:
    at 256 paths eight have 1.1 times the error of four (engine under uffizi and grace, CT head
    under noon_grass).
    """
    if samples < 8:
        replicas = 2
    elif samples < 256:
        replicas = 4
    else:
        replicas = 8
    return replicas, math.ceil(samples / replicas)


def pooled_variance(
    variance: np.ndarray, gbuffer: GBuffer, shown: np.ndarray | None = None
) -> np.ndarray:
    """Average the ``variance`` (m,) of each surface pixel, or of each of the pixels ``shown``, with
    those of its neighbours, by the weights BINOMIAL both ways.

    A few replicas say too little of one pixel alone: of four, 1.96 standard deviations would hold
    86 % of Gaussian errors, and none if all replicas met the same by chance. Pooled, they held 91
    to 96 % of the pixels of frames of 8 to 256 paths (engine under uffizi and grace, CT head under
    noon_grass, MNI under constant light).
    """
    pixels = shown
    if pixels is None:
        pixels = gbuffer.pixels
    height, width = gbuffer.shape
    pooled = np.empty(len(pixels))
    rows = max(POOLED_PIXELS // width, 1)

    # Pool some rows after the other, each piece with the neighbours above and below.
    for first in range(0, height, rows):
        last = min(first + rows, height)
        a, b = rows_among(pixels, width, first - POOLED_REACH, last + POOLED_REACH)
        # Filter the variances and the presence of pixels alike, and divide: pixels that are not
        # there do not count.
        both = np.zeros((2, last - first + 2 * POOLED_REACH, width))
        places = pixels[a:b].astype(np.int64) - width * (first - POOLED_REACH)
        both.reshape(2, -1)[:, places] = variance[a:b], np.ones(b - a)
        for axis in (1, 2):
            if axis == 2:
                both = np.pad(both, ((0, 0), (0, 0), (POOLED_REACH, POOLED_REACH)))
            windows = np.lib.stride_tricks.sliding_window_view(both, len(BINOMIAL), axis)
            both = windows @ BINOMIAL
        a, b = rows_among(pixels, width, first, last)
        total, weight = both.reshape(2, -1)[:, pixels[a:b].astype(np.int64) - width * first]
        pooled[a:b] = total / weight
    return pooled


def rows_among(pixels: np.ndarray, width: int, first: int, last: int) -> tuple[int, int]:
    """Return where rows ``first`` to ``last`` of a picture begin and end among ascending
    ``pixels``.
    """
    ends = np.array([max(first, 0) * width, last * width], pixels.dtype)
    a, b = np.searchsorted(pixels, ends).tolist()
    return a, b
