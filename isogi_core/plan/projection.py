"""Projection: at which isovalues a view's texels are to lie on the isosurface that it shows.

That follows from stiffness: the shares of each isosurface that are steep, on a plateau, noisy, beside holes or cut by
the box.
"""

import threading
from dataclasses import dataclass
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
from isogi_core.model.volume import Isovalue
from isogi_core.runs import Run, serially

COUNTED_LAYERS, SAMPLED_LAYERS = 8, 2
"""Layers of cells that are counted together, in all and in a sample; the voxels between two of these are read twice."""

SMOOTH_ERROR, STEEP_ERROR, NOISY_ERROR = 0.005, 0.01, 0.12
"""Error of light on a surface that is not stiff, and what is added on one that is all steep, or all noisy.

Fitted to 48 surfaces of real volumes and made ones (`benchmarks.accuracy stiffness`), each a view of 48 × 48 pixels
under constant light with texels at 2 %: relative RMSE against paths from each pixel, without its noise. Ranks agree
(Spearman's ρ = 0.7); steep surfaces err little, as their texels are lit half-way of the step.
"""

MIN_ERROR_FACTOR, MAX_ERROR_FACTOR = 0.2, 3.5
"""The error of nine in ten of these surfaces was between these multiples of the estimate.

The estimate does not know what stands behind a surface at other isovalues: a table under a teapot, say.
"""


@dataclass(frozen=True)
class Expectation:
    """Expected error of interpolation between texels: relative RMSE, and its likely range."""

    low: float
    likely: float
    high: float


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Counts of cells, (m,) int64 each, for isovalues ``levels`` (m,) float32 in voxel units, ascending.

    ``cells`` are those that the surface passes; of these, ``steep`` are those where the field leaps from one plateau
    to another, ``plateau`` those where it hardly changes, ``noisy`` those whose normals stray, and ``holed`` those
    beside a voxel that is no number. ``faces`` (6, m) are cells whose surface meets a face of the box, x = 0 first,
    then the other end along x, y = 0, … . See ``kernels.tracing.stiffness`` for what exactly makes them so.
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
        """Expected error of light on the surface at ``levels[place]``, from its STEEP_ROW and NOISY_ROW shares."""
        steep, noisy = (float(self.share(each)[place]) for each in (self.steep, self.noisy))
        likely = SMOOTH_ERROR + STEEP_ERROR * steep + NOISY_ERROR * noisy
        return Expectation(MIN_ERROR_FACTOR * likely, likely, MAX_ERROR_FACTOR * likely)


def measure_stiffness(field: Field, levels: Any, run: Run = serially, most: int | None = None) -> Stiffness:
    """Count the cells of all surfaces of a ``field`` at ``levels`` (m,), in one pass.

    Of an even sample of layers, where there are more than ``most`` cells.
    """
    layers = field.voxels.shape[0] - 1
    stride = 1 if most is None else max(-(-field.voxels.size // most), 1)
    thick = COUNTED_LAYERS if stride == 1 else SAMPLED_LAYERS
    begins = range(stride // 2 * thick, layers, stride * thick) or range(1)
    ascending = np.unique(np.asarray(levels, np.float32))
    counts, lock = np.zeros((COUNTED_ROWS, len(ascending) + 1), np.int64), threading.Lock()

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

The survey may expect a third of the true error, see MAX_ERROR_FACTOR, and projecting in vain costs half a bake.
"""

SURVEYED_LEVELS = 33
"""Isovalues that a volume is surveyed at, evenly spaced."""

MAX_SURVEYED_CELLS = 1 << 20
"""Cells that the survey looks at, at most."""

Span = tuple[Isovalue, Isovalue]
"""Isovalues from one to another, both included."""


@dataclass(frozen=True, eq=False)
class ProjectionPlan:
    """Where texels are projected: at isovalues where the expected error of interpolation is above ``allowed``.

    ``levels`` (m,) are the isovalues that were surveyed, ascending, and ``errors`` (m,) what interpolation between
    texels on their own isosurfaces errs by there, relative; that of the nearest level counts.
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
        edges = np.concatenate([self.levels[:1], self._between, self.levels[-1:]])[above[1:] != above[:-1]]
        return [(low, high) for low, high in edges.reshape(-1, 2).tolist()]

    @property
    def _between(self) -> np.ndarray:
        """Half-way between each two levels; (m - 1,)."""
        return np.asarray((self.levels[1:] + self.levels[:-1]) / 2)


def plan_projection(field: Field, span: Span, start: Isovalue, target: float) -> ProjectionPlan:
    """Survey how stiff isosurfaces of a ``field`` are: over a ``span`` of isovalues, and at that where views ``start``.

    ``target`` is the relative error of the scene; macrocells are not asked for. What stiff surfaces err by is of
    ``Stiffness``.
    """
    levels = np.append(np.linspace(*span, SURVEYED_LEVELS), start)
    found = measure_stiffness(field, levels, most=MAX_SURVEYED_CELLS)
    errors = np.array([found.expectation(place).likely for place in range(len(found.levels))])
    return ProjectionPlan(found.levels.astype(float), errors, INTERPOLATION * target)
