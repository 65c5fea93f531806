"""A camera as near as the shown surface fits, from three quarters where nobody says from where."""

import math
from dataclasses import replace
from itertools import product

import numpy as np

from isogi_core.frame.renderer import Renderer
from isogi_core.model.glow import Glowing
from isogi_core.model.orientation import triple
from isogi_core.model.view import PROJECTIONS, Vec3, View, orbit
from isogi_core.plan.scene import Scene

SIDE = 96
"""Pixels along each side of the picture that finds the surface."""

FRONT = (50.0, 25.0)
"""Azimuth and elevation from which a volume is seen that is as wide as it is deep."""

ASKEW = (20.0, 70.0)
"""Azimuths between which others are seen: of the longer they are, the more from the side."""

FACE = (65.0, 15.0)
"""The same for a patient, whose face is at azimuth 90."""

INSIDE = (90.0, 5.0)
"""The same in a room, from its open side."""

FILLED = 0.9
"""Share of the picture's height, or width, that the surface fills."""

SPECKS = 0.003
"""Share of the surface's pixels that may be outside at each side: noise afar does not push the camera away."""


def front_of(scene: Scene) -> tuple[float, float]:
    """The azimuth and the elevation from which a ``scene`` is seen at first: its volume's longer side lies across."""
    volume = scene.volume
    if scene.room.any:
        return INSIDE
    if volume.orientation.letters:
        return FACE
    (_, deep, wide), (x, y, _) = volume.shape, volume.spacing
    azimuth = FRONT[0] - 45.0 + math.degrees(math.atan2(wide * x, deep * y))
    return float(round(min(max(azimuth, ASKEW[0]), ASKEW[1]))), FRONT[1]


def fitted(
    renderer: Renderer, view: View, azimuth: float, elevation: float, projection: str = PROJECTIONS[0]
) -> tuple[Vec3, float] | None:
    """The world's target and the distance from it, in radii, at which a ``view`` shows its surface whole and large, and
    balls and boxes beside it that glow.

    The view itself is in perspective; distance and target are for a camera with that ``projection``.
    None where no surface is to be seen. Raises Cancelled.
    """
    volume, orientation = renderer.prepared.scene.volume, view.orientation
    fov = view.camera.fov
    across = math.tan(math.radians(fov) / 2.0) * min(1.0, view.width / view.height)
    afar = orbit(volume.world_centre, volume.radius, azimuth, elevation, math.hypot(1.0, 1.0 / across), fov)
    high = max(SIDE, round(SIDE * view.height / view.width))
    wide = max(SIDE, round(SIDE * view.width / view.height))
    seen = renderer.gbuffer(replace(view, camera=afar.in_box(orientation), width=wide, height=high))
    if not len(seen.points):
        return None
    right, up, forward = afar.basis()
    axes = np.stack([right, up, -forward])
    points = orientation.to_world(seen.points * np.array(seen.spacing))
    rims = orientation.to_world(rims_of(renderer.prepared.scene.glowing, axes @ orientation.matrix))
    points = np.vstack([points, np.repeat(rims, math.ceil(2.0 * SPECKS * len(points)), axis=0)])
    slope = FILLED * math.tan(math.radians(fov) / 2.0)
    nearest_of = nearest if projection == PROJECTIONS[0] else nearest_beside
    aim, away = nearest_of(points @ axes.T, (slope * view.width / view.height, slope))
    return triple(aim @ axes), away / volume.radius


def rims_of(glowing: Glowing, axes: np.ndarray) -> np.ndarray:
    """Points at the rims of regions of which all glows, in the box, (n, 3): corners of boxes, ends of balls' diameters
    along the ``axes`` (3, 3).
    """
    rims = [np.empty((0, 3))]
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    for middle, half, ball, values in zip(glowing.middles, glowing.halves, glowing.round, glowing.ranges, strict=True):
        if np.isinf(values).all():
            rims.append(middle + half * (np.vstack([axes, -axes]) if ball else corners))
    return np.concatenate(rims)


def nearest(points: np.ndarray, slopes: tuple[float, float]) -> tuple[np.ndarray, float]:
    """Where a camera that looks along -z aims, (3,), and its distance from there, so that it just sees all ``points``.

    From (p, q, d) it sees those of |x - p| ≤ s (d - z), s of ``slopes``, and of y likewise: what is greatest of
    s z + x and of s z - x gives p, and the least d. The aim is as deep as the middle of ``points`` (n, 3).
    """
    above, below = (
        [most(slope * points[:, 2] + sign * points[:, axis]) for axis, slope in enumerate(slopes)] for sign in (1, -1)
    )
    middle = float(np.median(points[:, 2]))
    away = max((a + b) / (2.0 * slope) for a, b, slope in zip(above, below, slopes, strict=True))
    return np.array([(above[0] - below[0]) / 2.0, (above[1] - below[1]) / 2.0, middle]), away - middle


def nearest_beside(points: np.ndarray, slopes: tuple[float, float]) -> tuple[np.ndarray, float]:
    """The same for a camera whose rays are parallel: depths do not matter."""
    aim, away = nearest(points * [1.0, 1.0, 0.0], slopes)
    return np.array([aim[0], aim[1], float(np.median(points[:, 2]))]), away


def most(values: np.ndarray) -> float:
    """The greatest of ``values`` (n,), a few specks aside."""
    return float(np.quantile(values, 1.0 - SPECKS))
