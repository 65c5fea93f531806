"""Packing: how stored numbers become values. First comes their type, then which numbers are holes,
then slope and intercept.

Order and names follow NetCDF's conventions for climate and forecast data (CF 1.11, sections 2.5 and
8.1).
"""

import base64
import itertools
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid, read_as


@dataclass(frozen=True)
class Scaling:
    """``value = slope · stored + intercept``."""

    slope: float = 1.0
    intercept: float = 0.0

    @property
    def trivial(self) -> bool:
        """True if values equal the stored numbers."""
        return self.slope == 1.0 and self.intercept == 0.0

    def dtype(self, stored: np.dtype[Any]) -> np.dtype[Any]:
        """Return the type of values: that of stored numbers if nothing is scaled, integers if
        scaled integers fit them, else floats.
        """
        if self.trivial or stored.kind not in "iuf":
            return stored
        whole = float(self.slope).is_integer() and float(self.intercept).is_integer()
        if (
            whole
            and stored.kind in "iu"
            and stored.itemsize <= 2
            and abs(self.slope) + abs(self.intercept) < 2**14
        ):
            return np.dtype(np.int32)
        return np.dtype(np.float32 if stored.itemsize <= 2 else np.float64)

    def apply(self, values: np.ndarray) -> np.ndarray:
        """Return the values of stored numbers, in ``dtype``."""
        if self.trivial or values.dtype.kind not in "iuf":
            return values
        kind = self.dtype(values.dtype)
        if kind == np.int32:
            return values.astype(np.int32) * np.int32(self.slope) + np.int32(self.intercept)
        return (values.astype(np.float64) * self.slope + self.intercept).astype(kind)


Span = tuple[Any, Any]
"""Two ends, which belong to it."""


@dataclass(frozen=True)
class Packing:
    """How stored numbers become values.

    - ``stored``: the type as which the numbers are read; it has the size of the type in the file.
    - ``holes``: spans of numbers that are holes; ``valid``: span outside of which all numbers are
      holes. Their ends are of the type ``stored``.
    - ``scaling``: is applied to all other numbers. Values outside of the span ``within`` are holes,
      too.
    - ``notes``: sentences that say which metadata were read so.
    """

    stored: np.dtype[Any]
    holes: tuple[Span, ...] = ()
    valid: Span | None = None
    scaling: Scaling = Scaling()
    within: Span | None = None
    notes: tuple[str, ...] = ()

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of values: floats if there may be holes, which are NaN."""
        scaled = self.scaling.dtype(self.stored)
        holed = self.holes or self.valid or self.within
        if holed:
            return np.result_type(scaled, np.float32)
        return scaled

    def apply(self, given: np.ndarray) -> np.ndarray:
        """Return the values of the stored numbers that are ``given``, of any shape, in ``dtype``.

        If they are of another type than ``stored``, their bits are read as that type: attributes of
        a file may take back the sign that its type says. Their byte order stays.
        """
        order = given.dtype.byteorder
        if given.dtype.newbyteorder("=") == self.stored.newbyteorder("="):
            numbers = given
        else:
            numbers = np.ascontiguousarray(given).view(self.stored.newbyteorder(order))
        # Find all holes before any is put in: of stored numbers, and of values.
        values = self.scaling.apply(numbers)
        for gone in self._gone(numbers, values):
            values = np.where(gone, np.float32(np.nan), values)
        return values

    def read_as(self, kind: str, placed: str = "") -> str:
        """Return the line that says how a source of a ``kind`` was read; see ``grid.read_as``."""
        return read_as(kind, self.stored, placed, self.scaling.slope, self.scaling.intercept)

    def _gone(self, numbers: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
        """Mark the holes: one array (bool) for each reason that there is."""
        found = [
            numbers == low if low == high else (numbers >= low) & (numbers <= high)
            for low, high in self.holes
        ]
        spans = ((numbers, self.valid), (values, self.within))
        return found + [
            (each < span[0]) | (each > span[1]) for each, span in spans if span is not None
        ]


def holed(stored: np.dtype[Any], ends: Sequence[float | None], why: str) -> Packing:
    """Return a packing whose numbers between two ``ends``, or equal to the only one, are holes.

    Ends that are None, or that the type cannot store, are left out. ``why`` names the metadata that
    say so.
    """
    known = sorted(
        found for end in ends if end is not None and (found := as_stored(end, stored)) is not None
    )
    if not known:
        return Packing(stored)
    named = " to ".join(map(str, dict.fromkeys(known)))
    return Packing(stored, ((known[0], known[-1]),), notes=(f"Holes are {named} ({why}).",))


def whole_type(stored: np.dtype[Any], unsigned: bool) -> np.dtype[Any]:
    """Return the type of whole numbers of the same size and byte order, without a sign if
    ``unsigned``; a type of floats is returned as it is.
    """
    if stored.kind not in "iu":
        return stored
    return np.dtype(f"{'u' if unsigned else 'i'}{stored.itemsize}").newbyteorder(stored.byteorder)


def as_stored(value: Any, kind: np.dtype[Any]) -> Any:
    """Return a number as a type stores it, for comparison with others of the type; None if the type
    has no such number.

    A float is rounded to the type: a mark of 1e20 is the float32 next to it in a file of float32.
    Of a whole number the bits count, as attributes often have the other sign: 65535 and -1 are the
    same in 16 bits.
    """
    native = kind.newbyteorder("=")
    if kind.kind == "f":
        with np.errstate(over="ignore"):
            return native.type(value)
    if kind.kind not in "iu" or not math.isfinite(value) or value != int(value):
        return None
    whole = int(value)
    bits = 8 * kind.itemsize
    if not -(1 << bits - 1) <= whole < 1 << bits:
        return None
    folded = whole % (1 << bits)
    return native.type(folded - (1 << bits) if kind.kind == "i" and folded >> bits - 1 else folded)


HOLE_ATTRIBUTES = ("_FillValue", "missing_value")

NETCDF_FILL_VALUES = {
    "f4": 9.969209968386869e36,
    "f8": 9.969209968386869e36,
    "i2": -32767,
    "i4": -2147483647,
}
"""Numbers by type with which NetCDF's library fills variables that have no ``_FillValue``; bytes
have none, as all are values.
"""


PACKING_ATTRIBUTES = (
    *HOLE_ATTRIBUTES,
    "_Unsigned",
    "valid_range",
    "valid_min",
    "valid_max",
    "scale_factor",
    "add_offset",
)
"""CF's vocabulary: the attributes of a variable that say how its numbers become values."""


def climate_packing(
    attributes: Mapping[str, Any], stored: np.dtype[Any], filled: Any = None
) -> Packing:
    """Return the packing of a variable with ``attributes`` of CF's vocabulary.

    ``filled`` is the number of voxels that were never written: it is a hole if it is the one with
    which NetCDF fills variables by default.
    """
    kind = whole_type(stored, _is_unsigned(attributes, stored))
    given = {name: _numbers(attributes.get(name)) for name in HOLE_ATTRIBUTES}
    if (
        not given[HOLE_ATTRIBUTES[0]]
        and filled is not None
        and filled == as_stored(NETCDF_FILL_VALUES.get(stored.str[1:], math.nan), kind)
    ):
        given["NetCDF's default"] = [filled]
    marks = {name: [as_stored(each, kind) for each in values] for name, values in given.items()}
    holes = {
        mark: None
        for values in marks.values()
        for mark in values
        if mark is not None and not np.isnan(mark)
    }
    slope, intercept = (
        _first(attributes, name, rest)
        for name, rest in (("scale_factor", 1.0), ("add_offset", 0.0))
    )
    notes = [
        (
            f"Whole numbers are read {'without' if kind.kind == 'u' else 'with'} a sign, as "
            "_Unsigned says."
        )
    ]
    found = Packing(
        kind, tuple((mark, mark) for mark in holes), scaling=Scaling(float(slope), float(intercept))
    )
    found = _with_range(found, attributes)
    return replace(found, notes=(*(notes if kind != stored else ()), *_holes_note(found, marks)))


def _is_unsigned(attributes: Mapping[str, Any], stored: np.dtype[Any]) -> bool:
    """Return True if whole numbers have no sign, by the attribute ``_Unsigned``, else by their
    type.
    """
    given = attributes.get("_Unsigned")
    if isinstance(given, bytes):
        word = given.decode()
    else:
        word = str(given)
    return {"true": True, "false": False}.get(word.lower(), stored.kind == "u")


def _with_range(packing: Packing, attributes: Mapping[str, Any]) -> Packing:
    """Return the packing with the range of valid numbers that attributes give. If the range is in
    floats, but stored numbers are scaled integers, it is one of values.
    """
    both = _numbers(attributes.get("valid_range"))
    if len(both) == 2:
        ends = both
    else:
        ends = [
            _first(attributes, "valid_min", -math.inf),
            _first(attributes, "valid_max", math.inf),
        ]
    if any(map(math.isnan, ends)) or ends == [-math.inf, math.inf]:
        return packing
    scaled = packing.stored.kind in "iu" and not packing.scaling.trivial
    if scaled and any(isinstance(end, float) and math.isfinite(end) for end in ends):
        return replace(packing, within=(ends[0], ends[1]))
    stored = [as_stored(end, packing.stored) for end in ends]
    low, high = (end if known is None else known for end, known in zip(ends, stored, strict=True))
    if (
        packing.stored.kind in "iu"
        and low <= np.iinfo(packing.stored).min
        and high >= np.iinfo(packing.stored).max
    ):
        return packing
    if low <= high:
        return replace(packing, valid=(low, high))
    return packing


def _holes_note(packing: Packing, marks: Mapping[str, Sequence[Any]]) -> tuple[str, ...]:
    """Return a sentence that lists the holes; none if there are none."""
    named = [
        f"{mark!s} ({name})"
        for name, values in marks.items()
        for mark in values
        if mark is not None
    ]
    spans = [span for span in (packing.valid, packing.within) if span is not None]
    outside = [f"what is not from {low!s} to {high!s} (the valid range)" for low, high in spans]
    if named or outside:
        return (f"Holes are {', '.join([*named, *outside])}.",)
    return ()


def _numbers(given: Any) -> list[Any]:
    """Return the numbers of an attribute as Python's; empty if it has none."""
    if isinstance(given, str | bytes):
        return _numbers_in(given if isinstance(given, str) else given.decode("ascii", "replace"))
    if given is None:
        values = []
    else:
        values = np.ravel(given).tolist()
    return [value for value in values if isinstance(value, int | float)]


def _numbers_in(text: str) -> list[float]:
    """Return the numbers that a text stands for: Xarray writes those of Zarr's third version as the
    bytes of a double.
    """
    try:
        if text.endswith("="):
            return [struct.unpack("<d", base64.b64decode(text))[0]]
        return [float(text)]
    except (ValueError, struct.error):
        return []


def _first(attributes: Mapping[str, Any], name: str, fallback: float) -> Any:
    """Return the first number of an attribute, or the ``fallback``."""
    return (*_numbers(attributes.get(name)), fallback)[0]


FILLED_SHARE = 0.02
"""Least share of the voxels that a fill value takes; the corners beside a circle take a fifth."""

MIN_FILL_GAP = 1 / 16
TAIL_SHARE = 0.001
"""Least gap above a fill value, as a share of the range of the other values without a tail at each
end.
"""

FEW_VALUES = 64
"""Distinct values that others have at least: phantoms and labels have fewer, and gaps between all
of them.
"""

MAX_ENCLOSED_SHARE = 0.001
"""Largest share of the filled voxels that may lie between others of their row: a field of view is
convex.
"""

BESIDE_QUANTILE = 0.75
MIN_SHARE_ABOVE = 0.4
"""Beside a field of view lies air: of all voxels that are left, at least the share MIN_SHARE_ABOVE
is brighter than the share BESIDE_QUANTILE of the voxels there. An object that stands in the fill
value itself has its skin there.
"""

SAMPLED_VALUES = 1 << 12
"""Values that are kept of a layer."""

FILL_NOTE = (
    "Voxels of {value} lie outside the field of view: they are holes. In a scene, "
    "missing = [] keeps them."
)


def without_fill(grid: Grid) -> Grid:
    """Return the grid with holes in place of a fill value that its file does not name; the same
    grid if it has none.

    Such a value is the least of all and negative, as zero may be sky or the air around a phantom.
    Many voxels have it, no other value is near, it takes up all outside of a convex region, and the
    voxels next to it are darker than many others.
    """
    fill = find_fill(grid)
    if fill is None:
        return grid
    packing = Packing(grid.dtype, ((fill, fill),))
    named = f"{fill:.10g}"
    return replace(
        grid,
        dtype=packing.dtype,
        slabs=partial(_holed, grid, packing),
        stamp=lambda: f"{grid.stamp()} without {named}",
        notes=(*grid.notes, FILL_NOTE.format(value=named)),
        read_as=f"{grid.read_as}; {named} is a fill value",
    )


def _holed(grid: Grid, packing: Packing) -> Iterator[np.ndarray]:
    return map(packing.apply, grid.slabs())


def find_fill(grid: Grid) -> Any:
    """Return the fill value of a grid, a number of its type; None if it has none.

    If no corner of the first layer has the layer's least value, or that is not negative, only the
    first slab is read.
    """
    if grid.dtype.kind not in "if" or min(grid.shape) < 2:
        return None
    slabs = grid.slabs()
    try:
        first = next(slabs)
        fill = _in_a_corner(first[0])
        if fill is None:
            return None
        seen = Seen(fill)
        if all(map(seen.add, itertools.chain((first,), slabs))) and seen.is_fill(grid.size):
            return fill
        return None
    except VolumeError:  # the source is damaged, which its next reading says
        return None


def _in_a_corner(layer: np.ndarray) -> Any:
    """Return the least value of a ``layer`` if it is negative and in a corner; else None."""
    least = np.fmin.reduce(layer, axis=None)
    corners = layer[:: max(len(layer) - 1, 1), :: max(layer.shape[1] - 1, 1)]
    if least < 0 and np.isfinite(least) and (corners == least).any():
        return least
    return None


@dataclass
class Seen:
    """Counts and samples of a volume that may have the ``fill`` value: the number of voxels that
    have it, the number of these that lie between others, values ``beside`` these voxels, a sample
    of all ``others``, and the ``least`` of these.
    """

    fill: Any
    filled: int = 0
    enclosed: int = 0
    beside: list[np.ndarray] = field(default_factory=list)
    others: list[np.ndarray] = field(default_factory=list)
    least: float = math.inf

    def add(self, slab: np.ndarray) -> bool:
        """Count layers (n, ny, nx); return False if some value is less than the fill value, which
        is then none.
        """
        return not (slab < self.fill).any() and all(map(self._add, slab))

    def _add(self, layer: np.ndarray) -> bool:
        filled = layer == self.fill
        inside = ~filled & np.isfinite(layer)
        others = layer[inside]
        self.filled += int(filled.sum())
        self.enclosed += int((filled & (_between(inside) | _between(inside.T).T)).sum())
        self.beside.append(layer[_touching(filled) & inside])
        self.others.append(others[:: len(others) // SAMPLED_VALUES + 1])
        self.least = min(self.least, float(others.min()) if others.size else math.inf)
        return True

    def is_fill(self, size: int) -> bool:
        """Return True if the value fills all outside of a field of view in a volume of ``size``
        voxels.
        """
        others = np.concatenate(self.others)
        beside = np.concatenate(self.beside)
        if (
            self.filled < FILLED_SHARE * size
            or not len(others)
            or not len(beside)
            or self.enclosed > MAX_ENCLOSED_SHARE * self.filled
        ):
            return False
        bright = np.mean(others > np.quantile(beside, BESIDE_QUANTILE, method="nearest"))
        return bool(bright >= MIN_SHARE_ABOVE) and self._is_apart(others.astype(np.float64))

    def _is_apart(self, others: np.ndarray) -> bool:
        """Return True if the fill value is far below all ``others``, and these have many values."""
        low, high = np.quantile(others, (TAIL_SHARE, 1.0 - TAIL_SHARE))
        return len(np.unique(others)) >= FEW_VALUES and bool(
            self.least - float(self.fill) >= MIN_FILL_GAP * (high - low)
        )


def _between(inside: np.ndarray) -> np.ndarray:
    """Mark the voxels of each row that have voxels ``inside`` on both sides."""
    return (
        np.logical_or.accumulate(inside, 1) & np.logical_or.accumulate(inside[:, ::-1], 1)[:, ::-1]
    )


def _touching(filled: np.ndarray) -> np.ndarray:
    """Mark the voxels of which one of the four neighbours in a layer is ``filled``."""
    wide = np.pad(filled, 1)
    found: np.ndarray = wide[:-2, 1:-1] | wide[2:, 1:-1] | wide[1:-1, :-2] | wide[1:-1, 2:]
    return found
