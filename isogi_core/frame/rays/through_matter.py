"""Surfaces that light passes in pictures: their pixels show walls and what lies outside, refracted
and mirrored.

The first picture follows the greater part of light where rays can part no more, and says how much
went that way. While the view rests trees are drawn by chance, in halves that tell their noise,
until that is small enough.
"""

import threading
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from isogi_core.bake.refine import seeds_of
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer, PointsBeside
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.rays.point_paths import HALVES, Estimate, NoisyLight
from isogi_core.frame.rays.wall_light import ViewWalls, WallView
from isogi_core.frame.refinement import Refinement
from isogi_core.frame.shading import empty_framebuffer
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import check_key
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, Framebuffer
from isogi_core.kernels.transport import streams
from isogi_core.kernels.transport.matter.sight import NO_SAMPLE, Chances, Leaves, see_through
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS

FIRST_BREADTH = 8
BREADTH = 64
"""Places that a point sees, at most, by its first tree, and by each of those drawn while the view
rests: trees with 64 take twice as long as those with 8, and have a tenth of the noise.
"""

DEEP = 256
"""Interfaces that a point's light passes, at most."""

TILE_PLACES = 1 << 13
PLACES_TOGETHER = 1 << 18
STEP_PLACES = 1 << 22
"""Places of a tile; those that are looked up together; and those of a step, about: of a point by
one tree of each half at least, and by as many again as there are at most.
"""

MIN_TREES = 8
MAX_TREES = 1 << 12
"""Trees of each half that all points have before some may have more than others, as fewer say too
little of one point; and at most.
"""

SURE = 0.25
"""What the first trees may tell of their error, over what is allowed, where no others are drawn: it
is a guess.
"""

SEEN_NOISE_SHARE = 0.5
"""Share of the target error that the noise of what is seen may have, beside that of walls."""


@dataclass(frozen=True)
class Trees:
    """Trees of rays from each point of a picture, one of each of the ``replicas`` and ``samples``,
    in this order.

    They see so many places at most, their ``breadth``. Sample NO_SAMPLE leaves nothing to chance.
    """

    breadth: int
    replicas: range
    samples: range

    @property
    def each(self) -> int:
        """How many a point has."""
        return len(self.replicas) * len(self.samples)

    def chances(self, pixels: np.ndarray) -> Chances:
        """How they choose, of points in ``pixels`` (m,)."""
        shape = len(pixels), len(self.replicas), len(self.samples)
        point, replica, sample = (part.ravel() for part in np.indices(shape))
        words = np.column_stack(
            [pixels[point], streams.GLASS_STREAM + self.replicas.start + replica]
        )
        return Chances(seeds_of(words), self.samples.start + sample, DEEP)


GREATEST = Trees(FIRST_BREADTH, range(1), range(NO_SAMPLE, NO_SAMPLE + 1))
"""A tree of each point that leaves nothing to chance."""


@dataclass(frozen=True, eq=False)
class SeenThrough:
    """What the trees of a G-buffer's points, n of them in all, show: ``sky`` (n, 3) of what lies
    outside, and walls.

    Each of h places on walls counts ``weights`` (h, 3) in the light of the tree in row ``rows``
    (h,), ascending. They are the ``walls`` of a picture of one row, whose pixel i is place i, and
    seen from their ``sides`` (h,). ``cut`` (n,) is the share of a tree's light that went the way of
    another.
    """

    sky: np.ndarray
    weights: np.ndarray
    rows: np.ndarray
    walls: PointsBeside
    sides: np.ndarray
    cut: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        parts = (self.sky, self.weights, self.rows, self.walls, self.sides, self.cut)
        return sum(each.nbytes for each in parts)

    @classmethod
    def of(cls, gbuffer: GBuffer, light: RotatedLight, trees: Trees, tiles: Tiles) -> "SeenThrough":
        """What is seen through the points of a G-buffer. Raises Cancelled."""
        prepared = light.spec.prepared
        count = len(gbuffer.points) * trees.each
        passable = prepared.passable
        traced = gbuffer.surface.traced(tiles.run)
        starts = np.repeat(gbuffer.points, trees.each, axis=0)
        (seeds, samples, deep) = trees.chances(gbuffer.pixels)
        weights, points = np.empty((2, count * trees.breadth, 3), np.float32)
        met, sides = np.empty((2, count * trees.breadth), np.int8)
        sky = np.empty((count, 3), np.float32)
        cut = np.empty(count, np.float32)

        def _piece(a: int, b: int) -> None:
            own = slice(a * trees.breadth, b * trees.breadth)
            chances = Chances(seeds[a:b], samples[a:b], deep)
            leaves = Leaves(sky[a:b], weights[own], points[own], met[own], sides[own], cut[a:b])
            see_through(
                traced, passable, light.surroundings, gbuffer.eye, starts[a:b], chances, leaves
            )

        tiles.run(_piece, count, TILE_PLACES // trees.breadth)
        seen = np.flatnonzero(met >= 0)
        walls = PointsBeside(np.arange(len(seen), dtype=np.uint32), points[seen], met[seen])
        return cls(
            sky, weights[seen], seen // trees.breadth, walls, sides[seen].astype(np.int64), cut
        )

    def views(self, gbuffer: GBuffer, light: RotatedLight) -> list[WallView]:
        """The walls that are seen, fronts and backs apart."""
        row = replace(gbuffer, shape=(1, max(len(self.rows), 1)), walls=self.walls)
        return WallView.of_sides(row, light, self.sides)

    def gather(self, lit: Framebuffer) -> tuple[np.ndarray, np.ndarray]:
        """What trees bring where walls are ``lit``, linear RGB, (n, 3) float64; and the error of
        its luminance (n,).

        Errors of walls count as those of one, as a place beside another errs as it does.
        """
        light = self.sky.astype(np.float64)
        brought = self.weights * lit.radiance[: len(self.rows)].astype(np.float64)
        np.add.at(light, self.rows, brought)
        wrong = np.bincount(
            self.rows, (brought @ LUMINANCE_WEIGHTS) * lit.error[: len(self.rows)], len(self.sky)
        )
        return light, wrong

    def states(self, lit: Framebuffer) -> np.ndarray:
        """The least state of what trees show; (n,) uint8."""
        state = np.full(len(self.sky), FINAL, np.uint8)
        np.minimum.at(state, self.rows, lit.state[: len(self.rows)])
        return state


@dataclass(eq=False)
class SurfaceSeen:
    """What a view of a target error shows of its surface, ``gbuffer``: by the ``first`` trees, or
    by the ``sums`` of those drawn by chance since all walls that they see are final. Threads wait
    for each other.
    """

    gbuffer: GBuffer
    light: RotatedLight
    first: SeenThrough
    sums: Estimate
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.first.nbytes + self.sums.nbytes

    def is_shown(self, frame: Frame) -> bool:
        """Whether a ``frame`` shows all trees that were drawn."""
        return frame.quality.rays == self.sums.version

    def put(self, lit: Framebuffer, target: float, framebuffer: Framebuffer, tiles: Tiles) -> bytes:
        """Write what is seen to a picture where walls are ``lit``; what names the trees. Raises
        Cancelled.

        Pixels have the least state of what they show, and are not final before the noise of what
        they see is allowed.
        """
        sums = self.sums
        pixels = self.gbuffer.pixels  # another thread may add to the sums meanwhile
        shown, wrong = self.shown(sums, lit, tiles)
        light = np.minimum(shown.light, np.finfo(np.float32).max)
        state = self.first.states(lit)
        if len(self.noisy(sums, shown, target)):
            np.minimum(state, CONVERGING, out=state)
        error = np.sqrt(shown.variance + wrong**2) / np.maximum(light @ LUMINANCE_WEIGHTS, 1e-30)
        framebuffer.radiance[pixels] = light
        framebuffer.state[pixels] = state
        framebuffer.error[pixels] = np.minimum(error, 1.0)
        return sums.version

    def shown(
        self, sums: Estimate, lit: Framebuffer, tiles: Tiles
    ) -> tuple[NoisyLight, np.ndarray]:
        """What is seen by ``sums`` where walls are ``lit``, and by how much these make its
        luminance err (m,).

        What went the way of another light errs by how much neighbours differ. Raises Cancelled.
        """
        light, wrong = self.first.gather(lit)
        if sums.most:
            return NoisyLight.of(sums.means, self.gbuffer, tiles), wrong
        apart = NoisyLight.of(light[:, None], self.gbuffer, tiles).variance
        return NoisyLight(light, 2.0 * self.first.cut.astype(np.float64) ** 2 * apart), wrong

    def noisy(self, sums: Estimate, shown: NoisyLight, target: float) -> np.ndarray:
        """Rows of the points that are to have more trees than in ``sums`` before what is ``shown``
        is at its target.
        """
        allowed = (
            (SEEN_NOISE_SHARE if len(self.first.rows) else 1.0)
            * target
            * float((shown.light @ LUMINANCE_WEIGHTS).mean())
        )
        count = sums.most
        if count >= MAX_TREES:
            return np.empty(0, np.int64)
        found = sums.noisy(shown.variance, allowed if count else SURE * allowed)
        if count >= MIN_TREES or not len(found):
            return found
        return np.arange(len(shown.light))


@dataclass(frozen=True, eq=False)
class ViewThrough(Refinement[SurfaceSeen]):
    """Pictures of what light passes; what is seen in a view is among what is ``kept``, and so is
    the light of walls.
    """

    kept: LruCache[Any]
    walls: ViewWalls

    def draw(
        self, gbuffer: GBuffer, light: RotatedLight, target: float, tiles: Tiles, watch: Stopwatch
    ) -> Frame:
        """The frame of a G-buffer with the walls' light as it is now. Raises Cancelled."""
        framebuffer = empty_framebuffer(gbuffer)
        with watch.stage("through"):
            seen = self._seen(gbuffer, light, target, tiles)
        with watch.stage("walls"):
            lit, version = self._lit(seen.first, gbuffer, light, target, tiles)
            rays = seen.put(lit, target, framebuffer, tiles)
            waiting = int((framebuffer.state[gbuffer.pixels] < FINAL).sum())
            if len(gbuffer.walls.pixels):
                more, own = self.walls.put(gbuffer, light, target, framebuffer, tiles)
                waiting = waiting + more
                version = version + own
        frame = frame_of(gbuffer, light, framebuffer, watch, rays=rays)
        return replace(
            frame,
            quality=replace(frame.quality, waiting=waiting),
            version=f"{frame.version}{version}",
        )

    def of(self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles) -> SurfaceSeen:
        """See ``Refinement``."""
        return self._seen(frame.gbuffer, light, target, tiles)

    def advance(
        self, found: SurfaceSeen, frame: Frame, target: float, tiles: Tiles, prices: Prices
    ) -> bool:
        """Have the walls in a picture, and those seen through its surface, that are not final take
        as many paths again; once all are, draw more trees for what is seen through it. See
        ``Refinement``.
        """
        gbuffer = frame.gbuffer
        light = found.light
        if self.walls.grow(
            [WallView.of(gbuffer, light), *found.first.views(gbuffer, light)], target, tiles
        ):
            return True
        lit, _ = self._lit(found.first, gbuffer, light, target, tiles)
        places = found.noisy(found.sums, found.shown(found.sums, lit, tiles)[0], target)
        return len(places) > 0 and self._draw_trees(found, places, target, tiles)

    def _draw_trees(
        self, seen: SurfaceSeen, places: np.ndarray, target: float, tiles: Tiles
    ) -> bool:
        """Draw as many trees again for the points at ``places``; where walls that they see are not
        final these take as many paths again in place of that. Whether anything was taken. Raises
        Cancelled.
        """
        numbers = seen.sums.next(STEP_PLACES // (HALVES * BREADTH * len(places)))
        trees = Trees(BREADTH, range(HALVES), numbers)
        added = np.zeros((len(places), HALVES, 3))
        some = max(PLACES_TOGETHER // (BREADTH * trees.each), 1)
        for a in range(0, len(places), some):
            rows = places[a : a + some]
            found = SeenThrough.of(seen.gbuffer.part(rows, tiles), seen.light, trees, tiles)
            lit, _ = self._lit(found, seen.gbuffer, seen.light, target, tiles)
            if (lit.state[: len(found.rows)] < FINAL).any():
                return self.walls.grow(found.views(seen.gbuffer, seen.light), target, tiles)
            added[a : a + some] = found.gather(lit)[0].reshape(len(rows), HALVES, -1, 3).sum(axis=2)
        seen.sums = seen.sums.joined(places, added, numbers.stop)
        return True

    def _lit(
        self, seen: SeenThrough, gbuffer: GBuffer, light: RotatedLight, target: float, tiles: Tiles
    ) -> tuple[Framebuffer, str]:
        """The walls that are ``seen`` as they are lit now, and what names their paths. Raises
        Cancelled.
        """
        lit = dark_row(len(seen.rows))
        return lit, self.walls.put_seen(seen.views(gbuffer, light), target, lit, tiles)

    def _seen(
        self, gbuffer: GBuffer, light: RotatedLight, target: float, tiles: Tiles
    ) -> SurfaceSeen:
        """What the points of a G-buffer show."""

        def make() -> SurfaceSeen:
            first = SeenThrough.of(gbuffer, light, GREATEST, tiles)
            return SurfaceSeen(gbuffer, light, first, Estimate.none(len(gbuffer.points)))

        return self.kept.get((SurfaceSeen, *check_key(light.view, target)), make)


def dark_row(count: int) -> Framebuffer:
    """A picture of one row in which nothing is lit."""
    n = max(count, 1)
    return Framebuffer(
        np.zeros((n, 3), np.float32), np.full(n, FINAL, np.uint8), np.zeros(n, np.float32)
    )
