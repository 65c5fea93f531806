"""Pictures of surfaces that light passes: their pixels show walls and the environment, refracted
and mirrored.

The first picture splits each ray into a tree of a few places. Once a ray may split no more, it
follows the larger part of the light, and records the share that it left out. While the view rests,
trees are drawn by chance, in halves that show their noise, until this is small enough.
"""

import threading
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from isogi_core.bake.refine import seeds_of
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer, OtherPoints
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.rays.point_paths import HALVES, Estimate, NoisyLight
from isogi_core.frame.rays.wall_light import ViewWalls, WallView
from isogi_core.frame.refinement import Refinement
from isogi_core.frame.shading import empty_framebuffer
from isogi_core.frame.shot import Shot
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_checks import check_key
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, Framebuffer
from isogi_core.kernels.transport import streams
from isogi_core.kernels.transport.matter.sight import NO_SAMPLE, Chances, Leaves, see_through
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS

FIRST_BREADTH = 8
BREADTH = 64
"""Places that a point sees, at most, by its first tree, and by each tree that is drawn while
the view rests. Trees with 64 take twice as long as those with 8, and have a tenth of the noise.
"""

DEEP = 256
"""Interfaces that the light of a point passes, at most."""

TILE_PLACES = 1 << 13
PLACES_TOGETHER = 1 << 18
STEP_PLACES = 1 << 22
"""Places of a tile; places that are looked up together; and, about, places of a step. A step takes
at least one tree of each half from a point, and at most doubles the trees.
"""

MIN_TREES = 8
MAX_TREES = 1 << 12
"""Trees of each half, at least and at most. Up to the least number all points have as many, as the
noise of a point is not known from fewer; from then on noisy points alone get more.
"""

SURE = 0.25
"""Share of the allowed error that the first trees may show if no others are drawn: their error
is a guess.
"""

SEEN_NOISE_SHARE = 0.5
"""Share of the target error that the noise of trees may have; the rest is for walls."""


@dataclass(frozen=True)
class Trees:
    """Trees of rays from each point of a picture, one for each of the ``replicas`` and ``samples``,
    in this order.

    Each sees ``breadth`` places at most. Sample NO_SAMPLE leaves nothing to chance.
    """

    breadth: int
    replicas: range
    samples: range

    @property
    def each(self) -> int:
        """The number of trees of a point."""
        return len(self.replicas) * len(self.samples)

    def chances(self, pixels: np.ndarray) -> Chances:
        """Return the random choices of the trees from points in ``pixels`` (m,)."""
        shape = len(pixels), len(self.replicas), len(self.samples)
        point, replica, sample = (part.ravel() for part in np.indices(shape))
        words = np.column_stack(
            [pixels[point], streams.GLASS_STREAM + self.replicas.start + replica]
        )
        return Chances(seeds_of(words), self.samples.start + sample, DEEP)


FIRST_TREES = Trees(FIRST_BREADTH, range(1), range(NO_SAMPLE, NO_SAMPLE + 1))
"""The first trees, one from each point. They leave nothing to chance: a ray that may split no more
follows the larger part of its light.
"""


@dataclass(frozen=True, eq=False)
class SeenThrough:
    """All that the n trees from the points of a G-buffer show: the environment, and h places on
    walls.

    - ``sky`` (n, 3): light of the environment.
    - ``weights`` (h, 3): weight of each place in the light of its tree.
    - ``rows`` (h,): row of the tree, ascending.
    - ``walls``: the places, as points of a picture of one row whose pixel i is place i.
    - ``sides`` (h,): sides of the walls that are seen.
    - ``cut`` (n,): share of a tree's light that followed the way of another.
    """

    sky: np.ndarray
    weights: np.ndarray
    rows: np.ndarray
    walls: OtherPoints
    sides: np.ndarray
    cut: np.ndarray

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        parts = (self.sky, self.weights, self.rows, self.walls, self.sides, self.cut)
        return sum(each.nbytes for each in parts)

    @classmethod
    def of(cls, shot: Shot, trees: Trees) -> "SeenThrough":
        """Trace ``trees`` from the surface points of a ``shot``. Raises Cancelled."""
        gbuffer = shot.gbuffer
        light = shot.light
        count = len(gbuffer.points) * trees.each
        passable = shot.prepared.passable
        traced = gbuffer.surface.traced(shot.tiles.run)
        starts = np.repeat(gbuffer.points, trees.each, axis=0)
        (seeds, samples, deep) = trees.chances(gbuffer.pixels)
        # Each tree has room for as many places as it may see.
        room = count * trees.breadth
        weights, points = np.empty((2, room, 3), np.float32)
        met, sides = np.empty((2, room), np.int8)
        sky = np.empty((count, 3), np.float32)
        cut = np.empty(count, np.float32)

        def _piece(a: int, b: int) -> None:
            rows = slice(a * trees.breadth, b * trees.breadth)
            chances = Chances(seeds[a:b], samples[a:b], deep)
            leaves = Leaves(sky[a:b], weights[rows], points[rows], met[rows], sides[rows], cut[a:b])
            see_through(
                traced, passable, light.surroundings, gbuffer.eye, starts[a:b], chances, leaves
            )

        shot.tiles.run(_piece, count, TILE_PLACES // trees.breadth)
        # Keep the places that are on walls.
        seen = np.flatnonzero(met >= 0)
        walls = OtherPoints(np.arange(len(seen), dtype=np.uint32), points[seen], met[seen])
        return cls(
            sky, weights[seen], seen // trees.breadth, walls, sides[seen].astype(np.int64), cut
        )

    def views(self, shot: Shot) -> list[WallView]:
        """Return the walls that are seen, fronts and backs apart."""
        row = replace(shot.gbuffer, shape=(1, max(len(self.rows), 1)), walls=self.walls)
        return WallView.of_sides(row, shot.light, self.sides)

    def gather(self, lit: Framebuffer) -> tuple[np.ndarray, np.ndarray]:
        """Return the light that trees bring if walls are ``lit``, linear RGB, (n, 3) float64; and
        the error that walls make in its luminance, (n,).

        Errors of walls add up as one error does, as those of neighbouring places are alike.
        """
        light = self.sky.astype(np.float64)
        brought = self.weights * lit.radiance[: len(self.rows)].astype(np.float64)
        np.add.at(light, self.rows, brought)
        # A place adds its weighted error to that of its tree, without squares.
        wrong = np.bincount(
            self.rows, (brought @ LUMINANCE_WEIGHTS) * lit.error[: len(self.rows)], len(self.sky)
        )
        return light, wrong

    def states(self, lit: Framebuffer) -> np.ndarray:
        """Return the state of each tree: the worst one of the walls that it shows (states ascend
        from provisional to final); (n,) uint8.

        A tree without walls is final, as the environment is exact. ``lit`` has one pixel for each
        place, or a single unused one if there are no places.
        """
        state = np.full(len(self.sky), FINAL, np.uint8)
        np.minimum.at(state, self.rows, lit.state[: len(self.rows)])
        return state


@dataclass(eq=False)
class SurfaceSeen:
    """All that the points of a ``gbuffer`` show through the surface, for a target error: by the
    ``first`` trees, or by the ``sums`` of trees that were drawn by chance once all walls that they
    see were final.

    Only the thread that holds the ``lock`` changes it.
    """

    gbuffer: GBuffer
    first: SeenThrough
    sums: Estimate
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.first.nbytes + self.sums.nbytes

    def is_shown(self, frame: Frame) -> bool:
        """Return True if a ``frame`` shows all trees that were drawn."""
        return frame.quality.rays == self.sums.version

    def put(self, shot: Shot, lit: Framebuffer, framebuffer: Framebuffer) -> bytes:
        """Write the light that is seen to the picture of a ``shot``, if walls are ``lit``; return a
        name of the trees. Raises Cancelled.

        A pixel has the least state of all that it shows, and is not final before its noise is
        allowed.
        """
        # Read the sums once: another thread may replace them meanwhile.
        sums = self.sums
        pixels = self.gbuffer.pixels
        shown, wrong = self.shown(sums, lit, shot.tiles)
        light = np.minimum(shown.light, np.finfo(np.float32).max)
        state = self.first.states(lit)
        if len(self.noisy(sums, shown, shot.goal.error)):
            np.minimum(state, CONVERGING, out=state)
        error = np.sqrt(shown.variance + wrong**2) / np.maximum(light @ LUMINANCE_WEIGHTS, 1e-30)
        framebuffer.radiance[pixels] = light
        framebuffer.state[pixels] = state
        framebuffer.error[pixels] = np.minimum(error, 1.0)
        return sums.version

    def shown(
        self, sums: Estimate, lit: Framebuffer, tiles: Tiles
    ) -> tuple[NoisyLight, np.ndarray]:
        """Return the light that is seen by ``sums`` if walls are ``lit``, and the error (m,)
        that these make in its luminance. Raises Cancelled.
        """
        light, wrong = self.first.gather(lit)
        if sums.most:
            return NoisyLight.of(sums.means, self.gbuffer, tiles), wrong
        # The first trees sent some light another way: its error is taken from how much neighbours
        # differ.
        apart = NoisyLight.of(light[:, None], self.gbuffer, tiles).variance
        return NoisyLight(light, 2.0 * self.first.cut.astype(np.float64) ** 2 * apart), wrong

    def noisy(self, sums: Estimate, shown: NoisyLight, target: float) -> np.ndarray:
        """Return the rows of the points that need more trees than ``sums`` holds, so that the
        relative error of the light ``shown`` falls to the ``target``; none once all points have
        MAX_TREES.
        """
        count = sums.most
        if count >= MAX_TREES:
            return np.empty(0, np.int64)
        # If walls are seen, trees may use up only a share of the target: the noise of the walls'
        # light has the rest.
        share = 1.0
        if len(self.first.rows):
            share = SEEN_NOISE_SHARE
        allowed = share * target * float((shown.light @ LUMINANCE_WEIGHTS).mean())
        # The error of the first trees is a guess, so they must stay well below what is allowed.
        if not count:
            allowed = SURE * allowed
        found = sums.noisy(shown.variance, allowed)
        # Few trees do not show the noise of a single point: as long as there are few, all points
        # get more together.
        if count >= MIN_TREES or not len(found):
            return found
        return np.arange(len(shown.light))


@dataclass(frozen=True, eq=False)
class ViewThrough(Refinement[SurfaceSeen]):
    """Pictures of surfaces that light passes. All that views show through them is among results
    that are ``kept``, with the light of ``walls``.
    """

    kept: LruCache[Any]
    walls: ViewWalls

    def draw(self, shot: Shot) -> Frame:
        """Draw a ``shot`` with the light of walls as it is now. Raises Cancelled."""
        gbuffer = shot.gbuffer
        framebuffer = empty_framebuffer(gbuffer)
        with shot.watch.stage("through"):
            seen = self.of(shot)
        # Light the walls that are seen through the surface, then those in the open.
        with shot.watch.stage("walls"):
            lit, version = self._lit(shot, seen.first)
            rays = seen.put(shot, lit, framebuffer)
            waiting = int((framebuffer.state[gbuffer.pixels] < FINAL).sum())
            if len(gbuffer.walls.pixels):
                more, paths = self.walls.put(shot, framebuffer)
                waiting += more
                version += paths
        frame = frame_of(shot, framebuffer, rays=rays)
        return replace(
            frame,
            quality=replace(frame.quality, waiting=waiting),
            version=f"{frame.version}{version}",
        )

    def of(self, shot: Shot) -> SurfaceSeen:
        """Return the light that a ``shot`` shows through the surface: as it was kept of this
        picture, or else begun now with the first trees. See ``Refinement``. Raises Cancelled.
        """

        def make() -> SurfaceSeen:
            first = SeenThrough.of(shot, FIRST_TREES)
            return SurfaceSeen(shot.gbuffer, first, Estimate.none(len(shot.gbuffer.points)))

        return self.kept.get((SurfaceSeen, *check_key(shot.view, shot.goal.error)), make)

    def advance(self, found: SurfaceSeen, frame: Frame, shot: Shot, prices: Prices) -> bool:
        """Take a step of the light ``found``: see ``Refinement``.

        Walls that are not final double their paths; once all are final, points take more trees.
        """
        views = [WallView.of(shot.gbuffer, shot.light), *found.first.views(shot)]
        if self.walls.grow(views, shot):
            return True
        lit, _ = self._lit(shot, found.first)
        shown, _ = found.shown(found.sums, lit, shot.tiles)
        places = found.noisy(found.sums, shown, shot.goal.error)
        return len(places) > 0 and self._draw_trees(shot, found, places)

    def _draw_trees(self, shot: Shot, seen: SurfaceSeen, places: np.ndarray) -> bool:
        """Double the trees of the points in rows ``places``; if they see walls that are not
        final, take a step of these instead. Return False if nothing was taken. Raises
        Cancelled.
        """
        # Draw as many trees as a step has places for, some points after the other.
        numbers = seen.sums.next(STEP_PLACES // (HALVES * BREADTH * len(places)))
        trees = Trees(BREADTH, range(HALVES), numbers)
        added = np.zeros((len(places), HALVES, 3))
        some = max(PLACES_TOGETHER // (BREADTH * trees.each), 1)
        for a in range(0, len(places), some):
            rows = places[a : a + some]
            some_points = replace(shot, gbuffer=shot.gbuffer.part(rows, shot.tiles))
            found = SeenThrough.of(some_points, trees)
            lit, _ = self._lit(shot, found)
            # Sums must not hold light of walls that will still change.
            if (lit.state[: len(found.rows)] < FINAL).any():
                return self.walls.grow(found.views(shot), shot)
            added[a : a + some] = found.gather(lit)[0].reshape(len(rows), HALVES, -1, 3).sum(axis=2)
        seen.sums = seen.sums.joined(places, added, numbers.stop)
        return True

    def _lit(self, shot: Shot, seen: SeenThrough) -> tuple[Framebuffer, str]:
        """Return the walls that are ``seen`` as they are lit now, and a name of their paths.
        Raises Cancelled.
        """
        lit = dark_row(len(seen.rows))
        return lit, self.walls.put_seen(shot, seen.views(shot), lit)


def dark_row(count: int) -> Framebuffer:
    """Return a picture of one row in which nothing is lit."""
    n = max(count, 1)
    return Framebuffer(
        np.zeros((n, 3), np.float32), np.full(n, FINAL, np.uint8), np.zeros(n, np.float32)
    )
