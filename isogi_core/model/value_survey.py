"""A survey of a volume's values: their range without outliers and missing values, and their
normalisation.
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid

MAX_NORMALISED = 2.0**120
"""Largest normalised voxel or isovalue, to which outliers are clipped: float32 sums of a few
such are finite.
"""


def offset_and_scale(low: float, high: float, solid: str) -> tuple[float, float]:
    """Return the empty end of the range as a double, and ± the least power of two that spans it:
    both exact.

    Integers beyond 2^53 may have no double: the offset is then the next double outside of the
    range.
    """
    if solid == "above":
        sign = 1
        end = low
    else:
        sign = -1
        end = high
    # Adding 0 turns -0 into 0.
    offset = float(end) + 0.0
    if sign * (Fraction(offset) - Fraction(end)) > 0:
        offset = math.nextafter(offset, -sign * math.inf)
    # Compute in fractions, as differences of doubles may round or overflow.
    span = sign * (Fraction(high if sign > 0 else low) - Fraction(offset))
    if span == 0:
        return offset, float(sign)
    # The least power of two that is at least span, from its numerator and denominator.
    exponent = (span.numerator - 1).bit_length() - (span.denominator.bit_length() - 1)
    return offset, math.ldexp(sign, min(exponent, 1023))


def normalise(values: np.ndarray, offset: float, scale: float) -> np.ndarray:
    """Return ``(values - offset) / scale`` in float64 without overflow on the way, never -0,
    and at most MAX_NORMALISED in size.
    """
    sign = math.copysign(1.0, scale)
    exponent = math.frexp(scale)[1] - 1
    # Quarter the values if their range is huge: the difference of two doubles could overflow.
    shift = 2 if exponent > 1000 else 0
    with np.errstate(over="ignore"):
        distance = np.ldexp(values.astype(np.float64), -shift) - math.ldexp(offset, -shift)
        # Integers of 64 bits would lose digits as doubles: subtract them as integers if the
        # distance fits.
        if values.dtype.kind in "iu" and values.dtype.itemsize == 8 and exponent < 63:
            distance = np.where(
                np.abs(distance) < 2.0**63, _integer_distance(values, int(offset)), distance
            )
        return np.clip(
            np.ldexp(sign * distance, shift - exponent) + 0.0, -MAX_NORMALISED, MAX_NORMALISED
        )


def _integer_distance(values: np.ndarray, offset: int) -> np.ndarray:
    """Return ``values - offset`` as float64, if it is less than 2^63 in size: exact modulo 2^64."""
    whole = values.astype(values.dtype.newbyteorder("=")).view(np.uint64)
    return (whole - np.uint64(offset % 2**64)).view(np.int64).astype(np.float64)


def count_steps(low: float, high: float, dtype: np.dtype[Any]) -> float:
    """Return the number of steps of a type from ``low`` to ``high``: whole numbers, or units in
    the last place of the larger end.
    """
    if dtype.kind != "f":
        return float(high - low)
    # Floats are counted in units of the last place of the larger end.
    unit = float(np.spacing(np.array(max(abs(low), abs(high)), dtype)))
    return high / unit - low / unit


MAX_SURVEYED_VOXELS = 1 << 20
"""Most voxels that are sampled."""

SLAB_BYTES = 1 << 26
"""Bytes that are processed together."""

OUTLIER_SPANS = 1024.0
"""Values farther away than this many times the span of the others are outliers."""


def sample_step(shape: tuple[int, ...]) -> int:
    """Return the step between sampled voxels of a volume of ``shape`` (z, y, x), for at most
    MAX_SURVEYED_VOXELS.

    The step shares no divisor with the length of a row, so that every column is sampled.
    """
    # Take every n-th voxel, with n so large that few enough are read.
    step = max(-(-math.prod(shape) // MAX_SURVEYED_VOXELS), 1)
    while math.gcd(step, shape[2]) > 1:
        step += 1
    return step


def sample_values(array: np.ndarray) -> np.ndarray:
    """Return the distinct finite values of at most MAX_SURVEYED_VOXELS voxels, evenly sampled from
    ``array`` (z, y, x), ascending.

    A few layers are read at a time: an array in a file need not fit into memory.
    """
    step = sample_step(array.shape)
    layers = max(SLAB_BYTES // max(array[0].nbytes, 1), 1)
    parts = [sample_layers(array[z : z + layers], step, z) for z in range(0, len(array), layers)]
    return np.unique(np.concatenate(parts))


def sample_layers(layers: np.ndarray, step: int, first: int) -> np.ndarray:
    """Return the values that ``sample_values`` takes, with a ``step``, from the layers that
    begin at layer ``first``.
    """
    values = np.unique(layers.flat[-first * layers[0].size % step :: step])
    return values[np.isfinite(values)]


def find_core(values: np.ndarray) -> tuple[float, float]:
    """Return the ends of the core of distinct ascending ``values``, as exact Python numbers. The
    core is all of them but outliers.

    It begins as the two thirds of the values that lie closest together, and grows over gaps of up
    to OUTLIER_SPANS times its span. If the core has a smaller core in the same way, no value is an
    outlier: values may fall by powers of ten.
    """
    first, last = grow_span(values)
    # Keep all values if the core itself would lose some.
    if grow_span(values[first : last + 1]) != (0, last - first):
        first = 0
        last = len(values) - 1
    return values[first].item(), values[last].item()


def grow_span(values: np.ndarray) -> tuple[int, int]:
    """Return the first and last index of the two thirds of distinct ascending ``values`` that lie
    closest together, grown over gaps of up to OUTLIER_SPANS times the span so far.
    """
    places = positions(values)
    count = len(values)
    # Gap n lies between values n and n + 1.
    gaps = np.diff(places)
    most = count - count // 3
    # Find the run of two thirds with the least span. Places are ascending, so each run of ``most``
    # values spans the difference of its ends.
    first = int(np.argmin(places[most - 1 :] - places[: count - most + 1]))
    last = first + most - 1
    # Grow to the next gap on either side that is too wide; a larger span allows wider gaps, until
    # nothing changes. Gaps are divided, as the span times OUTLIER_SPANS could overflow.
    while True:
        too_wide = np.flatnonzero(gaps / OUTLIER_SPANS > places[last] - places[first])
        ends = (
            int(too_wide[too_wide < first].max(initial=-1)) + 1,
            int(too_wide[too_wide >= last].min(initial=count - 1)),
        )
        if ends == (first, last):
            return ends
        first, last = ends


def positions(values: np.ndarray) -> np.ndarray:
    """Return numbers with the differences of ascending ``values``, or a quarter of these if a
    difference could overflow.
    """
    if values.dtype.kind in "iu":
        # Unsigned differences of integers are exact.
        whole = values.astype(values.dtype.newbyteorder("=")).view(f"u{values.itemsize}")
        return whole - whole[0]
    reals = values.astype(np.float64)
    if np.abs(reals).max() > 2.0**1000:
        return reals * 0.25
    return reals


LEAST_SPACING = 1e-30
MOST_SPACING = 1e30
"""Range of world units per voxel, as positions are float32."""

COPY_STAGES = 3
"""Passes over all layers while a copy is made: for the range, the voxels and their histogram."""

Progress = Callable[[int, int], object]
"""Function that is called with the number of finished parts of long work, and their total."""


def no_progress(done: int, total: int) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class Survey:
    """Facts of a ``grid`` that are needed to make its voxels; see ``Volume``.

    - ``marks``: values that mean "missing", in the grid's type; ``holes``: number of voxels without
      a value.
    - ``value_range``, ``core``: exact Python numbers, in the file's units.
    - ``offset``, ``scale``: the normalisation.
    - ``tally``: number of voxels of each code, see ``codes_of``, if the type has few codes.
    """

    grid: Grid
    spacing: tuple[float, float, float]
    solid: str
    marks: np.ndarray
    value_range: tuple[float, float]
    holes: int
    core: tuple[float, float]
    offset: float
    scale: float
    tally: np.ndarray | None = None

    def planes(self) -> Iterator[np.ndarray]:
        """Yield the normalised voxels, plane by plane along z; (ny, nx) float32 each, NaN for
        holes.
        """
        # There is a tally if the type has few codes and the grid many voxels: normalise the value
        # of each code once, and look voxels up.
        if self.tally is None:
            by_code = None
        else:
            by_code = self.voxels_of(values_of(usable_type(self.grid.dtype)))
        for slab in self.grid.slabs():
            for plane in usable(slab):
                yield self.voxels_of(plane) if by_code is None else by_code[codes_of(plane)]

    def voxels_of(self, values: np.ndarray) -> np.ndarray:
        """Return the normalised voxels of ``values``, float32, NaN for holes."""
        voxels = normalise(values, self.offset, self.scale).astype(np.float32, order="C")
        if self.holes:
            voxels[~are_measured(values, self.marks)] = np.nan
        return voxels

    def tallied(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the distinct voxels (m,) float32 and the number of each (m,); None if they
        were not counted.
        """
        if self.tally is None:
            return None
        there = np.flatnonzero(self.tally)
        return self.voxels_of(values_of(usable_type(self.grid.dtype))[there]), self.tally[there]

    def pour(self, write: Callable[[np.ndarray], object], progress: Progress = no_progress) -> str:
        """Pass the ``planes`` to ``write``, one after another, and return the digest of their
        volume.
        """
        digest = begin_digest(self.grid.shape, self.spacing, self.offset, self.scale)
        for z, voxels in enumerate(self.planes()):
            digest.update(voxels.data)
            write(voxels)
            progress(len(self.grid) + z + 1, COPY_STAGES * len(self.grid))
        return digest.hexdigest()

    def facts(self, name: str, digest: str) -> dict[str, Any]:
        """Return all fields of a Volume except its voxels."""
        return {
            "spacing": self.spacing,
            "offset": self.offset,
            "scale": self.scale,
            "solid": self.solid,
            "name": name,
            "dtype": self.grid.dtype.name,
            "digest": digest,
            "value_range": (float(self.value_range[0]), float(self.value_range[1])),
            "core": (float(self.core[0]), float(self.core[1])),
            "steps": count_steps(*self.core, usable_type(self.grid.dtype)),
            "holes": self.holes,
        }


def survey(
    grid: Grid, solid: str, missing: Sequence[float] = (), progress: Progress = no_progress
) -> Survey:
    """Read all values of a ``grid`` once; those equal to one of ``missing`` are holes.

    Raises VolumeError if it is complex, not 3-D, thinner than two voxels or without a finite value,
    or if a spacing is not a positive number of a usable size.
    """
    check(grid, solid)
    spacing = checked_spacing(grid.spacing)
    kind = usable_type(grid.dtype)
    marks = find_marks(missing, kind)
    # Count the values of a narrow type, which saves work on all voxels; look at those of others.
    narrow = (
        kind.kind in "iu" and kind.itemsize <= COUNTED_BYTES and grid.size > MAX_UNSAMPLED_VOXELS
    )
    low, high, holes, some, tally = (tallying if narrow else scan)(grid, marks, progress)
    # The core is found among sampled values, and the true ends of the range.
    ends = np.array([low, high], kind)
    core = find_core(np.union1d(some[are_measured(some, marks)], ends))
    return Survey(
        grid,
        spacing,
        solid,
        marks,
        (low, high),
        holes,
        core,
        *offset_and_scale(*core, solid),
        tally,
    )


def begin_digest(
    shape: Sequence[int], spacing: Sequence[float], offset: float, scale: float
) -> "hashlib.blake2b":
    """Begin a volume's digest with shape (z, y, x), spacing and normalisation; the caller adds
    the voxels.
    """
    units = f"{tuple(shape)} {[step.hex() for step in spacing]} {offset.hex()} {scale.hex()}"
    return hashlib.blake2b(units.encode(), digest_size=16)


def check(grid: Grid, solid: str) -> None:
    """Raise VolumeError if the ``grid`` is not a real 3-D field, or ``solid`` not a side."""
    if solid not in ("above", "below"):
        raise VolumeError(
            f"solid is '{solid}': say which side of the isovalue is solid, 'above' or 'below'."
        )
    if grid.dtype.kind not in "biuf":
        raise VolumeError(f"The volume holds {grid.dtype} values: give one real number per voxel.")
    if len(grid.shape) != 3:
        raise VolumeError(
            f"The volume has {len(grid.shape)} dimensions, not 3: choose one scalar field of it."
        )
    if min(grid.shape) < 2:
        sides = " × ".join(str(n) for n in grid.shape[::-1])
        raise VolumeError(
            f"A volume of {sides} voxels has no cells: every side needs at least 2 voxels."
        )


def checked_spacing(spacing: Sequence[float]) -> tuple[float, float, float]:
    """Return the spacing as three floats. Raises VolumeError if one is missing, too small or
    too large.
    """
    steps = [float(step) for step in spacing]
    if len(steps) != 3 or not all(LEAST_SPACING <= step <= MOST_SPACING for step in steps):
        given = ", ".join(f"{step:g}" for step in steps)
        wanted = f"three positive numbers, from {LEAST_SPACING:g} to {MOST_SPACING:g}"
        raise VolumeError(f"The spacing ({given}) must be {wanted}: set spacing in the scene.")
    return steps[0], steps[1], steps[2]


def usable_type(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return the type in which values are processed: integers or floats of at most 64 bits.

    Truth values become bytes, as NumPy does not subtract them; longer floats become doubles.
    """
    if dtype.kind == "b":
        return np.dtype(np.uint8)
    if dtype.itemsize <= 8:
        return dtype
    return np.dtype(np.float64)


def usable(slab: np.ndarray) -> np.ndarray:
    """Return the values of a ``slab`` in their ``usable_type``."""
    if slab.dtype.kind == "b":
        return slab.view(np.uint8)
    with np.errstate(over="ignore"):
        return slab.astype(usable_type(slab.dtype), copy=False)


def find_marks(missing: Sequence[float], dtype: np.dtype[Any]) -> np.ndarray:
    """Return the ``missing`` values as the type holds them, without numbers that it cannot hold."""
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return np.array(missing, np.float64).astype(dtype)
    info = np.iinfo(dtype)
    return np.array(
        [int(mark) for mark in missing if info.min <= mark <= info.max and mark == int(mark)], dtype
    )


def are_measured(values: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Return which values are finite and not marked as missing; bool."""
    finite = np.isfinite(values)
    for mark in marks:
        finite &= values != mark
    return np.asarray(finite)


COUNTED_BYTES = 2
"""Bytes of integers that have so few values that each can be counted: one computation per value
then serves all its voxels.
"""

MAX_UNSAMPLED_VOXELS = 1 << 20
"""Number of voxels up to which counting values would take longer."""

Scanned = tuple[float, float, int, np.ndarray, np.ndarray | None]
"""Minimum and maximum (exact Python numbers), the number of missing values, ``sample_values``,
and a tally or None.
"""


def codes_of(values: np.ndarray) -> np.ndarray:
    """Return the bits of ``values`` of a narrow type, as unsigned integers."""
    native = values.astype(values.dtype.newbyteorder("="), order="C", copy=False)
    return native.view(f"u{values.itemsize}")


def values_of(dtype: np.dtype[Any]) -> np.ndarray:
    """Return all values of a narrow type, in the order of their codes."""
    return np.arange(1 << 8 * dtype.itemsize, dtype=f"u{dtype.itemsize}").view(
        dtype.newbyteorder("=")
    )


def tallying(grid: Grid, marks: np.ndarray, progress: Progress) -> Scanned:
    """Return the same as ``scan`` for a grid of a narrow type, by counting the voxels of each
    value.
    """
    values = values_of(usable_type(grid.dtype))
    tally = np.zeros(len(values), np.int64)
    some = []
    z = 0
    step = sample_step(grid.shape)
    # Sample the values, and count the voxels of each code, plane by plane.
    for slab in map(usable, grid.slabs()):
        some.append(sample_layers(slab, step, z))
        for plane in slab:
            tally += np.bincount(codes_of(plane).ravel(), minlength=len(tally))
            z += 1
            progress(z, COPY_STAGES * len(grid))
    # Range and holes follow from the values that occur.
    there = are_measured(values, marks)
    found = values[there & (tally > 0)]
    if not len(found):
        raise VolumeError(NO_FINITE_VALUE)
    return (
        found.min().item(),
        found.max().item(),
        int(tally[~there].sum()),
        np.unique(np.concatenate(some)),
        tally,
    )


NO_FINITE_VALUE = "The volume has no finite value: every voxel is NaN, infinite or missing."


def scan(grid: Grid, marks: np.ndarray, progress: Progress) -> Scanned:
    """Read all values once; return their range, the number of missing ones, and a sample."""
    lows = []
    highs = []
    some = []
    z = 0
    count = 0
    step = sample_step(grid.shape)
    for slab in map(usable, grid.slabs()):
        some.append(sample_layers(slab, step, z))
        for plane in slab:
            # Collect range and count of the measured values, plane by plane.
            there = plane[are_measured(plane, marks)]
            count += there.size
            if there.size:
                lows.append(there.min().item())
                highs.append(there.max().item())
            z += 1
            progress(z, COPY_STAGES * len(grid))
    if not lows:
        raise VolumeError(NO_FINITE_VALUE)
    return min(lows), max(highs), grid.size - count, np.unique(np.concatenate(some)), None


def digest_of(parts: list[Any]) -> str:
    """Return the digest (hex) of numbers and words."""
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=10).hexdigest()
