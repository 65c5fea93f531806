"""The lights of a scene in two groups: the environment (constant and image) with its lobes, and fixed lamps.

Images are lat-long, (h, w, ...): all directions, with the solid angles of their pixels.
"""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.kernels.transport.lights import AREA, DIRECTIONAL, POINT, LampArrays, project_lamps
from isogi_core.model.lights import (
    AreaLight,
    DirectionalLight,
    Lamp,
    Light,
    PointLight,
    Vector,
)
from isogi_core.model.orientation import PLAIN_ORIENTATION, Orientation
from isogi_core.model.sky import LUMINANCE_WEIGHTS


def solid_angles(height: int, width: int) -> np.ndarray:
    """Steradians of each pixel, (h, w) float64, exact: 2π/w (cos θ_top - cos θ_bottom)."""
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    row = 4.0 * np.pi / width * np.sin(theta) * np.sin(np.pi / (2 * height))
    return np.broadcast_to(row[:, None], (height, width))


def pixel_directions(height: int, width: int) -> np.ndarray:
    """Unit directions (h, w, 3) float64 of the pixels' centres."""
    theta = (np.arange(height)[:, None] + 0.5) * (np.pi / height)
    phi = (np.arange(width) + 0.5) * (2.0 * np.pi / width)
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    return np.stack([x, y, np.broadcast_to(np.cos(theta), x.shape)], axis=-1)


def mean_radiance(image: np.ndarray) -> np.ndarray:
    """Mean (3,) of a lat-long image (h, w, 3) over the sphere, float64."""
    weights = solid_angles(*image.shape[:2])[:, 0] / (4.0 * np.pi)
    return np.asarray(weights @ image.sum(axis=1, dtype=np.float64))


def resample(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """The image averaged by solid angle over the pixels of another grid, (height, width, 3) float64."""
    if image.shape[:2] == (height, width):
        return np.asarray(image, np.float64)
    rows = _overlap(-np.cos(np.linspace(0, np.pi, height + 1)), -np.cos(np.linspace(0, np.pi, len(image) + 1)))
    columns = _overlap(np.linspace(0, 1, width + 1), np.linspace(0, 1, image.shape[1] + 1))
    wide = np.asarray(image, np.float64)
    return np.asarray(np.einsum("ij,jkc,lk->ilc", rows, wide, columns, optimize=True))


def _overlap(to: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Share of each interval between the edges ``to`` that lies in each between ``source``; rows sum to 1."""
    upper = np.minimum(to[1:, None], source[None, 1:])
    lower = np.maximum(to[:-1, None], source[None, :-1])
    return np.asarray(np.maximum(upper - lower, 0.0) / np.diff(to)[:, None])


Row = tuple[int, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Lamps:
    """All lamps of a scene, in its order: ``arrays`` for the kernels, and a hex ``digest`` of these."""

    arrays: LampArrays
    digest: str

    @property
    def any(self) -> bool:
        """Whether there is a lamp at all."""
        return len(self.arrays.kinds) > 0

    def seen_from(self, point: Vector, least: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Unit directions (k, 3) from a world point to the lamps, and irradiance (k, 3) of what faces them there.

        Shadows are left out. An area light counts as a point in its middle, and is dark from behind. A lamp nearer than
        ``least`` counts as that far away and facing the point; one at the point itself has direction 0.
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
        cosines = np.maximum(-(towards * normals).sum(axis=1), 0.0)
        cosines = np.where(distance < least, np.linalg.norm(normals, axis=1), cosines)
        return towards, math.pi * colours * (spread * np.where(kinds == AREA, cosines, 1.0))[:, None]

    def approximate(self, order: int, centre: Vector, radius: float) -> np.ndarray:
        """SH coefficients (3, n²) float64 of the lamps, each taken as infinitely far from ``centre``: Σ E Y_i(d).

        Lamps within ``radius`` count as that far away. A lamp at the centre shines evenly from all sides.
        """
        coefficients = np.zeros((3, order**2))
        if self.any:
            directions, irradiances = self.seen_from(centre, radius)
            beside = directions.any(axis=1)
            project_lamps(order, directions[beside], irradiances[beside], coefficients)
            coefficients[:, 0] += irradiances[~beside].sum(axis=0) / math.sqrt(4.0 * math.pi)
        return coefficients

    def brightest(self, centre: Vector, radius: float) -> float:
        """Irradiance over π, in luminance, of an unshadowed surface at ``centre`` that faces the best of the lamps.

        Lamps within ``radius`` count as that far away, as most of the lit volume is farther away.
        """
        directions, irradiances = self.seen_from(centre, radius)
        cosines = np.maximum(directions @ directions.T, 0.0)
        np.fill_diagonal(cosines, 1.0)
        return float((cosines @ (irradiances @ LUMINANCE_WEIGHTS)).max(initial=0.0)) / math.pi


def gather_lamps(lights: Sequence[Light], orientation: Orientation = PLAIN_ORIENTATION) -> Lamps:
    """Gather the lamps among the lights into arrays, in the box of a volume with an ``orientation``."""
    rows = [_row(light) for light in lights if isinstance(light, Lamp)]
    arrays = LampArrays(
        np.array([row[0] for row in rows], np.int8),
        np.array([row[1] for row in rows], np.float64).reshape(-1, 3),
        np.array([row[2] for row in rows], np.float64).reshape(-1, 2, 3),
        np.array([row[3] for row in rows], np.float64).reshape(-1, 3),
    )
    arrays = _in_box(arrays, orientation) if orientation.placed else arrays
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(array.tobytes())
    return Lamps(arrays, digest.hexdigest())


def _in_box(lamps: LampArrays, orientation: Orientation) -> LampArrays:
    """Lamps of the world in the box: directional ones have a direction for their place."""
    near = (lamps.kinds != DIRECTIONAL)[:, None]
    places = np.where(near, lamps.places - np.array(orientation.origin), lamps.places)
    return lamps._replace(places=places @ orientation.matrix, edges=lamps.edges @ orientation.matrix)


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


OVERVIEW = (256, 512)
"""Rows and columns of an environment's overview."""

SAMPLES_PER_SIDE = 4
"""Samples along each side of a pixel of an image that is turned."""

SHARP_VARIANCE = 1.0
"""Relative variance of the luminance over the sphere from which shadow rays towards its bright parts pay.

At equal time they make the variance of texels' irradiance smaller by 0.9 for half a sky (whose variance is 1), 1.4
for a lobe cos² (2.6), 3.5 for pisa (2.4), 4.4 for uffizi (7.7), and by 6000 and more for grace and all with a sun
(3700 and more); measured on the engine, with 2 × 512 samples and 4 bounces.
"""


@dataclass(frozen=True, eq=False)
class Environment:
    """Linear RGB radiance from infinitely far: ``constant`` (3,) float64 plus ``image`` (h, w, 3) float32.

    Where there is no image it is one black pixel. ``digest`` is a hex digest of both.
    """

    constant: np.ndarray
    image: np.ndarray
    digest: str
    name: str

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """Radiance (..., 3) float64 that arrives from ``directions`` (..., 3), which need not be unit."""
        x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
        height, width = self.image.shape[:2]
        row = np.arctan2(np.hypot(x, y), z) * (height / np.pi)
        column = np.arctan2(y, x) * (width / (2.0 * np.pi)) % width
        i = np.minimum(row.astype(np.int64), height - 1)
        j = np.minimum(column.astype(np.int64), width - 1)
        return np.asarray(self.constant + self.image[i, j])

    @cached_property
    def sharp(self) -> bool:
        """Whether rays towards its bright parts pay: see ``SHARP_VARIANCE``."""
        seen, shares = self._luminance, solid_angles(*self.image.shape[:2]) / (4.0 * np.pi)
        mean = float((shares * seen).sum())
        return float((shares * seen**2).sum()) > (1.0 + SHARP_VARIANCE) * mean**2

    @cached_property
    def table(self) -> tuple[np.ndarray, np.ndarray]:
        """Table for sampling directions, see ``cumulative``; two empty arrays where the environment is not ``sharp``.

        Only light above the mean is sampled by it; the rest is left to cosine sampling at the surface.
        Source: Karlík et al., "MIS Compensation", ACM Transactions on Graphics 38(6), 2019.
        """
        if not self.sharp:
            return np.zeros(0), np.zeros((0, 0))
        excess = np.maximum(self._luminance - self.mean() @ LUMINANCE_WEIGHTS, 0.0)
        return cumulative(excess * solid_angles(*excess.shape))

    @cached_property
    def overview(self) -> np.ndarray:
        """Radiance (256, 512, 3) float64 of all light, averaged over each pixel; its grid is that of the image."""
        return np.asarray(self.constant + resample(self.image, *OVERVIEW))

    @property
    def _luminance(self) -> np.ndarray:
        """Luminance (h, w) float64 of all light, constant and image."""
        return np.asarray(self.image @ LUMINANCE_WEIGHTS + self.constant @ LUMINANCE_WEIGHTS)

    def turned(self, matrix: np.ndarray) -> "Environment":
        """This environment as a box sees it that lies in it turned by ``matrix`` (3, 3).

        Each pixel is the mean of FINE² samples. The digest follows from this one's and the matrix.
        """
        if not self.image.any():
            return self
        height, width = self.image.shape[:2]
        fine, image = (
            pixel_directions(SAMPLES_PER_SIDE * height, SAMPLES_PER_SIDE * width),
            np.zeros((height, width, 3)),
        )
        weights = np.sin((np.arange(SAMPLES_PER_SIDE * height) + 0.5) * (np.pi / (SAMPLES_PER_SIDE * height)))
        for i in range(height):
            rows = slice(SAMPLES_PER_SIDE * i, SAMPLES_PER_SIDE * (i + 1))
            seen = self.radiance(fine[rows] @ matrix.T) - self.constant
            shares = weights[rows] / (weights[rows].sum() * SAMPLES_PER_SIDE)
            image[i] = (
                shares[:, None, None] * seen.reshape(SAMPLES_PER_SIDE, width, SAMPLES_PER_SIDE, 3).sum(axis=2)
            ).sum(axis=0)
        digest = hashlib.blake2b(f"{self.digest} {matrix.round(9).tolist()}".encode(), digest_size=16).hexdigest()
        return Environment(self.constant, image.astype(np.float32), digest, self.name)

    def mean(self) -> np.ndarray:
        """Mean radiance (3,) over the sphere."""
        return np.asarray(self.constant + mean_radiance(self.image))


def cumulative(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cumulative shares of pixel weights (h, w): over the rows (h + 1,), and within each row (h, w + 1); float64.

    ``kernels.transport.sampling.sample_piecewise_2d`` takes them. A row without weight is even and never sampled.
    """
    rows = weights.sum(axis=1)
    within = np.where(rows[:, None] > 0.0, weights, 1.0).cumsum(axis=1)
    over = np.append(0.0, rows.cumsum())
    return over / over[-1], np.pad(within / within[:, -1:], ((0, 0), (1, 0)))


@dataclass(frozen=True)
class Lobe:
    """A small bright part of an environment, as a disc of even radiance about the unit direction ``towards``.

    ``cosine`` is that of its half angle.

    ``flux`` is its radiance integrated over the sphere, linear RGB.
    """

    towards: tuple[float, float, float]
    cosine: float
    flux: tuple[float, float, float]

    @property
    def angle(self) -> float:
        """The apparent diameter, degrees."""
        return 2.0 * math.degrees(math.acos(self.cosine))

    @property
    def azimuth(self) -> float:
        """Degrees from +x towards +y."""
        return math.degrees(math.atan2(self.towards[1], self.towards[0])) % 360.0

    @property
    def elevation(self) -> float:
        """Degrees above the horizon."""
        return math.degrees(math.atan2(self.towards[2], math.hypot(*self.towards[:2])))

    @property
    def irradiance(self) -> np.ndarray:
        """Irradiance of a surface that faces it, ∫ L cosθ dω = Φ (1 + cos a)/2; (3,) linear RGB."""
        return np.array(self.flux) * (0.5 * (1.0 + self.cosine))
