"""Transfer in few bits, for pages without a server: integers in steps as coarse as the light
allows.
"""

from dataclasses import dataclass

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, band_of

TYPICAL = 0.5
"""Mean light that leaves a surface, as a share of that which leaves one in unshadowed light."""


MOST_CODE = (1 << 15) - 1
"""Largest code; the least is its opposite. Numbers beyond are cut to these."""


NOISE_STEP = 1.0
"""Step of both ``noise_numbers``, which are logarithms to base 2: filters know noise within a
factor of √2, which changes pictures by 0.04 % (RMSE).
"""


@dataclass(frozen=True, eq=False)
class Coding:
    """Codes of transfer: number k of a texel is an integer times ``steps[k]``, (numbers,) float32.

    The step is 0 for numbers that meet no light: all of these are 0.
    """

    steps: np.ndarray

    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """Return the codes of ``numbers`` (m, numbers); of the same shape, integers in float32."""
        codes = np.rint(numbers / np.where(self.steps > 0.0, self.steps, np.float32(np.inf)))
        return np.asarray(np.clip(codes, -MOST_CODE, MOST_CODE), np.float32)

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """Return the numbers that ``codes`` (m, numbers) stand for; float32."""
        return np.asarray(codes * self.steps, np.float32)


def fold_signs(codes: np.ndarray) -> np.ndarray:
    """Return integers of either sign as unsigned ones of as many bits, small where they are: 0, -1,
    1, -2, … become 0, 1, 2, 3, …
    """
    size = codes.dtype.itemsize
    return np.asarray((codes << 1 ^ codes >> 8 * size - 1).view(f"<u{size}"))


def byte_planes(table: np.ndarray) -> bytes:
    """Return the rows of a ``table`` byte by byte: the first byte of each row, then all second
    ones, and so on. Similar bytes in a row compress well.
    """
    rows = np.ascontiguousarray(table).view(np.uint8).reshape(len(table), table.dtype.itemsize)
    return rows.T.tobytes()


def coding_for(spec: BakeSpec, scale: float, error: float) -> Coding:
    """Return the coding of ``raw_numbers`` by which rounding changes the light of a typical texel
    by about the relative ``error``. ``scale`` is the divisor of these numbers, ``raw_scale``.

    The squared error of rounding is a twelfth of the squared step. For a given number of bits the
    error of light is least if each number has the same share in it. So steps are inverse to the
    light that a number is multiplied by: the root mean square of its band, as the light may turn.
    """
    # Find the light that each number is multiplied by, in the unit of the spec.
    meets = (
        np.concatenate([band_means(term.luminance) for term in spec.terms], axis=1).ravel()
        * scale
        / spec.unit
    )
    lit = meets > 0.0
    # Distribute the error that is allowed evenly over all numbers that meet light.
    allowed = error * TYPICAL * spec.unoccluded / spec.unit
    steps = allowed * np.sqrt(12.0 / max(int(lit.sum()), 1)) / np.where(lit, meets, np.inf)
    # Raw numbers end with the two noise numbers.
    return Coding(np.append(steps, [NOISE_STEP, NOISE_STEP]).astype(np.float32))


def band_means(light: np.ndarray) -> np.ndarray:
    """Return harmonics (channels, n²) with each coefficient replaced by the root mean square of its
    band, which does not change if the light turns.
    """
    bands = band_of(round(light.shape[1] ** 0.5))
    sums = np.stack([np.bincount(bands, each**2) for each in light]) / np.bincount(bands)
    return np.asarray(np.sqrt(sums)[:, bands])
