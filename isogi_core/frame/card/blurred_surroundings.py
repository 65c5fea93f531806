"""The surroundings of a scene as visitors' graphics cards look them up along reflected rays: an
image at several widths of blur.

A card casts few rays for a lobe, so that each ray stands for a solid angle, and takes the mean
radiance of the surroundings over it. Source: Křivánek and Colbert, "Real-time Shading with Filtered
Importance Sampling", 2008.
"""

import hashlib
import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from isogi_core.model.environment import OVERVIEW, Environment, resample
from isogi_core.plan.inputs import find_once

FORMAT = 1
"""Version of the levels; raised if the same environment gives others."""

FEWEST_ROWS = 8
"""Rows of the coarsest level: it is blurred by 22°, about as much as a quarter of the roughest
lobe.
"""

BLUR_REACH = 5.0
"""Widths of the blur beyond which it is 0."""

BRIGHTEST = 32768.0
"""Largest number that is sent: halves end at 65504."""


@dataclass(frozen=True, eq=False)
class BlurredSurroundings:
    """Lat-long images of all light from far away, in its own axes.

    - ``levels``: float16 (rows, 2 rows, 3) each, linear RGB over ``brightness``. Each level has
      half the rows of the one before. The first one is not blurred; the others are, by a width of
      π / rows.
    - ``version``: hex digest of everything that they depend on.
    """

    levels: tuple[np.ndarray, ...]
    brightness: float
    version: str

    @property
    def rows(self) -> int:
        """Rows of the first level."""
        return len(self.levels[0])

    @property
    def nbytes(self) -> int:
        """Bytes of all levels."""
        return sum(level.nbytes for level in self.levels)

    def tobytes(self) -> bytes:
        """Return the levels, one after the other: rows from +z down, columns from +x towards +y."""
        return b"".join(level.astype("<f2").tobytes() for level in self.levels)


def blurred_surroundings(environment: Environment) -> BlurredSurroundings:
    """Return the levels of an ``environment``, which are made once, and kept as long as it is."""
    return find_once(environment, BlurredSurroundings, partial(blur_surroundings, environment))


def blur_surroundings(environment: Environment) -> BlurredSurroundings:
    """Make the levels of an ``environment``. The first one has as many rows as its image, rounded
    up to a power of two, and at most those of the overview.
    """
    rows = 1 << max(len(environment.image) - 1, FEWEST_ROWS - 1).bit_length()
    rows = min(rows, OVERVIEW[0])
    levels = [environment.constant + resample(environment.image, rows, 2 * rows)]
    while rows > FEWEST_ROWS:
        # A source of twice the rows resolves the blur, and is small.
        source = resample(levels[0], rows, 2 * rows)
        rows //= 2
        levels.append(blurred(source, math.pi / rows))
    # Numbers are relative to the brightest one, so that suns fit into halves.
    brightness = float(levels[0].max()) / BRIGHTEST or 1.0
    return BlurredSurroundings(
        tuple((level / brightness).astype(np.float16) for level in levels),
        brightness,
        hashlib.blake2b(f"{environment.digest} {FORMAT}".encode(), digest_size=16).hexdigest(),
    )


def blurred(image: np.ndarray, width: float) -> np.ndarray:
    """Return a lat-long ``image`` (2h, 4h, 3) blurred on the sphere, with half of its rows and
    columns; (h, 2h, 3) float64.

    The blur at an angle γ is exp((cos γ - 1) / ``width``²), a normal distribution of this width in
    radians if it is narrow (von Mises and Fisher).
    """
    rows, columns = len(image) // 2, image.shape[1]
    theta = (np.arange(2 * rows) + 0.5) * (np.pi / (2 * rows))
    # Columns of the source lie half a column beside those of the result.
    around = np.cos((np.arange(columns) - 0.5) * (2.0 * np.pi / columns))
    waves = np.fft.rfft(image, axis=1)
    found = np.empty((rows, columns // 2, 3))
    for k in range(rows):
        middle = (k + 0.5) * (np.pi / rows)
        near = np.abs(theta - middle) <= BLUR_REACH * width
        # The blur depends on the difference of columns alone: a row of the result is a sum of
        # correlations with rows of the source, weighted by the solid angle of their pixels.
        level = math.cos(middle) * np.cos(theta[near])[:, None]
        across = math.sin(middle) * np.sin(theta[near])[:, None]
        kernel = np.exp((level + across * around - 1.0) / width**2) * np.sin(theta[near])[:, None]
        product = (waves[near] * np.fft.rfft(kernel, axis=1).conj()[..., None]).sum(axis=0)
        found[k] = np.fft.irfft(product, columns, axis=0)[::2] / kernel.sum()
    # Rounding may leave tiny negative light.
    return np.maximum(found, 0.0)
