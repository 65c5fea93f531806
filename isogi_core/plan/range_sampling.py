"""Levels in a range of isovalues: evenly spaced, or by S3's adaptive rule, whose surfaces are evenly spaced.

S3 steps from c to c + ε (gMin(c) + k²), where gMin(c) is the least gradient on the isosurface c: the next surface is
then nowhere further than ε (1 + k²/gMin). Here ε follows from how many levels are wanted, and k² is the gradient of a
field that takes the box's diagonal for the whole range. Where noise or a plateau makes gMin small at most isovalues, k²
decides, and the levels are even ones: ``softened`` says how much of the range that is. Source: S3, section 2.3.
"""

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np

from isogi_core.model.volume import Volume

RANGE_BINS = 1024
"""Even parts of a range in which the isosurfaces are looked at."""

CELLS_WAITED_FOR = 1 << 21
"""Cells that are looked at for what a person waits for, about: they take a tenth of a second."""

SPACING_KINDS = ("uniform", "adaptive")
"""How levels are spaced."""

MAX_ROUNDED_STEP = 1e300
"""Steps from here on are not rounded to: a double may have no room for the next multiple."""

SLIDER_STOPS = 20
"""Stops of a slider. S3 lit 17 to 52 levels; twenty stand 16 pixels apart on the page, and a held key passes them in a
second.
"""


@dataclass(frozen=True)
class SampledRange:
    """Isovalues ascending, in a volume's own units, and the share of the range in which k² is above gMin: at least,
    where ``few`` cells were looked at.
    """

    levels: tuple[float, ...]
    softened: float = 0.0
    few: bool = False

    @property
    def note(self) -> str:
        """Where the adaptive rule says nothing, in a sentence; empty where that is nowhere."""
        if not self.softened:
            return ""
        why = "noise or a plateau makes the gradient vanish somewhere on the surface"
        share = f"{'at least ' if self.few else ''}{100.0 * self.softened:.0f}%"
        return f"In {share} of the range {why}: levels are even there."


def sample_range(
    volume: Volume, isovalues: tuple[float, float], count: int, way: str, most: float = math.inf
) -> SampledRange:
    """Choose ``count`` levels in a range by one of the SPACING_KINDS: each is in the middle of an equal part of it.

    Adaptive ones are ``shortened``. For them about so many cells are looked at, at ``most``: see ``least_gradients``.
    """
    shares, (low, high) = (np.arange(count) + 0.5) / count, isovalues
    if way == "uniform":
        return SampledRange(tuple((low * (1.0 - shares) + high * shares).tolist()))
    shares, softened = adaptive_shares(volume, isovalues, shares, most)
    levels = shortened((low * (1.0 - shares) + high * shares).tolist(), isovalues)
    return SampledRange(levels, softened, volume.voxels.size > most)


def find_stops(volume: Volume, isovalues: tuple[float, float]) -> SampledRange:
    """The isovalues where a slider over a range stops, by the adaptive rule; none where the range is one isovalue."""
    if isovalues[0] == isovalues[1]:
        return SampledRange(())
    return sample_range(volume, isovalues, SLIDER_STOPS, "adaptive", CELLS_WAITED_FOR)


def shortened(levels: list[float], isovalues: tuple[float, float]) -> tuple[float, ...]:
    """Ascending levels in a range with fewer digits: each moves by a 20th of the way to its neighbours at most."""
    low, high = isovalues
    around = (low - (levels[0] - low), *levels, high + (high - levels[-1]))
    return tuple(rounded(b, min(b - a, c - b) / 10.0) for a, b, c in zip(around, around[1:], around[2:], strict=False))


def rounded(value: float, most: float) -> float:
    """The nearest multiple of a power of ten that is ``most`` at most; the value where there is none, or it is huge."""
    return round(value, -math.floor(math.log10(most))) + 0.0 if 0.0 < most < MAX_ROUNDED_STEP else value


def adaptive_shares(
    volume: Volume, isovalues: tuple[float, float], shares: np.ndarray, most: float = math.inf
) -> tuple[np.ndarray, float]:
    """Where S3's rule comes to after these ``shares`` of its steps, as shares of the range; and how much is softened.

    Its steps are taken as small: the way from one level to the next is ∫ dc / (gMin + k²). No step falls into a part of
    the range that has no surface.
    """
    ends = [float(volume.normalise_isovalue(value)) for value in isovalues]
    if ends[0] == ends[1]:
        return shares, 0.0
    gradients = least_gradients(volume, (min(ends), max(ends)), most)
    gradients = gradients if ends[0] < ends[1] else gradients[::-1]
    soft = abs(ends[1] - ends[0]) / (2.0 * volume.radius)
    there = np.isfinite(gradients)
    if not there.any():
        return shares, 0.0
    way = np.append(0.0, np.cumsum(np.where(there, 1.0 / (np.where(there, gradients, 0.0) + soft), 0.0)))
    edges = np.arange(RANGE_BINS + 1) / RANGE_BINS
    onward = np.append(True, np.diff(way) > 0.0)
    found = np.interp(shares, way[onward] / way[-1], edges[onward])
    return found, float((gradients[there] < soft).mean())


def least_gradients(volume: Volume, span: tuple[float, float], most: float = math.inf) -> np.ndarray:
    """gMin in the middle of RANGE_BINS even parts of a ``span``, both in the voxels' units over the world's;
    (RANGE_BINS,) float64.

    The gradient of a cell is that in its middle, and counts at all isovalues between its least and its greatest corner;
    inf where no cell has a surface. One pass over the voxels, two layers at a time. Of a volume of more cells than
    ``most`` it takes evenly spread rows: what it finds is then at least gMin.
    """
    depth, step = RANGE_BINS.bit_length(), max(math.ceil(math.sqrt(volume.voxels.size / most)), 1)
    table = np.full(depth * RANGE_BINS, np.inf)
    for z in range(0, len(volume.voxels) - 1, step):
        low, high, gradient = cells_between(volume.voxels[z], volume.voxels[z + 1], volume.spacing, step)
        places = ((each.astype(np.float64) - span[0]) / (span[1] - span[0]) * RANGE_BINS for each in (low, high))
        first, last = (np.ceil(place - 0.5) for place in places)
        met = (np.clip(last, 0, RANGE_BINS) > np.clip(first, 0, RANGE_BINS)) & np.isfinite(gradient)
        begin, end = (np.clip(each[met], 0, RANGE_BINS).astype(np.int64) for each in (first, last))
        level = np.frexp(end - begin)[1] - 1
        for place in (begin, end - (1 << level)):
            np.minimum.at(table, level * RANGE_BINS + place, gradient[met])
    return spread_down(table.reshape(depth, RANGE_BINS))


def edges_between(lower: np.ndarray, upper: np.ndarray, step: int = 1) -> tuple[np.ndarray, ...]:
    """The four edges along x of every ``step``th row of cells between two layers (ny, nx); (rows, nx) each."""
    return tuple(rows for layer in (lower, upper) for rows in (layer[:-1:step], layer[1::step]))


def extremes_between(edges: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest corner of the cells between ``edges`` along x, (rows, nx); (rows, nx - 1) each."""
    low, high = reduce(np.minimum, edges), reduce(np.maximum, edges)
    return np.minimum(low[:, 1:], low[:, :-1]), np.maximum(high[:, 1:], high[:, :-1])


def cells_between(
    lower: np.ndarray, upper: np.ndarray, spacing: tuple[float, float, float], step: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The least and the greatest corner of the cells between two layers, and the gradient's length in their middle.

    (rows, nx - 1) each, of every ``step``th row of cells; no number beside a voxel that is none.
    """
    edges = edges_between(lower, upper, step)
    square = sum(slope**2 for slope in slopes_between(edges, spacing))
    return *extremes_between(edges), np.sqrt(square)


def slopes_between(edges: tuple[np.ndarray, ...], spacing: tuple[float, float, float]) -> tuple[np.ndarray, ...]:
    """The gradient in the middle of the cells between ``edges`` along x: its x, y and z, (rows, nx - 1) each."""
    a, b, c, d = (each.astype(np.float64) for each in edges)
    along, across, up = a + b + c + d, b - a + d - c, c - a + d - b
    slopes = (along[:, 1:] - along[:, :-1], across[:, 1:] + across[:, :-1], up[:, 1:] + up[:, :-1])
    return tuple(slope / (4.0 * length) for slope, length in zip(slopes, spacing, strict=True))


def spread_down(table: np.ndarray) -> np.ndarray:
    """The least of all entries over each place, where entry (l, i) is of places i … i + 2^l - 1; (places,)."""
    for level in range(len(table) - 1, 0, -1):
        half, above = 1 << (level - 1), table[level]
        np.minimum(table[level - 1], above, out=table[level - 1])
        np.minimum(table[level - 1, half:], above[: len(above) - half], out=table[level - 1, half:])
    return np.asarray(table[0])
