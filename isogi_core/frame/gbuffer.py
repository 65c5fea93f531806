"""The G-buffer: where each pixel's ray meets the isosurface. Light can turn without casting it
again.
"""

import math
import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from isogi_core.files.vector import Vector
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.local_models import find_normals
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.tracing.camera import NO_WALLS, WINDOW_FACE, Pinhole, Sight, trace_pixels
from isogi_core.kernels.tracing.walls import Walls
from isogi_core.kernels.transport.colours import Colours, fill_albedos
from isogi_core.model.view import Camera, View
from isogi_core.model.volume import Isovalue
from isogi_core.prepared.prepared_scene import Surface

TILE_RAYS = 4096
"""Primary rays of a tile: as many as are cast together."""

POINTS = 4096
"""Surface points of a tile."""


@dataclass(frozen=True, eq=False)
class PointsBeside:
    """Where rays of a camera meet what is beside the isosurface: ``pixels`` (m,) uint32, ascending,
    ``points`` (m, 3) float32 in index space, and the ``numbers`` (m,) int8 of the walls, or
    WINDOW_FACE on the faces of a window.
    """

    pixels: np.ndarray
    points: np.ndarray
    numbers: np.ndarray

    @classmethod
    def none(cls) -> "PointsBeside":
        """Nothing else is seen."""
        return cls(np.empty(0, np.uint32), np.empty((0, 3), np.float32), np.empty(0, np.int8))

    def part(self, some: np.ndarray) -> "PointsBeside":
        """The points in ``some`` rows."""
        return PointsBeside(self.pixels[some], self.points[some], self.numbers[some])

    @property
    def nbytes(self) -> int:
        """Bytes that they take."""
        return self.pixels.nbytes + self.points.nbytes + self.numbers.nbytes


@dataclass(eq=False)
class GBuffer:
    """Where the rays of one camera, whose ``eye`` is in index space, meet a ``surface``.

    ``shape`` (height, width) of the picture; ``pixels`` (m,) uint32 are the picture indices that
    show the surface, ascending; ``points`` (m, 3) float32 where they meet it, in index space.
    ``walls`` are seen beside it, and ``faces`` that a window opens in what is solid.
    """

    shape: tuple[int, int]
    spacing: Vector
    eye: Vector
    surface: Surface
    pixels: np.ndarray
    points: np.ndarray
    walls: PointsBeside = field(default_factory=PointsBeside.none)
    faces: PointsBeside = field(default_factory=PointsBeside.none)
    _shown: SurfacePoints | None = field(default=None, repr=False)
    _albedos: np.ndarray | None = field(default=None, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @classmethod
    def of_points(cls, surface: Surface, eye: Vector, points: np.ndarray) -> "GBuffer":
        """A picture of one row whose pixel i shows point i of ``points`` (m, 3), in index space;
        ``eye`` is so, too.
        """
        pixels = np.arange(len(points), dtype=np.uint32)
        places = np.ascontiguousarray(points, np.float32)
        return cls((1, len(points)), surface.field.spacing, eye, surface, pixels, places)

    @property
    def isovalue(self) -> Isovalue:
        """The surface's isovalue."""
        return self.surface.isovalue

    def shown(self, tiles: Tiles) -> SurfacePoints:
        """The points with their outward normals, which are found when first asked for. Raises
        Cancelled.
        """
        with self._lock:
            if self._shown is None:
                normals = np.empty_like(self.points)

                def _piece(a: int, b: int) -> None:
                    find_normals(self.surface.field, self.points[a:b], self.eye, normals[a:b])

                tiles.run(_piece, len(self.points), POINTS)
                self._shown = SurfacePoints(self.points, normals, self.pixels)
            return self._shown

    def normals(self, tiles: Tiles) -> np.ndarray:
        """Outward unit world normals (m, 3) float32, found when first asked for. Raises
        Cancelled.
        """
        return self.shown(tiles).normals

    def albedos(self, colours: Colours, tiles: Tiles) -> np.ndarray:
        """The albedo of each point by the scene's ``colours``, (m, 3) float32, found when first
        asked for.

        Raises Cancelled.
        """
        with self._lock:
            if self._albedos is None:
                albedos = np.empty_like(self.points)
                tiles.run(
                    lambda a, b: fill_albedos(colours, self.points[a:b], albedos[a:b]),
                    len(albedos),
                    POINTS,
                )
                self._albedos = albedos
            return self._albedos

    @property
    def alone(self) -> bool:
        """Whether every pixel that shows anything shows the surface."""
        return not len(self.walls.pixels) and not len(self.faces.pixels)

    @property
    def rows(self) -> np.ndarray:
        """The row of the point that each pixel shows, -1 off the surface; (h, w) int32."""
        rows = np.full(self.shape, -1, np.int32)
        rows.reshape(-1)[self.pixels] = np.arange(len(self.pixels), dtype=np.int32)
        return rows

    def part(self, places: np.ndarray, tiles: Tiles) -> "GBuffer":
        """A G-buffer of the points in rows ``places`` (k,) alone, ascending. Raises Cancelled."""
        return self.of_these(self.shown(tiles).part(places))

    def of_these(self, shown: SurfacePoints, walls: PointsBeside | None = None) -> "GBuffer":
        """A G-buffer like this of the points ``shown``, whose pixels ascend, and of ``walls``, if
        any.
        """
        place = (self.shape, self.spacing, self.eye, self.surface)
        beside = walls or PointsBeside.none()
        return GBuffer(*place, shown.pixels, shown.points, beside, _shown=shown)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes; normals are counted before they are found."""
        if self._albedos is None:
            albedos = 0
        else:
            albedos = self._albedos.nbytes
        return (
            self.pixels.nbytes
            + 2 * self.points.nbytes
            + albedos
            + self.walls.nbytes
            + self.faces.nbytes
        )

    @property
    def position(self) -> np.ndarray:
        """Coordinates, in the volume's box, of what is seen in each pixel, zero where nothing is;
        (h, w, 3) float32.
        """
        return self.positions(0, self.shape[0])

    def positions(self, first: int, last: int) -> np.ndarray:
        """``position`` in the rows from ``first`` to ``last``; (last - first, w, 3) float32."""
        width = self.shape[1]
        rows = np.zeros(((last - first) * width, 3), np.float32)
        for each in (self, self.walls, self.faces):
            a, b = np.searchsorted(each.pixels, (first * width, last * width))
            rows[each.pixels[a:b] - first * width] = each.points[a:b] * np.array(
                self.spacing, np.float32
            )
        return rows.reshape(last - first, width, 3)


def pinhole(camera: Camera, width: int, height: int, spacing: Vector) -> Pinhole:
    """The camera in index space for a picture of ``width`` × ``height`` pixels, row 0 at the
    top.
    """
    right, up, forward = camera.basis()
    pixel = 2.0 * math.tan(math.radians(camera.fov) / 2.0) / height
    corner = forward - right * (pixel * width / 2.0) + up * (pixel * height / 2.0)
    return Pinhole(
        *(to_index(v, spacing) for v in (np.array(camera.eye), corner, right * pixel, -up * pixel))
    )


def view_pinhole(view: View, spacing: Vector) -> Pinhole:
    """The camera of a view in index space, from the first row and column of its picture on."""
    first, rows = view.whole
    before, columns = view.columns or (0, view.width)
    hole = pinhole(view.camera, columns, rows, spacing)
    x, y, z = (
        a + first * b + before * c
        for a, b, c in zip(hole.corner, hole.down, hole.right, strict=True)
    )
    return hole._replace(corner=(x, y, z))


def to_index(v: np.ndarray, spacing: Vector) -> Vector:
    """A world vector in index space, as a tuple for the kernels."""
    x, y, z = (float(a / s) for a, s in zip(v, spacing, strict=True))
    return x, y, z


def sight_of(view: View, spacing: Vector, walls: Walls | None) -> Sight:
    """What rays of a ``view`` meet besides the surface: ``walls``, if any, and the planes of its
    window, if any.
    """
    if view.window is None:
        planes = np.empty((0, 4))
    else:
        planes = view.window.in_index(spacing)
    return Sight(NO_WALLS if walls is None else walls, planes)


class Hits:
    """What rays of a picture meet, tile by tile: numbers of pixels and points, in memory for those
    that meet something alone. Tiles may be put by several threads.
    """

    def __init__(self, count: int) -> None:
        """None yet, of ``count`` rays. The system has no memory for what is not written."""
        self._pixels = np.empty(count, np.uint32)
        self._points = np.empty((count, 3), np.float32)
        self._runs: dict[int, int] = {}

    def put(self, first: int, pixels: np.ndarray, points: np.ndarray) -> None:
        """The hits of a tile that begins with the ray ``first``."""
        last = first + len(pixels)
        self._pixels[first:last] = pixels
        self._points[first:last] = points
        self._runs[first] = len(pixels)

    @property
    def runs(self) -> list[tuple[int, int]]:
        """The first ray of each tile, and how many hits it has; tiles ascend."""
        return sorted(self._runs.items())

    def joined(self) -> tuple[np.ndarray, np.ndarray]:
        """The pixels (m,) uint32 and points (m, 3) float32 of all tiles; nothing is left here."""
        # Move each tile's hits up to those before it, in place: a copy would take as much again.
        end = 0
        for first, count in self.runs:
            self._pixels[end : end + count] = self._pixels[first : first + count]
            self._points[end : end + count] = self._points[first : first + count]
            end += count
        self._pixels.resize(end, refcheck=False)
        self._points.resize((end, 3), refcheck=False)
        return self._pixels, self._points


def trace(view: View, surface: Surface, tiles: Tiles, walls: Walls | None = None) -> GBuffer:
    """Cast the primary rays of ``view`` at the ``surface`` that it shows, and at ``walls``. Raises
    Cancelled.
    """
    spacing = surface.field.spacing
    camera = view_pinhole(view, spacing)
    sight = sight_of(view, spacing, walls)
    traced = surface.traced(tiles.run)
    count = view.width * view.height
    hits = Hits(count)
    beside = Hits(count)
    numbers = np.empty(count, np.int8)

    def _piece(a: int, b: int) -> None:
        pixels = np.empty((2, b - a), np.uint32)
        points = np.empty((2, b - a, 3), np.float32)
        here, there = trace_pixels(
            traced, sight, camera, a, view.width, pixels, points, numbers[a:b]
        )
        hits.put(a, pixels[0, :here], points[0, :here])
        beside.put(a, pixels[1, :there], points[1, :there])

    tiles.run(_piece, count, TILE_RAYS)
    numbers = np.concatenate([numbers[a : a + n] for a, n in beside.runs])
    seen = PointsBeside(*beside.joined(), numbers)
    shown = (view.height, view.width), spacing, camera.eye, surface, *hits.joined()
    if view.window is None:
        return GBuffer(*shown, walls=seen)
    on_face = seen.numbers == WINDOW_FACE
    return GBuffer(*shown, walls=seen.part(~on_face), faces=seen.part(on_face))


def surface_key(view: View) -> tuple[Any, ...]:
    """What the surface in a picture depends on."""
    part = view.strip, view.columns
    return view.isovalue, view.camera, view.width, view.height, *part, view.window
