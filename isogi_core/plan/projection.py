"""Projection: at which isovalues a view's texels are to lie on the isosurface that it shows.

That follows from stiffness: the shares of each isosurface that are steep, on a plateau, noisy,
beside holes or cut by the box.

Levels in a range of isovalues: evenly spaced, or by S3's adaptive rule, whose surfaces are evenly
spaced. S3 steps from c to c + ε (gMin(c) + k²), where gMin(c) is the least gradient on the
isosurface c: the next surface is then nowhere further than ε (1 + k²/gMin). Here ε follows from how
many levels are wanted, and k² is the gradient of a field that takes the box's diagonal for the
whole range. Where noise or a plateau makes gMin small at most isovalues, k² decides, and the levels
are even ones: ``softened`` says how much of the range that is. Source: S3, section 2.3.
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
"""Layers of cells that are counted together, in all and in a sample; the voxels between two of
these are read twice.
"""

SMOOTH_ERROR = 0.005
STEEP_ERROR = 0.01
NOISY_ERROR = 0.12
"""Error of light on a surface that is not stiff, and what is added on one that is all steep, or all
noisy.

Fitted to 48 surfaces of real volumes and made ones (`benchmarks.accuracy stiffness`), each a view
of 48 × 48 pixels under constant light with texels at 2 %: relative RMSE against paths from each
pixel, without its noise. Ranks agree (Spearman's ρ = 0.7); steep surfaces err little, as their
texels are lit half-way of the step.
"""

MIN_ERROR_FACTOR = 0.2
MAX_ERROR_FACTOR = 3.5
"""The error of nine in ten of these surfaces was between these multiples of the estimate.

The estimate does not know what stands behind a surface at other isovalues: a table under a teapot,
say.
"""


@dataclass(frozen=True)
class Expectation:
    """Expected error of interpolation between texels: relative RMSE, and its likely range."""

    low: float
    likely: float
    high: float


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Counts of cells, (m,) int64 each, for isovalues ``levels`` (m,) float32 in voxel units,
    ascending.

    ``cells`` are those that the surface passes; of these, ``steep`` are those where the field leaps
    from one plateau to another, ``plateau`` those where it hardly changes, ``noisy`` those whose
    normals stray, and ``holed`` those beside a voxel that is no number. ``faces`` (6, m) are cells
    whose surface meets a face of the box, x = 0 first, then the other end along x, y = 0, … . See
    ``kernels.tracing.stiffness`` for what exactly makes them so.
    """

    levels: np.ndarray
    cells: np.ndarray
    steep: np.ndarray
    plateau: np.ndarray
    noisy: np.ndarray
    holed: np.ndarray
    faces: np.ndarray

    def share(self, some: np.ndarray) -> np.ndarray:
        """``some`` counts over all cells of the surface, 0 where there are none; (m,)."""
        return np.asarray(some / np.maximum(self.cells, 1))

    def expectation(self, place: int) -> Expectation:
        """Expected error of light on the surface at ``levels[place]``, from its STEEP_ROW and
        NOISY_ROW shares.
        """
        steep, noisy = (float(self.share(each)[place]) for each in (self.steep, self.noisy))
        likely = SMOOTH_ERROR + STEEP_ERROR * steep + NOISY_ERROR * noisy
        return Expectation(MIN_ERROR_FACTOR * likely, likely, MAX_ERROR_FACTOR * likely)


def measure_stiffness(
    field: Field, levels: Any, run: Run = serially, most: int | None = None
) -> Stiffness:
    """Count the cells of all surfaces of a ``field`` at ``levels`` (m,), in one pass.

    Of an even sample of layers, where there are more than ``most`` cells.
    """
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
        own = np.zeros_like(counts)
        for begin in begins[first:last]:
            count_stiffness(field, ascending, begin, min(begin + thick, layers), own)
        with lock:
            np.add(counts, own, out=counts)

    run(piece, len(begins), 1)
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


INTERPOLATION = 0.5
"""Share of the target error that interpolation between texels may take: a quarter of its variance.

The survey may expect a third of the true error, see MAX_ERROR_FACTOR, and projecting in vain costs
half a bake.
"""

SURVEYED_LEVELS = 33
"""Isovalues that a volume is surveyed at, evenly spaced."""

MAX_SURVEYED_CELLS = 1 << 20
"""Cells that the survey looks at, at most."""

Span = tuple[Isovalue, Isovalue]
"""Isovalues from one to another, both included."""


@dataclass(frozen=True, eq=False)
class ProjectionPlan:
    """Where texels are projected: at isovalues where the expected error of interpolation is above
    ``allowed``.

    ``levels`` (m,) are the isovalues that were surveyed, ascending, and ``errors`` (m,) what
    interpolation between texels on their own isosurfaces errs by there, relative; that of the
    nearest level counts.
    """

    levels: np.ndarray
    errors: np.ndarray
    allowed: float

    @classmethod
    def settled(cls, span: Span, projects: bool) -> "ProjectionPlan":
        """At every isovalue of a ``span``, or at none: what a scene settles itself."""
        return cls(np.array(span, float), np.full(2, np.inf if projects else 0.0), 0.0)

    @property
    def any(self) -> bool:
        """Whether texels are projected at any isovalue."""
        return bool((self.errors > self.allowed).any())

    def error(self, isovalue: Isovalue) -> float:
        """The expected error of interpolation at an isovalue; relative."""
        return float(self.errors[np.searchsorted(self._between, isovalue)])

    def projects(self, isovalue: Isovalue) -> bool:
        """Whether texels are projected onto the isosurface at an isovalue."""
        return self.error(isovalue) > self.allowed

    def spans(self) -> list[tuple[float, float]]:
        """The isovalues at which texels are projected, normalised, as ascending spans."""
        above = np.concatenate([[False], self.errors > self.allowed, [False]])
        edges = np.concatenate([self.levels[:1], self._between, self.levels[-1:]])[
            above[1:] != above[:-1]
        ]
        return [(low, high) for low, high in edges.reshape(-1, 2).tolist()]

    @property
    def _between(self) -> np.ndarray:
        """Half-way between each two levels; (m - 1,)."""
        return np.asarray((self.levels[1:] + self.levels[:-1]) / 2)


def plan_projection(field: Field, span: Span, start: Isovalue, target: float) -> ProjectionPlan:
    """Survey how stiff isosurfaces of a ``field`` are: over a ``span`` of isovalues, and at that
    where views ``start``.

    ``target`` is the relative error of the scene; macrocells are not asked for. What stiff surfaces
    err by is of ``Stiffness``.
    """
    levels = np.append(np.linspace(*span, SURVEYED_LEVELS), start)
    found = measure_stiffness(field, levels, most=MAX_SURVEYED_CELLS)
    errors = np.array([found.expectation(place).likely for place in range(len(found.levels))])
    return ProjectionPlan(found.levels.astype(float), errors, INTERPOLATION * target)


RANGE_BINS = 1024
"""Even parts of a range in which the isosurfaces are looked at."""

CELLS_WAITED_FOR = 1 << 21
"""Cells that are looked at for what a person waits for, about: they take a tenth of a second."""

SPACING_KINDS = ("uniform", "adaptive")
"""How levels are spaced."""

MAX_ROUNDED_STEP = 1e300
"""Steps from here on are not rounded to: a double may have no room for the next multiple."""

SLIDER_STOPS = 20
"""Stops of a slider. S3 lit 17 to 52 levels; twenty stand 16 pixels apart on the page, and a held
key passes them in a second.
"""


@dataclass(frozen=True)
class SampledRange:
    """Isovalues ascending, in a volume's own units, and the share of the range in which k² is above
    gMin: at least, where ``few`` cells were looked at.
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
    """Choose ``count`` levels in a range by one of the SPACING_KINDS: each is in the middle of an
    equal part of it.

    Adaptive ones are ``shortened``. For them about so many cells are looked at, at ``most``: see
    ``least_gradients``.
    """
    shares = (np.arange(count) + 0.5) / count
    (low, high) = isovalues
    if way == "uniform":
        return SampledRange(tuple((low * (1.0 - shares) + high * shares).tolist()))
    shares, softened = adaptive_shares(volume, isovalues, shares, most)
    levels = shortened((low * (1.0 - shares) + high * shares).tolist(), isovalues)
    return SampledRange(levels, softened, volume.voxels.size > most)


def find_stops(volume: Volume, isovalues: tuple[float, float]) -> SampledRange:
    """The isovalues where a slider over a range stops, by the adaptive rule; none where the range
    is one isovalue.
    """
    if isovalues[0] == isovalues[1]:
        return SampledRange(())
    return sample_range(volume, isovalues, SLIDER_STOPS, "adaptive", CELLS_WAITED_FOR)


def shortened(levels: list[float], isovalues: tuple[float, float]) -> tuple[float, ...]:
    """Ascending levels in a range with fewer digits: each moves by a 20th of the way to its
    neighbours at most.
    """
    low, high = isovalues
    around = (low - (levels[0] - low), *levels, high + (high - levels[-1]))
    return tuple(
        rounded(b, min(b - a, c - b) / 10.0)
        for a, b, c in zip(around, around[1:], around[2:], strict=False)
    )


def rounded(value: float, most: float) -> float:
    """The nearest multiple of a power of ten that is ``most`` at most; the value where there is
    none, or it is huge.
    """
    if 0.0 < most < MAX_ROUNDED_STEP:
        return round(value, -math.floor(math.log10(most))) + 0.0
    return value


def adaptive_shares(
    volume: Volume, isovalues: tuple[float, float], shares: np.ndarray, most: float = math.inf
) -> tuple[np.ndarray, float]:
    """Where S3's rule comes to after these ``shares`` of its steps, as shares of the range; and how
    much is softened.

    Its steps are taken as small: the way from one level to the next is ∫ dc / (gMin + k²). No step
    falls into a part of the range that has no surface.
    """
    ends = [float(volume.normalise_isovalue(value)) for value in isovalues]
    if ends[0] == ends[1]:
        return shares, 0.0
    gradients = least_gradients(volume, (min(ends), max(ends)), most)
    if not (ends[0] < ends[1]):
        gradients = gradients[::-1]
    soft = abs(ends[1] - ends[0]) / (2.0 * volume.radius)
    there = np.isfinite(gradients)
    if not there.any():
        return shares, 0.0
    way = np.append(
        0.0, np.cumsum(np.where(there, 1.0 / (np.where(there, gradients, 0.0) + soft), 0.0))
    )
    edges = np.arange(RANGE_BINS + 1) / RANGE_BINS
    onward = np.append(True, np.diff(way) > 0.0)
    found = np.interp(shares, way[onward] / way[-1], edges[onward])
    return found, float((gradients[there] < soft).mean())


def least_gradients(
    volume: Volume, span: tuple[float, float], most: float = math.inf
) -> np.ndarray:
    """gMin in the middle of RANGE_BINS even parts of a ``span``, both in the voxels' units over the
    world's; (RANGE_BINS,) float64.

    The gradient of a cell is that in its middle, and counts at all isovalues between its least and
    its greatest corner; inf where no cell has a surface. One pass over the voxels, two layers at a
    time. Of a volume of more cells than ``most`` it takes evenly spread rows: what it finds is then
    at least gMin.
    """
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
        first, last = (np.ceil(place - 0.5) for place in places)
        met = (np.clip(last, 0, RANGE_BINS) > np.clip(first, 0, RANGE_BINS)) & np.isfinite(gradient)
        begin, end = (np.clip(each[met], 0, RANGE_BINS).astype(np.int64) for each in (first, last))
        level = np.frexp(end - begin)[1] - 1
        for place in (begin, end - (1 << level)):
            np.minimum.at(table, level * RANGE_BINS + place, gradient[met])
    return spread_down(table.reshape(depth, RANGE_BINS))


def edges_between(lower: np.ndarray, upper: np.ndarray, step: int = 1) -> tuple[np.ndarray, ...]:
    """The four edges along x of every ``step``th row of cells between two layers (ny, nx); (rows,
    nx) each.
    """
    return tuple(rows for layer in (lower, upper) for rows in (layer[:-1:step], layer[1::step]))


def extremes_between(edges: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest corner of the cells between ``edges`` along x, (rows, nx); (rows,
    nx - 1) each.
    """
    low, high = reduce(np.minimum, edges), reduce(np.maximum, edges)
    return np.minimum(low[:, 1:], low[:, :-1]), np.maximum(high[:, 1:], high[:, :-1])


def cells_between(
    lower: np.ndarray, upper: np.ndarray, spacing: tuple[float, float, float], step: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The least and the greatest corner of the cells between two layers, and the gradient's length
    in their middle.

    (rows, nx - 1) each, of every ``step``th row of cells; no number beside a voxel that is none.
    """
    edges = edges_between(lower, upper, step)
    square = sum(slope**2 for slope in slopes_between(edges, spacing))
    return *extremes_between(edges), np.sqrt(square)


def slopes_between(
    edges: tuple[np.ndarray, ...], spacing: tuple[float, float, float]
) -> tuple[np.ndarray, ...]:
    """The gradient in the middle of the cells between ``edges`` along x: its x, y and z, (rows, nx
    - 1) each.
    """
    a, b, c, d = (each.astype(np.float64) for each in edges)
    along = a + b + c + d
    across = b - a + d - c
    up = c - a + d - b
    slopes = (along[:, 1:] - along[:, :-1], across[:, 1:] + across[:, :-1], up[:, 1:] + up[:, :-1])
    return tuple(slope / (4.0 * length) for slope, length in zip(slopes, spacing, strict=True))


def spread_down(table: np.ndarray) -> np.ndarray:
    """The least of all entries over each place, where entry (l, i) is of places i … i + 2^l - 1;
    (places,).
    """
    for level in range(len(table) - 1, 0, -1):
        half = 1 << (level - 1)
        above = table[level]
        np.minimum(table[level - 1], above, out=table[level - 1])
        np.minimum(table[level - 1, half:], above[: len(above) - half], out=table[level - 1, half:])
    return np.asarray(table[0])
