"""Named axes and their coordinates, as NetCDF, HDF5 and Zarr have them: the roles of axes (x, y, z,
time, channel), and the place of voxels.

Names and directions are those of NetCDF's conventions for climate and forecast data (CF 1.11,
chapters 4 and 5).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from isogi_core.files.grid import Affine
from isogi_core.files.units import LENGTHS
from isogi_core.files.vector import Vector, triple

EVEN_STEP_SHARE = 1e-3
"""Largest part of a step by which a coordinate may stray for its axis to be even."""

SPACING_KEY = "#spacing=1,1,2, or spacing in the scene, sets it"
"""The way to say how far voxels lie apart."""

NAMES = {
    "x": ("x", "lon", "longitude", "easting", "xc", "nx", "rlon", "projection_x_coordinate"),
    "y": ("y", "lat", "latitude", "northing", "yc", "ny", "rlat", "projection_y_coordinate"),
    "z": (
        *("z", "lev", "level", "depth", "height", "altitude", "alt", "plev", "elevation", "nz"),
        *("isobaric", "pressure", "air_pressure", "zc", "deptht", "st_ocean"),
    ),
    "t": ("t", "time", "valid_time", "date", "year", "month", "day", "hour"),
    "c": ("c", "channel", "channels", "ch", "band"),
}
"""Names of dimensions, and of CF's standard names, that say which axis they are."""

CF_AXES = {"X": "x", "Y": "y", "Z": "z", "T": "t"}
EAST = ("degrees_east", "degree_east", "degree_e", "degrees_e", "degreese")
NORTH = ("degrees_north", "degree_north", "degree_n", "degrees_n", "degreesn")
PRESSURES = ("pa", "hpa", "kpa", "mbar", "millibar", "millibars", "bar", "dbar", "decibar", "atm")
"""Units by which CF tells longitude, latitude and the vertical."""


@dataclass(frozen=True, eq=False)
class Along:
    """Coordinates along an axis, (n,), their unit, and ``down``, True if they grow downwards."""

    values: np.ndarray
    unit: str = ""
    down: bool = False


@dataclass(frozen=True)
class Place:
    """The place of voxels: spacing, affine map (None if the file gives the spacing alone), unit of
    lengths, and notes. ``said`` is True if the file gives it.
    """

    spacing: Vector = (1.0, 1.0, 1.0)
    affine: Affine | None = None
    unit: str = ""
    notes: tuple[str, ...] = ()
    said: bool = False


NOWHERE = Place()
"""The place of voxels of which a file says nothing."""


def text_of(value: Any) -> str:
    """Return an attribute as a text; letters one by one, as Imaris keeps them, are joined."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "S" and value.size > 1 and value.dtype.itemsize == 1:
            return value.tobytes().decode("utf-8", "replace")
        value = value.ravel()[0] if value.size else ""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(value)


SPACING_WORDS = ("spacing", "voxel", "pixel", "resolution", "element_size", "scale")
"""Words in the names of attributes that may say how far voxels lie apart."""


def unread_spacing(attributes: Mapping[str, Any]) -> tuple[str, ...]:
    """Say which attribute of three numbers looks like spacing, of which isogi does not know the
    order or the unit.
    """
    for name, value in attributes.items():
        try:
            steps = np.ravel(np.asarray(value, np.float64))
        except (TypeError, ValueError):
            continue
        if any(word in str(name).lower() for word in SPACING_WORDS) and steps.size == 3:
            given = ", ".join(f"{step:g}" for step in steps)
            return (f"Its attribute '{name}', {given}, is not read as spacing: {SPACING_KEY}.",)
    return ()


def role_of(name: str, attributes: Mapping[str, Any]) -> str:
    """Tell which axis a dimension is, by the ``attributes`` of its coordinates, else by its name:
    x, y, z, t, c, or nothing if neither says it.
    """
    axis = CF_AXES.get(text_of(attributes.get("axis", "")).upper(), "")
    unit = text_of(attributes.get("units", "")).lower()
    if axis:
        return axis
    if " since " in unit:
        return "t"
    if unit in EAST:
        return "x"
    if unit in NORTH:
        return "y"
    if text_of(attributes.get("positive", "")).lower() in ("up", "down"):
        return "z"
    known = {word: role for role, words in NAMES.items() for word in words}
    standard = text_of(attributes.get("standard_name", "")).lower()
    return known.get(name.rpartition("/")[2].lower()) or known.get(standard, "")


def roles_of(found: Sequence[str]) -> tuple[str, ...]:
    """Settle the roles of an array's axes, the slowest first: those that were ``found`` by names if
    x, y and z are among them and no role comes twice; else the last three axes that are neither
    time nor channel are z, y and x, and those before have no role, "".

    If fewer than three axes are neither time nor channel, axes of time become axes of space, the
    first ones first, then those of channels: a film (t, y, x) is (z, y, x).
    """
    named = sorted(role for role in found if role in ("x", "y", "z"))
    if named == ["x", "y", "z"] and len(set(filter(None, found))) == len([*filter(None, found)]):
        return tuple(found)
    roles = [role if role in ("t", "c") else "" for role in found]
    free = [n for n, role in enumerate(roles) if not role]
    spare = [n for other in ("t", "c") for n, role in enumerate(roles) if role == other]
    free = sorted([*free, *spare[: max(3 - len(free), 0)]])
    for n, role in zip(free[::-1], "xyz", strict=False):
        roles[n] = role
    return tuple(roles)


def along(values: Any, attributes: Mapping[str, Any]) -> Along:
    """Return the coordinates of an axis with their direction by CF's rules: heights are up unless
    the file says down; pressures grow downwards.
    """
    unit = text_of(attributes.get("units", ""))
    positive = text_of(attributes.get("positive", "")).lower()
    down = positive == "down" or (not positive and unit.lower() in PRESSURES)
    return Along(np.asarray(values, np.float64), unit, down)


def place_by(axes: Sequence[Along | None], named: str = "its axes") -> Place:
    """Place voxels by the coordinates along x, y, z, None for those that the file does not give.

    Voxels are cubes, with a note, if coordinates are uneven, or of units that cannot be compared;
    their directions are kept. The note names the axes as ``named``.
    """
    known = [each for each in axes if each is not None and each.values.size > 1]
    if not known:
        return NOWHERE
    signs = [direction_of(each) for each in axes]
    if len(known) < 3:
        missing = [name for name, each in zip("xyz", axes, strict=True) if each not in known]
        return _cubes(signs, f"the file gives no coordinates along {' and '.join(missing)}")
    even = [is_even(each.values) for each in known]
    if not all(even):
        return _cubes(signs, f"the coordinates of {named} are uneven")
    units = [each.unit.lower() for each in known]
    if len(set(units)) > 1 and not set(units) <= set(LENGTHS):
        listed = ", ".join(each.unit or "no unit" for each in known)
        return _cubes(signs, f"{named} are in {listed}")
    scales = [LENGTHS[unit] / LENGTHS[units[0]] if len(set(units)) > 1 else 1.0 for unit in units]
    turns = [-scale if each.down else scale for scale, each in zip(scales, known, strict=True)]
    means = [
        turn * float(each.values[-1] - each.values[0]) / (each.values.size - 1)
        for turn, each in zip(turns, known, strict=True)
    ]
    origin = [turn * float(each.values[0]) for turn, each in zip(turns, known, strict=True)]
    affine = Affine.of(np.column_stack([np.diag(means), origin]))
    return Place(triple(map(abs, means)), affine, known[0].unit, said=True)


def direction_of(axis: Along | None) -> float:
    """Tell which way an axis goes, 1 or -1."""
    if axis is None or axis.values.size < 2:
        return 1.0
    return -1.0 if (axis.values[-1] < axis.values[0]) != axis.down else 1.0


def is_even(values: np.ndarray) -> bool:
    """Return True if steps are alike and not zero."""
    steps = np.diff(values)
    mean = float(steps.mean())
    return mean != 0.0 and bool(np.abs(steps - mean).max() <= EVEN_STEP_SHARE * abs(mean))


def _cubes(signs: Sequence[float], why: str) -> Place:
    """Take voxels as cubes that lie along their axes' directions, with a note that says why."""
    note = f"Voxels are taken as cubes, as {why}: {SPACING_KEY}."
    turned = any(sign < 0.0 for sign in signs)
    affine = np.column_stack([np.diag(signs), np.zeros(3)])
    return Place(affine=Affine.of(affine) if turned else None, notes=(note,), said=True)
