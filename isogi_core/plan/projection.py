"""Projection: the isovalues at which a view's texels are moved onto the isosurface that it shows,
and evenly spaced isosurfaces of a range.

Projection pays on stiff surfaces. Stiffness is measured as the shares of an isosurface that are
steep, on a plateau, noisy, next to holes, or cut by the box.

Levels in a range of isovalues are either even, or spaced by S3's adaptive rule so that their
surfaces are. S3 steps from c to c + ε (gMin(c) + k²), where gMin(c) is the least gradient on the
isosurface c: the next surface is then nowhere farther away than ε (1 + k²/gMin). Here ε follows
from the number of levels, and k² is the gradient of a field that takes the box's diagonal for the
whole range. If noise or a plateau makes gMin small at most isovalues, k² decides and the levels are
even; ``softened`` is the share of the range, as far as it has surfaces, in which it does. Source:
Beason et al. 2006 (S3), section 2.3.
"""

import math
import threading
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from isogi_core.kernels.tracing.field import Field
from isogi_core.kernels.tracing.stiffness import (
    CELLS_ROW,
    COUNTED_ROWS,
    FACES_ROW,
    HOLED_ROW,
    NOISY_ROW,
    PLATEAU_ROW,
    STEEP_ROW,
    count_stiffness,
)
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.runs import Run, serially

COUNTED_LAYERS = 8
SAMPLED_LAYERS = 2
"""Layers of cells that are counted together, in a whole volume and in a sample; the layer of
voxels between two such groups is read twice.
"""

SMOOTH_ERROR = 0.005
STEEP_ERROR = 0.01
NOISY_ERROR = 0.12
"""Error of interpolated light on a surface that is not stiff, and the addition to it on one that is
steep everywhere, or noisy everywhere.

Fitted to 48 surfaces of real and synthetic volumes (`benchmarks.accuracy stiffness`), each in a
view of 48 × 48 pixels under constant light with texels at 2 %: relative RMSE against paths from
each pixel, without its noise. The ranks agree (Spearman's ρ = 0.7). Steep surfaces have a small
error, as their texels are lit half-way up the step.
"""

MIN_ERROR_FACTOR = 0.2
MAX_ERROR_FACTOR = 3.5
"""The error of nine in ten of these surfaces was between these multiples of the estimate.

The estimate does not see matter behind a surface at other isovalues, such as a table under a
teapot.
"""


@dataclass(frozen=True)
class Expectation:
    """Expected error of interpolation between texels: ``likely`` relative RMSE, and the range
    from ``low`` to ``high`` that it probably lies in.
    """

    low: float
    likely: float
    high: float


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Counts of cells for isovalues ``levels`` (m,) float32 in voxel units, ascending; (m,) int64
    each.

    - ``cells``: cells that the surface passes. The next four count those of them with a property;
      ``kernels.tracing.stiffness`` defines it exactly.
    - ``steep``: the field leaps from one plateau to another.
    - ``plateau``: the field hardly changes.
    - ``noisy``: normals deviate from those around.
    - ``holed``: a voxel next to the cell is NaN.
    - ``faces`` (6, m): cells whose surface meets a face of the box: x = 0, the other end along x, y
      = 0, ….
    """

    levels: np.ndarray
    cells: np.ndarray
    steep: np.ndarray
    plateau: np.ndarray
    noisy: np.ndarray
    holed: np.ndarray
    faces: np.ndarray

    def share(self, some: np.ndarray) -> np.ndarray:
        """Return counts ``some`` over all cells of the surface, 0 if there are none; (m,)."""
        return np.asarray(some / np.maximum(self.cells, 1))

    def expectation(self, place: int) -> Expectation:
        """Return the expected error of light on the surface at ``levels[place]``, from its
        steep and noisy shares.
        """
        steep, noisy = (float(self.share(each)[place]) for each in (self.steep, self.noisy))
        likely = SMOOTH_ERROR + STEEP_ERROR * steep + NOISY_ERROR * noisy
        return Expectation(MIN_ERROR_FACTOR * likely, likely, MAX_ERROR_FACTOR * likely)


def measure_stiffness(
    field: Field, levels: Any, run: Run = serially, most: int | None = None
) -> Stiffness:
    """Count the cells of all surfaces of a ``field`` at ``levels`` (m,), in one pass over the
    voxels by means of ``run``.

    If there are more than ``most`` cells, an even sample of layers is counted.
    """
    # Take every n-th group of layers so that about ``most`` cells are read.
    layers = field.voxels.shape[0] - 1
    if most is None:
        stride = 1
    else:
        stride = max(-(-field.voxels.size // most), 1)
    if stride == 1:
        thick = COUNTED_LAYERS
    else:
        thick = SAMPLED_LAYERS
    begins = range(stride // 2 * thick, layers, stride * thick) or range(1)
    ascending = np.unique(np.asarray(levels, np.float32))
    counts = np.zeros((COUNTED_ROWS, len(ascending) + 1), np.int64)
    lock = threading.Lock()

    def piece(first: int, last: int) -> None:
        """Count the cells of some groups of layers, and add them to all counts."""
        part = np.zeros_like(counts)
        for begin in begins[first:last]:
            count_stiffness(field, ascending, begin, min(begin + thick, layers), part)
        with lock:
            np.add(counts, part, out=counts)

    run(piece, len(begins), 1)
    # The kernel counts by differences: a cell adds at the first level that passes it, and subtracts
    # after the last.
    rows = counts.cumsum(axis=1)[:, :-1]
    return Stiffness(
        ascending,
        rows[CELLS_ROW],
        rows[STEEP_ROW],
        rows[PLATEAU_ROW],
        rows[NOISY_ROW],
        rows[HOLED_ROW],
        rows[FACES_ROW:],
    )


INTERPOLATION_SHARE = 0.5
"""Share of the target error that interpolation between texels may take: a quarter of its variance.

The true error may be three times the expected one, see MAX_ERROR_FACTOR, while projecting without
need costs half a bake.
"""

SURVEYED_LEVELS = 33
"""Number of evenly spaced isovalues at which a volume is surveyed."""

MAX_SURVEYED_CELLS = 1 << 20
"""Most cells that a survey reads."""

Span = tuple[Isovalue, Isovalue]
"""Isovalues from one to another, both included."""


@dataclass(frozen=True, eq=False)
class ProjectionPlan:
    """The isovalues at which texels are projected: those at which the expected error of
    interpolation is above ``allowed``.

    ``levels`` (m,) are the isovalues that were surveyed, ascending; ``errors`` (m,) are the
    relative errors expected there of interpolation between texels on the isosurfaces through their
    points. The nearest level decides.
    """

    levels: np.ndarray
    errors: np.ndarray
    allowed: float

    @classmethod
    def settled(cls, span: Span, projects: bool) -> "ProjectionPlan":
        """Return the plan of a scene that projects at every isovalue of a ``span``, or at none,
        by its own choice.
        """
        return cls(np.array(span, float), np.full(2, np.inf if projects else 0.0), 0.0)

    @property
    def any(self) -> bool:
        """True if texels are projected at any isovalue."""
        return bool((self.errors > self.allowed).any())

    def error(self, isovalue: Isovalue) -> float:
        """Return the expected relative error of interpolation at an ``isovalue``."""
        return float(self.errors[np.searchsorted(self._between, isovalue)])

    def projects(self, isovalue: Isovalue) -> bool:
        """Return True if texels are projected onto the isosurface at an ``isovalue``."""
        return self.error(isovalue) > self.allowed

    def spans(self) -> list[tuple[float, float]]:
        """Return the normalised isovalues at which texels are projected, as ascending spans."""
        above = np.concatenate([[False], self.errors > self.allowed, [False]])
        edges = np.concatenate([self.levels[:1], self._between, self.levels[-1:]])[
            above[1:] != above[:-1]
        ]
        return [(low, high) for low, high in edges.reshape(-1, 2).tolist()]

    @property
    def _between(self) -> np.ndarray:
        """The midpoints between neighbouring levels; (m - 1,)."""
        return np.asarray((self.levels[1:] + self.levels[:-1]) / 2)


def plan_projection(field: Field, span: Span, start: Isovalue, target: float) -> ProjectionPlan:
    """Plan the projection of texels by the stiffness of isosurfaces of a ``field``, at
    SURVEYED_LEVELS isovalues of a ``span`` and at one more, the isovalue at which views ``start``.

    ``target`` is the scene's relative error. The plan's errors are the ``likely`` ones of
    ``Stiffness.expectation``. The field needs no macrocells, and about MAX_SURVEYED_CELLS of its
    cells are read.
    """
    levels = np.append(np.linspace(*span, SURVEYED_LEVELS), start)
    found = measure_stiffness(field, levels, most=MAX_SURVEYED_CELLS)
    errors = np.array([found.expectation(place).likely for place in range(len(found.levels))])
    return ProjectionPlan(found.levels.astype(float), errors, INTERPOLATION_SHARE * target)


RANGE_BINS = 1024
"""Number of even parts of a range in which isosurfaces are examined."""

CELLS_WAITED_FOR = 1 << 21
"""Number of cells, about, that are read for a result that a person waits for: a tenth of a
second.
"""

SPACING_KINDS = ("uniform", "adaptive")
"""Ways to space levels."""

MAX_ROUNDED_STEP = 1e300
"""Steps above this are not rounded: a double may have no room for the next multiple."""

SLIDER_STOPS = 20
"""Stops of a slider. S3 lit 17 to 52 levels; twenty are 16 pixels apart on the page, and a held
key passes them in a second.
"""


@dataclass(frozen=True)
class SampledRange:
    """Isovalues ``levels``, ascending in the units of the volume's file.

    ``softened`` is the share of the range, as far as it has surfaces, in which k² is above gMin; at
    least that share, if ``few`` cells were read.
    """

    levels: tuple[float, ...]
    softened: float = 0.0
    few: bool = False

    @property
    def note(self) -> str:
        """A sentence on the part of the range in which the adaptive rule has no effect; empty
        if there is none.
        """
        if not self.softened:
            return ""
        why = "noise or a plateau makes the gradient vanish somewhere on the surface"
        share = f"{'at least ' if self.few else ''}{100.0 * self.softened:.0f}%"
        return f"In {share} of the range {why}: levels are even there."


def sample_range(
    volume: Volume, isovalues: tuple[float, float], count: int, way: str, most: float = math.inf
) -> SampledRange:
    """Choose ``count`` levels in a range by one of the SPACING_KINDS, ``way``: each in the middle
    of an equal part.

    Adaptive levels are rounded by ``shortened``. They read about ``most`` cells, see
    ``least_gradients``.
    """
    shares = (np.arange(count) + 0.5) / count
    (low, high) = isovalues
    if way == "uniform":
        return SampledRange(tuple((low * (1.0 - shares) + high * shares).tolist()))
    # Place levels by the adaptive rule, and round them for display.
    shares, softened = adaptive_shares(volume, isovalues, shares, most)
    levels = shortened((low * (1.0 - shares) + high * shares).tolist(), isovalues)
    return SampledRange(levels, softened, volume.voxels.size > most)


def find_stops(volume: Volume, isovalues: tuple[float, float]) -> SampledRange:
    """Return the isovalues at which a slider over a range stops, by the adaptive rule; none if
    the range is one isovalue.
    """
    if isovalues[0] == isovalues[1]:
        return SampledRange(())
    return sample_range(volume, isovalues, SLIDER_STOPS, "adaptive", CELLS_WAITED_FOR)


def shortened(levels: list[float], isovalues: tuple[float, float]) -> tuple[float, ...]:
    """Round ascending levels in a range to fewer digits: each moves by at most a 20th of the
    distance to its neighbours.
    """
    low, high = isovalues
    around = (low - (levels[0] - low), *levels, high + (high - levels[-1]))
    return tuple(
        rounded(b, min(b - a, c - b) / 10.0)
        for a, b, c in zip(around, around[1:], around[2:], strict=False)
    )


def rounded(value: float, most: float) -> float:
    """Round ``value`` to a multiple of the largest power of ten that is at most ``most``. The
    value is returned as it is if there is none, or if ``most`` is huge.
    """
    if 0.0 < most < MAX_ROUNDED_STEP:
        return round(value, -math.floor(math.log10(most))) + 0.0
    return value


def adaptive_shares(
    volume: Volume, isovalues: tuple[float, float], shares: np.ndarray, most: float = math.inf
) -> tuple[np.ndarray, float]:
    """Place levels in a range of ``isovalues`` by the adaptive rule, see the top of this file.

    Return the places, as shares of the range, that are reached after ``shares`` (m,) of all steps;
    and the softened share, see ``SampledRange``. If the range is one isovalue or has no surface,
    the ``shares`` are returned as they are.

    A step from c is ε (gMin + k²) long, so the number of steps from one level to another is, but
    for the factor ε, their way ∫ dc / (gMin + k²), and equal steps are equal parts of it. Parts of
    the range without a surface add nothing to the way, and no level lies in them. About ``most``
    cells are read, see ``least_gradients``.
    """
    ends = [float(volume.normalise_isovalue(value)) for value in isovalues]
    if ends[0] == ends[1]:
        return shares, 0.0
    # Find gMin over the range, in the direction from its first isovalue to its last.
    gradients = least_gradients(volume, (min(ends), max(ends)), most)
    if not (ends[0] < ends[1]):
        gradients = gradients[::-1]
    # k²: the gradient of a field that takes the box's diagonal for the whole range.
    soft = abs(ends[1] - ends[0]) / (2.0 * volume.radius)
    there = np.isfinite(gradients)
    if not there.any():
        return shares, 0.0
    # Integrate the way. Parts without a surface take none: of a gap both ends are kept, where the
    # way stands still, and of a gap at an end of the range the inner one.
    way = np.append(
        0.0, np.cumsum(np.where(there, 1.0 / (np.where(there, gradients, 0.0) + soft), 0.0))
    )
    edges = np.arange(RANGE_BINS + 1) / RANGE_BINS
    moves = np.diff(way) > 0.0
    kept = np.append(moves, False) | np.append(False, moves)
    found = np.interp(shares, way[kept] / way[-1], edges[kept])
    return found, float((gradients[there] < soft).mean())


def least_gradients(
    volume: Volume, span: tuple[float, float], most: float = math.inf
) -> np.ndarray:
    """Return gMin in the middle of each of RANGE_BINS even parts of a ``span``, in units of voxels
    per unit of the world; (RANGE_BINS,) float64.

    The gradient of a cell is that in its middle. It counts at all isovalues between the cell's
    least and greatest corner. A part is inf if no cell has a surface in it. The voxels are read
    once, two layers at a time. If there are more than ``most`` cells, evenly spread rows are read:
    the result is then an upper bound of gMin.
    """
    # The table holds minima over intervals of 2^l parts for each l: a cell writes to at most two,
    # which together cover its range.
    depth = RANGE_BINS.bit_length()
    step = max(math.ceil(math.sqrt(volume.voxels.size / most)), 1)
    table = np.full(depth * RANGE_BINS, np.inf)
    for z in range(0, len(volume.voxels) - 1, step):
        low, high, gradient = cells_between(
            volume.voxels[z], volume.voxels[z + 1], volume.spacing, step
        )
        places = (
            (each.astype(np.float64) - span[0]) / (span[1] - span[0]) * RANGE_BINS
            for each in (low, high)
        )
        # Find the parts whose middle lies in the cell's range.
        first, last = (np.ceil(place - 0.5) for place in places)
        met = (np.clip(last, 0, RANGE_BINS) > np.clip(first, 0, RANGE_BINS)) & np.isfinite(gradient)
        begin, end = (np.clip(each[met], 0, RANGE_BINS).astype(np.int64) for each in (first, last))
        # Write the gradient to the two longest intervals of a power of two within the range.
        level = np.frexp(end - begin)[1] - 1
        for place in (begin, end - (1 << level)):
            np.minimum.at(table, level * RANGE_BINS + place, gradient[met])
    return spread_down(table.reshape(depth, RANGE_BINS))


def edges_between(lower: np.ndarray, upper: np.ndarray, step: int = 1) -> tuple[np.ndarray, ...]:
    """Return the four edges along x of every ``step``-th row of cells between two layers (ny,
    nx); (rows, nx) each.
    """
    return tuple(rows for layer in (lower, upper) for rows in (layer[:-1:step], layer[1::step]))


def extremes_between(edges: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the greatest corner of the cells between ``edges`` along x, (rows,
    nx) each; (rows, nx - 1) each.
    """
    low, high = reduce(np.minimum, edges), reduce(np.maximum, edges)
    return np.minimum(low[:, 1:], low[:, :-1]), np.maximum(high[:, 1:], high[:, :-1])


def cells_between(
    lower: np.ndarray, upper: np.ndarray, spacing: tuple[float, float, float], step: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the least and the greatest corner of the cells between two layers, and the length of
    the gradient in their middle.

    (rows, nx - 1) each, for every ``step``-th row of cells; NaN next to a voxel that is NaN.
    """
    edges = edges_between(lower, upper, step)
    square = sum(slope**2 for slope in slopes_between(edges, spacing))
    return *extremes_between(edges), np.sqrt(square)


def slopes_between(
    edges: tuple[np.ndarray, ...], spacing: tuple[float, float, float]
) -> tuple[np.ndarray, ...]:
    """Return the gradient in the middle of the cells between ``edges`` along x: its x, y and z,
    (rows, nx - 1) each.
    """
    # Average the differences over the four edges of a cell along each axis: a and b lie in the
    # lower layer of voxels, c and d in the upper one.
    a, b, c, d = (each.astype(np.float64) for each in edges)
    along = a + b + c + d
    across = b - a + d - c
    up = c - a + d - b
    slopes = (along[:, 1:] - along[:, :-1], across[:, 1:] + across[:, :-1], up[:, 1:] + up[:, :-1])
    return tuple(slope / (4.0 * length) for slope, length in zip(slopes, spacing, strict=True))


def spread_down(table: np.ndarray) -> np.ndarray:
    """Return the minimum of all entries that cover each place, if entry (l, i) of the ``table``
    covers the places i … i + 2^l - 1; (places,).
    """
    for level in range(len(table) - 1, 0, -1):
        # Push each interval down to its two halves.
        half = 1 << (level - 1)
        above = table[level]
        np.minimum(table[level - 1], above, out=table[level - 1])
        np.minimum(table[level - 1, half:], above[: len(above) - half], out=table[level - 1, half:])
    return np.asarray(table[0])
