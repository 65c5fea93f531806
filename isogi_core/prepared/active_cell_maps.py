"""Active-cell maps and voxel codes of one volume.

Maps serve rays: they are kept for the next isovalues. Voxel codes serve drawing elsewhere: they
hold the voxels exactly in the smallest numbers. Voxels that no isosurface of a range needs may have
any value on their side of it; equal values take almost no bytes once compressed.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import chain, pairwise
from typing import Literal

import numpy as np

from isogi_core.files.mappings import UNMAPPED_SHARE, budget
from isogi_core.files.volume_copies import get_scratch
from isogi_core.kernels.tracing.active_cells import (
    ActiveCells,
    block_ranges,
    brick_shape,
    make_active_cells,
    measure_ranges,
)
from isogi_core.lru_cache import OVERHEAD_BYTES, LruCache
from isogi_core.model.value_survey import sample_values
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.plan.reachable_texels import surface_cells
from isogi_core.runs import Run, serially

CORE_GROUPS = 64
"""Number of groups over the core of the values, which is [0, 1] for voxels.

With a map 1/64 of the value range wide, 512 × 512 primary rays took up to 7 % longer than with one
of the isovalue alone (engine 1 %, bonsai 5 %, CT head 6 %); with 1/32 up to 13 %. Four values of a
byte lie in such a step, so that a slider needs one map for all four.
"""

CROWDED_SHARE = 15 / 16
"""Share of a volume's distinct values in one group above which the group is divided by their
ranks: smooth fields reach 0.86.
"""


NEAR_ZERO_LEVEL = 2.0**-30
"""A level just above 0, which empty space often is: maps of isovalues above it hold no empty
space.
"""


def find_levels(voxels: np.ndarray) -> np.ndarray:
    """Return the levels of a volume, at which maps begin and end, ascending from -inf to inf;
    float64.

    They divide the core evenly. If one bright voxel stretches the range, or values fall by powers
    of ten, all surfaces lie in one of these groups, whose map would hold every cell: such a group
    is divided by CORE_GROUPS quantiles of its values.
    """
    values = sample_values(voxels).astype(np.float64)
    # Divide each group that holds nearly all values; keep the others.
    levels = [-np.inf, *(np.arange(CORE_GROUPS + 1) / CORE_GROUPS), np.inf]
    return np.unique(
        [
            *chain.from_iterable(divide_group(values, *ends) for ends in pairwise(levels)),
            NEAR_ZERO_LEVEL,
            np.inf,
        ]
    )


def divide_group(values: np.ndarray, low: float, high: float) -> list[float]:
    """Return the levels of the group of values from ``low`` to before ``high``: ``low``, and those
    that divide the group, if it is crowded; never ``high``.

    A group is crowded if it holds more than CROWDED_SHARE of ``values``, the sampled distinct
    values of the volume, ascending, and more than CORE_GROUPS.
    """
    inner = values[np.searchsorted(values, low) : np.searchsorted(values, high)]
    if len(inner) <= max(CROWDED_SHARE * len(values), CORE_GROUPS):
        return [low]
    # Divide it at even ranks, so that each part has about as many values.
    ranks = np.arange(CORE_GROUPS) * len(inner) // CORE_GROUPS
    return [low, *inner[ranks].tolist()]


MAP_BYTES = 768 << 20
"""Bytes of maps that are kept. A map takes 4 bytes for each block of 64 cells, and 16 more if
any of them is marked.
"""

USUAL_BLOCK_BYTES = 6
"""Bytes per block of 64 cells that are assumed for a map before it is made."""

NARROW_LEVELS = 2
"""Number of levels that the maps of a bake span, as long as all maps that it asks for are kept.

Through maps 12 levels wide, paths in a volume of 1024³ voxels took 1.7 times as long, as they look
at more cells.
"""

MARKED_LAYERS = 4
"""Layers of bricks that are marked in one piece of work."""


Survey = Callable[[str, Callable[[], np.ndarray]], np.ndarray]
"""Function that returns an array measured on all voxels, by a name and a function that measures
it.
"""


def measure_now(name: str, measure: Callable[[], np.ndarray]) -> np.ndarray:
    """Return the result of ``measure``; the survey that keeps nothing."""
    return measure()


class ActiveCellMaps:
    """The active-cell maps of one volume. Safe to use from many threads; two that ask for the same
    map make it once.

    ``levels`` are the values at which maps begin and end, from -inf to inf, in the voxels' units,
    as all isovalues here are.
    """

    def __init__(
        self, voxels: np.ndarray, most: int = MAP_BYTES, survey: Survey = measure_now
    ) -> None:
        """Find the ranges of the blocks of ``voxels`` by a ``survey``; keep maps of at most
        ``most`` bytes.

        Maps that take much of the memory budget lie in files, as voxels do.
        """
        self._voxels = voxels
        self._bricks = math.prod(brick_shape(voxels.shape))
        # Maps that take much of the memory budget also take seconds to make; they are kept in
        # scratch files.
        self._dear = USUAL_BLOCK_BYTES * self._bricks > UNMAPPED_SHARE * budget()
        self._take = get_scratch if self._dear else np.empty
        measured = survey("ranges", lambda: measure_ranges(voxels))
        self._ranges = block_ranges(voxels, take=self._take, measured=measured)
        self.levels = survey("levels", lambda: find_levels(voxels))
        self.measured = {"ranges": measured, "levels": self.levels}
        self._kept: LruCache[tuple[int, int]] = LruCache(most)
        self._most = most
        self._sizes = dict[tuple[int, int], int]()
        self._lock = threading.Lock()
        # Mark each interval that is asked for; interval n lies between levels n and n + 1. Groups
        # start narrow, and widen as more isovalues are asked for.
        self._asked = np.zeros(len(self.levels) - 1, np.bool_)
        self._width = NARROW_LEVELS
        self._grouped: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def nbytes(self) -> int:
        """Bytes of the maps that are kept."""
        return self._kept.nbytes

    def at(self, isovalue: Isovalue, run: Run = serially) -> ActiveCells:
        """Return the map of one isosurface and those near it; it is made by means of ``run`` if
        it is not kept.
        """
        return self._between(float(isovalue), float(isovalue), run)

    def covering(self, isovalues: np.ndarray, run: Run = serially) -> ActiveCells:
        """Return the map from the least to the greatest of some ``isovalues`` (m,); it is made
        by means of ``run`` if it is not kept.
        """
        return self._between(float(isovalues.min()), float(isovalues.max()), run)

    def _between(self, lowest: float, highest: float, run: Run) -> ActiveCells:
        """Return the map of a range of isovalues, widened to levels."""
        # Find the levels around the range.
        first = int(np.searchsorted(self.levels, lowest, "right")) - 1
        last = max(int(np.searchsorted(self.levels, highest)), first + 1)
        return self._kept.get((first, last), lambda: self._make(first, last, run))

    def groups(self, isovalues: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Divide ``isovalues`` (m,), none NaN, into groups that share a map. Return the number of
        each one's group (m,), and for each group the levels at which its map begins and ends,
        (groups, 2), which may be infinite.

        Groups are NARROW_LEVELS wide at first. Each map that was asked for may be needed again, so
        groups widen until all such maps together fit into the bytes that are kept. A group's number
        is therefore valid for the result of one call.
        """
        places = np.searchsorted(self.levels, isovalues, "right") - 1
        with self._lock:
            # New intervals are asked for: note them, and divide into groups again.
            if not self._asked[places].all():
                self._ask(places)
                self._widen()
                self._grouped = None
            if self._grouped is None:
                self._grouped = self.levels[self._edges()], self.levels[self._spans()]
            ends, spans = self._grouped
        return np.searchsorted(ends, isovalues, "right") - 1, spans

    def _ask(self, places: np.ndarray) -> None:
        """Note the intervals ``places`` as asked for. If maps are dear, the noted range at least
        doubles whenever it grows.

        In a volume of 1024³ voxels a map takes seconds, and each batch of texels asks for slightly
        more than the last.
        """
        before = np.flatnonzero(self._asked)
        self._asked[places] = True
        if self._dear and len(before):
            first = int(before[0])
            last = int(before[-1])
            # Extend the noted range by its width on the side that it grows to.
            width = last + 1 - first
            if places.min() < first:
                self._asked[max(first - width, 0) : first] = True
            if places.max() > last:
                self._asked[last + 1 : last + 1 + width] = True

    def forget(self) -> None:
        """Drop all maps."""
        self._kept.clear()

    def _make(self, first: int, last: int, run: Run) -> ActiveCells:
        """Make the map from one level to another."""
        ends = float(self.levels[first]), float(self.levels[last])
        self._kept.make_room(USUAL_BLOCK_BYTES * self._bricks)
        made = make_active_cells(
            self._voxels, self._ranges, *ends, partial(run, size=MARKED_LAYERS), self._take
        )
        # Its true size may show that groups must be wider for all maps to be kept.
        with self._lock:
            self._sizes[first, last] = made.nbytes
            self._widen()
        return made

    def _widen(self) -> None:
        """Widen groups until the maps of all that were asked for fit into the limit."""
        while self._asked_bytes() > self._most and self._width < len(self._asked):
            self._width = self._width + 1
            self._grouped = None

    def _edges(self) -> np.ndarray:
        """Return the places of the groups' ends among the levels, (groups + 1,). The first group
        is the interval below the first finite level alone.
        """
        last = len(self._asked)
        return np.array([0, *range(1, last, self._width), last])

    def _spans(self) -> np.ndarray:
        """Return, for each group, the places of two levels: those that enclose all its intervals
        that were asked for, or its own ends if none was; (groups, 2).
        """
        edges = self._edges()
        # Count the intervals asked for from the first of their group.
        asked = [np.flatnonzero(self._asked[first:last]) for first, last in pairwise(edges)]
        spans = [
            (first + inner[0], first + inner[-1] + 1) if len(inner) else (first, last)
            for (first, last), inner in zip(pairwise(edges), asked, strict=True)
        ]
        return np.array(spans)

    def _asked_bytes(self) -> int:
        """Return the bytes of the maps of all groups that were asked for; USUAL_BLOCK_BYTES
        stand in for sizes that are not known.
        """
        usual = USUAL_BLOCK_BYTES * self._bricks
        spans = map(tuple, self._spans().tolist())
        asked = [span for span in spans if self._asked[slice(*span)].any()]
        return sum(self._sizes.get(span, usual) + OVERHEAD_BYTES for span in asked)


HOLE_CODE = -float(np.finfo(np.float32).max)
"""Code of a voxel without a value: graphics cards may take NaN for any number."""

SLAB_CODE_BYTES = 1 << 22
"""Most bytes of codes in a slab, unless one layer takes more."""


CodeType = Literal["uint8", "uint16", "float32"]

INTEGER_CODES: tuple[CodeType, ...] = ("uint8", "uint16")


@dataclass(frozen=True)
class VoxelCodes:
    """Codes of voxels, of NumPy type ``kind``: ``voxel = base + gain · code`` exactly.

    ``gain`` is a power of two, so that order and normals are those of the voxels. Voxels without a
    value have the code ``hole``, None if there are none. ``shape`` is that of the volume, z, y, x.
    """

    kind: CodeType
    gain: float
    base: float
    hole: float | None
    shape: tuple[int, int, int]

    @property
    def nbytes(self) -> int:
        """Bytes of all codes."""
        return math.prod(self.shape) * np.dtype(self.kind).itemsize

    @property
    def slabs(self) -> tuple[tuple[int, int], ...]:
        """First layer of each slab along z, and the first after it."""
        depth = self.shape[0]
        layers = max(SLAB_CODE_BYTES * depth // self.nbytes, 1)
        return tuple((z, min(z + layers, depth)) for z in range(0, depth, layers))

    def code(self, voxels: np.ndarray) -> np.ndarray:
        """Return the codes of ``voxels`` of any shape, little-endian."""
        if self.kind == "float32":
            if self.hole is None:
                codes = voxels
            else:
                codes = np.where(np.isnan(voxels), np.float32(self.hole), voxels)
            return np.asarray(codes, "<f4")
        return np.rint((voxels.astype(np.float64) - self.base) / self.gain).astype(
            np.dtype(self.kind).newbyteorder("<")
        )

    def holds(self, voxels: np.ndarray) -> bool:
        """Return True if the codes of ``voxels`` give exactly these voxels again."""
        return bool(
            np.array_equal((self.base + self.gain * self.code(voxels)).astype(np.float32), voxels)
        )


def find_codes(volume: Volume) -> VoxelCodes:
    """Return the codes of a ``volume``: whole numbers if its file holds such and their range fits,
    else its voxels as they are.

    All voxels are read.
    """
    ends = sorted(float(volume.normalise_isovalue(value)) for value in volume.value_range)
    gain = 1.0 / abs(volume.scale)
    if np.issubdtype(np.dtype(volume.dtype), np.integer) and not volume.holes:
        # Take the smallest type that holds the range, if it gives every voxel exactly.
        for kind in INTEGER_CODES:
            codes = VoxelCodes(kind, gain, ends[0], None, volume.shape)
            if ends[1] - ends[0] <= gain * np.iinfo(kind).max and all(
                map(codes.holds, volume.slabs())
            ):
                return codes
    return VoxelCodes("float32", 1.0, 0.0, HOLE_CODE if volume.holes else None, volume.shape)


VOXELS_BEFORE = 1
VOXELS_AFTER = 2
"""Voxels along each axis that drawing a cell reads before the cell's first voxel, and after it:
four with the first one itself, those of the cubic B-spline.
"""


class IdleVoxels:
    """The ``voxels`` (z, y, x) of a volume as isosurfaces from isovalue ``low`` to ``high``
    need them: idle voxels are those that drawing these surfaces never reads.
    """

    def __init__(self, voxels: np.ndarray, low: Isovalue, high: Isovalue) -> None:
        """Find the values that stand for idle voxels: the greatest up to ``low``, and the least
        above ``high``.
        """
        self._voxels = voxels
        self._range = (low, high)
        above = [float(layer[layer > high].min(initial=np.inf)) for layer in voxels]
        below = [float(layer[layer <= low].max(initial=-np.inf)) for layer in voxels]
        self._sides = max(below), min(above)

    def flattened(self, first: int, last: int) -> np.ndarray:
        """Return the layers from ``first`` to before ``last``, (layers, ny, nx) float32, with idle
        voxels made alike.

        Idle voxels up to the low end of the range become the greatest such value of the volume,
        those above its high end the least such. Those within the range, and holes, stay.
        """
        (low, high) = self._range
        (below, above) = self._sides
        # Set idle voxels of each side to its value; those that are needed stay.
        asked = self._voxels[first:last]
        idle = ~self.needed(first, last)
        sided = np.where(idle & (asked <= low), np.float32(below), asked)
        return np.asarray(np.where(idle & (asked > high), np.float32(above), sided), np.float32)

    def needed(self, first: int, last: int) -> np.ndarray:
        """Mark the voxels of the layers from ``first`` to before ``last`` that are not idle;
        (layers, ny, nx) bool.
        """
        # Cells from first - VOXELS_AFTER to last - 1 + VOXELS_BEFORE read voxels of these layers:
        # take all layers in which such cells have corners.
        a = max(first - VOXELS_AFTER, 0)
        b = min(last + VOXELS_AFTER, len(self._voxels))
        # Mark the cells that may show a surface, then the voxels that drawing them reads.
        marks = surface_cells(self._voxels[a:b], *self._range)
        for axis in range(3):
            marks = voxels_read(marks, axis)
        return np.asarray(marks[first - a : last - a])


def voxels_read(cells: np.ndarray, axis: int) -> np.ndarray:
    """Widen the marks of ``cells`` along an ``axis`` to all voxels that drawing these cells reads;
    bool, one more voxel than cells along that axis.
    """
    marks = np.moveaxis(cells, axis, 0)
    # Cell n reads the voxels n - VOXELS_BEFORE to n + VOXELS_AFTER, which have the places from n on
    # in ``wide``. Drop those beyond the volume at the end.
    wide = np.zeros((len(marks) + VOXELS_BEFORE + VOXELS_AFTER, *marks.shape[1:]), np.bool_)
    for shift in range(VOXELS_BEFORE + VOXELS_AFTER + 1):
        wide[shift : shift + len(marks)] |= marks
    return np.moveaxis(wide[VOXELS_BEFORE : VOXELS_BEFORE + len(marks) + 1], 0, axis)
