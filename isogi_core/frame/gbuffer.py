"""The G-buffer: where each pixel's ray meets the isosurface. Light can turn without casting it again."""

import math
import threading
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from isogi_core.bake.recipe import Recipe
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.camera import Pinhole, trace_rows
from isogi_core.kernels.shading import find_normals
from isogi_core.model.view import Camera, View

ROWS = 16
"""Picture rows of a tile."""

POINTS = 4096
"""Surface points of a tile."""

Vector = tuple[float, float, float]


@dataclass(eq=False)
class GBuffer:
    """Surface points of one camera and isovalue.

    ``pixels`` (m,) int64 are the picture indices that show the surface, ascending; ``points`` (m, 3)
    float32 where they meet it, in index space; ``depth`` (m,) float32 along the view axis, world units.
    """

    shape: tuple[int, int]
    spacing: Vector
    eye: Vector
    isovalue: float
    pixels: np.ndarray
    points: np.ndarray
    depth: np.ndarray
    _normals: np.ndarray | None = field(default=None, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def normals(self, recipe: Recipe, tiles: Tiles, cancelled: threading.Event | None) -> np.ndarray:
        """Outward unit world normals (m, 3) float32, found when first asked for."""
        with self._lock:
            if self._normals is None:
                normals = np.empty_like(self.points)

                def _piece(a: int, b: int) -> None:
                    find_normals(recipe.field, self.points[a:b], self.eye, normals[a:b])

                tiles.run(_piece, len(self.points), POINTS, cancelled)
                self._normals = normals
            return self._normals

    @cached_property
    def position(self) -> np.ndarray:
        """World coordinates of the surface in each pixel, zero off the surface; (h, w, 3) float32."""
        return self.scatter(self.points * np.array(self.spacing, np.float32))

    def scatter(self, values: np.ndarray) -> np.ndarray:
        """A picture (h, w, …) of per-point ``values`` (m, …), zero off the surface."""
        picture = np.zeros((self.shape[0] * self.shape[1], *values.shape[1:]), values.dtype)
        picture[self.pixels] = values
        return picture.reshape(*self.shape, *values.shape[1:])


def pinhole(camera: Camera, width: int, height: int, spacing: Vector) -> Pinhole:
    """The camera in index space for a picture of ``width`` × ``height`` pixels, row 0 at the top."""
    right, up, forward = camera.basis()
    pixel = 2.0 * math.tan(math.radians(camera.fov) / 2.0) / height
    corner = forward - right * (pixel * width / 2.0) + up * (pixel * height / 2.0)
    return Pinhole(*(to_index(v, spacing) for v in (np.array(camera.eye), corner, right * pixel, -up * pixel)))


def to_index(v: np.ndarray, spacing: Vector) -> Vector:
    """A world vector in index space, as a tuple for the kernels."""
    x, y, z = (float(a / s) for a, s in zip(v, spacing, strict=True))
    return x, y, z


def trace(view: View, recipe: Recipe, tiles: Tiles, cancelled: threading.Event | None) -> GBuffer:
    """Cast the primary rays of ``view``."""
    volume = recipe.scene.volume
    isovalue = volume.normalise_isovalue(view.isovalue)
    camera = pinhole(view.camera, view.width, view.height, volume.spacing)
    depth = np.empty((view.height, view.width), np.float32)
    position = np.empty((view.height, view.width, 3), np.float32)

    def _piece(a: int, b: int) -> None:
        trace_rows(recipe.field, isovalue, camera, a, depth[a:b], position[a:b])

    tiles.run(_piece, view.height, ROWS, cancelled)
    pixels = np.flatnonzero(np.isfinite(depth))
    points = position.reshape(-1, 3)[pixels]
    return GBuffer(depth.shape, volume.spacing, camera.eye, isovalue, pixels, points, depth.ravel()[pixels])
