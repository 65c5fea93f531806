"""Depth peels: all surfaces along the rays of a view, front to back, until a wall is met or
what is behind hardly counts.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from isogi_core.frame.gbuffer import TILE_RAYS, GBuffer, OtherPoints, sight_of, view_pinhole
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
    """Points where rays meet surfaces, ray by ray and front to back, (m,) each.

    - ``pixels`` uint32: picture indices, or other numbers of the rays.
    - ``points`` (m, 3) float32: in index space.
    - ``sides``, ``ranks``, ``weights``: as in ``Peeled``.
    """

    pixels: np.ndarray
    points: np.ndarray
    sides: np.ndarray
    ranks: np.ndarray
    weights: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["Hits"]) -> "Hits":
        """Concatenate the hits of several sets of rays."""
        return cls(
            np.concatenate([part.pixels for part in parts]),
            np.concatenate([part.points for part in parts]),
            np.concatenate([part.sides for part in parts]),
            np.concatenate([part.ranks for part in parts]),
            np.concatenate([part.weights for part in parts]),
        )

    def rows_of(self, side: Side) -> np.ndarray:
        """Return the rows of the hits on a ``side``."""
        return np.flatnonzero(np.minimum(self.sides, FIRST_WALL_SIDE) == side.peeled)

    def others(self, rows: np.ndarray) -> OtherPoints:
        """Return the hits in some ``rows``, which are on walls or on faces of a window."""
        sides = self.sides[rows]
        return OtherPoints(
            self.pixels[rows],
            self.points[rows],
            np.where(sides < FIRST_WALL_SIDE, sides, sides - FIRST_WALL_SIDE),
        )


@dataclass(frozen=True, eq=False)
class SideLayers:
    """All that a picture shows of one side of a surface: a G-buffer of ``layers`` pictures, one
    below the other, layer behind layer.

    ``weights`` (m,) float32 are the shares of their pixels' light that come from its points.
    """

    gbuffer: GBuffer
    layers: int
    weights: np.ndarray

    @property
    def each(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield (rows, pixels) for each layer, the front one first: the rows of its points in the
        G-buffer and in ``weights``, and their picture indices in a single picture, uint32. No index
        occurs twice in a layer.
        """
        # Layer k shifts picture indices by k · size. The indices of the G-buffer ascend, so its
        # points are sorted by layer.
        height, width = self.gbuffer.shape
        size = height // self.layers * width
        places = self.gbuffer.pixels
        bounds = np.searchsorted(places, size * np.arange(self.layers + 1)).tolist()
        for layer, (first, last) in enumerate(pairwise(bounds)):
            yield slice(first, last), places[first:last] - np.uint32(layer * size)


@dataclass(frozen=True, eq=False)
class Peels:
    """All that a view shows.

    - ``first``: G-buffer of the surfaces in front of all others.
    - ``sides``: layers of each side of a surface that is seen.
    - ``left`` (h, w) float32: share of the light that comes from behind everything.
    - ``walls``: G-buffer of the walls alone.
    """

    first: GBuffer
    sides: Mapping[Side, SideLayers]
    left: np.ndarray
    walls: GBuffer

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        layers = sum(each.gbuffer.nbytes + each.weights.nbytes for each in self.sides.values())
        return self.first.nbytes + layers + self.left.nbytes + self.walls.nbytes


@dataclass(frozen=True, eq=False)
class Peeler:
    """Casts rays of a ``camera`` at surfaces, the ``shells``, and at walls and planes in its
    ``sight``.
    """

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
        """Return the peeler of some ``surfaces`` and ``walls`` in a ``view``; ``clears``
        (surfaces,) are the shares of rays that pass a surface.

        A surface at the isovalue of an earlier one coincides with it, and is left out.
        """
        field = surfaces[0].field
        levels = [float(each.isovalue) for each in surfaces]
        # A surface that lets all rays pass is not seen.
        clears = np.where([level in levels[:k] for k, level in enumerate(levels)], 1.0, clears)
        maps = [each.cells(tiles.run) for each in surfaces]
        # Kernels take a fixed number of maps: repeat the first.
        filled = tuple(maps + [maps[0]] * (MAX_SURFACES - len(maps)))
        sight = sight_of(view, field.spacing, walls)
        return cls(
            Shells(field, filled, np.array(levels), clears),
            view_pinhole(view, field.spacing),
            sight,
        )

    def through(self, x: np.ndarray, y: np.ndarray) -> tuple[Hits, np.ndarray]:
        """Cast rays through places (n,) of the picture; return their hits, with the numbers of
        the rays, and the share of light (n,) float64 that is left behind all of these.
        """
        corner, right, down = (np.array(each)[:, None] for each in self.camera[1:])
        directions = np.ascontiguousarray(corner + x * right + y * down)
        # Provide room for all layers of each ray, and a wall; keep as many rows as are filled.
        room = (MAX_PEELED_LAYERS + 1) * len(x)
        left = np.empty(len(x))
        sides, ranks = np.empty((2, room), np.int8)
        rays = np.empty(room, np.uint32)
        points = np.empty((room, 3), np.float32)
        peeled = Peeled(rays, points, sides, ranks, np.empty(room, np.float32))
        count = peel_rays(self.shells, self.sight, self.camera.eye, directions, peeled, left)
        return Hits(*(each[:count].copy() for each in peeled)), left

    def whole(self, view: View, tiles: Tiles) -> tuple[Hits, np.ndarray]:
        """Cast the rays of all pixels of a ``view``; return their hits, and the share (h, w)
        float32 of the light behind everything that passes. Raises Cancelled.
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
    """Return the layers of a ``side`` of a ``surface`` among the ``hits``, at least one, in the
    picture of the G-buffer ``first``.
    """
    (height, width) = first.shape
    rows = hits.rows_of(side)
    ranks = hits.ranks[rows]
    layers = int(ranks.max()) + 1
    # Sort the hits by layer: the k-th hit of a ray on this side is in layer k, whose picture lies
    # below those before.
    rows = np.concatenate([rows[ranks == rank] for rank in range(layers)])
    places = hits.pixels[rows] + hits.ranks[rows].astype(np.uint32) * np.uint32(height * width)
    shape = (layers * height, width)
    gbuffer = GBuffer(shape, first.spacing, first.eye, surface, places, hits.points[rows])
    return SideLayers(gbuffer, layers, hits.weights[rows])


def first_of(view: View, hits: Hits, surface: Surface) -> GBuffer:
    """Return the G-buffer of the surfaces in front, of the walls and of the faces of a window;
    ``surface`` is the one that slides.
    """
    spacing = surface.field.spacing
    # The first hit of each ray is in front.
    front = np.append(True, hits.pixels[1:] != hits.pixels[:-1])[: len(hits.pixels)]
    face = hits.sides == WINDOW_FACE
    wall = hits.sides >= FIRST_WALL_SIDE
    on = np.flatnonzero(front & ~face & ~wall)
    return GBuffer(
        (view.height, view.width),
        spacing,
        view_pinhole(view, spacing).eye,
        surface,
        hits.pixels[on],
        hits.points[on],
        walls=hits.others(np.flatnonzero(front & wall)),
        faces=hits.others(np.flatnonzero(face)),
    )


def walls_of(hits: Hits, first: GBuffer) -> tuple[GBuffer, SideLayers | None]:
    """Return the walls among the ``hits`` twice: as a picture that shows walls alone, to light
    them, and as a side of one layer, to add them up with the surfaces by their weights; None in
    place of the latter if there are no walls.

    One layer is enough, as a wall ends each ray that meets it. Both are for the picture of the
    G-buffer ``first``.
    """
    rows = hits.rows_of(WALLS_SIDE)
    seen = hits.others(rows)
    view = (first.shape, first.spacing, first.eye, first.surface)
    picture = GBuffer(*view, np.empty(0, np.uint32), np.empty((0, 3), np.float32), walls=seen)
    if not len(rows):
        return picture, None
    return picture, SideLayers(GBuffer(*view, seen.pixels, seen.points), 1, hits.weights[rows])
