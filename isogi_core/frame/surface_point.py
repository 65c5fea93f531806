"""A point of a picture: what a frame knows of the surface in one of its pixels."""

from dataclasses import dataclass

import numpy as np

from isogi_core.frame.frame import STATES, Frame
from isogi_core.kernels.shading.local_models import find_normals
from isogi_core.model.orientation import triple
from isogi_core.model.room import Room
from isogi_core.model.view import Vec3


@dataclass(frozen=True)
class SurfacePoint:
    """What one pixel shows: ``position`` and outward unit ``normal``, world, and the ``voxel`` indices there, x first.

    ``wall`` is the number of the wall that is there in place of the isosurface. ``radiance`` is linear RGB, ``state``
    one of STATES, and ``error`` the relative error of the pixel, whatever its causes.
    """

    position: Vec3
    normal: Vec3
    voxel: Vec3
    wall: int | None
    radiance: Vec3
    state: str
    error: float


def point_at(frame: Frame, column: int, row: int, room: Room) -> SurfacePoint | None:
    """What the pixel in a ``column`` and a ``row`` of a ``frame`` shows, in a scene with that ``room``; None off it."""
    gbuffer, pixel = frame.gbuffer, np.uint32(row * frame.state.shape[1] + column)
    wall, place = None, int(np.searchsorted(gbuffer.pixels, pixel))
    if place < len(gbuffer.pixels) and gbuffer.pixels[place] == pixel:
        index, normal = gbuffer.points[place], surface_normal(frame, place)
    elif pixel in gbuffer.walls.pixels:
        place = int(np.searchsorted(gbuffer.walls.pixels, pixel))
        index, wall = gbuffer.walls.points[place], int(gbuffer.walls.numbers[place])
        normal = wall_normal(frame, index, room.edges[wall])
    else:
        return None
    orientation = frame.view.orientation
    return SurfacePoint(
        position=triple(orientation.to_world(index.astype(np.float64) * gbuffer.spacing)),
        normal=triple(orientation.matrix @ normal),
        voxel=triple(index),
        wall=wall,
        radiance=triple(frame.radiance[row, column]),
        state=next(name for name, state in STATES.items() if state == frame.state[row, column]),
        error=float(frame.total_error[row, column]),
    )


def surface_normal(frame: Frame, place: int) -> np.ndarray:
    """The normal of the isosurface, in the volume's box, at a ``place`` of the G-buffer; (3,) float64."""
    gbuffer, normals = frame.gbuffer, np.empty((1, 3), np.float32)
    find_normals(gbuffer.surface.field, gbuffer.points[place : place + 1], gbuffer.eye, normals)
    return normals[0].astype(np.float64)


def wall_normal(frame: Frame, index: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The normal, in the volume's box, of the side of a wall with these ``edges`` (2, 3) that the camera sees."""
    normal = np.cross(*edges)
    towards = np.subtract(frame.gbuffer.eye, index) * frame.gbuffer.spacing
    return np.asarray(np.copysign(1.0, normal @ towards) * normal / np.linalg.norm(normal))
