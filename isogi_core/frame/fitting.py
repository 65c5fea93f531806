"""A camera as near as the shown surface fits."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from isogi_core.files.vector import Vector, triple
from isogi_core.frame.renderer import Renderer
from isogi_core.model.choices import PROJECTIONS
from isogi_core.model.glow import Glowing
from isogi_core.model.view import View, orbit

FITTED_SIDE = 96
"""Pixels along each side of the picture that finds the surface."""

FILLED = 0.9
"""Share of the picture's height, or width, that the surface fills."""

SPECKS = 0.003
"""Share of the surface's pixels that may be outside at each side: noise afar does not push the
camera away.
"""


MIN_SURFACE_PIXELS = 9
"""Pixels of a surface, at least, that tell how large it is: of one the camera would be at no
distance.
"""

SHALLOW = 0.05
"""How far apart cameras look, as a sine, for their pictures to tell how deep the middle lies."""


class Stand(NamedTuple):
    """A ``view`` in perspective, and the world's ``azimuth`` and ``elevation`` from which its
    camera is to look.
    """

    view: View
    azimuth: float
    elevation: float


class Cloud(NamedTuple):
    """What a picture is to show: ``points`` of the world (n, 3), along the ``axes`` (3, 3) of a
    camera, right, up and back; ``slopes`` are how far it looks aside, across and up, for each unit
    of depth.
    """

    points: np.ndarray
    axes: np.ndarray
    slopes: tuple[float, float]


def fitted(
    renderer: Renderer,
    view: View,
    azimuth: float,
    elevation: float,
    projection: str = PROJECTIONS[0],
) -> tuple[Vector, float] | None:
    """``fitted_to_all`` of one view."""
    return fitted_to_all(renderer, [Stand(view, azimuth, elevation)], projection)


def fitted_to_all(
    renderer: Renderer, stands: Sequence[Stand], projection: str = PROJECTIONS[0]
) -> tuple[Vector, float] | None:
    """The world's target and the distance from it, in radii, at which views show their surfaces
    whole and large, and balls and boxes beside these that glow. All views have the same, also where
    they look from many sides.

    Distance and target are for a camera with that ``projection``. None where no surface is to be
    seen, or too little of it. Raises Cancelled.
    """
    clouds = [cloud for stand in stands if (cloud := cloud_of(renderer, stand)) is not None]
    if not clouds:
        return None
    if projection == PROJECTIONS[0]:
        depth = 1.0
    else:
        depth = 0.0
    alike = all(
        np.allclose(each.axes, clouds[0].axes) and each.slopes == clouds[0].slopes
        for each in clouds
    )
    if alike:
        aim, away = nearest_ahead(clouds, depth)
    else:
        aim, away = nearest_around(clouds, depth)
    return triple(aim), away / renderer.prepared.scene.volume.radius


def cloud_of(renderer: Renderer, stand: Stand) -> Cloud | None:
    """What the picture of a ``stand`` is to show; None where that is nothing, or too little. Raises
    Cancelled.
    """
    scene = renderer.prepared.scene
    view = stand.view
    volume = scene.volume
    orientation = view.orientation
    fov = view.camera.fov
    across = math.tan(math.radians(fov) / 2.0) * min(1.0, view.width / view.height)
    away = math.hypot(1.0, 1.0 / across)
    # Look at the square in the middle of the picture, which has the whole volume in it: what a long
    # picture has besides is empty.
    angle = 2.0 * math.degrees(math.atan(across))
    afar = orbit(volume.world_centre, volume.radius, stand.azimuth, stand.elevation, away, angle)
    square = replace(view, camera=afar.in_box(orientation), width=FITTED_SIDE, height=FITTED_SIDE)
    seen = renderer.gbuffer(square)
    if len(seen.points) < MIN_SURFACE_PIXELS:
        return None
    right, up, forward = afar.basis()
    axes = np.stack([right, up, -forward])
    points = orientation.to_world(seen.points * np.array(seen.spacing))
    rims = orientation.to_world(rims_of(scene.lighting.glowing, axes @ orientation.matrix))
    points = np.vstack([points, np.repeat(rims, math.ceil(2.0 * SPECKS * len(points)), axis=0)])
    slope = FILLED * math.tan(math.radians(fov) / 2.0)
    return Cloud(points, axes, (slope * view.width / view.height, slope))


def rims_of(glowing: Glowing, axes: np.ndarray) -> np.ndarray:
    """Points at the rims of regions of which all glows, in the box, (n, 3): corners of boxes, ends
    of balls' diameters along the ``axes`` (3, 3).
    """
    rims = [np.empty((0, 3))]
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    for middle, half, ball, values in zip(
        glowing.middles, glowing.halves, glowing.round, glowing.ranges, strict=True
    ):
        if np.isinf(values).all():
            rims.append(middle + half * (np.vstack([axes, -axes]) if ball else corners))
    return np.concatenate(rims)


def nearest(points: np.ndarray, slopes: tuple[float, float]) -> tuple[np.ndarray, float]:
    """Where a camera that looks along -z aims, (3,), and its distance from there, so that it just
    sees all ``points``.

    From (p, q, d) it sees those of |x - p| ≤ s (d - z), s of ``slopes``, and of y likewise: what is
    greatest of s z + x and of s z - x gives p, and the least d. The aim is as deep as the middle of
    ``points`` (n, 3).
    """
    above, below = (
        [most(slope * points[:, 2] + sign * points[:, axis]) for axis, slope in enumerate(slopes)]
        for sign in (1, -1)
    )
    middle = float(np.median(points[:, 2]))
    away = max((a + b) / (2.0 * slope) for a, b, slope in zip(above, below, slopes, strict=True))
    return np.array(
        [(above[0] - below[0]) / 2.0, (above[1] - below[1]) / 2.0, middle]
    ), away - middle


def nearest_ahead(clouds: Sequence[Cloud], depth: float) -> tuple[np.ndarray, float]:
    """Where cameras that all look the same way aim, and their distance from there: ``nearest``, in
    the world.

    ``depth`` is 0 for a camera whose rays are parallel, to which depths do not matter.
    """
    axes = clouds[0].axes
    slopes = clouds[0].slopes
    points = np.vstack([cloud.points for cloud in clouds]) @ axes.T
    aim, away = nearest(points * [1.0, 1.0, depth], slopes)
    middle = float(np.median(points[:, 2]))
    return np.array([aim[0], aim[1], middle]) @ axes, away


def nearest_around(clouds: Sequence[Cloud], depth: float) -> tuple[np.ndarray, float]:
    """Where cameras that look from several sides aim, and the greatest distance that one of them
    needs from there.

    The aim is the point that all pictures together have nearest to their middles, by least squares;
    no deeper or nearer than the middle of the ``clouds`` where the pictures leave that open.
    """
    middle = np.median(np.vstack([cloud.points for cloud in clouds]), axis=0)
    rows = np.concatenate([cloud.axes[:2] for cloud in clouds])
    seen = [(cloud.points - middle) @ cloud.axes.T * [1.0, 1.0, depth] for cloud in clouds]
    wanted = np.concatenate(
        [nearest(x, cloud.slopes)[0][:2] for x, cloud in zip(seen, clouds, strict=True)]
    )
    off = np.linalg.lstsq(rows, wanted, SHALLOW)[0]
    needed = []
    for points, cloud in zip(seen, clouds, strict=True):
        x, y, z = (points - cloud.axes @ off * [1.0, 1.0, depth]).T
        needed += [
            most(z + np.abs(aside) / slope)
            for aside, slope in zip((x, y), cloud.slopes, strict=True)
        ]
    return middle + off, max(needed)


def most(values: np.ndarray) -> float:
    """The greatest of ``values`` (n,), a few specks aside."""
    return float(np.quantile(values, 1.0 - SPECKS))
