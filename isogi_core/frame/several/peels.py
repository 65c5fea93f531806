"""Depth peels: all surfaces that the rays of a camera meet, front to back, until what is behind hardly counts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isogi_core.frame.gbuffer import RAYS, GBuffer, view_pinhole
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.tracing.camera import Pinhole
from isogi_core.kernels.tracing.cast import TracedSurface, cast_rays
from isogi_core.kernels.tracing.intersect import SOLID, UNKNOWN
from isogi_core.model.surfaces import LAYERS
from isogi_core.model.view import View
from isogi_core.plan.sides import Side
from isogi_core.prepared.surface import Surface

LEAST = 1.0 / 512.0
"""Share of a pixel's light below which what lies behind is left out."""


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays meet surfaces, ray by ray and front to back, (n,) each.

    They are the picture indices of ``pixels``, ``points`` (n, 3) float32 in index space, the surfaces' ``numbers``,
    whether their ``inner`` side is seen, and the share of the pixel's light that comes from there, ``weights``.
    """

    pixels: np.ndarray
    points: np.ndarray
    numbers: np.ndarray
    inner: np.ndarray
    weights: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["Hits"]) -> "Hits":
        """Those of several sets of rays."""
        names = ("pixels", "points", "numbers", "inner", "weights")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True, eq=False)
class SideLayers:
    """What a picture shows of one side, layer behind layer, as one tall picture: a G-buffer of so many ``layers``.

    ``weights`` (m,) float32 are the shares of their pixels' light that its points have.
    """

    gbuffer: GBuffer
    layers: int
    weights: np.ndarray

    @property
    def pixels(self) -> np.ndarray:
        """The picture indices of its points."""
        height, width = self.gbuffer.shape
        return np.asarray(self.gbuffer.pixels % (height // self.layers * width))


@dataclass(frozen=True, eq=False)
class Peels:
    """All that a view shows: its ``sides``, in what is ``first`` the surfaces in front of all others, and the share
    ``left`` (h, w) float32 of what lies behind everything.
    """

    first: GBuffer
    sides: Mapping[Side, SideLayers]
    left: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that they take."""
        layers = sum(each.gbuffer.nbytes + each.weights.nbytes for each in self.sides.values())
        return self.first.nbytes + layers + self.left.nbytes


def directions_of(camera: Pinhole, numbers: np.ndarray, width: int) -> np.ndarray:
    """Directions (3, n), in index space per unit of depth, through the middles of pixels of these ``numbers``."""
    x, y = numbers % width + 0.5, numbers // width + 0.5
    corner, right, down = (np.array(each)[:, None] for each in (camera.corner, camera.right, camera.down))
    return np.ascontiguousarray(corner + x * right + y * down)


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays from the ``eye`` in ``directions`` (3, n) at the ``surfaces``, of which the shares ``clears`` pass."""

    surfaces: Sequence[TracedSurface]
    clears: np.ndarray
    eye: np.ndarray
    directions: np.ndarray

    def crossings(self, number: int, some: np.ndarray, t: np.ndarray, came: np.ndarray) -> None:
        """Write the next crossings of ``some`` rays with a surface to ``t`` and ``came`` (n,), which hold the last."""
        surface, start = self.surfaces[number], np.where(np.isfinite(t[some]), t[some], 0.0)
        directions = np.ascontiguousarray(self.directions[:, some])
        origins = self.eye[:, None] + start * directions
        found, sides = np.empty(len(some)), np.empty(len(some), np.int8)
        levels = np.full(len(some), surface.isovalue)
        cast_rays(surface.field, surface.cells, levels, origins, directions, -came[some], found, sides)
        t[some], came[some] = start + found, sides

    def layers(self, left: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Rays that meet something, ways, surfaces, sides, weights: layer by layer; ``left`` (n,) is reduced."""
        shape = len(self.surfaces), self.directions.shape[1]
        t, came, opaque = np.full(shape, np.nan), np.full(shape, UNKNOWN, np.int8), self.clears <= 0.0
        for number in range(shape[0]):
            self.crossings(number, np.arange(shape[1]), t[number], came[number])
        for layer in range(LAYERS):
            ways = t if layer < LAYERS - 1 else np.where(opaque[:, None], t, np.inf)
            met = ways.argmin(axis=0)
            way = np.take_along_axis(ways, met[None], 0)[0]
            rays = np.flatnonzero((way < np.inf) & (left > 0.0))
            numbers = met[rays]
            weights = left[rays] * (1.0 - self.clears[numbers])
            yield rays, way[rays], numbers, came[numbers, rays], weights
            left[rays] *= self.clears[numbers]
            left[left < LEAST] = 0.0
            for number in np.unique(numbers):
                some = rays[(numbers == number) & (left[rays] > 0.0)]
                self.crossings(int(number), some, t[number], came[number])

    def hits(self, pixels: np.ndarray, left: np.ndarray) -> Hits:
        """All that the rays of ``pixels`` (n,) meet; ``left`` (n,) is reduced to what is seen behind that."""
        found = [np.concatenate(each) for each in zip(*self.layers(left), strict=True)]
        order = np.argsort(found[0], kind="stable")
        rays, ways, numbers, came, weights = (each[order] for each in found)
        points = (self.eye[:, None] + ways * self.directions[:, rays]).T.astype(np.float32)
        counted = weights > 0.0
        every = pixels[rays], points, numbers.astype(np.int8), came == SOLID, weights.astype(np.float32)
        return Hits(*(each[counted] for each in every))


def peel(view: View, surfaces: Sequence[Surface], clears: np.ndarray, tiles: Tiles) -> tuple[Hits, np.ndarray]:
    """All that a view shows of some ``surfaces``, and the share (h, w) float32 of what is behind. Raises Cancelled.

    A surface at the isovalue of one before it is that one: it is left out.
    """
    spacing, count = surfaces[0].field.spacing, view.width * view.height
    levels = [float(each.isovalue) for each in surfaces]
    clears = np.where([level in levels[:k] for k, level in enumerate(levels)], 1.0, clears)
    camera, traced = view_pinhole(view, spacing), [each.traced(tiles.run) for each in surfaces]
    found, left = dict[int, Hits](), np.ones(count)

    def _piece(a: int, b: int) -> None:
        pixels = np.arange(a, b)
        rays = Rays(traced, clears, np.array(camera.eye), directions_of(camera, pixels, view.width))
        found[a] = rays.hits(pixels.astype(np.uint32), left[a:b])

    tiles.run(_piece, count, RAYS)
    hits = Hits.joined([found[a] for a in sorted(found)])
    return hits, left.reshape(view.height, view.width).astype(np.float32)


def layers_of(hits: Hits, some: np.ndarray, first: GBuffer, surface: Surface) -> SideLayers:
    """Those of ``some`` hits, of one side of a ``surface``, as layers of the picture that ``first`` is of."""
    height, width = first.shape
    pixels = hits.pixels[some].astype(np.int64)
    starts = np.flatnonzero(np.append(True, pixels[1:] != pixels[:-1]))
    ranks = np.arange(len(pixels)) - np.repeat(starts, np.diff(np.append(starts, len(pixels))))
    layers, places = int(ranks.max()) + 1, ranks * (height * width) + pixels
    order = np.argsort(places)
    rows = np.flatnonzero(some)[order]
    shown = (layers * height, width), first.spacing, first.eye, surface
    gbuffer = GBuffer(*shown, places[order].astype(np.uint32), np.ascontiguousarray(hits.points[rows]))
    return SideLayers(gbuffer, layers, hits.weights[rows])


def first_of(view: View, hits: Hits, surface: Surface) -> GBuffer:
    """The G-buffer of what is in front; it has the ``surface`` of the one that slides."""
    spacing = surface.field.spacing
    eye = view_pinhole(view, spacing).eye
    front = np.append(True, hits.pixels[1:] != hits.pixels[:-1])[: len(hits.pixels)]
    points = np.ascontiguousarray(hits.points[front])
    return GBuffer((view.height, view.width), spacing, eye, surface, hits.pixels[front], points)
