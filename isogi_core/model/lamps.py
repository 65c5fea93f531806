"""The lamps of a scene as one: what the kernels take, and what they are to one who sees them from afar."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from isogi_core.kernels.lamps import AREA, DIRECTIONAL, POINT, LampArrays, project_lamps
from isogi_core.model.lights import AreaLight, DirectionalLight, Lamp, Light, PointLight, Vector
from isogi_core.model.sky import LUMINANCE

Row = tuple[int, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Lamps:
    """All lamps of a scene, in its order. ``arrays`` are for the kernels, ``digest`` is a hex name of them."""

    arrays: LampArrays
    digest: str

    @property
    def any(self) -> bool:
        """Whether there is a lamp at all."""
        return len(self.arrays.kinds) > 0

    def seen_from(self, point: Vector, least: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Unit directions (k, 3) from a world point to the lamps, and the irradiance (k, 3) of what faces them there.

        Unshadowed; an area light stands in its own middle, and is dark from behind. A lamp within the distance
        ``least`` counts as if it were that far and faced the point; one at the point itself has direction 0.
        """
        kinds, places, edges, colours = self.arrays
        near = kinds != DIRECTIONAL
        away = np.where(near[:, None], places + edges.sum(axis=1) / 2 - point, places)
        distance = np.linalg.norm(away, axis=1)
        clamped = np.maximum(distance, least)
        with np.errstate(divide="ignore", invalid="ignore"):
            towards = np.nan_to_num(away / distance[:, None])
            spread = np.where(near & (clamped > 0.0), clamped**-2.0, ~near)
        normals = np.cross(edges[:, 0], edges[:, 1])
        facing = np.maximum(-(towards * normals).sum(axis=1), 0.0)
        facing = np.where(distance < least, np.linalg.norm(normals, axis=1), facing)
        return towards, math.pi * colours * (spread * np.where(kinds == AREA, facing, 1.0))[:, None]

    def approximate(self, order: int, centre: Vector, radius: float) -> np.ndarray:
        """SH coefficients (3, n²) float64 of the lamps as if each were infinitely far from ``centre``: Σ E Y_i(d).

        Lamps within ``radius`` are taken as that far. One at the centre itself shines from all sides alike.
        """
        coefficients = np.zeros((3, order**2))
        if self.any:
            directions, irradiances = self.seen_from(centre, radius)
            beside = directions.any(axis=1)
            project_lamps(order, directions[beside], irradiances[beside], coefficients)
            coefficients[:, 0] += irradiances[~beside].sum(axis=0) / math.sqrt(4.0 * math.pi)
        return coefficients

    def brightest(self, centre: Vector, radius: float) -> float:
        """Irradiance over π, in luminance, of an unshadowed surface at ``centre`` turned to the best of the lamps.

        Lamps within ``radius`` are taken as that far: what is lit has that size, and most of it is farther away.
        """
        directions, irradiances = self.seen_from(centre, radius)
        facing = np.maximum(directions @ directions.T, 0.0)
        np.fill_diagonal(facing, 1.0)
        return float((facing @ (irradiances @ LUMINANCE)).max(initial=0.0)) / math.pi


def gather_lamps(lights: Sequence[Light]) -> Lamps:
    """The lamps among the lights."""
    rows = [_row(light) for light in lights if isinstance(light, Lamp)]
    arrays = LampArrays(
        np.array([row[0] for row in rows], np.int8),
        np.array([row[1] for row in rows], np.float64).reshape(-1, 3),
        np.array([row[2] for row in rows], np.float64).reshape(-1, 2, 3),
        np.array([row[3] for row in rows], np.float64).reshape(-1, 3),
    )
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(array.tobytes())
    return Lamps(arrays, digest.hexdigest())


def _row(light: Lamp) -> Row:
    """Kind, place, edges and colour of a lamp: see ``LampArrays``."""
    if isinstance(light, DirectionalLight):
        colour = np.array(light.irradiance) / math.pi
        return DIRECTIONAL, *_disc(light), colour
    if isinstance(light, PointLight):
        return POINT, np.array(light.position), np.zeros((2, 3)), np.array(light.intensity) / math.pi
    if isinstance(light, AreaLight):
        return AREA, np.array(light.corner), np.array([light.u, light.v]), np.array(light.radiance) / math.pi


def _disc(light: DirectionalLight) -> tuple[np.ndarray, np.ndarray]:
    """The direction (3,) towards a directional light, and two radii (2, 3) of its disc, as long as its sine."""
    azimuth, elevation = math.radians(light.azimuth), math.radians(light.elevation)
    east = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    towards = math.cos(elevation) * level + np.array([0.0, 0.0, math.sin(elevation)])
    return towards, math.sin(math.radians(light.angle / 2.0)) * np.array([east, np.cross(towards, east)])
