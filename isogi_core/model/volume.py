"""A volume: a scalar field on a regular grid, normalised once, so that kernels never see its units.

Its orientation places its box in the world. Voxels are never rotated; the world's cameras, lights
and points are, once, when a view is made.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any, NewType

import numpy as np

from isogi_core.files.grid import Grid
from isogi_core.files.spelling import shortest
from isogi_core.files.vector import Vector, triple
from isogi_core.model.value_survey import COPY_STAGES, Progress, no_progress, normalise, survey

Rows = tuple[Vector, Vector, Vector]
STRAIGHT: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

OPPOSITE = dict(zip("RASLPI", "LPIRAS", strict=True))
"""The letter of the opposite side of a patient."""


@dataclass(frozen=True)
class Orientation:
    """``world = rotation · box + origin``; a point of the box is voxel indices times spacing, x
    first.

    - ``rotation``: rows of a rotation matrix.
    - ``unit``: of the world's lengths, empty if unknown.
    - ``letters``: sides of a patient that the world's axes point to, such as "RAS", or empty.
    - ``notes``: changes that were made to the file's field; ``read_as``: a line on the kind of file
      that it was read as.
    """

    rotation: Rows = STRAIGHT
    origin: Vector = (0.0, 0.0, 0.0)
    unit: str = ""
    letters: str = ""
    notes: tuple[str, ...] = ()
    read_as: str = field(default="", compare=False)

    @classmethod
    def of(cls, grid: Grid) -> "Orientation":
        """Return the orientation of a ``grid`` on right angles."""
        if grid.affine is None:
            return cls(unit=grid.unit, notes=grid.notes, read_as=grid.read_as)
        # The columns of the affine over the spacing are unit vectors: the rotation. Remainders of
        # rounding become exact zeros.
        directions = np.array(grid.affine.matrix) / np.array(grid.spacing)
        a, b, c = (triple(row) for row in np.where(np.abs(directions) < 1e-12, 0.0, directions))
        return cls(
            (a, b, c), grid.affine.origin, grid.unit, grid.affine.letters, grid.notes, grid.read_as
        )

    @property
    def turned(self) -> bool:
        """True if the box's axes are not the world's."""
        return self.rotation != STRAIGHT

    @property
    def straight(self) -> bool:
        """True if the box's axes lie along the world's, in any order and direction."""
        parts = np.abs(self.matrix)
        return bool(np.isclose(parts, np.round(parts), atol=1e-6).all())

    @property
    def matrix(self) -> np.ndarray:
        """The rotation from the box to the world, (3, 3) float64."""
        return np.array(self.rotation)

    def affine(self, spacing: Vector) -> np.ndarray:
        """Return the affine map from voxel indices of a volume with this ``spacing`` to the
        world: a matrix, and the origin; (3, 4).
        """
        return np.column_stack([self.matrix * np.array(spacing), self.origin])

    def to_world(self, points: Any) -> np.ndarray:
        """Convert points (..., 3) of the box to the world."""
        if self.placed:
            return np.asarray(points) @ self.matrix.T + np.array(self.origin)
        return np.asarray(points)

    def point_to_box(self, point: Vector) -> Vector:
        """Convert a point of the world to the box."""
        if self.placed:
            return self.direction_to_box(triple(np.subtract(point, self.origin)))
        return point

    def direction_to_box(self, direction: Vector) -> Vector:
        """Convert a direction of the world to the box."""
        if self.turned:
            return triple(self.matrix.T @ np.array(direction))
        return direction

    def letter(self, direction: Vector) -> str:
        """Return the letter of the patient's side that a world ``direction`` points to most;
        empty without letters.
        """
        if not self.letters:
            return ""
        axis = int(np.argmax(np.abs(direction)))
        letter = self.letters[axis]
        if direction[axis] > 0.0:
            return letter
        return OPPOSITE[letter]

    def sides(self, point: Vector) -> str:
        """Return the sides of the patient that a world ``point`` lies on, seen from the world's
        origin, such as "LAS".
        """
        pairs = zip(self.letters, point, strict=False)
        return "".join(
            letter if coordinate >= 0.0 else OPPOSITE[letter] for letter, coordinate in pairs
        )

    @property
    def axes(self) -> str:
        """Sides of a patient that voxel axes x, y, z point to, as three letters; empty without
        letters.
        """
        return "".join(self.letter(triple(column)) for column in self.matrix.T)

    @property
    def placed(self) -> bool:
        """True if a point of the box has other coordinates in the world."""
        return self.turned or self.origin != (0.0, 0.0, 0.0)


PLAIN_ORIENTATION = Orientation()
"""The orientation of a volume whose world is its voxel indices times spacing."""


CUT_AWAY_VALUE = -8.0
"""What voxels that are taken away hold, in units of voxels: those that are left are from 0 to 1,
but for outliers.

A face of the isovalue c lies (f - c) / (f - CUT_AWAY_VALUE) of a voxel before the last voxels left,
f. Were it farther, faces would be flatter, and edges beside them rounder: normals are smoothed over
four voxels.
"""

CORE_LIMIT = 4.0
"""Largest normalised voxel of the core; outliers are a hundred times larger."""

HISTOGRAM_BINS = 256
"""Number of bins of a histogram."""

SLAB_BYTES = 1 << 26
"""Bytes of voxels that are processed together."""

Isovalue = NewType("Isovalue", np.floating[Any])
"""An isovalue in the units of a volume's voxels. Plain floats, as scenes and views have, are in the
units of its file.

``Volume.normalise_isovalue`` alone makes them, of float64. For mypy the two types exclude each
other: it refuses an isovalue that was not normalised, and a normalised one for the file's units.
"""


UNMEASURED_FIELDS = ("voxels", "orientation", "moment", "segmented", "level", "deviations", "cell")
"""Fields of a volume that are not facts of its voxels, and so are not kept with these."""


@dataclass(frozen=True)
class Cell:
    """One cell of a field that repeats along the axes that are ``periodic``: its first voxels along
    x, y, z, and those after its last, which are the first ones again; ``spans``.
    """

    spans: tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
    periodic: tuple[bool, bool, bool]

    def of(self, voxels: np.ndarray) -> np.ndarray:
        """The ``voxels`` (z, y, x) of the cell."""
        x, y, z = (slice(*span) for span in self.spans)
        return voxels[z, y, x]


@dataclass(frozen=True, eq=False)
class Volume:
    """A scalar field: ``value = offset + scale · voxel``, solid if ``voxel > normalised isovalue``.

    - ``voxels``: (nz, ny, nx) float32, C-contiguous, NaN if the source was not finite or its value
      is missing.
    - ``spacing``: (x, y, z), world units per voxel.
    - ``scale``: ± a power of two, negative if ``solid`` is "below".
    - ``value_range``: finite minimum and maximum in the file's units; ``core``: the same without
      outliers; ``steps``: number of values in the core that the source's type distinguishes.
    - ``holes``: number of voxels that are NaN.
    - ``digest``: hex digest of everything that light depends on.
    - ``counts``, ``span``: the ``histogram`` and the ``core_span``, if they were kept.
    - ``orientation``: place of the box in the world. Light does not depend on it, but on the places
      of the world's lights in the box.
    - ``moment``: number of the step in a series in time, and the number of steps.
    - ``segmented``: the field is made from a segmentation's labels.
    - ``level``, ``deviations``: those of the volume's ``Grid``.
    - ``cell``: one cell of a field that repeats; None if the field does not.
    """

    voxels: np.ndarray
    spacing: tuple[float, float, float]
    offset: float
    scale: float
    solid: str
    name: str
    dtype: str
    digest: str
    value_range: tuple[float, float]
    core: tuple[float, float]
    steps: float
    holes: int
    counts: tuple[int, ...] = ()
    span: tuple[float, ...] = ()
    orientation: Orientation = PLAIN_ORIENTATION
    moment: tuple[int, int] = (0, 1)
    segmented: bool = False
    level: float | None = None
    deviations: float | None = None
    cell: Cell | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along z, y, x: the order of the array."""
        nz, ny, nx = self.voxels.shape
        return nz, ny, nx

    @property
    def size(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        nz, ny, nx = self.voxels.shape
        return nx, ny, nz

    @property
    def extent(self) -> tuple[float, float, float]:
        """Lengths of the box between the outermost voxel centres, along x, y, z."""
        x, y, z = ((n - 1) * step for n, step in zip(self.size, self.spacing, strict=True))
        return x, y, z

    @property
    def centre(self) -> tuple[float, float, float]:
        """The middle of the box, in the box's x, y, z."""
        x, y, z = self.extent
        return x / 2, y / 2, z / 2

    @property
    def world_centre(self) -> Vector:
        """The middle of the box, world x, y, z."""
        return triple(self.orientation.to_world(self.centre))

    @property
    def world_bounds(self) -> tuple[Vector, Vector]:
        """Least and greatest world x, y, z of the box's corners."""
        corners = self.orientation.to_world(
            np.array(list(product(*((0.0, length) for length in self.extent))))
        )
        return triple(corners.min(axis=0)), triple(corners.max(axis=0))

    @property
    def radius(self) -> float:
        """Radius of the sphere around the box, world units."""
        return math.hypot(*self.extent) / 2

    def normalise_isovalue(self, value: float) -> Isovalue:
        """Convert an isovalue of the volume's file to the units of its voxels, rounded to
        float32 exactly as they are.
        """
        return Isovalue(
            np.float64(np.float32(normalise(np.array(float(value)), self.offset, self.scale)))
        )

    def spell(self, value: float) -> str:
        """Write an isovalue with the fewest digits that give the same surface."""
        level = self.normalise_isovalue(value)
        return shortest(value, lambda other: self.normalise_isovalue(other) == level)

    def normalise_span(self, one: float, other: float) -> tuple[Isovalue, Isovalue]:
        """Convert a range of isovalues of the volume's file to the units of its voxels; the
        least comes first.
        """
        ends = self.normalise_isovalue(one), self.normalise_isovalue(other)
        return min(ends), max(ends)

    def file_value(self, voxel: float) -> float:
        """Convert a value in the units of the voxels to those of the volume's file."""
        return self.offset + self.scale * voxel

    def slabs(self) -> Iterator[np.ndarray]:
        """Yield the voxels a few layers at a time, (layers, ny, nx) each, for work that makes
        arrays of their size.
        """
        layers = max(SLAB_BYTES // self.voxels[0].nbytes, 1)
        for z in range(0, len(self.voxels), layers):
            yield self.voxels[z : z + layers]

    def core_voxels(self) -> Iterator[np.ndarray]:
        """Yield the voxels of the core, a slab at a time, of any shape."""
        whole = self.core == self.value_range and not self.holes
        for slab in self.slabs():
            yield slab if whole else slab[np.abs(slab) <= CORE_LIMIT]

    def core_span(self) -> tuple[float, float]:
        """Return the least and the greatest voxel of the core."""
        if self.span:
            return self.span[0], self.span[1]
        ends = [
            (float(inner.min()), float(inner.max())) for inner in self.core_voxels() if inner.size
        ]
        return min(low for low, _ in ends), max(high for _, high in ends)

    def plane(self, axis: int, at: float) -> np.ndarray:
        """Return the file's values on the plane at index ``at`` across an ``axis``, 0 for x, linear
        between voxels; float64, NaN in holes.

        Columns go along the first of the other two axes, rows down the second: its end is at the
        top.
        """
        # Interpolate between the two planes of voxels around it.
        planes = np.moveaxis(self.voxels, 2 - axis, 0)
        first = min(int(at), len(planes) - 1)
        values = planes[first].astype(np.float64)
        share = at - first
        if share > 0.0:
            values = (1.0 - share) * values + share * planes[first + 1]
        if self.cell is not None:
            # what is cut away around the cell is no value of the field
            ends = planes[first : first + 1 + (share > 0.0)]
            values = np.where((ends == CUT_AWAY_VALUE).any(axis=0), np.nan, values)
        return self.offset + self.scale * values[::-1]

    def counted(
        self,
        bins: int = HISTOGRAM_BINS,
        progress: Progress = no_progress,
        tally: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> "Volume":
        """Return a copy of this volume that keeps its core's span and the counts of its histogram
        in ``bins`` bins; the volume itself if it keeps them already. Voxels are not copied.

        Finding both takes passes over all voxels. With a ``tally``, the distinct voxels and the
        number of each, no pass is needed. ``progress`` is called for the last stage of making a
        copy.
        """
        if len(self.counts) == bins and self.span:
            return self
        if tally is not None:
            # The tally has all that is needed: count distinct voxels by their numbers.
            inner = np.abs(tally[0]) <= CORE_LIMIT
            voxels, weights = (each[inner] for each in tally)
            span = float(voxels.min()), float(voxels.max())
            counts = np.histogram(voxels, bins, span, weights=weights)[0]
            progress(COPY_STAGES * len(self.voxels), COPY_STAGES * len(self.voxels))
            return replace(self, span=span, counts=tuple(counts.astype(int).tolist()))
        known = replace(self, span=self.core_span())
        return replace(known, counts=tuple(known._count(bins, progress).tolist()))

    @cached_property
    def inside_out(self) -> "Volume":
        """The volume with its other side solid: the inner side of an isosurface becomes the outer
        one.

        Its voxels are 1 - v. Turned twice it is the volume itself.
        """
        digest = hashlib.blake2b(f"{self.digest} inside out".encode(), digest_size=16).hexdigest()
        solid = "below" if self.solid == "above" else "above"
        voxels = np.float32(1.0) - self.voxels
        turned = replace(self, voxels=voxels, solid=solid, digest=digest, counts=(), span=())
        # value = offset + scale · v = (offset + scale) - scale · (1 - v).
        turned = replace(turned, offset=self.offset + self.scale, scale=-self.scale)
        vars(turned)["inside_out"] = self
        return turned

    def histogram(self, bins: int = HISTOGRAM_BINS) -> tuple[np.ndarray, np.ndarray]:
        """Return counts (bins,) int64 of the voxels in the core, and the ``bins + 1`` edges,
        float64, in the file's units.
        """
        if bins == HISTOGRAM_BINS:
            counts = self._usual
        else:
            counts = self._count(bins)
        low, high = self.core
        # A constant volume gets a bin width, so that edges differ.
        if low == high:
            low = low - 0.5
            high = high + 0.5
        t = np.linspace(0.0, 1.0, bins + 1)
        # Voxels ascend against the file's values if the scale is negative.
        return counts[:: 1 if self.scale > 0 else -1].copy(), low * (1 - t) + high * t

    @cached_property
    def _usual(self) -> np.ndarray:
        """The counts that were kept with the volume, or those of HISTOGRAM_BINS bins, which are
        counted once.
        """
        if len(self.counts) == HISTOGRAM_BINS:
            return np.array(self.counts)
        return self._count(HISTOGRAM_BINS)

    def _count(self, bins: int, progress: Progress = no_progress) -> np.ndarray:
        """Count the voxels in the core in even bins, ascending in the voxels' units; (bins,)
        int64.
        """
        span = self.core_span()
        counts = np.zeros(bins, np.int64)
        layers = len(self.voxels)
        slabs = sum(1 for _ in self.slabs())
        for number, inner in enumerate(self.core_voxels(), 1):
            counts += np.histogram(inner, bins, span)[0]
            # The histogram is the last stage of a copy: those before it count as done.
            progress((COPY_STAGES - 1) * layers + number * layers // slabs, COPY_STAGES * layers)
        return counts


def make_volume(
    array: np.ndarray,
    spacing: Sequence[float] = (1.0, 1.0, 1.0),
    solid: str = "above",
    name: str = "",
    missing: Sequence[float] = (),
) -> Volume:
    """Normalise an array (z, y, x) of any real type into a Volume; voxels equal to one of
    ``missing`` are holes.

    The offset is the core's minimum (maximum if ``solid`` is "below"), the scale the power of two
    that brings the core into [0, 1] ([0, 4] if its range exceeds 2^1023). Both are removed before
    the values become float32, for integers of 64 bits as integers: a small range on a large offset
    keeps its digits, and tiny and subnormal ranges are like any other. A constant volume has scale
    ± 1. Raises VolumeError as ``survey`` does.
    """
    found = survey(Grid.of(np.asarray(array), spacing), solid, missing)
    voxels = np.empty(found.grid.shape, np.float32)
    planes = iter(voxels)
    digest = found.pour(lambda plane: np.copyto(next(planes), plane))
    return Volume(voxels, **found.facts(name, digest))
