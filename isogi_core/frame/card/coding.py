"""Transfer as small integers, for pages that have no server."""

from dataclasses import dataclass

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, band_of

TYPICAL = 0.5
"""The light that leaves a surface in the mean, over what leaves one that sees all of the light."""


MOST_CODE = (1 << 15) - 1
"""The greatest code; the least is its opposite."""


NOISE_STEP = 1.0
"""The step of ``noise_numbers``: filters know noise within a factor of √2, which moves pictures by
0.04 % (RMSE).
"""


@dataclass(frozen=True, eq=False)
class Coding:
    """Codes of transfer: number k of a texel is a whole number of ``steps[k]``, (numbers,) float32.

    A step of 0 is that of numbers which meet no light: all of them are 0.
    """

    steps: np.ndarray

    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """The codes of ``numbers`` (m, numbers); of the same shape, float32 without fractions."""
        codes = np.rint(numbers / np.where(self.steps > 0.0, self.steps, np.float32(np.inf)))
        return np.asarray(np.clip(codes, -MOST_CODE, MOST_CODE), np.float32)

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """What ``codes`` (m, numbers) stand for; float32."""
        return np.asarray(codes * self.steps, np.float32)


def coding_for(spec: BakeSpec, scale: float, error: float) -> Coding:
    """The coding of ``raw_numbers`` over a ``scale`` at which texels have about an ``error``,
    relative to light.

    The squared error of rounding is a twelfth of the squared step. Errors are the least for their
    bits where each number brings as much: steps are inverse to the light that it meets, in the mean
    over a band, as the light may turn.
    """
    meets = (
        np.concatenate([band_means(term.luminance) for term in spec.terms], axis=1).ravel()
        * scale
        / spec.unit
    )
    lit = meets > 0.0
    allowed = error * TYPICAL * spec.unoccluded / spec.unit
    steps = allowed * np.sqrt(12.0 / max(int(lit.sum()), 1)) / np.where(lit, meets, np.inf)
    return Coding(np.append(steps, [NOISE_STEP, NOISE_STEP]).astype(np.float32))


def band_means(light: np.ndarray) -> np.ndarray:
    """Root mean squares of each band of harmonics (channels, n²), for each of its coefficients; of
    the same shape.
    """
    bands = band_of(round(light.shape[1] ** 0.5))
    sums = np.stack([np.bincount(bands, each**2) for each in light]) / np.bincount(bands)
    return np.asarray(np.sqrt(sums)[:, bands])
