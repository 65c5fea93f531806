"""Fit a camera that turns about the middle of the surface: as near as shows all of it from
every side.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from isogi_core.files.vector import Vector, triple
from isogi_core.frame.renderer import Renderer
from isogi_core.model.choices import PROJECTIONS
from isogi_core.model.room import Wall, cornell_room
from isogi_core.model.view import View, orbit
from isogi_core.plan.isovalue_presets import BALL_DIRECTIONS
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import surfaces_of
from isogi_core.prepared.isosurface_mesh import outermost_points
from isogi_core.prepared.prepared_scene import PreparedScene

FILLED = 0.95
"""Share of the picture's height, or width, that the surface fills from the side where it is
largest.
"""

NEAREST = 0.05
"""Least distance of a fitted camera, in radii of the volume: a speck of a voxel or two is shown
with its surroundings.
"""


class Stand(NamedTuple):
    """A ``view`` in perspective, and the ``azimuth`` and ``elevation`` in the world from which
    its camera is to look, in degrees.
    """

    view: View
    azimuth: float
    elevation: float


def fitted(
    renderer: Renderer,
    view: View,
    azimuth: float,
    elevation: float,
    projection: str = PROJECTIONS[0],
) -> tuple[Vector, float] | None:
    """Return ``fitted_to_all`` of one view."""
    return fitted_to_all(renderer, [Stand(view, azimuth, elevation)], projection)


def fitted_to_all(
    renderer: Renderer, stands: Sequence[Stand], projection: str = PROJECTIONS[0]
) -> tuple[Vector, float] | None:
    """Return the world's target, and the distance from it in radii, at which all ``stands`` show
    their surfaces and glow whole from every azimuth, and walls from the azimuth of the stand, as
    rooms are looked into from one side; None if there is no surface.

    The target is the middle of all of that, for all views. Distance and target are for cameras with
    this ``projection``.
    """
    prepared = renderer.prepared
    scene = prepared.scene
    # Collect the points that decide: hulls of all surfaces, glow, and walls.
    isovalues = dict.fromkeys(stand.view.isovalue for stand in stands)
    surfaces = [surface_points(prepared, isovalue) for isovalue in isovalues]
    shown = np.concatenate(surfaces)
    if not len(shown):
        return None
    shown = np.concatenate([shown, glowing_points(prepared)])
    walls = wall_points(scene)
    everything = np.concatenate([shown, walls])
    middle = (everything.min(axis=0) + everything.max(axis=0)) / 2.0
    # How near points are to the camera adds to the distance in perspective, but not with parallel
    # rays.
    if projection == PROJECTIONS[0]:
        perspective = 1.0
    else:
        perspective = 0.0
    # The view that needs the largest distance decides.
    away = max(
        max(
            needed_around(shown - middle, stand, perspective),
            needed_from(walls - middle, stand, perspective),
        )
        for stand in stands
    )
    return triple(middle), max(away / scene.volume.radius, NEAREST)


def surface_points(prepared: PreparedScene, isovalue: float) -> np.ndarray:
    """Return world points (n, 3) that have the convex hull of all surfaces of a view at an
    ``isovalue``, in the units of the volume's file.
    """
    scene = prepared.scene
    found = [
        outermost_points(prepared.field, prepared.surface(each.isovalue).isovalue)
        for each in surfaces_of(scene, isovalue)
    ]
    points = np.concatenate(found) * np.array(scene.volume.spacing)
    return scene.volume.orientation.to_world(points)


def glowing_points(prepared: PreparedScene) -> np.ndarray:
    """Return world points (n, 3) whose convex hull contains all glow, and little more.

    Of a glow of a range of values it is the part of its box, or ball, that the isosurfaces at the
    ends of the range reach: a mist thins out long before the box ends.
    """
    volume = prepared.scene.volume
    glowing = prepared.scene.lighting.glowing
    spacing = np.array(volume.spacing)
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    found = [np.empty((0, 3))]
    for middle, half, ball, values in zip(
        glowing.middles, glowing.halves, glowing.round, glowing.ranges, strict=True
    ):
        # A range of values is bounded by the isosurfaces at its finite ends.
        ends = [
            outermost_points(prepared.field, volume.normalise_isovalue(volume.file_value(end)))
            for end in values
            if np.isfinite(end)
        ]
        # Otherwise the whole region of the glow counts, of which corners or directions stand for
        # all.
        if ends:
            region = np.clip(np.concatenate(ends) * spacing, middle - half, middle + half)
        else:
            region = middle + half * (BALL_DIRECTIONS if ball else corners)
        found.append(region)
    return volume.orientation.to_world(np.concatenate(found))


def wall_points(scene: Scene) -> np.ndarray:
    """Return the corners (n, 3) of the walls in the world, clipped to the cube that a Cornell
    room would be: a large floor does not push the camera away.
    """
    walls = corners_of(scene.lighting.room.walls)
    cube = corners_of(cornell_room(scene.volume))
    return np.clip(walls, cube.min(axis=0), cube.max(axis=0))


def corners_of(walls: Sequence[Wall]) -> np.ndarray:
    """Return the corners (n, 3) of ``walls``, in the world."""
    return np.array(
        [
            np.add(wall.corner, a * np.array(wall.edges[0]) + b * np.array(wall.edges[1]))
            for wall in walls
            for a, b in product((0.0, 1.0), repeat=2)
        ]
    ).reshape(-1, 3)


def slopes_of(view: View) -> tuple[float, float]:
    """Return the largest distances from the axis of a fitted camera, across and up, at which it
    sees points, per distance from the camera along the axis.
    """
    slope = FILLED * math.tan(math.radians(view.camera.fov) / 2.0)
    return slope * view.width / view.height, slope


def needed_around(points: np.ndarray, stand: Stand, perspective: float) -> float:
    """Return the least distance from the origin at which cameras at every azimuth, at the elevation
    e of a ``stand``, see ``points`` (n, 3).

    A point at radius r about the z axis and at height z, at the angle φ from the camera's azimuth,
    is n = r cos φ cos e + z sin e nearer to the camera than the origin, r sin φ across and z cos e
    - r cos φ sin e up. It is seen from at least n + |across| / s and n + |up| / t, with s and t
    from ``slopes_of``; the maximum of a cos φ + b sin φ over φ is √(a² + b²). ``perspective`` is 1,
    or 0 for a camera with parallel rays, which counts n as 0.
    """
    across, up = slopes_of(stand.view)
    e = math.radians(stand.elevation)
    cosine, sine = math.cos(e), math.sin(e)
    radius = np.hypot(points[:, 0], points[:, 1])
    height = points[:, 2]
    # The share of the radius and of the height by which a point is nearer to the camera.
    near_radius, near_height = perspective * cosine, perspective * sine
    # The largest distance of each point for the left and right edges of the picture, for its top,
    # and for its bottom.
    across_most = radius * math.hypot(near_radius, 1.0 / across) + near_height * height
    above = radius * abs(near_radius - sine / up) + height * (near_height + cosine / up)
    below = radius * abs(near_radius + sine / up) + height * (near_height - cosine / up)
    return float(max(each.max() for each in (across_most, above, below)))


def needed_from(points: np.ndarray, stand: Stand, perspective: float) -> float:
    """Return the least distance from the origin at which the camera of a ``stand``, at its azimuth
    and elevation, sees world ``points`` (n, 3) relative to the origin; 0 if there are none.

    A point is seen from at least n + |across| / s and n + |up| / t, if it is n nearer to the camera
    than the origin, with s and t from ``slopes_of``. ``perspective`` is 1, or 0 for a camera with
    parallel rays, which counts n as 0.
    """
    camera = orbit((0.0, 0.0, 0.0), 1.0, stand.azimuth, stand.elevation, 1.0, stand.view.camera.fov)
    right, up, forward = camera.basis()
    needed = [
        np.abs(points @ axis) / slope - perspective * (points @ forward)
        for axis, slope in zip((right, up), slopes_of(stand.view), strict=True)
    ]
    return float(np.max(needed, initial=0.0))
