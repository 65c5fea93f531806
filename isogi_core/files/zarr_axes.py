"""Axes of Zarr arrays that no image describes: by the names of their dimensions, and by the
coordinates that Xarray writes next to them.
"""

from collections.abc import Callable
from pathlib import PurePath
from typing import Any

import numpy as np
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.coordinates import Along, along, role_of
from isogi_core.files.formats.source import LAYERED, TIME_STEPS
from isogi_core.files.ome import SPACE_AXES

ASSUMED_AXES = {3: "zyx", 4: "czyx", 5: "tczyx"}
"""Assumed names of axes without names, by their number."""

OTHER_NAMES = {"time": "t", "channel": "c"}
NOT_IN_SPACE = ("t", "c")

Open = Callable[[str], Any]
"""Opens the array or group at a path of the hierarchy. Raises VolumeError if there is none."""

Held = tuple[dict[str, Any], Any]
"""Attributes and array of an axis's coordinates; none and None if there are no coordinates."""

NONE: Held = ({}, None)


def named_axes(
    array: "zarr.Array[Any]", open_at: Open
) -> tuple[tuple[str, ...], tuple[Along | None, ...], tuple[str, ...]]:
    """Name the dimensions of an array as x, y, z, t and c, as they are called, else by their
    number; with the coordinates along x, y, z, none if the names are not these; and with notes on
    time that is shown as depth, and on coordinates that are not as many as their axis has.
    """
    found, held = _roles(array, open_at)
    if all(found) and len(set(found)) == len(found) and set(SPACE_AXES) <= set(found):
        names = found
    else:
        names = _names(array) or tuple(ASSUMED_AXES.get(array.ndim, ""))
    if not set(SPACE_AXES) <= set(names) or len(names) != array.ndim:
        return names, (), ()
    places = [names.index(axis) for axis in SPACE_AXES]
    notes = tuple(_amiss(*held[place], array.shape[place]) for place in places)
    film = (LAYERED.format(what=TIME_STEPS),) if "t" in found and "t" not in names else ()
    scales = tuple(_along(*held[place], array.shape[place]) for place in places)
    return names, scales, (*film, *filter(None, notes))


def is_in_space(array: "zarr.Array[Any]", open_at: Open) -> bool:
    """Return True if dimensions of an array are x, y and z by their names or coordinates."""
    return set(SPACE_AXES) <= set(_roles(array, open_at)[0])


def _along(attributes: dict[str, Any], values: Any, length: int) -> Along | None:
    """Read the coordinates of an axis; None if there are none, or others than the axis has."""
    if values is None or values.shape != (length,):
        return None
    return along(np.asarray(values[:]), attributes)


def _amiss(attributes: dict[str, Any], values: Any, length: int) -> str:
    """Say that the coordinates of an axis are not as many as it has; empty if they are."""
    if values is None or values.shape == (length,):
        return ""
    given = f"'{PurePath(values.path).name}' has {values.size} coordinates for {length} voxels"
    return f"{given}: they are left out."


def _given_names(array: "zarr.Array[Any]") -> tuple[str, ...]:
    """Return the names of the dimensions, as Zarr's third version or Xarray writes them."""
    given: Any = (
        getattr(array.metadata, "dimension_names", None)
        or array.attrs.asdict().get("_ARRAY_DIMENSIONS")
        or ()
    )
    return tuple(str(name) for name in given)


def _roles(array: "zarr.Array[Any]", open_at: Open) -> tuple[tuple[str, ...], list[Held]]:
    """Tell which axis each dimension of an array is, by its name and its coordinates; with these
    coordinates.
    """
    given = _given_names(array)
    if len(given) != array.ndim:
        return ("",) * array.ndim, [NONE] * array.ndim
    held = [_coordinates(array, name, open_at) for name in given]
    roles = [role_of(name, each[0]) for name, each in zip(given, held, strict=True)]
    return tuple(roles), held


def _coordinates(array: "zarr.Array[Any]", name: str, open_at: Open) -> Held:
    """Find the coordinates of a dimension: an array of its name next to the field."""
    folder = PurePath(array.path).parent.as_posix().removeprefix(".")
    inside = f"{folder}/{name}".strip("/")
    if not name or not array.path or inside == array.path.strip("/"):
        return NONE
    try:
        found = open_at(inside)
    except VolumeError:
        return NONE
    if not isinstance(found, zarr.Array) or found.ndim != 1 or found.dtype.kind not in "iuf":
        return NONE
    return found.attrs.asdict(), found


def _names(array: "zarr.Array[Any]") -> tuple[str, ...]:
    """Return the names of the dimensions if all are known ones; else empty."""
    given = _given_names(array)
    names = [OTHER_NAMES.get(str(name).lower(), str(name).lower()) for name in given]
    spatial = [n for n, name in enumerate(names) if name not in NOT_IN_SPACE]
    if len(spatial) == 3 and not any(
        names[n] in SPACE_AXES for n in spatial
    ):  # such as depth, latitude and longitude
        for n, name in zip(spatial, SPACE_AXES[::-1], strict=True):
            names[n] = name
    known = set(names) <= {*SPACE_AXES, *NOT_IN_SPACE} and len(set(names)) == len(names)
    return tuple(names) if known else ()
