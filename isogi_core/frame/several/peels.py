"""Depth peels: all surfaces that a view shows, front to back, until what is behind hardly counts,
or a wall is met.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from isogi_core.frame.gbuffer import TILE_RAYS, GBuffer, PointsBeside, sight_of, view_pinhole
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.tracing.camera import WINDOW_FACE, Pinhole, Sight
from isogi_core.kernels.tracing.peels import (
    FIRST_WALL_SIDE,
    MAX_PEELED_LAYERS,
    MAX_SURFACES,
    Peeled,
    Shells,
    peel_rays,
)
from isogi_core.kernels.tracing.walls import Walls
from isogi_core.model.view import View
from isogi_core.plan.variants import WALLS_SIDE, Side
from isogi_core.prepared.prepared_scene import Surface


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays meet surfaces, ray by ray and front to back, (m,) each.

    They are the picture indices of ``pixels``, or other numbers of rays, ``points`` (m, 3) float32
    in index space, and the ``sides`` that are seen, their ``ranks`` and ``weights``, as of
    ``Peeled``.
    """

    pixels: np.ndarray
    points: np.ndarray
    sides: np.ndarray
    ranks: np.ndarray
    weights: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["Hits"]) -> "Hits":
        """The hits of several sets of rays, one set after the other."""
        names = ("pixels", "points", "sides", "ranks", "weights")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def rows_of(self, side: Side) -> np.ndarray:
        """The rows of those that are of a ``side``."""
        return np.flatnonzero(np.minimum(self.sides, FIRST_WALL_SIDE) == side.peeled)

    def beside(self, rows: np.ndarray) -> PointsBeside:
        """The hits in some ``rows``, which are on walls or faces."""
        sides = self.sides[rows]
        return PointsBeside(
            self.pixels[rows],
            self.points[rows],
            np.where(sides < FIRST_WALL_SIDE, sides, sides - FIRST_WALL_SIDE),
        )


@dataclass(frozen=True, eq=False)
class SideLayers:
    """What a picture shows of one side, layer behind layer, as one tall picture: a G-buffer of so
    many ``layers``.

    ``weights`` (m,) float32 are the shares of their pixels' light that its points have.
    """

    gbuffer: GBuffer
    layers: int
    weights: np.ndarray

    @property
    def each(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Layer by layer the rows of its points, and the picture indices that these have in it,
        each of them once.
        """
        height, width = self.gbuffer.shape
        size = height // self.layers * width
        places = self.gbuffer.pixels
        bounds = np.searchsorted(places, size * np.arange(self.layers + 1)).tolist()
        for layer, (first, last) in enumerate(pairwise(bounds)):
            yield slice(first, last), places[first:last] - np.uint32(layer * size)


@dataclass(frozen=True, eq=False)
class Peels:
    """All that a view shows: its ``sides``, in what is ``first`` the surfaces in front of all
    others, and the share ``left`` (h, w) float32 of what lies behind everything. ``walls`` is the
    picture of walls alone.
    """

    first: GBuffer
    sides: Mapping[Side, SideLayers]
    left: np.ndarray
    walls: GBuffer

    @property
    def nbytes(self) -> int:
        """Bytes that they take."""
        layers = sum(each.gbuffer.nbytes + each.weights.nbytes for each in self.sides.values())
        return self.first.nbytes + layers + self.left.nbytes + self.walls.nbytes


@dataclass(frozen=True, eq=False)
class Peeler:
    """Casts rays of a view's ``camera`` at ``shells``, with what is in ``sight`` beside them."""

    shells: Shells
    camera: Pinhole
    sight: Sight

    @classmethod
    def of(
        cls,
        view: View,
        surfaces: Sequence[Surface],
        clears: np.ndarray,
        tiles: Tiles,
        walls: Walls | None = None,
    ) -> "Peeler":
        """The peeler of some ``surfaces``, which the shares ``clears`` of rays pass, and of
        ``walls``.

        A surface at the isovalue of one before it is that one: it is left out.
        """
        field = surfaces[0].field
        levels = [float(each.isovalue) for each in surfaces]
        clears = np.where([level in levels[:k] for k, level in enumerate(levels)], 1.0, clears)
        maps = [each.cells(tiles.run) for each in surfaces]
        filled = tuple(maps + [maps[0]] * (MAX_SURFACES - len(maps)))
        sight = sight_of(view, field.spacing, walls)
        return cls(
            Shells(field, filled, np.array(levels), clears),
            view_pinhole(view, field.spacing),
            sight,
        )

    def through(self, x: np.ndarray, y: np.ndarray) -> tuple[Hits, np.ndarray]:
        """What is met through places (n,) of the picture, by their numbers; and the share left
        behind, (n,) float64.
        """
        corner, right, down = (np.array(each)[:, None] for each in self.camera[1:])
        directions = np.ascontiguousarray(corner + x * right + y * down)
        room = (MAX_PEELED_LAYERS + 1) * len(x)
        left = np.empty(len(x))
        sides, ranks = np.empty((2, room), np.int8)
        rays = np.empty(room, np.uint32)
        points = np.empty((room, 3), np.float32)
        peeled = Peeled(rays, points, sides, ranks, np.empty(room, np.float32))
        count = peel_rays(self.shells, self.sight, self.camera.eye, directions, peeled, left)
        return Hits(*(each[:count].copy() for each in peeled)), left

    def whole(self, view: View, tiles: Tiles) -> tuple[Hits, np.ndarray]:
        """All that its view shows, and the share (h, w) float32 of what is behind. Raises
        Cancelled.
        """
        count = view.width * view.height
        found = dict[int, Hits]()
        left = np.empty(count, np.float32)

        def _piece(a: int, b: int) -> None:
            y, x = np.divmod(np.arange(a, b), view.width)
            found[a], left[a:b] = self.through(x + 0.5, y + 0.5)
            found[a].pixels[:] += np.uint32(a)

        tiles.run(_piece, count, TILE_RAYS)
        return Hits.joined([found[a] for a in sorted(found)]), left.reshape(view.height, view.width)


def side_layers(hits: Hits, side: Side, first: GBuffer, surface: Surface) -> SideLayers:
    """The ``hits`` of a ``side`` of a ``surface``, some at least, as layers of the picture that
    ``first`` is of.
    """
    (height, width) = first.shape
    rows = hits.rows_of(side)
    ranks = hits.ranks[rows]
    layers = int(ranks.max()) + 1
    rows = np.concatenate([rows[ranks == rank] for rank in range(layers)])
    places = hits.pixels[rows] + hits.ranks[rows].astype(np.uint32) * np.uint32(height * width)
    shown = (layers * height, width), first.spacing, first.eye, surface
    return SideLayers(GBuffer(*shown, places, hits.points[rows]), layers, hits.weights[rows])


def first_of(view: View, hits: Hits, surface: Surface) -> GBuffer:
    """The G-buffer of what is in front, and of the faces of a window; it has the ``surface`` of the
    one that slides.
    """
    spacing = surface.field.spacing
    front = np.append(True, hits.pixels[1:] != hits.pixels[:-1])[: len(hits.pixels)]
    face = hits.sides == WINDOW_FACE
    wall = hits.sides >= FIRST_WALL_SIDE
    on = np.flatnonzero(front & ~face & ~wall)
    shown = (view.height, view.width), spacing, view_pinhole(view, spacing).eye, surface
    walls, faces = (hits.beside(np.flatnonzero(each)) for each in (front & wall, face))
    return GBuffer(*shown, hits.pixels[on], hits.points[on], walls=walls, faces=faces)


def walls_of(hits: Hits, first: GBuffer) -> tuple[GBuffer, SideLayers | None]:
    """The picture of walls alone among some ``hits``, and what they count in that which ``first``
    is of; None where there are none.
    """
    rows = hits.rows_of(WALLS_SIDE)
    shown = (first.shape, first.spacing, first.eye, first.surface)
    seen = hits.beside(rows)
    picture = GBuffer(*shown, np.empty(0, np.uint32), np.empty((0, 3), np.float32), walls=seen)
    if not len(rows):
        return picture, None
    return picture, SideLayers(GBuffer(*shown, seen.pixels, seen.points), 1, hits.weights[rows])
