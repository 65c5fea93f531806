"""One point of a frame: position, normal, value and light of the surface in a pixel."""

from dataclasses import dataclass

import numpy as np

from isogi_core.files.vector import Vector, triple
from isogi_core.frame.frame import STATE_CODES, Frame
from isogi_core.frame.framing import values_at
from isogi_core.kernels.shading.local_models import find_normals
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import surfaces_of


@dataclass(frozen=True)
class SurfacePoint:
    """The point that one pixel shows.

    - ``position``, ``normal``: world coordinates, and the outward unit normal.
    - ``voxel``: voxel indices, x first.
    - ``value``: the volume's value in the units of its file: the isovalue, or another on the face
      of a window; None on a wall.
    - ``wall``: number of the wall, if it is on one.
    - ``radiance``: linear RGB; ``state``: a name in STATE_CODES.
    - ``error``: relative error of the pixel, whatever its causes.
    """

    position: Vector
    normal: Vector
    voxel: Vector
    value: float | None
    wall: int | None
    radiance: Vector
    state: str
    error: float


def point_at(frame: Frame, column: int, row: int, scene: Scene) -> SurfacePoint | None:
    """Return the point in a ``column`` and a ``row`` of a ``frame``; None if the pixel shows
    nothing.
    """
    gbuffer = frame.gbuffer
    pixel = np.uint32(row * frame.state.shape[1] + column)
    wall = None
    value = None
    # A pixel shows the surface, a wall, or the face of a window: look for it in each list.
    if (place := place_of(gbuffer.pixels, pixel)) is not None:
        index = gbuffer.points[place]
        normal = surface_normal(frame, place)
        value = isovalue_at(frame, place, scene)
    elif (place := place_of(gbuffer.walls.pixels, pixel)) is not None:
        index = gbuffer.walls.points[place]
        wall = int(gbuffer.walls.numbers[place])
        normal = wall_normal(frame, index, scene.lighting.room.edges[wall])
    elif (place := place_of(gbuffer.faces.pixels, pixel)) is not None:
        index = gbuffer.faces.points[place]
        normal = face_normal(frame, index)
        value = float(values_at(scene.volume, index[None])[0])
    else:
        return None
    orientation = frame.view.orientation
    return SurfacePoint(
        position=triple(orientation.to_world(index.astype(np.float64) * gbuffer.spacing)),
        normal=triple(orientation.matrix @ normal),
        voxel=triple(index),
        value=value,
        wall=wall,
        radiance=triple(frame.radiance[row, column]),
        state=next(
            name for name, state in STATE_CODES.items() if state == frame.state[row, column]
        ),
        error=float(frame.total_error[row, column]),
    )


def isovalue_at(frame: Frame, place: int, scene: Scene) -> float:
    """Return the isovalue of the surface at a ``place`` of the G-buffer: that of the view, or
    of a pinned surface.
    """
    shown = frame.view.isovalue
    if not scene.surfaces.pinned:
        return shown
    # Of several surfaces it is the one with the isovalue nearest to the value there.
    value = float(values_at(scene.volume, frame.gbuffer.points[place : place + 1])[0])
    return min(
        (each.isovalue for each in surfaces_of(scene, shown)), key=lambda level: abs(level - value)
    )


def place_of(pixels: np.ndarray, pixel: np.uint32) -> int | None:
    """Return the position of a ``pixel`` in ascending ``pixels``; None if it is not among them."""
    place = int(np.searchsorted(pixels, pixel))
    if place < len(pixels) and pixels[place] == pixel:
        return place
    return None


def face_normal(frame: Frame, index: np.ndarray) -> np.ndarray:
    """Return the normal of the plane of the frame's window that is nearest to a point, towards
    the eye; in the volume's box.
    """
    if frame.view.window:
        planes = np.array(frame.view.window.planes)
    else:
        planes = np.empty((0, 4))
    heights = planes[:, :3] @ (index * frame.gbuffer.spacing) + planes[:, 3]
    return np.asarray(-planes[np.abs(heights).argmin(), :3])


def surface_normal(frame: Frame, place: int) -> np.ndarray:
    """Return the normal of the isosurface at a ``place`` of the G-buffer, in the volume's box;
    (3,) float64.
    """
    gbuffer = frame.gbuffer
    normals = np.empty((1, 3), np.float32)
    find_normals(gbuffer.surface.field, gbuffer.points[place : place + 1], gbuffer.eye, normals)
    return normals[0].astype(np.float64)


def wall_normal(frame: Frame, index: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the normal of the side of a wall with ``edges`` (2, 3) that the camera sees, in
    the volume's box.
    """
    normal = np.cross(*edges)
    towards = np.subtract(frame.gbuffer.eye, index) * frame.gbuffer.spacing
    return np.asarray(np.copysign(1.0, normal @ towards) * normal / np.linalg.norm(normal))
