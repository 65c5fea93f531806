"""Levels in a range of isovalues: evenly spaced, or by S3's adaptive rule, whose surfaces are evenly spaced.

S3 steps from c to c + ε (gMin(c) + k²), where gMin(c) is the least gradient on the isosurface c: the next surface is
then nowhere further than ε (1 + k²/gMin). Here ε follows from how many levels are wanted, and k² is the gradient of a
field that takes the box's diagonal for the whole range. Where noise or a plateau makes gMin small at most isovalues, k²
decides, and the levels are even ones: ``softened`` says how much of the range that is. Source: S3, section 2.3.
"""

from dataclasses import dataclass

import numpy as np

from isogi_core.model.volume import Volume

BINS = 1024
"""Even parts of a range in which the isosurfaces are looked at."""

WAYS = ("uniform", "adaptive")
"""How levels are spaced."""


@dataclass(frozen=True)
class SampledRange:
    """Isovalues ascending, in a volume's own units, and the share of the range in which k² is above gMin."""

    levels: tuple[float, ...]
    softened: float = 0.0

    @property
    def note(self) -> str:
        """Where the adaptive rule says nothing, in a sentence; empty where that is nowhere."""
        if not self.softened:
            return ""
        why = "noise or a plateau makes the gradient vanish somewhere on the surface"
        return f"In {100.0 * self.softened:.0f}% of the range {why}: levels are even there."


def sample_range(volume: Volume, isovalues: tuple[float, float], count: int, way: str) -> SampledRange:
    """Choose ``count`` levels in a range by one of the WAYS: each is in the middle of an equal part of it."""
    shares, softened = (np.arange(count) + 0.5) / count, 0.0
    if way == "adaptive":
        shares, softened = adaptive_shares(volume, isovalues, shares)
    low, high = isovalues
    return SampledRange(tuple((low * (1.0 - shares) + high * shares).tolist()), softened)


def adaptive_shares(volume: Volume, isovalues: tuple[float, float], shares: np.ndarray) -> tuple[np.ndarray, float]:
    """Where S3's rule comes to after these ``shares`` of its steps, as shares of the range; and how much is softened.

    Its steps are taken as small: the way from one level to the next is ∫ dc / (gMin + k²). No step falls into a part of
    the range that has no surface.
    """
    ends = [float(volume.normalise_isovalue(value)) for value in isovalues]
    if ends[0] == ends[1]:
        return shares, 0.0
    gradients = least_gradients(volume, (min(ends), max(ends)))
    gradients = gradients if ends[0] < ends[1] else gradients[::-1]
    soft = abs(ends[1] - ends[0]) / (2.0 * volume.radius)
    there = np.isfinite(gradients)
    if not there.any():
        return shares, 0.0
    way = np.append(0.0, np.cumsum(np.where(there, 1.0 / (np.where(there, gradients, 0.0) + soft), 0.0)))
    edges = np.arange(BINS + 1) / BINS
    onward = np.append(True, np.diff(way) > 0.0)
    found = np.interp(shares, way[onward] / way[-1], edges[onward])
    return found, float((gradients[there] < soft).mean())


def least_gradients(volume: Volume, span: tuple[float, float]) -> np.ndarray:
    """gMin in the middle of BINS even parts of a ``span``, both in the voxels' units over the world's; (BINS,) float64.

    The gradient of a cell is that in its middle, and counts at all isovalues between its least and its greatest corner;
    inf where no cell has a surface. One pass over the voxels, two layers at a time.
    """
    depth = BINS.bit_length()
    table = np.full((depth, BINS), np.inf)
    for lower, upper in zip(volume.voxels, volume.voxels[1:], strict=False):
        low, high, gradient = cells_between(lower, upper, volume.spacing)
        first, last = (np.ceil((each - span[0]) / (span[1] - span[0]) * BINS - 0.5) for each in (low, high))
        met = (np.clip(last, 0, BINS) > np.clip(first, 0, BINS)) & np.isfinite(gradient)
        begin, end = (np.clip(each[met], 0, BINS).astype(np.int64) for each in (first, last))
        level = np.frexp(end - begin)[1] - 1
        np.minimum.at(table, (level, begin), gradient[met])
        np.minimum.at(table, (level, end - (1 << level)), gradient[met])
    return spread_down(table)


def extremes_between(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest corner of the cells between two layers (ny, nx); (ny - 1, nx - 1) each."""
    low, high = np.minimum(lower, upper), np.maximum(lower, upper)
    low, high = np.minimum(low[1:], low[:-1]), np.maximum(high[1:], high[:-1])
    return np.minimum(low[:, 1:], low[:, :-1]), np.maximum(high[:, 1:], high[:, :-1])


def cells_between(
    lower: np.ndarray, upper: np.ndarray, spacing: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The least and the greatest corner of the cells between two layers, and the gradient's length in their middle.

    (ny - 1, nx - 1) each; no number beside a voxel that is none.
    """
    corners = [layer[j : len(layer) - 1 + j, i : layer.shape[1] - 1 + i] for layer in (lower, upper) for j, i in SIDES]
    low, high = extremes_between(lower, upper)
    square = np.zeros(low.shape)
    for signs, step in zip(SIGNS, spacing, strict=True):
        slope = sum(float(sign) * corner.astype(np.float64) for sign, corner in zip(signs, corners, strict=True))
        square += (slope / (4.0 * step)) ** 2
    return low, high, np.sqrt(square)


SIDES = ((0, 0), (0, 1), (1, 0), (1, 1))
"""The corners of a cell in a layer, by their steps along y and x."""

SIGNS = ((-1, 1, -1, 1, -1, 1, -1, 1), (-1, -1, 1, 1, -1, -1, 1, 1), (-1, -1, -1, -1, 1, 1, 1, 1))
"""What the corners of both layers count in the slope along x, y and z."""


def spread_down(table: np.ndarray) -> np.ndarray:
    """The least of all entries over each place, where entry (l, i) is of places i … i + 2^l - 1; (places,)."""
    for level in range(len(table) - 1, 0, -1):
        half, above = 1 << (level - 1), table[level]
        np.minimum(table[level - 1], above, out=table[level - 1])
        np.minimum(table[level - 1, half:], above[: len(above) - half], out=table[level - 1, half:])
    return np.asarray(table[0])
