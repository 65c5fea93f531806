"""The lights of a scene in two groups: the environment (constant and image) with its lobes, and
fixed lamps.

Images are lat-long, (h, w, ...): all directions, with the solid angles of their pixels.

Clear skies are analytic, after Preetham, Shirley and Smits, "A Practical Analytic Model for
Daylight", 1999. Luminances are in kcd/m² as in the paper until the whole image is scaled.

Environments by formula are surroundings that need no file. ``overcast`` is the standard overcast
sky of Moon and Spencer 1942 (CIE S 011); ``noon`` and ``evening`` are clear skies. ``studio`` is a
dim room with two soft boxes, ``gallery`` a white one with two skylights; both are boxes seen from a
point within.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.files.vector import Vector
from isogi_core.kernels.transport.lights import (
    AREA,
    DIRECTIONAL,
    NO_TABLE,
    POINT,
    BrightTable,
    LampArrays,
    project_lamps,
)
from isogi_core.model.lights import (
    ENVIRONMENTS,
    AreaLight,
    DirectionalLight,
    EnvironmentLight,
    Lamp,
    Light,
    PointLight,
    SkyLight,
)
from isogi_core.model.volume import PLAIN_ORIENTATION, Orientation

SUN_RADIUS = math.radians(0.2665)
SUN_ILLUMINANCE = 128.0
"""Illuminance of the sun outside the atmosphere, klx."""

LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear sRGB in luminance (ITU-R BT.709)."""

_XYZ_TO_RGB = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)  # IEC 61966-2-1

# Rows are A to E of Perez's distribution, columns the weights of (turbidity, 1); the paper's
# appendix A.2.
_PEREZ_LUMINANCE = np.array(
    [
        [0.17872, -1.46303],
        [-0.35540, 0.42749],
        [-0.02266, 5.32505],
        [0.12064, -2.57705],
        [-0.06696, 0.37027],
    ]
)
_PEREZ_X = np.array(
    [
        [-0.01925, -0.25922],
        [-0.06651, 0.00081],
        [-0.00041, 0.21247],
        [-0.06409, -0.89887],
        [-0.00325, 0.04517],
    ]
)
_PEREZ_Y = np.array(
    [
        [-0.01669, -0.26078],
        [-0.09495, 0.00921],
        [-0.00792, 0.21023],
        [-0.04405, -1.65369],
        [-0.01092, 0.05291],
    ]
)
# Zenith chromaticity: rows are powers 2, 1, 0 of turbidity, columns powers 3 to 0 of the sun's
# zenith angle.
_ZENITH_X = np.array(
    [
        [0.00166, -0.00375, 0.00209, 0.0],
        [-0.02903, 0.06377, -0.03202, 0.00394],
        [0.11693, -0.21196, 0.06052, 0.25886],
    ]
)
_ZENITH_Y = np.array(
    [
        [0.00275, -0.00610, 0.00317, 0.0],
        [-0.04214, 0.08970, -0.04153, 0.00516],
        [0.15346, -0.26756, 0.06670, 0.26688],
    ]
)
_WAVELENGTHS = np.array([0.610, 0.550, 0.465])
"""Wavelengths in micrometres that stand for red, green and blue in the attenuation of the sun's
beam.
"""


def sky_image(light: SkyLight, directions: np.ndarray, solid_angles: np.ndarray) -> np.ndarray:
    """Return the radiance (h, w, 3) float64 of sky, sun and ground in unit ``directions`` (h, w,
    3), z up.

    ``solid_angles`` (h, w), steradians, belong to the directions. The directions within the sun's
    disc together hold exactly its irradiance. The ground reflects the light that falls on it. The
    mean luminance over the sphere is ``light.scale``.
    """
    up = directions[..., 2] > 0.0
    sky = np.zeros(directions.shape)
    sky[up] = _sky_radiance(light, directions[up])
    sky[up] += _sun_disc(light, directions[up], solid_angles[up])
    # Let the ground reflect the irradiance of the upper half, diffuse.
    falling = (directions[..., 2] * solid_angles)[up] @ sky[up]
    sky[~up] = np.multiply(light.ground, falling / np.pi)
    # Scale the image to its mean luminance.
    mean = np.sum(solid_angles * (sky @ LUMINANCE_WEIGHTS)) / np.sum(solid_angles)
    return np.asarray(sky * (light.scale / mean))


def sun_direction(light: SkyLight) -> np.ndarray:
    """Return the unit vector (3,) towards the sun."""
    azimuth, elevation = math.radians(light.sun_azimuth), math.radians(light.sun_elevation)
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])


def _sky_radiance(light: SkyLight, directions: np.ndarray) -> np.ndarray:
    """Return the radiance (n, 3), linear RGB in kcd/m², of the sky without the sun, in
    ``directions`` (n, 3) above the horizon.
    """
    turbidity = light.turbidity
    theta = math.radians(90.0 - light.sun_elevation)
    cos_gamma = np.clip(directions @ sun_direction(light), -1.0, 1.0)
    # Zenith luminance: appendix A.2 of the paper.
    chi = (4.0 / 9.0 - turbidity / 120.0) * (math.pi - 2.0 * theta)
    zenith = (4.0453 * turbidity - 4.9710) * math.tan(chi) - 0.2155 * turbidity + 2.4192
    parts = (
        (zenith, _PEREZ_LUMINANCE),
        (_chromaticity(_ZENITH_X, turbidity, theta), _PEREZ_X),
        (_chromaticity(_ZENITH_Y, turbidity, theta), _PEREZ_Y),
    )
    # Scale Perez's distribution of luminance and chromaticity by the values at the
    # zenith.
    luminance, x, y = (
        at_zenith
        * _perez(table, turbidity, directions[:, 2], cos_gamma)
        / _perez(table, turbidity, np.array(1.0), np.array(math.cos(theta)))
        for at_zenith, table in parts
    )
    # Convert from CIE xyY to linear sRGB.
    xyz = np.stack([x / y, np.ones_like(y), (1.0 - x - y) / y], axis=-1) * luminance[:, None]
    return np.asarray(np.maximum(xyz @ _XYZ_TO_RGB.T, 0.0))


def _chromaticity(table: np.ndarray, turbidity: float, theta: float) -> float:
    """Return CIE x or y of the zenith by a ``table`` of coefficients, for the sun at zenith
    angle ``theta``.
    """
    return float(
        np.array([turbidity**2, turbidity, 1.0])
        @ table
        @ np.array([theta**3, theta**2, theta, 1.0])
    )


def _perez(
    table: np.ndarray, turbidity: float, cos_theta: np.ndarray, cos_gamma: np.ndarray
) -> np.ndarray:
    """Return Perez's distribution at zenith angle θ and angle γ from the sun: eq. 3 of the
    paper.
    """
    a, b, c, d, e = table @ np.array([turbidity, 1.0])
    gradation = 1.0 + a * np.exp(b / cos_theta)
    return np.asarray(gradation * (1.0 + c * np.exp(d * np.arccos(cos_gamma)) + e * cos_gamma**2))


def _sun_disc(light: SkyLight, directions: np.ndarray, solid_angles: np.ndarray) -> np.ndarray:
    """Return the radiance (n, 3) of the sun, spread evenly over the directions within its disc, or
    over the nearest ones if none is.

    The beam is attenuated by Rayleigh and aerosol scattering over the relative optical mass of the
    air (appendix A.1 of the paper; ozone, gases and water vapour attenuate it little and are left
    out).
    """
    # Attenuate the beam: relative optical mass, turbidity of the aerosol, and optical
    # depth of both kinds of scattering.
    zenith = 90.0 - light.sun_elevation
    mass = 1.0 / (math.cos(math.radians(zenith)) + 0.15 * (93.885 - zenith) ** -1.253)
    beta = 0.04608 * light.turbidity - 0.04586
    depth = 0.008735 * _WAVELENGTHS**-4.08 + beta * _WAVELENGTHS**-1.3
    irradiance = SUN_ILLUMINANCE * np.exp(-mass * depth)
    # Spread the irradiance over the directions within the disc; a coarse image may have none there.
    away = np.linalg.norm(directions - sun_direction(light), axis=-1)
    disc = away <= max(SUN_RADIUS, 1.5 * float(away.min()))
    return np.where(disc[:, None], irradiance / np.sum(solid_angles[disc]), 0.0)


def solid_angles(height: int, width: int) -> np.ndarray:
    """Return the solid angle in steradians of each pixel, (h, w) float64, exact: 2π/w (cos
    θ_top - cos θ_bottom).
    """
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    # cos a - cos b = 2 sin((a + b)/2) sin((b - a)/2), which loses no digits in small pixels.
    row = 4.0 * np.pi / width * np.sin(theta) * np.sin(np.pi / (2 * height))
    return np.broadcast_to(row[:, None], (height, width))


def pixel_directions(height: int, width: int) -> np.ndarray:
    """Return unit directions (h, w, 3) float64 of the pixels' centres."""
    theta = (np.arange(height)[:, None] + 0.5) * (np.pi / height)
    phi = (np.arange(width) + 0.5) * (2.0 * np.pi / width)
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    return np.stack([x, y, np.broadcast_to(np.cos(theta), x.shape)], axis=-1)


def mean_radiance(image: np.ndarray) -> np.ndarray:
    """Return the mean (3,) of a lat-long image (h, w, 3) over the sphere, float64."""
    weights = solid_angles(*image.shape[:2])[:, 0] / (4.0 * np.pi)
    return np.asarray(weights @ image.sum(axis=1, dtype=np.float64))


def resample(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Average an ``image`` by solid angle over the pixels of another grid; (height, width, 3)
    float64.
    """
    if image.shape[:2] == (height, width):
        return np.asarray(image, np.float64)
    # The solid angle of a pixel is Δφ · Δ(-cos θ): average over rows of pixels by -cos θ, which
    # ascends with them, and over columns by φ.
    rows = _overlap(
        -np.cos(np.linspace(0, np.pi, height + 1)), -np.cos(np.linspace(0, np.pi, len(image) + 1))
    )
    columns = _overlap(np.linspace(0, 1, width + 1), np.linspace(0, 1, image.shape[1] + 1))
    wide = np.asarray(image, np.float64)
    return np.asarray(np.einsum("ij,jkc,lk->ilc", rows, wide, columns, optimize=True))


def _overlap(to: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return the share of each interval between the edges ``to`` that lies in each interval
    between ``source``; rows sum to 1.
    """
    upper = np.minimum(to[1:, None], source[None, 1:])
    lower = np.maximum(to[:-1, None], source[None, :-1])
    return np.asarray(np.maximum(upper - lower, 0.0) / np.diff(to)[:, None])


Row = tuple[int, np.ndarray, np.ndarray, np.ndarray]
"""Kind, place, edges and colour of a lamp."""


@dataclass(frozen=True, eq=False)
class Lamps:
    """All lamps of a scene, in its order: ``arrays`` for the kernels, in the box of the volume, and
    their hex ``digest``.
    """

    arrays: LampArrays
    digest: str

    @property
    def any(self) -> bool:
        """True if there is any lamp."""
        return len(self.arrays.kinds) > 0

    def seen_from(self, point: Vector, least: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return unit directions (k, 3) from a ``point`` of the volume's box to the lamps, and the
        irradiance (k, 3) of a surface at the point that faces each.

        Shadows are left out. An area light counts as a point in its middle, and is dark from
        behind. A lamp nearer than ``least`` counts as that far away and facing the point; one at
        the point itself has direction 0.
        """
        kinds, places, edges, colours = self.arrays
        # Directional lamps hold their direction as their place, and do not fall off with distance.
        near = kinds != DIRECTIONAL
        away = np.where(near[:, None], places + edges.sum(axis=1) / 2 - point, places)
        distance = np.linalg.norm(away, axis=1)
        clamped = np.maximum(distance, least)
        with np.errstate(divide="ignore", invalid="ignore"):
            towards = np.nan_to_num(away / distance[:, None])
            spread = np.where(near & (clamped > 0.0), clamped**-2.0, ~near)
        # An area light shines by its area times the cosine at its front.
        normals = np.cross(edges[:, 0], edges[:, 1])
        cosines = np.maximum(-(towards * normals).sum(axis=1), 0.0)
        cosines = np.where(distance < least, np.linalg.norm(normals, axis=1), cosines)
        return towards, math.pi * colours * (spread * np.where(kinds == AREA, cosines, 1.0))[
            :, None
        ]

    def approximate(self, order: int, centre: Vector, radius: float) -> np.ndarray:
        """Return SH coefficients (3, n²) float64 of the lamps, Σ E Y_i(d), for the ``order`` n.

        Each lamp counts as infinitely far away, in its direction d from ``centre``, a point of the
        box. Lamps within ``radius`` are as bright as at that distance. A lamp at the centre shines
        evenly from all sides.
        """
        coefficients = np.zeros((3, order**2))
        if self.any:
            directions, irradiances = self.seen_from(centre, radius)
            # A lamp at the centre has no direction: its E, spread over all of them, is the radiance
            # E/4π, whose only coefficient is that of band 0, E/4π · √(4π).
            away = directions.any(axis=1)
            project_lamps(order, directions[away], irradiances[away], coefficients)
            coefficients[:, 0] += irradiances[~away].sum(axis=0) / math.sqrt(4.0 * math.pi)
        return coefficients

    def brightest(self, centre: Vector, radius: float) -> float:
        """Return the irradiance over π, as luminance, of an unshadowed surface at ``centre`` in the
        best of the directions to the lamps.

        Lamps within ``radius`` count as that far away, as most of the lit volume is farther away.
        """
        directions, irradiances = self.seen_from(centre, radius)
        # A surface faces one of the lamps, and receives the others by the cosine between both.
        cosines = np.maximum(directions @ directions.T, 0.0)
        np.fill_diagonal(cosines, 1.0)
        return float((cosines @ (irradiances @ LUMINANCE_WEIGHTS)).max(initial=0.0)) / math.pi


def gather_lamps(lights: Sequence[Light], orientation: Orientation = PLAIN_ORIENTATION) -> Lamps:
    """Gather the lamps among the ``lights``, which lie in the world, into arrays in the box of a
    volume with an ``orientation``.
    """
    rows = [_row(light) for light in lights if isinstance(light, Lamp)]
    arrays = LampArrays(
        np.array([row[0] for row in rows], np.int8),
        np.array([row[1] for row in rows], np.float64).reshape(-1, 3),
        np.array([row[2] for row in rows], np.float64).reshape(-1, 2, 3),
        np.array([row[3] for row in rows], np.float64).reshape(-1, 3),
    )
    # Up to here the arrays are in the world; kernels take them in the box.
    if orientation.placed:
        arrays = _in_box(arrays, orientation)
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(array.tobytes())
    return Lamps(arrays, digest.hexdigest())


def _in_box(lamps: LampArrays, orientation: Orientation) -> LampArrays:
    """Transform lamps of the world to the box. A directional lamp has a direction as its place,
    which is not moved.
    """
    near = (lamps.kinds != DIRECTIONAL)[:, None]
    places = np.where(near, lamps.places - np.array(orientation.origin), lamps.places)
    return lamps._replace(
        places=places @ orientation.matrix, edges=lamps.edges @ orientation.matrix
    )


def _row(light: Lamp) -> Row:
    """Return kind, place, edges and colour of a lamp: see ``LampArrays``."""
    # Colours are over π, as kernels compute E/π.
    if isinstance(light, DirectionalLight):
        colour = np.array(light.irradiance) / math.pi
        return DIRECTIONAL, *_disc(light), colour
    if isinstance(light, PointLight):
        return (
            POINT,
            np.array(light.position),
            np.zeros((2, 3)),
            np.array(light.intensity) / math.pi,
        )
    if isinstance(light, AreaLight):
        return (
            AREA,
            np.array(light.corner),
            np.array([light.u, light.v]),
            np.array(light.radiance) / math.pi,
        )


def _disc(light: DirectionalLight) -> tuple[np.ndarray, np.ndarray]:
    """Return the direction (3,) towards a directional light, and two radii (2, 3) of its disc,
    as long as the sine of its half angle.
    """
    azimuth, elevation = math.radians(light.azimuth), math.radians(light.elevation)
    east = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    level = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    towards = math.cos(elevation) * level + np.array([0.0, 0.0, math.sin(elevation)])
    return towards, math.sin(math.radians(light.angle / 2.0)) * np.array(
        [east, np.cross(towards, east)]
    )


OVERVIEW = (256, 512)
"""Rows and columns of an environment's overview."""

SAMPLES_PER_SIDE = 4
"""Samples along each side of a pixel of an image that is rotated."""

SHARP_VARIANCE = 1.0
"""Relative variance of the luminance over the sphere from which shadow rays towards bright parts
pay.

At equal time they divide the variance of texels' irradiance by 0.9 for half a sky (whose variance
is 1), by 1.4 for a lobe cos² (2.6), 3.5 for pisa (2.4), 4.4 for uffizi (7.7), and by 6000 and more
for grace and all probes with a sun (3700 and more); measured on the engine, with 2 × 512 samples
and 4 bounces.
"""


@dataclass(frozen=True, eq=False)
class Environment:
    """Linear RGB radiance from infinitely far: ``constant`` (3,) float64 plus ``image`` (h, w, 3)
    float32.

    An environment without an image has one black pixel. ``digest`` is a hex digest of both.
    """

    constant: np.ndarray
    image: np.ndarray
    digest: str
    name: str

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """Return the radiance (..., 3) float64 that arrives from ``directions`` (..., 3), which
        need not be unit.
        """
        x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
        height, width = self.image.shape[:2]
        # Look the pixel of each direction up; the image is constant over a pixel.
        row = np.arctan2(np.hypot(x, y), z) * (height / np.pi)
        column = np.arctan2(y, x) * (width / (2.0 * np.pi)) % width
        i = np.minimum(row.astype(np.int64), height - 1)
        j = np.minimum(column.astype(np.int64), width - 1)
        return np.asarray(self.constant + self.image[i, j])

    @cached_property
    def sharp(self) -> bool:
        """True if shadow rays towards bright parts pay: see ``SHARP_VARIANCE``."""
        seen = self._luminance
        shares = solid_angles(*self.image.shape[:2]) / (4.0 * np.pi)
        mean = float((shares * seen).sum())
        return float((shares * seen**2).sum()) > (1.0 + SHARP_VARIANCE) * mean**2

    @cached_property
    def table(self) -> BrightTable:
        """Table for sampling directions; NO_TABLE if the environment is not ``sharp``.

        Only light above the mean is sampled by the table; the rest is left to cosine sampling at
        the surface. Source: Karlík et al., "MIS Compensation", ACM Transactions on Graphics 38(6),
        2019.
        """
        if not self.sharp:
            return NO_TABLE
        excess = np.maximum(self._luminance - self.mean() @ LUMINANCE_WEIGHTS, 0.0)
        return bright_table(self.constant + self.image, excess)

    @cached_property
    def overview(self) -> np.ndarray:
        """Radiance (256, 512, 3) float64 of all light, averaged over each pixel."""
        return np.asarray(self.constant + resample(self.image, *OVERVIEW))

    @property
    def _luminance(self) -> np.ndarray:
        """Luminance (h, w) float64 of all light, constant and image."""
        return np.asarray(self.image @ LUMINANCE_WEIGHTS + self.constant @ LUMINANCE_WEIGHTS)

    def turned(self, matrix: np.ndarray) -> "Environment":
        """Return this environment as seen in the axes of a box whose rotation to the world is
        ``matrix`` (3, 3).

        About z the columns of the image are moved, which is exact. Otherwise each pixel is the mean
        of SAMPLES_PER_SIDE² samples. The digest is ``turned_digest``.
        """
        if not self.image.any():
            return self
        if (columns := self._columns_moved(matrix)) is not None:
            image = moved_columns(self.image, columns)
        else:
            image = self._sampled(matrix)
        return Environment(
            self.constant, image.astype(np.float32), self.turned_digest(matrix), self.name
        )

    def turned_digest(self, matrix: np.ndarray) -> str:
        """Return the digest of this environment turned by a ``matrix``, which follows from this
        one's and the matrix.
        """
        if not self.image.any():
            return self.digest
        if (columns := self._columns_moved(matrix)) is not None:
            how = f"columns {columns!r}"
        else:
            how = str(matrix.round(9).tolist())
        return hashlib.blake2b(f"{self.digest} {how}".encode(), digest_size=16).hexdigest()

    def _columns_moved(self, matrix: np.ndarray) -> float | None:
        """Return by how many columns a rotation ``matrix`` moves the image, from 0 to its width;
        None if it does not rotate about z.
        """
        if not matrix[2, 2] > 1.0 - 1e-12:
            return None
        width = self.image.shape[1]
        turn = math.atan2(matrix[1, 0], matrix[0, 0]) / (2.0 * math.pi)
        return round(turn * width, 6) % width

    def _sampled(self, matrix: np.ndarray) -> np.ndarray:
        """Return the image (h, w, 3) float64 turned by a rotation ``matrix``, from samples."""
        height, width = self.image.shape[:2]
        fine = pixel_directions(SAMPLES_PER_SIDE * height, SAMPLES_PER_SIDE * width)
        image = np.zeros((height, width, 3))
        weights = np.sin(
            (np.arange(SAMPLES_PER_SIDE * height) + 0.5) * (np.pi / (SAMPLES_PER_SIDE * height))
        )
        # Rotate the directions of one row of pixels at a time, and average radiance by solid angle.
        for i in range(height):
            rows = slice(SAMPLES_PER_SIDE * i, SAMPLES_PER_SIDE * (i + 1))
            seen = self.radiance(fine[rows] @ matrix.T) - self.constant
            shares = weights[rows] / (weights[rows].sum() * SAMPLES_PER_SIDE)
            image[i] = (
                shares[:, None, None]
                * seen.reshape(SAMPLES_PER_SIDE, width, SAMPLES_PER_SIDE, 3).sum(axis=2)
            ).sum(axis=0)
        return image

    def mean(self) -> np.ndarray:
        """Return the mean radiance (3,) over the sphere."""
        return np.asarray(self.constant + mean_radiance(self.image))


def moved_columns(image: np.ndarray, columns: float) -> np.ndarray:
    """Return an ``image`` (h, w, 3) that begins ``columns`` further right, in float64. Each pixel
    is the mean of the former image, which is constant over a pixel, over its area.
    """
    whole = math.floor(columns)
    left = np.roll(image, -whole, axis=1).astype(np.float64)
    part = columns - whole
    if part == 0.0:
        return left
    return np.asarray((1.0 - part) * left + part * np.roll(left, -1, axis=1))


def bright_table(radiance: np.ndarray, excess: np.ndarray) -> BrightTable:
    """Return the table that samples directions to pixels of ``radiance`` (h, w, 3) by their
    ``excess`` (h, w) over the light that other techniques sample: the density per steradian is in
    proportion to it.
    """
    height, width = excess.shape
    # A pixel is drawn in proportion to its excess times its solid angle.
    weights = excess * solid_angles(height, width)
    rows, columns = cumulative(weights)
    density = excess / weights.sum()
    pixels = np.concatenate([radiance, density[..., None]], axis=2, dtype=np.float32)
    heights = np.cos(np.arange(height + 1) * (np.pi / height))
    return BrightTable(rows, columns, guide_of(rows), guide_of(columns), heights, pixels)


GUIDED_ROWS = 64
"""Number of rows of shares whose guides are made at once: they stay in the processor's cache."""


def guide_of(shares: np.ndarray) -> np.ndarray:
    """Return the intervals of cumulative ``shares`` (..., n + 1), from 0 to 1 along the last axis,
    in which 0, 1/n, …, 1 lie; (..., n + 1) int32. See ``kernels.transport.sampling.find_interval``.
    """
    rows = shares.reshape(-1, shares.shape[-1])
    guides = np.empty(rows.shape, np.int32)
    for first in range(0, len(rows), GUIDED_ROWS):
        block = slice(first, first + GUIDED_ROWS)
        guides[block] = _guides(rows[block])
    return guides.reshape(shares.shape)


def _guides(shares: np.ndarray) -> np.ndarray:
    """Return ``guide_of`` each row of ``shares`` (h, n + 1); (h, n + 1) int32."""
    height, width = shares.shape
    count = width - 1
    # Find the least k of which the double k/n is not below a share: n times the share, rounded
    # down, or one more.
    reached = (shares * count).astype(np.intp)
    reached += shares > (np.arange(width) / count)[reached]
    # Count the shares that each k is the least for, row by row. All of them up to k lie at k/n or
    # below; the last of these begins the interval.
    reached += width * np.arange(height)[:, None]
    begun = np.bincount(reached.ravel(), minlength=height * width).reshape(height, width)
    return np.minimum(begun.cumsum(axis=1, dtype=np.int32) - 1, count - 1)


def cumulative(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cumulative shares of pixel ``weights`` (h, w): over the rows (h + 1,), and within each
    row (h, w + 1); float64. A row without weight is even.
    """
    # Sum the rows, and the pixels within each; both are normalised to end at 1.
    rows = weights.sum(axis=1)
    within = np.where(rows[:, None] > 0.0, weights, 1.0).cumsum(axis=1)
    over = np.append(0.0, rows.cumsum())
    return over / over[-1], np.pad(within / within[:, -1:], ((0, 0), (1, 0)))


@dataclass(frozen=True)
class Lobe:
    """A small bright part of an environment, as a disc of even radiance around the unit direction
    ``towards``.

    ``cosine`` is that of its half angle. ``flux`` is its radiance integrated over the sphere,
    linear RGB.
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


GROUND = 0.3
"""Albedo of the ground under an overcast sky."""

NOON = SkyLight(sun_azimuth=100.0, sun_elevation=62.0, turbidity=2.5)
EVENING = SkyLight(sun_azimuth=20.0, sun_elevation=9.0, turbidity=4.5, ground=(0.3, 0.27, 0.23))

SOFT_BOXES = (
    ((5.0, 42.0), (30.0, 26.0), (17.0, 16.2, 15.0)),
    ((125.0, 18.0), (20.0, 30.0), (4.2, 4.6, 5.2)),
)
"""The soft boxes of the studio: azimuth and elevation of the middle, half width and half
height, all in degrees, and radiance. A large warm one is in front and above, a dimmer cool one
at the side.
"""

EDGE_DEGREES = 4.0
"""Degrees over which a soft box fades at its edges."""

Image = np.ndarray


def environment_image(
    light: EnvironmentLight, directions: np.ndarray, solid_angles: np.ndarray
) -> Image:
    """Return the radiance (h, w, 3) float64 of an environment by formula in unit ``directions`` (h,
    w, 3), z up.

    ``solid_angles`` (h, w), steradians, belong to the directions. The mean luminance over the
    sphere is 1.
    """
    image = FORMULAS[light.environment](directions, solid_angles)
    return np.asarray(
        image * (np.sum(solid_angles) / np.sum(solid_angles * (image @ LUMINANCE_WEIGHTS)))
    )


def overcast(directions: np.ndarray, solid_angles: np.ndarray) -> Image:
    """Return the overcast sky: L = Lz (1 + 2 sin θ)/3 at the elevation θ, with Lz = 1, over a
    ground that reflects GROUND of its irradiance E = 7π/9 Lz.

    As for all formulas, the mean is scaled later; ``solid_angles`` are not needed here.
    """
    height = directions[..., 2]
    sky = (1.0 + 2.0 * height) / 3.0
    grey = np.where(height > 0.0, sky, GROUND * 7.0 / 9.0)
    return np.repeat(grey[..., None], 3, axis=-1)


def studio(directions: np.ndarray, solid_angles: np.ndarray) -> Image:
    """Return a dim grey room, darker towards the floor, with SOFT_BOXES."""
    height = directions[..., 2]
    room = 0.16 + 0.12 * height
    image = np.repeat(room[..., None], 3, axis=-1)
    for (azimuth, elevation), half, radiance in SOFT_BOXES:
        image += _box(directions, azimuth, elevation, half)[..., None] * np.array(radiance)
    return image


def _box(
    directions: np.ndarray, azimuth: float, elevation: float, half: tuple[float, float]
) -> np.ndarray:
    """Return the visible share of a soft box in each direction, from 0 to 1: a rectangle in a
    plane that faces the middle.
    """
    turn = math.radians(azimuth)
    tilt = math.radians(elevation)
    towards = np.array(
        [math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt)]
    )
    right = np.array([-math.sin(turn), math.cos(turn), 0.0])
    before = directions @ towards
    # Angles of each direction from the middle, across and along the box.
    across, along = (
        np.degrees(np.arctan2(np.abs(directions @ axis), before))
        for axis in (right, np.cross(towards, right))
    )
    inside = [
        np.clip((size - angle) / EDGE_DEGREES + 0.5, 0.0, 1.0)
        for size, angle in zip(half, (across, along), strict=True)
    ]
    return np.where(before > 0.0, inside[0] * inside[1], 0.0)


GALLERY_HALF_SIZES = (3.0, 2.2, 1.0)
"""Half sizes of the gallery along x, y and z, seen from its middle."""

SKYLIGHTS = (0.4, 1.4)
"""Range of |y| in which its ceiling is of glass; along x the glass reaches from wall to wall."""

WALL_RADIANCE = (0.62, 0.60, 0.57)
CEILING_RADIANCE = (0.5, 0.5, 0.49)
FLOOR_RADIANCE = (0.30, 0.22, 0.15)
GLASS_RADIANCE = (3.6, 3.8, 4.1)
"""Radiances, linear RGB: white walls, a ceiling, a wooden floor, and the sky through the glass."""


def gallery(directions: np.ndarray, solid_angles: np.ndarray) -> Image:
    """Return a white room under two skylights, seen from the middle of a box."""
    size = np.array(GALLERY_HALF_SIZES)
    with np.errstate(divide="ignore"):
        reach = size / np.abs(directions)
    # Find the side of the box that each direction meets first, and the point there.
    face = reach.argmin(axis=-1)
    points = directions * reach.min(axis=-1)[..., None]
    up = points[..., 2]
    image = np.array(WALL_RADIANCE) * (0.75 + 0.25 * up / GALLERY_HALF_SIZES[2])[..., None]
    image[(face == 2) & (up < 0.0)] = FLOOR_RADIANCE
    image[(face == 2) & (up > 0.0)] = CEILING_RADIANCE
    aside = np.abs(points[..., 1])
    image[(face == 2) & (up > 0.0) & (aside > SKYLIGHTS[0]) & (aside < SKYLIGHTS[1])] = (
        GLASS_RADIANCE
    )
    return image


def _clear(light: SkyLight) -> "Formula":
    """Return the formula of a clear sky."""
    return lambda directions, solid_angles: sky_image(light, directions, solid_angles)


Formula = Callable[[np.ndarray, np.ndarray], Image]

FORMULAS: dict[str, Formula] = dict(
    zip(ENVIRONMENTS, (overcast, studio, _clear(NOON), _clear(EVENING), gallery), strict=True)
)
"""The image of each environment, up to a factor, from directions (h, w, 3) and solid angles (h,
w).
"""
