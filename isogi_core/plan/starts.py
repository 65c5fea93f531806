"""The isovalue that a volume is shown at first, if its file names one or its values are of a kind
whose halves or classes mean nothing: fields of both signs, densities with peaks, and maps.

Otsu's threshold, the default of all others, splits a histogram into two classes: of an orbital it
shows one lobe or the plane between both, of a density with peaks its nuclei alone. Chemists show
what holds a share of the whole: of an orbital's square, or of a density (Psi4 writes such a range
into its cubes, for 85 %). Cryo-EM and crystallography count standard deviations about the mean.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from isogi_core.files.spelling import shortest
from isogi_core.model.volume import CORE_LIMIT, Volume

SAMPLED_VOXELS = 1 << 21
"""Number of voxels that are sampled, in whole layers."""

HELD_SHARE = 0.85
"""Share of a field's squares, or of a density, that its first surface holds."""

NEAR_ZERO = 0.1
"""Values up to this share of the greatest one are near zero."""

SIGNED_NEAR = 0.75
LEAST_SIGN = 0.3
LEAST_SQUARES = 0.05
"""Of a field of both signs: the least share of voxels near zero, the least extreme of one sign over
that of the other, and the least share of squares of one sign. Eight orbitals and potentials that
were tried have 0.92, 0.57 and 0.09 or more; of 17 scans and simulations, six densities and a map of
2Fo - Fc none has all three.
"""

DIFFERENCE_SIGN = 0.65
DIFFERENCE_SQUARES = 0.42
DIFFERENCE_DEVIATIONS = 3.0
"""Of a map of differences, such as Fo - Fc: the same two shares, and the standard deviations that
it is shown at. Two that were tried have 0.71 and 0.48 or more; six maps of densities have 0.57 and
0.37 at the most, solvent and ripples below 0 among them.
"""

PEAKED_NEAR = 0.9
MOST_MASS = 0.65
MOST_VOXELS = 0.05
"""Of a density with peaks: the least share of voxels near zero; the most of its mass, and the most
of its voxels, above Otsu's threshold.
"""

LEAST_OUTSIDE = 0.002
"""Least share of voxels that a map has above the deviations that it is shown at."""

POSITIVE_ALBEDO = [0.2, 0.42, 0.78]
NEGATIVE_ALBEDO = [0.85, 0.36, 0.14]
"""Linear RGB of both signs: blue and orange, which colour-blind people tell apart."""


def both_signs(isovalue: float) -> dict[str, Any]:
    """Settings of a scene that shows a field of both signs at an ``isovalue`` and at minus that,
    each sign in its colour.
    """
    pinned = {
        "isovalue": -isovalue,
        "albedo": _albedo(-isovalue),
        "name": "positive" if isovalue < 0.0 else "negative",
    }
    return {"isovalue": isovalue, "albedo": _albedo(isovalue), "surfaces": [pinned]}


def _albedo(isovalue: float) -> list[float]:
    if isovalue > 0.0:
        return POSITIVE_ALBEDO
    return NEGATIVE_ALBEDO


@dataclass(frozen=True)
class Start:
    """The ``isovalue`` at which a volume is shown at first, if it is ``signed`` together with the
    surface at minus that; ``why`` is a sentence.
    """

    isovalue: float
    signed: bool
    why: str

    @property
    def one_sign(self) -> "Start":
        """The start of a field of both signs in a scene that shows one surface."""
        shown, other = shortest(self.isovalue), shortest(-self.isovalue)
        return replace(
            self,
            why=f"The field has both signs: its surface at {shown} is shown, and a table "
            f"[[surfaces]] with isovalue = {other} pins the other.",
        )


def find_start(volume: Volume, otsu: float) -> Start | None:
    """Where a ``volume`` starts whose Otsu's threshold is no good start; None if that is."""
    if not volume.dtype.startswith("float") or volume.segmented:
        return None
    values = sampled(volume)
    if not len(values) or values.max() == values.min() or not np.isfinite(values).all():
        return None
    if volume.deviations is None:
        signed = is_signed(values)
    else:
        signed = is_difference(values)
    low, high = volume.core
    level = volume.level
    if level is not None and low < level < high and (not signed or level != 0.0):
        both = f" and {shortest(-level)}" if signed else ""
        return Start(level, signed, f"Starts at {shortest(level)}{both}, as the file says.")
    if volume.deviations is not None:
        return of_deviations(values, DIFFERENCE_DEVIATIONS if signed else volume.deviations, signed)
    if signed:
        isovalue = rounded(holding(np.abs(values), (values / np.abs(values).max()) ** 2))
        return Start(
            isovalue,
            True,
            f"The field has both signs: its surfaces at {shortest(isovalue)} and "
            f"{shortest(-isovalue)} start "
            f"together, which hold {HELD_SHARE:.0%} of its square.",
        )
    if is_peaked(values, otsu):
        isovalue = rounded(holding(values, np.maximum(values / values.max(), 0.0)))
        return Start(
            isovalue,
            False,
            f"Starts at {shortest(isovalue)}, which holds {HELD_SHARE:.0%} of the density.",
        )
    return None


def sampled(volume: Volume) -> np.ndarray:
    """Values of some layers of a ``volume``, in the units of its file, without holes and outliers;
    (n,) float64.
    """
    step = max(-(-volume.voxels.size // SAMPLED_VOXELS), 1)
    layers = volume.voxels[step // 2 :: step] if step < len(volume.voxels) else volume.voxels[:1]
    inner = layers[np.abs(layers) <= CORE_LIMIT].astype(np.float64)
    return np.asarray(volume.offset + volume.scale * inner)


def is_signed(values: np.ndarray) -> bool:
    """Whether ``values`` are those of a field with lobes of both signs about 0."""
    sign, negative, near = signs_of(values)
    return (
        sign >= LEAST_SIGN
        and near >= SIGNED_NEAR
        and LEAST_SQUARES <= negative <= 1.0 - LEAST_SQUARES
    )


def is_difference(values: np.ndarray) -> bool:
    """Whether ``values`` of a map are differences of two: as much of them is below 0 as above."""
    sign, negative, _ = signs_of(values)
    return sign >= DIFFERENCE_SIGN and abs(negative - 0.5) <= 0.5 - DIFFERENCE_SQUARES


def signs_of(values: np.ndarray) -> tuple[float, float, float]:
    """The lesser extreme of ``values`` on a side of 0 over the greater one, the share of squares
    below 0, and the share of values near it.
    """
    low, high = -float(values.min()), float(values.max())
    peak = max(low, high)
    scaled = values / peak
    squares = scaled**2
    negative = float(squares[values < 0.0].sum() / squares.sum())
    return min(low, high) / peak, negative, float((np.abs(scaled) < NEAR_ZERO).mean())


def is_peaked(values: np.ndarray, otsu: float) -> bool:
    """Whether ``values`` are a density, most of which lies below Otsu's threshold, or nearly so."""
    peak = float(values.max())
    if peak <= 0.0 or float(values.min()) < -1e-3 * peak:
        return False
    near = float((values < NEAR_ZERO * peak).mean())
    above = values > otsu
    mass = float((values[above] / peak).sum() / (values / peak).sum())
    return near >= PEAKED_NEAR and mass <= MOST_MASS and float(above.mean()) <= MOST_VOXELS


def of_deviations(values: np.ndarray, deviations: float, signed: bool) -> Start | None:
    """The start of a map at so many standard deviations above its mean; None if its mean is far
    from 0, as of no density map, or next to nothing lies above.
    """
    mean, deviation = float(values.mean()), float(values.std())
    isovalue = rounded(mean + deviations * deviation)
    if abs(mean) > deviation or float((values > isovalue).mean()) < LEAST_OUTSIDE:
        return None
    return Start(
        isovalue,
        signed,
        f"Starts at {shortest(isovalue)}, {deviations:g} σ above the mean of the map: σ is "
        f"{deviation:.4g}, and the mean {mean:.4g}.",
    )


def holding(values: np.ndarray, weights: np.ndarray) -> float:
    """The value above which HELD_SHARE of all ``weights`` lies."""
    order = np.argsort(values)[::-1]
    summed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(summed, HELD_SHARE * summed[-1])])


def rounded(value: float) -> float:
    """A ``value`` to three digits."""
    return float(f"{value:.3g}")
