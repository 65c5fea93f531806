"""Surfaces that light passes in pictures: their pixels show walls and what lies outside, refracted and mirrored."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer, PointsBeside
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.view_walls import ViewWalls
from isogi_core.frame.rays.wall_light import WallView
from isogi_core.frame.shading import empty_framebuffer
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_keys import surface_key
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.transport.matter.sight import LEAVES, Leaves, see_through
from isogi_core.lru_cache import LruCache
from isogi_core.model.sky import LUMINANCE

POINTS = 1024
"""Points of a tile."""


@dataclass(frozen=True, eq=False)
class SeenThrough:
    """What the points of a G-buffer, m of them, show: ``sky`` (m, 3) of what lies outside, and walls.

    Each of h places on walls counts ``weights`` (h, 3) in the light of the point in row ``rows`` (h,), ascending. They
    are the ``walls`` of a picture of one row, whose pixel i is place i, and seen from their ``sides`` (h,).
    """

    sky: np.ndarray
    weights: np.ndarray
    rows: np.ndarray
    walls: PointsBeside
    sides: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return sum(each.nbytes for each in (self.sky, self.weights, self.rows, self.walls, self.sides))

    @classmethod
    def of(cls, gbuffer: GBuffer, light: RotatedLight, tiles: Tiles) -> "SeenThrough":
        """What is seen through the points of a G-buffer. Raises Cancelled."""
        prepared, count = light.spec.prepared, len(gbuffer.points)
        passable, traced = prepared.passable, gbuffer.surface.traced(tiles.run)
        weights, points = np.empty((2, count * LEAVES, 3), np.float32)
        met, sides = np.empty((2, count * LEAVES), np.int8)
        sky = np.empty((count, 3), np.float32)

        def _piece(a: int, b: int) -> None:
            own = slice(a * LEAVES, b * LEAVES)
            leaves = Leaves(sky[a:b], weights[own], points[own], met[own], sides[own])
            see_through(traced, passable, light.surroundings, gbuffer.eye, gbuffer.points[a:b], leaves)

        tiles.run(_piece, count, POINTS)
        seen = np.flatnonzero(met >= 0)
        walls = PointsBeside(np.arange(len(seen), dtype=np.uint32), points[seen], met[seen])
        return cls(sky, weights[seen], seen // LEAVES, walls, sides[seen].astype(np.int64))

    def views(self, gbuffer: GBuffer, light: RotatedLight) -> list[WallView]:
        """The walls that are seen, fronts and backs apart."""
        row = replace(gbuffer, shape=(1, max(len(self.rows), 1)), walls=self.walls)
        found = [(side, np.flatnonzero(self.sides == side)) for side in (1, -1)]
        return [
            WallView(replace(row, walls=self.walls.part(some)), light, self.sides[some])
            for _, some in found
            if len(some)
        ]

    def put(self, lit: Framebuffer, gbuffer: GBuffer, framebuffer: Framebuffer) -> None:
        """Write what is seen to a picture, where walls are ``lit``: pixels have the least state of what they show.

        Errors of walls count as those of one, as a place beside another errs as it does.
        """
        light, state = self.sky.astype(np.float64), np.full(len(self.sky), FINAL, np.uint8)
        brought = self.weights * lit.radiance[: len(self.rows)].astype(np.float64)
        np.add.at(light, self.rows, brought)
        np.minimum.at(state, self.rows, lit.state[: len(self.rows)])
        wrong = np.bincount(self.rows, (brought @ LUMINANCE) * lit.error[: len(self.rows)], len(self.sky))
        light = np.minimum(light, np.finfo(np.float32).max)
        framebuffer.radiance[gbuffer.pixels] = light
        framebuffer.state[gbuffer.pixels] = state
        framebuffer.error[gbuffer.pixels] = np.minimum(wrong / np.maximum(light @ LUMINANCE, 1e-30), 1.0)


@dataclass(frozen=True, eq=False)
class ViewThrough:
    """Pictures of what light passes; what is seen in a view is among what is ``kept``, and so is the light of walls."""

    kept: LruCache[Any]
    walls: ViewWalls

    def draw(self, gbuffer: GBuffer, light: RotatedLight, target: float, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of a G-buffer with the walls' light as it is now. Raises Cancelled."""
        framebuffer = empty_framebuffer(gbuffer)
        with watch.stage("through"):
            seen = self._seen(gbuffer, light, tiles)
        with watch.stage("walls"):
            lit = dark_row(len(seen.rows))
            version = self.walls.put_seen(seen.views(gbuffer, light), target, lit, tiles)
            seen.put(lit, gbuffer, framebuffer)
            waiting = int((framebuffer.state[gbuffer.pixels] < FINAL).sum())
            if len(gbuffer.walls.pixels):
                more, own = self.walls.put(gbuffer, light, target, framebuffer, tiles)
                waiting, version = waiting + more, version + own
        frame = frame_of(gbuffer, light, framebuffer, watch)
        return replace(frame, walls_waiting=waiting, version=f"{frame.version}{version}")

    def grow(self, gbuffer: GBuffer, light: RotatedLight, target: float, tiles: Tiles) -> bool:
        """Have the walls in a picture, and those seen through its surface, that are not final take as many paths again.

        Raises Cancelled.
        """
        views = [WallView.of(gbuffer, light)]
        if light.spec.prepared.scene.material.refracts:
            views += self._seen(gbuffer, light, tiles).views(gbuffer, light)
        return self.walls.grow(views, target, tiles)

    def _seen(self, gbuffer: GBuffer, light: RotatedLight, tiles: Tiles) -> SeenThrough:
        """What the points of a G-buffer show."""
        key = SeenThrough, surface_key(light.view), light.view.light
        return self.kept.get(key, lambda: SeenThrough.of(gbuffer, light, tiles))


def dark_row(count: int) -> Framebuffer:
    """A picture of one row in which nothing is lit."""
    n = max(count, 1)
    return Framebuffer(np.zeros((n, 3), np.float32), np.full(n, FINAL, np.uint8), np.zeros(n, np.float32))
