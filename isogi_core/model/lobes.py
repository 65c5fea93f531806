"""Lobes: the few small bright parts of an environment, suns and windows, each as a disc of even radiance."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from isogi_core.model.environment import solid_angles
from isogi_core.model.sky import LUMINANCE

SHARES = (0.5, 0.25, 0.1, 0.05, 0.02, 0.01)
"""Shares of the peak's luminance at which a lobe's edge is sought."""

WIDEST = 0.1
"""Steradians that a lobe fills at most, about 20° across: wider light is what harmonics are good at."""

CONTRAST = 4.0
"""Light whose peak has less than so many times the mean luminance has no lobe."""

NEAR = 2
"""Texels within which a lobe's surround is looked at."""


@dataclass(frozen=True)
class Lobe:
    """A disc of even radiance about the unit direction ``towards``; ``cosine`` is that of its half angle.

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
        """What a surface that faces it receives, ∫ L cosθ dω = Φ (1 + cos a)/2; (3,) linear RGB."""
        return np.array(self.flux) * (0.5 * (1.0 + self.cosine))


@dataclass(frozen=True, eq=False)
class Outline:
    """Where a ``lobe`` was found: flat places of the texels of its ``region``, and the ``level`` (3,) around it."""

    lobe: Lobe
    region: np.ndarray
    level: np.ndarray

    def clear(self, radiance: np.ndarray) -> None:
        """Leave no more than ``level`` of a lat-long ``radiance`` (h, w, 3) in the region, in place."""
        flat = radiance.reshape(-1, 3)
        flat[self.region] = np.minimum(flat[self.region], self.level)


def outlines(radiance: np.ndarray) -> Iterator[Outline]:
    """What the brightest texel of a lat-long ``radiance`` (h, w, 3) float64 may be the peak of, by edges: see SHARES.

    No two fill the same texels; there is none where nothing stands out.
    """
    seen, known = radiance @ LUMINANCE, {0}
    angles = solid_angles(*seen.shape)
    peak = int(seen.argmax())
    if not seen.flat[peak] > CONTRAST * float((seen * angles).sum()) / (4.0 * math.pi):
        return
    for share in SHARES:
        region = grow(seen > share * seen.flat[peak], peak, angles[:, 0])
        if len(region) not in known:
            known.add(len(region))
            level = surround(radiance, region)
            yield Outline(lobe_of(radiance, region, level), region, level)


def grow(mask: np.ndarray, seed: int, angles: np.ndarray) -> np.ndarray:
    """Flat places of the marked texels that hang together with ``seed``; none where they fill more than WIDEST.

    ``mask`` (h, w) bool is a lat-long image, whose columns close to a ring and whose rows go on beyond the poles;
    ``angles`` (h,) are the solid angles of a texel by row.
    """
    left, front, found = mask.ravel().copy(), np.array([seed]), []
    left[seed], filled = False, 0.0
    while len(front):
        found.append(front)
        filled += float(angles[front // mask.shape[1]].sum())
        if filled > WIDEST:
            return np.zeros(0, np.int64)
        around = neighbours(front, mask.shape[0], mask.shape[1], 1)
        front = around[left[around]]
        left[front] = False
    return np.sort(np.concatenate(found))


def neighbours(places: np.ndarray, height: int, width: int, reach: int) -> np.ndarray:
    """Flat places of all texels up to ``reach`` rows and columns from any of ``places``, each once."""
    steps = np.arange(-reach, reach + 1)
    rows = (places // width)[:, None, None] + steps[:, None]
    columns = (places % width)[:, None, None] + steps
    beyond = (rows < 0) | (rows >= height)
    rows = np.clip(np.where(rows < 0, -1 - rows, np.where(rows >= height, 2 * height - 1 - rows, rows)), 0, height - 1)
    return np.unique(rows * width + (columns + np.where(beyond, width // 2, 0)) % width)


def surround(radiance: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Mean radiance (3,) of the texels NEAR the ``region``."""
    height, width = radiance.shape[:2]
    rim = np.setdiff1d(neighbours(region, height, width, NEAR), region, assume_unique=True)
    if not len(rim):
        return np.zeros(3)
    angles = solid_angles(height, width)[rim // width, 0]
    return np.asarray(angles @ radiance.reshape(-1, 3)[rim] / angles.sum())


def lobe_of(radiance: np.ndarray, region: np.ndarray, level: np.ndarray) -> Lobe:
    """The disc with the flux, direction and spread of what the ``region`` has above a ``level`` (3,).

    The mean direction of a disc of half angle a has the length (1 + cos a)/2: so that of the region tells a.
    """
    moments = moments_of(region, *radiance.shape[:2])
    excess = np.maximum(radiance.reshape(-1, 3)[region] - level, 0.0)
    flux, vector = moments[:, 3] @ excess, (excess @ LUMINANCE) @ moments[:, :3]
    length = float(np.linalg.norm(vector))
    cosine = min(2.0 * length / float(flux @ LUMINANCE) - 1.0, 1.0)
    x, y, z = (vector / length).tolist()
    r, g, b = flux.tolist()
    return Lobe((x, y, z), cosine, (r, g, b))


def moments_of(places: np.ndarray, height: int, width: int) -> np.ndarray:
    """∫ ω dω and ∫ dω over texels of a lat-long image, in closed form; (m, 4) float64: x, y, z, steradians."""
    theta = np.pi / height * (places // width + np.array([[0], [1]]))
    phi = 2.0 * np.pi / width * (places % width + np.array([[0], [1]]))
    up = np.diff(theta / 2.0 - np.sin(2.0 * theta) / 4.0, axis=0)
    x, y = up * np.diff(np.sin(phi), axis=0), -up * np.diff(np.cos(phi), axis=0)
    z = np.diff(np.sin(theta) ** 2, axis=0) / 2.0 * np.diff(phi, axis=0)
    whole = -np.diff(np.cos(theta), axis=0) * np.diff(phi, axis=0)
    return np.concatenate([x, y, z, whole]).T
