"""How a scene is seen at first: from where, and how bright.

The exposure belongs to the scene: pictures keep it while camera, light and isovalue move. It is found before any ray is
cast, from the light that the surface would have without shadows, whose brightest parts few shadows reach. Of 66
path-traced pictures, of 20 volumes and under 14 lights, the 98th percentile was 0.58 to 1.09 of the bare surface's; it
was 0.93 to 1.06 in four of five.
"""

import math
from typing import NamedTuple

import numpy as np

from isogi_core.kernels.transport.harmonics import cosine_lobe_factors
from isogi_core.model.environment import pixel_directions
from isogi_core.model.lights import Colour
from isogi_core.model.view import orbit
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.bands import evaluate_harmonics
from isogi_core.plan.range_sampling import CELLS_WAITED_FOR, edges_between, extremes_between, slopes_between

FRONT = (50.0, 25.0)
"""Azimuth and elevation from which a volume is seen that is as wide as it is deep."""

SKEW_AZIMUTHS = (20.0, 70.0)
"""Azimuths between which others are seen: of the longer they are, the more from the side."""

FACE_VIEW = (65.0, 15.0)
"""Azimuth and elevation for a patient, whose face is at azimuth 90."""

ROOM_VIEW = (90.0, 5.0)
"""Azimuth and elevation in a room, from its open side."""

MAX_NORMALS = 4096
"""Normals that stand for a surface, at most."""

BRIGHT_SHARE = 0.98
"""Share of the seen surface that shows its albedo or less."""

MAX_SHOWN_ALBEDO = 0.75
"""Highest albedo that is shown as it is: lighter surfaces are darkened to it, so that their highlights keep shape."""

FALL = 0.5
"""Least brightness that the front counts as having, of that on the brightest side of a ball: no turn of the camera ends
in white.
"""

BALL_DIRECTIONS = pixel_directions(16, 32).reshape(-1, 3)
"""Directions all around, (n, 3)."""


class SeenNormals(NamedTuple):
    """Outward unit ``normals`` (n, 3) of a surface in the volume's box, and how much each is seen of, (n,)."""

    normals: np.ndarray
    weights: np.ndarray


def front_of(volume: Volume, inside: bool) -> tuple[float, float]:
    """The azimuth and the elevation from which a ``volume`` is seen at first: its longer side lies across.

    ``inside`` a room it is seen from the open side.
    """
    if inside:
        return ROOM_VIEW
    if volume.orientation.letters:
        return FACE_VIEW
    (_, deep, wide), (x, y, _) = volume.shape, volume.spacing
    azimuth = FRONT[0] - 45.0 + math.degrees(math.atan2(wide * x, deep * y))
    return float(round(min(max(azimuth, SKEW_AZIMUTHS[0]), SKEW_AZIMUTHS[1]))), FRONT[1]


def find_seen(volume: Volume, level: Isovalue, front: tuple[float, float]) -> SeenNormals:
    """The normals of an isosurface that look to the ``front``, weighted by the area that is seen of them from there.

    Parts that others hide count, too. A ball stands for a surface that is not there.
    """
    towards = np.array(volume.orientation.direction_to_box(orbit((0.0, 0.0, 0.0), 1.0, *front, 1.0, 1.0).eye))
    found = surface_normals(volume, level)
    facing = found[found @ towards > 0.0]
    normals = facing[:: max(math.ceil(len(facing) / MAX_NORMALS), 1)] if len(facing) else BALL_DIRECTIONS
    weights = np.maximum(normals @ towards, 0.0) / (np.abs(normals) @ np.array(volume.spacing))
    return SeenNormals(normals, weights)


def surface_normals(volume: Volume, level: Isovalue) -> np.ndarray:
    """Outward unit normals (n, 3) of the cells that an isosurface passes, among about CELLS_WAITED_FOR cells."""
    step = max(math.ceil(math.sqrt(volume.voxels.size / CELLS_WAITED_FOR)), 1)
    found = [np.empty((0, 3))]
    for z in range(0, len(volume.voxels) - 1, step):
        edges = edges_between(volume.voxels[z], volume.voxels[z + 1], step)
        low, high = extremes_between(edges)
        passed = (low <= level) & (level < high)
        found.append(-np.stack([slope[passed] for slope in slopes_between(edges, volume.spacing)], axis=1))
    slopes = np.concatenate(found)
    lengths = np.linalg.norm(slopes, axis=1)
    sound = np.isfinite(lengths) & (lengths > 0.0)
    return np.asarray(slopes[sound] / lengths[sound, None])


def exposure_for(light: np.ndarray, albedo: Colour, seen: SeenNormals) -> float:
    """The exposure at which BRIGHT_SHARE of what is ``seen`` shows its ``albedo`` or less, and at most
    MAX_SHOWN_ALBEDO; three digits.

    ``light`` is all that shines on it, as harmonics, linear RGB (3, n²). The exposure is 1 where that is nothing.
    """
    tint = np.array(albedo) / max(albedo) if any(albedo) else np.ones(3)
    front = percentile(brightness(light, tint, seen.normals), seen.weights, BRIGHT_SHARE)
    white = max(front, FALL * float(brightness(light, tint, BALL_DIRECTIONS).max()))
    return float(f"{MAX_SHOWN_ALBEDO / max(*albedo, MAX_SHOWN_ALBEDO) / white:.3g}") if white > 0.0 else 1.0


def brightness(light: np.ndarray, tint: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The brightest channel of a surface of colour ``tint`` (3,) under a ``light``, without shadows: tint · E/π at each
    of the ``normals`` (n, 3); (n,).
    """
    order = math.isqrt(light.shape[1])
    x, y, z = normals.T
    bands = np.repeat(cosine_lobe_factors(order) / math.pi, 2 * np.arange(order) + 1)
    arriving = (light * bands) @ evaluate_harmonics(order, np.arctan2(np.hypot(x, y), z), np.arctan2(y, x))
    return np.asarray((tint[:, None] * arriving).max(axis=0))


def percentile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The least of ``values`` (n,) that a ``share`` of their ``weights`` (n,) does not exceed."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, share * below[-1])])
