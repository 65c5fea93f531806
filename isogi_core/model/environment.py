"""All lights of a scene as one: a constant and a lat-long image.

Row 0 of an image is +z, column 0 starts at azimuth 0 (+x), azimuth grows with the column towards +y, pixel
centres lie at half-integers, and a pixel has one radiance over the whole of its solid angle.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.errors import LightError
from isogi_core.files.radiance import read_hdr
from isogi_core.model.lights import ConstantLight, Lamp, Light, ProbeLight, SkyLight
from isogi_core.model.sky import LUMINANCE, sky_image

SKY_SIZE = (512, 1024)
"""Rows and columns of the grid on which a sky is laid out."""

OVERVIEW = (256, 512)
"""Rows and columns of an environment at a glance."""

SHARP = 1.0
"""Relative variance of the luminance over the sphere from which shadow rays towards its bright parts pay.

At equal time they make the variance of texels' irradiance smaller by 0.9 for half a sky (whose variance is 1), 1.4
for a lobe cos² (2.6), 3.5 for pisa (2.4), 4.4 for uffizi (7.7), and by 6000 and more for grace and all with a sun
(3700 and more); measured on the engine, with 2 × 512 samples and 4 bounces.
"""


@dataclass(frozen=True, eq=False)
class Environment:
    """Linear RGB radiance from infinitely far: ``constant`` (3,) float64 plus ``image`` (h, w, 3) float32.

    Without an image it is one black pixel. ``digest`` is a hex name of both.
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
        """Whether rays towards its bright parts are worth their time: see ``SHARP``."""
        seen, shares = self._luminance, solid_angles(*self.image.shape[:2]) / (4.0 * np.pi)
        mean = float((shares * seen).sum())
        return float((shares * seen**2).sum()) > (1.0 + SHARP) * mean**2

    @cached_property
    def table(self) -> tuple[np.ndarray, np.ndarray]:
        """Where to draw rays from: see ``cumulative``. Two empty arrays where the environment is not ``sharp``.

        Only what is brighter than the mean is drawn; the rest is left to the rays that the surface draws.
        Source: Karlík et al., "MIS Compensation", ACM Transactions on Graphics 38(6), 2019.
        """
        if not self.sharp:
            return np.zeros(0), np.zeros((0, 0))
        excess = np.maximum(self._luminance - self.mean() @ LUMINANCE, 0.0)
        return cumulative(excess * solid_angles(*excess.shape))

    @cached_property
    def overview(self) -> np.ndarray:
        """Radiance (256, 512, 3) float64 of all light, averaged over each pixel; its grid is that of the image."""
        return np.asarray(self.constant + resample(self.image, *OVERVIEW))

    @property
    def _luminance(self) -> np.ndarray:
        """Luminance (h, w) float64 of all light, constant and image."""
        return np.asarray(self.image @ LUMINANCE + self.constant @ LUMINANCE)

    def mean(self) -> np.ndarray:
        """Mean radiance (3,) over the sphere."""
        return np.asarray(self.constant + mean_radiance(self.image))


def environment(lights: Sequence[Light]) -> Environment:
    """The sum of the lights that are no lamps. Images are brought to the largest grid without change of energy.

    Raises LightError where a probe cannot be read or holds a negative or non-finite radiance.
    """
    constant = np.zeros(3)
    images = []
    around = [light for light in lights if not isinstance(light, Lamp)]
    for light in around:
        if isinstance(light, ConstantLight):
            constant += light.radiance
        else:
            images.append(_image(light))
    height = max((image.shape[0] for image in images), default=1)
    width = max((image.shape[1] for image in images), default=1)
    total = np.zeros((height, width, 3))
    for image in images:
        total += resample(image, height, width)
    with np.errstate(over="ignore"):
        total = _checked(total.astype(np.float32), "The sum of all lights")
    digest = hashlib.blake2b(f"{constant.tolist()} {total.shape}".encode(), digest_size=16)
    digest.update(total.data)
    name = " + ".join(light.name for light in around) or "no light"
    return Environment(constant, total, digest.hexdigest(), name)


def cumulative(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares of pixel weights (h, w), summed up: over the rows (h + 1,), and within each row (h, w + 1); float64.

    As ``kernels.sampling.sample_piecewise_2d`` takes them. A row without weight is even, and is never drawn.
    """
    rows = weights.sum(axis=1)
    within = np.where(rows[:, None] > 0.0, weights, 1.0).cumsum(axis=1)
    over = np.append(0.0, rows.cumsum())
    return over / over[-1], np.pad(within / within[:, -1:], ((0, 0), (1, 0)))


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
    """How much of each interval between the edges ``to`` lies in each between ``source``; rows sum to 1."""
    upper = np.minimum(to[1:, None], source[None, 1:])
    lower = np.maximum(to[:-1, None], source[None, :-1])
    return np.asarray(np.maximum(upper - lower, 0.0) / np.diff(to)[:, None])


def _image(light: SkyLight | ProbeLight) -> np.ndarray:
    """The lat-long image (h, w, 3) of a sky or a probe."""
    if isinstance(light, ProbeLight):
        return light.scale * _checked(read_hdr(light.file), f"The probe '{light.file}'").astype(np.float64)
    return sky_image(light, pixel_directions(*SKY_SIZE), solid_angles(*SKY_SIZE))


def _checked(image: np.ndarray, what: str) -> np.ndarray:
    """The image, where every radiance is finite and not negative; LightError otherwise."""
    bad = int((~(np.isfinite(image) & (image >= 0.0))).any(axis=-1).sum())
    if bad:
        raise LightError(f"{what} has {bad} pixels of negative or non-finite radiance: give another light.")
    return image
