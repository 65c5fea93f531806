"""Environments by formula: surroundings that need no file, for scenes and views that name one.

``overcast`` is the standard overcast sky of Moon and Spencer 1942 (CIE S 011), ``noon`` and ``evening`` are clear skies
after Preetham et al. 1999 (see ``sky``). ``studio`` is a dim room with two soft boxes, ``gallery`` a white one with two
skylights; both are boxes seen from a point in them.
"""

import math
from collections.abc import Callable

import numpy as np

from isogi_core.model.lights import ENVIRONMENTS, EnvironmentLight, SkyLight
from isogi_core.model.sky import LUMINANCE_WEIGHTS, sky_image

GROUND = 0.3
"""What the ground under an overcast sky reflects."""

NOON = SkyLight(sun_azimuth=100.0, sun_elevation=62.0, turbidity=2.5)
EVENING = SkyLight(sun_azimuth=20.0, sun_elevation=9.0, turbidity=4.5, ground=(0.3, 0.27, 0.23))

SOFT_BOXES = (
    ((5.0, 42.0), (30.0, 26.0), (17.0, 16.2, 15.0)),
    ((125.0, 18.0), (20.0, 30.0), (4.2, 4.6, 5.2)),
)
"""The soft boxes of the studio: azimuth and elevation of the middle, half width and half height in degrees, radiance:
a large warm one before and above, a dimmer cool one to the side."""

EDGE_DEGREES = 4.0
"""Degrees over which a soft box fades at its edges."""

Image = np.ndarray


def environment_image(light: EnvironmentLight, directions: np.ndarray, solid_angles: np.ndarray) -> Image:
    """Radiance (h, w, 3) float64 of a named environment in unit ``directions`` (h, w, 3), z up.

    ``solid_angles`` (h, w), steradians, say what each direction stands for. The mean luminance over the sphere is 1.
    """
    image = FORMULAS[light.environment](directions, solid_angles)
    return np.asarray(image * (np.sum(solid_angles) / np.sum(solid_angles * (image @ LUMINANCE_WEIGHTS))))


def overcast(directions: np.ndarray, solid_angles: np.ndarray) -> Image:
    """L = Lz (1 + 2 sin θ)/3 at the elevation θ, over a ground that reflects GROUND of it: E = 7π/9 Lz."""
    height = directions[..., 2]
    sky = (1.0 + 2.0 * height) / 3.0
    grey = np.where(height > 0.0, sky, GROUND * 7.0 / 9.0)
    return np.repeat(grey[..., None], 3, axis=-1)


def studio(directions: np.ndarray, solid_angles: np.ndarray) -> Image:
    """A dim grey room, darker towards the floor, and SOFT_BOXES that fade over EDGE_DEGREES degrees at their edges."""
    height = directions[..., 2]
    room = 0.16 + 0.12 * height
    image = np.repeat(room[..., None], 3, axis=-1)
    for (azimuth, elevation), half, radiance in SOFT_BOXES:
        image += _box(directions, azimuth, elevation, half)[..., None] * np.array(radiance)
    return image


def _box(directions: np.ndarray, azimuth: float, elevation: float, half: tuple[float, float]) -> np.ndarray:
    """How much of a soft box is seen in each direction, from 0 to 1: a rectangle of a plane that faces the middle."""
    turn, tilt = math.radians(azimuth), math.radians(elevation)
    towards = np.array([math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt)])
    right = np.array([-math.sin(turn), math.cos(turn), 0.0])
    before = directions @ towards
    across, along = (
        np.degrees(np.arctan2(np.abs(directions @ axis), before)) for axis in (right, np.cross(towards, right))
    )
    inside = [
        np.clip((size - angle) / EDGE_DEGREES + 0.5, 0.0, 1.0)
        for size, angle in zip(half, (across, along), strict=True)
    ]
    return np.where(before > 0.0, inside[0] * inside[1], 0.0)


GALLERY_HALF_SIZES = (3.0, 2.2, 1.0)
"""Half sizes of the gallery along x, y and z, seen from its middle."""

SKYLIGHTS = (0.4, 1.4)
"""From where to where along y, to either side, its ceiling is of glass; along x it is so from wall to wall."""

WALL_RADIANCE, CEILING_RADIANCE, FLOOR_RADIANCE, GLASS_RADIANCE = (
    (0.62, 0.60, 0.57),
    (0.5, 0.5, 0.49),
    (0.30, 0.22, 0.15),
    (3.6, 3.8, 4.1),
)
"""Radiances, linear RGB: white walls, a ceiling, a wooden floor, and the sky through the glass."""


def gallery(directions: np.ndarray, solid_angles: np.ndarray) -> Image:
    """A white room under two skylights: what a box reflects and lets in, seen from its middle."""
    size = np.array(GALLERY_HALF_SIZES)
    with np.errstate(divide="ignore"):
        reach = size / np.abs(directions)
    face = reach.argmin(axis=-1)
    points = directions * reach.min(axis=-1)[..., None]
    up = points[..., 2]
    image = np.array(WALL_RADIANCE) * (0.75 + 0.25 * up / GALLERY_HALF_SIZES[2])[..., None]
    image[(face == 2) & (up < 0.0)] = FLOOR_RADIANCE
    image[(face == 2) & (up > 0.0)] = CEILING_RADIANCE
    aside = np.abs(points[..., 1])
    image[(face == 2) & (up > 0.0) & (aside > SKYLIGHTS[0]) & (aside < SKYLIGHTS[1])] = GLASS_RADIANCE
    return image


def _clear(light: SkyLight) -> "Formula":
    """A clear sky as a formula."""
    return lambda directions, solid_angles: sky_image(light, directions, solid_angles)


Formula = Callable[[np.ndarray, np.ndarray], Image]

FORMULAS: dict[str, Formula] = dict(
    zip(ENVIRONMENTS, (overcast, studio, _clear(NOON), _clear(EVENING), gallery), strict=True)
)
"""The image of each environment, up to a factor, from directions (h, w, 3) and solid angles (h, w)."""
