"""Rooms of a few walls, with one surface or several, and starts of paths in them, as the kernels
take them.
"""

import numpy as np

from isogi_core.kernels.tracing.peels import MAX_SURFACES
from isogi_core.kernels.tracing.walls import Walls
from isogi_core.kernels.transport.colours import NO_COLOURS
from isogi_core.kernels.transport.light_paths import Surroundings
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.kernels.transport.room_paths import InRoom, Room, light_in_room
from isogi_core.kernels.transport.surface_paths import Among, Surfaces
from tests.kernels.fields import cells_of

X, Y, Z = np.eye(3)


def wall(corner, u, v, albedo=0.0, radiance=0.0, twofold=False):
    """A wall as ``room_of`` takes it."""
    return corner, (u, v), albedo, radiance, twofold


def box(side, albedo=0.0, radiance=0.0):
    """The six walls of a cube from 0 to ``side``, lit inside: x low and high, y, z."""
    a, b, c = side * np.eye(3)
    low = np.zeros(3)
    high = np.full(3, side)
    faces = [(low, b, c), (high, -c, -b), (low, c, a), (high, -a, -c), (low, a, b), (high, -b, -a)]
    return [wall(*face, albedo, radiance) for face in faces]


def room_of(walls, spacing=(1.0, 1.0, 1.0), albedo=0.0, colours=NO_COLOURS):
    """The room that some walls of the world make about an isosurface."""
    corners = np.array([each[0] for each in walls], float)
    edges = np.array([each[1] for each in walls], float)
    corners = corners.reshape(-1, 3)
    edges = edges.reshape(-1, 2, 3)
    normals = np.cross(edges[:, 0], edges[:, 1])
    areas = np.linalg.norm(normals, axis=1)
    normals /= areas[:, None]
    across = edges / (edges**2).sum(axis=2, keepdims=True) * np.array(spacing)
    kept = Walls(corners / spacing, normals * spacing, across, np.full(len(walls), np.inf))
    albedos, radiances = (
        np.array([np.full(3, each[i]) for each in walls]).reshape(-1, 3) for i in (2, 3)
    )
    twofold = np.array([each[4] for each in walls], float)
    return Room(
        kept,
        corners,
        edges,
        normals,
        areas,
        albedos,
        radiances,
        twofold,
        np.full(3, albedo),
        colours,
    )


def among(field, own, others, albedos, clears, transmissions=None, walls=()):
    """The surfaces of a ``field`` at ``own`` and some ``others``, with an albedo and a share that
    passes each.

    They are among ``walls``. Albedos and transmissions are numbers or linear RGB.
    """
    maps = [cells_of(field, each) for each in (own, *others)]
    cells = (*maps, *[maps[0]] * (MAX_SURFACES - len(maps)))
    back, through = (
        np.array([np.broadcast_to(each, 3) for each in given], float)
        for given in (albedos, transmissions or [0.0] * len(albedos))
    )
    levels = np.array([own, *others], float)
    surfaces = Surfaces(cells, levels, back, np.array(clears, float), through)
    return Among(field, surfaces, room_of(walls, field.spacing))


def sky(radiance):
    """The same light from everywhere."""
    return Surroundings(np.full(3, radiance), np.zeros((1, 1, 3), np.float32), np.eye(3))


def starts_in(field, points, normals, walls):
    """Starts at world points with normals (g, 3), on walls by number or on the isosurface 0
    (-1).
    """
    here, around = (
        np.ascontiguousarray(each.T)
        for each in (np.divide(points, field.spacing), np.array(normals, float))
    )
    g = len(points)
    return PathStarts(
        here, around, np.zeros(g), np.arange(1, g + 1, dtype=np.uint64), np.array(walls, float)
    )


def gather(field, room, starts, samples, bounces=0, light=None, survival=1.0):
    """E/π (g, 3) at ``starts``: see ``starts_in``."""
    starts = starts_in(field, *starts)
    rules = PathRules(np.ones((bounces + 1, 3)), survival)
    sums = np.zeros(starts.points.T.shape)
    cells = cells_of(field, 0.0)
    light_in_room(
        InRoom(field, cells, room), starts, SampleRange(0, samples), rules, light or sky(0.0), sums
    )
    return sums / samples
