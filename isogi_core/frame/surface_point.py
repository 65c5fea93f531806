"""One point of a frame: position, normal and value of what a pixel shows."""

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
    """What one pixel shows: ``position`` and outward unit ``normal``, world, and the ``voxel``
    indices there, x first.

    ``value`` is the volume's there, in the units of its file: the isovalue, or another where a
    window shows a face. On a wall it is None, and ``wall`` its number. ``radiance`` is linear RGB,
    ``state`` one of STATE_CODES, and ``error`` the relative error of the pixel, whatever its
    causes.
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
    """What the pixel in a ``column`` and a ``row`` of a ``frame`` of a ``scene`` shows; None where
    nothing is.
    """
    gbuffer = frame.gbuffer
    pixel = np.uint32(row * frame.state.shape[1] + column)
    wall = None
    value = None
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
    """The isovalue of what is in front at a ``place`` of the G-buffer: that of the view, or of a
    pinned surface.
    """
    shown = frame.view.isovalue
    if not scene.surfaces.pinned:
        return shown
    value = float(values_at(scene.volume, frame.gbuffer.points[place : place + 1])[0])
    return min(
        (each.isovalue for each in surfaces_of(scene, shown)), key=lambda level: abs(level - value)
    )


def place_of(pixels: np.ndarray, pixel: np.uint32) -> int | None:
    """Where a ``pixel`` is among ascending ``pixels``; None where it is not."""
    place = int(np.searchsorted(pixels, pixel))
    if place < len(pixels) and pixels[place] == pixel:
        return place
    return None


def face_normal(frame: Frame, index: np.ndarray) -> np.ndarray:
    """The normal, in the volume's box, of the plane of the frame's window that is nearest to a
    point: towards the eye from what is left.
    """
    if frame.view.window:
        planes = np.array(frame.view.window.planes)
    else:
        planes = np.empty((0, 4))
    heights = planes[:, :3] @ (index * frame.gbuffer.spacing) + planes[:, 3]
    return np.asarray(-planes[np.abs(heights).argmin(), :3])


def surface_normal(frame: Frame, place: int) -> np.ndarray:
    """The normal of the isosurface, in the volume's box, at a ``place`` of the G-buffer; (3,)
    float64.
    """
    gbuffer = frame.gbuffer
    normals = np.empty((1, 3), np.float32)
    find_normals(gbuffer.surface.field, gbuffer.points[place : place + 1], gbuffer.eye, normals)
    return normals[0].astype(np.float64)


def wall_normal(frame: Frame, index: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The normal, in the volume's box, of the side of a wall with these ``edges`` (2, 3) that the
    camera sees.
    """
    normal = np.cross(*edges)
    towards = np.subtract(frame.gbuffer.eye, index) * frame.gbuffer.spacing
    return np.asarray(np.copysign(1.0, normal @ towards) * normal / np.linalg.norm(normal))
