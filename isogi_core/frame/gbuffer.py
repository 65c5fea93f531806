"""The G-buffer: the points at which the rays of pixels meet the isosurface. It is kept, so that
light can turn without new primary rays.
"""

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
"""Primary rays of a tile, which are cast together."""

POINTS = 4096
"""Surface points of a tile."""


@dataclass(frozen=True, eq=False)
class OtherPoints:
    """Points at which rays of a camera meet something other than the isosurface.

    - ``pixels`` (m,) uint32: picture indices, ascending.
    - ``points`` (m, 3) float32: in index space.
    - ``numbers`` (m,) int8: numbers of the walls that are met, or WINDOW_FACE on a face of a
      window.
    """

    pixels: np.ndarray
    points: np.ndarray
    numbers: np.ndarray

    @classmethod
    def none(cls) -> "OtherPoints":
        """Return no points."""
        return cls(np.empty(0, np.uint32), np.empty((0, 3), np.float32), np.empty(0, np.int8))

    def part(self, some: np.ndarray) -> "OtherPoints":
        """Return the points in ``some`` rows."""
        return OtherPoints(self.pixels[some], self.points[some], self.numbers[some])

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.pixels.nbytes + self.points.nbytes + self.numbers.nbytes


@dataclass(eq=False)
class GBuffer:
    """Points at which the rays of one camera meet a ``surface``.

    - ``shape``: height and width of the picture.
    - ``spacing``: world size of a voxel along x, y, z.
    - ``eye``: position of the camera, in index space.
    - ``pixels`` (m,) uint32: picture indices that show the surface, ascending.
    - ``points`` (m, 3) float32: hits of their rays, in index space.
    - ``walls``: points on walls; ``faces``: points on the faces that a window cuts into the solid.

    Normals and albedos are found when they are first asked for.
    """

    shape: tuple[int, int]
    spacing: Vector
    eye: Vector
    surface: Surface
    pixels: np.ndarray
    points: np.ndarray
    walls: OtherPoints = field(default_factory=OtherPoints.none)
    faces: OtherPoints = field(default_factory=OtherPoints.none)
    _shown: SurfacePoints | None = field(default=None, repr=False)
    _albedos: np.ndarray | None = field(default=None, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @classmethod
    def of_points(cls, surface: Surface, eye: Vector, points: np.ndarray) -> "GBuffer":
        """Return a picture of one row whose pixel i shows point i of ``points`` (m, 3); these
        and the ``eye`` are in index space.
        """
        pixels = np.arange(len(points), dtype=np.uint32)
        points = np.ascontiguousarray(points, np.float32)
        return cls((1, len(points)), surface.field.spacing, eye, surface, pixels, points)

    @property
    def isovalue(self) -> Isovalue:
        """The isovalue of the surface."""
        return self.surface.isovalue

    def shown(self, tiles: Tiles) -> SurfacePoints:
        """Return the points with their outward normals, found when first asked for. Raises
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
        """Return the outward unit world normals (m, 3) float32, found when first asked for.
        Raises Cancelled.
        """
        return self.shown(tiles).normals

    def albedos(self, colours: Colours, tiles: Tiles) -> np.ndarray:
        """Return the albedo of each point by the ``colours`` of the scene, (m, 3) float32, found
        when first asked for.

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
        """True if the picture shows the surface and nothing else."""
        return not len(self.walls.pixels) and not len(self.faces.pixels)

    @property
    def rows(self) -> np.ndarray:
        """The row of the point that each pixel shows, -1 off the surface; (h, w) int32."""
        return numbered(self.pixels, self.shape)

    def part(self, places: np.ndarray, tiles: Tiles) -> "GBuffer":
        """Return a G-buffer of the points in rows ``places`` (k,) alone, ascending. Raises
        Cancelled.
        """
        return self.of_these(self.shown(tiles).part(places))

    def of_these(self, shown: SurfacePoints, walls: OtherPoints | None = None) -> "GBuffer":
        """Return a G-buffer with the same camera, picture and surface, of the points ``shown``
        alone, whose pixels ascend, and of ``walls``: without faces, and without walls by default.
        """
        view = (self.shape, self.spacing, self.eye, self.surface)
        walls = walls or OtherPoints.none()
        return GBuffer(*view, shown.pixels, shown.points, walls, _shown=shown)

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes; normals are counted before they are found."""
        size = self.pixels.nbytes + 2 * self.points.nbytes + self.walls.nbytes + self.faces.nbytes
        if self._albedos is not None:
            size += self._albedos.nbytes
        return size

    @property
    def position(self) -> np.ndarray:
        """Coordinates in the volume's box of the point that each pixel shows, zero if it shows
        none; (h, w, 3) float32.
        """
        return self.positions(0, self.shape[0])

    def positions(self, first: int, last: int) -> np.ndarray:
        """Return ``position`` in the rows from ``first`` to ``last``; (last - first, w, 3)
        float32.
        """
        width = self.shape[1]
        rows = np.zeros(((last - first) * width, 3), np.float32)
        for each in (self, self.walls, self.faces):
            a, b = np.searchsorted(each.pixels, (first * width, last * width))
            points = each.points[a:b] * np.array(self.spacing, np.float32)
            rows[each.pixels[a:b] - first * width] = points
        return rows.reshape(last - first, width, 3)


def pinhole(camera: Camera, width: int, height: int, spacing: Vector) -> Pinhole:
    """Return the camera in index space for a picture of ``width`` × ``height`` pixels, row 0 at
    the top.
    """
    right, up, forward = camera.basis()
    pixel = camera.pixel_size(height)
    corner = forward - right * (pixel * width / 2.0) + up * (pixel * height / 2.0)
    return Pinhole(
        *(to_index(v, spacing) for v in (np.array(camera.eye), corner, right * pixel, -up * pixel))
    )


def view_pinhole(view: View, spacing: Vector) -> Pinhole:
    """Return the camera of a view in index space. A view may be a part of a larger picture: its
    camera begins at the first row and column of that part.
    """
    first, rows = view.whole
    before, columns = view.columns or (0, view.width)
    hole = pinhole(view.camera, columns, rows, spacing)
    x, y, z = (
        a + first * b + before * c
        for a, b, c in zip(hole.corner, hole.down, hole.right, strict=True)
    )
    return hole._replace(corner=(x, y, z))


def to_index(v: np.ndarray, spacing: Vector) -> Vector:
    """Return a world vector in index space, as a tuple for the kernels."""
    x, y, z = (float(a / s) for a, s in zip(v, spacing, strict=True))
    return x, y, z


def sight_of(view: View, spacing: Vector, walls: Walls | None) -> Sight:
    """Return everything besides the surface that rays of a ``view`` meet: ``walls`` and the
    planes of its window.
    """
    if view.window is None:
        planes = np.empty((0, 4))
    else:
        planes = view.window.in_index(spacing)
    return Sight(NO_WALLS if walls is None else walls, planes)


class Hits:
    """The hits of the rays of a picture, tile by tile: numbers of pixels, and points. Only hits
    take memory; rays that miss take none. Several threads may put tiles.
    """

    def __init__(self, count: int) -> None:
        """Start without hits, for ``count`` rays. The system gives memory to written pages only."""
        self._pixels = np.empty(count, np.uint32)
        self._points = np.empty((count, 3), np.float32)
        self._runs: dict[int, int] = {}

    def put(self, first: int, pixels: np.ndarray, points: np.ndarray) -> None:
        """Put the hits of the tile that begins with the ray ``first``."""
        last = first + len(pixels)
        self._pixels[first:last] = pixels
        self._points[first:last] = points
        self._runs[first] = len(pixels)

    @property
    def runs(self) -> list[tuple[int, int]]:
        """Return the first ray of each tile and the number of its hits, in the order of rays."""
        return sorted(self._runs.items())

    def joined(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixels (m,) uint32 and points (m, 3) float32 of all tiles, and keep none."""
        # Move the hits of each tile up to those before it, in place: a copy takes as much again.
        end = 0
        for first, count in self.runs:
            self._pixels[end : end + count] = self._pixels[first : first + count]
            self._points[end : end + count] = self._points[first : first + count]
            end += count
        self._pixels.resize(end, refcheck=False)
        self._points.resize((end, 3), refcheck=False)
        return self._pixels, self._points


def trace(view: View, surface: Surface, tiles: Tiles, walls: Walls | None = None) -> GBuffer:
    """Cast the primary rays of ``view`` at the ``surface`` that it shows, and at ``walls``.
    Raises Cancelled.
    """
    spacing = surface.field.spacing
    camera = view_pinhole(view, spacing)
    sight = sight_of(view, spacing, walls)
    traced = surface.traced(tiles.run)
    count = view.width * view.height
    surface_hits = Hits(count)
    others = Hits(count)
    numbers = np.empty(count, np.int8)

    # Each tile has arrays of its own, as the number of its hits is not known before.
    def _piece(a: int, b: int) -> None:
        pixels = np.empty((2, b - a), np.uint32)
        points = np.empty((2, b - a, 3), np.float32)
        met, met_others = trace_pixels(
            traced, sight, camera, a, view.width, pixels, points, numbers[a:b]
        )
        surface_hits.put(a, pixels[0, :met], points[0, :met])
        others.put(a, pixels[1, :met_others], points[1, :met_others])

    tiles.run(_piece, count, TILE_RAYS)
    # Join the tiles in the order of their pixels, whichever thread was first.
    numbers = np.concatenate([numbers[a : a + hits] for a, hits in others.runs])
    seen = OtherPoints(*others.joined(), numbers)
    shown = (view.height, view.width), spacing, camera.eye, surface, *surface_hits.joined()
    if view.window is None:
        return GBuffer(*shown, walls=seen)
    on_face = seen.numbers == WINDOW_FACE
    return GBuffer(*shown, walls=seen.part(~on_face), faces=seen.part(on_face))


def surface_key(view: View) -> tuple[Any, ...]:
    """Return the part of a cache key that names the surface in a picture: all that its G-buffer
    depends on.
    """
    size = view.width, view.height, view.strip, view.columns
    return view.isovalue, view.camera, *size, view.window


def numbered(pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the number of each of the ``pixels`` (k,) in a picture of this ``shape``, -1 in all
    others; (height, width) int32.
    """
    numbers = np.full(shape, -1, np.int32)
    numbers.reshape(-1)[pixels] = np.arange(len(pixels), dtype=np.int32)
    return numbers
