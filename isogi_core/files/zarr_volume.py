"""Zarr volumes: arrays of Zarr v2 and v3, bare or in an OME-Zarr image, read chunk by chunk.

A chunk that is missing holds the fill value: so the format has it, and sparse volumes are written that way.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.grid import Grid, layers_of
from isogi_core.files.nrrd import MAX_VOXELS
from isogi_core.files.ome import SPACE, Axis, Resolution, resolutions_of, spacing_of
from isogi_core.files.zarr_places import Hierarchy, hierarchy_at

MOST = 1 << 29
"""Bytes of a layer of chunks up to which it is read at once; beyond that its chunks are read several times."""

MAX_CHUNK = 1 << 30
"""Bytes of one chunk beyond which an array is refused: it would have to be in memory as a whole."""

ORDERS = {3: "zyx", 4: "czyx", 5: "tczyx"}
"""What axes are taken for that have no names, by their number."""

CHOSEN = {"t": "time", "c": "channel"}
"""Settings of a scene that choose along axes which are not of space."""


@dataclass(frozen=True, eq=False)
class Found:
    """An ``array`` of a hierarchy, and what is known of its axes and of the step along each."""

    among: Hierarchy
    array: "zarr.Array[Any]"
    axes: tuple[Axis, ...]
    scale: tuple[float, ...]


def open_zarr(path: Path | str, level: int | None = None, channel: int | None = None, time: int | None = None) -> Grid:
    """The grid of a Zarr array, or of a resolution of an OME-Zarr image, of which only metadata is read now.

    ``path``, a folder or a URL, is the array or the image, or an array inside one (``brain.zarr/2``). ``level`` 0, the
    default, is the finest resolution; ``channel`` and ``time`` choose along these axes. Spacing is the scale of the
    image, in the unit of x, else 1. Raises VolumeError where there is no such array, where it has other axes of more
    than one element or its codecs are not to be had, and for links that lead out of the folder; the slabs do where
    chunks are damaged.
    """
    found = find_array(path, level)
    array, chosen = found.array, {"c": channel, "t": time}
    picks = [slice(None) if axis.name in SPACE else _pick(path, found, n, chosen) for n, axis in enumerate(found.axes)]
    _check(path, found)
    shape = tuple(n for n, pick in zip(array.shape, picks, strict=True) if isinstance(pick, slice))
    slabs = partial(_slabs, path, array, tuple(picks), shape)
    told = [array.path, *(pick for pick in picks if isinstance(pick, int))]
    spacing = spacing_of(found.axes, found.scale)
    return Grid(shape, array.dtype, spacing, slabs, lambda: f"{found.among.stamp()} {told}")


def find_array(path: Path | str, level: int | None) -> Found:
    """The array at ``path``, or the one of ``level`` of the image there."""
    among = hierarchy_at(path)
    node = _open(path, among, among.inside)
    if isinstance(node, zarr.Group):
        image = _resolutions(node, path)
        chosen = image[level or 0].path if (level or 0) < len(image) else None
        if chosen is None:
            raise VolumeError(_no_array(path, node, image, level))
        array = _open(path, among, f"{among.inside}/{chosen}".strip("/"))
        if isinstance(array, zarr.Group):
            raise VolumeError(f"'{path}' names a resolution '{chosen}' that is no array: write it again.")
        return _with_axes(path, among, array, image[level or 0])
    if level is not None:
        raise VolumeError(f"'{path}' is one array, without levels: leave out 'level', or name the image.")
    return _with_axes(path, among, node, _resolution_above(path, among))


def _open(path: Path | str, among: Hierarchy, inside: str) -> "zarr.Array[Any] | zarr.Group":
    """An array or a group of a hierarchy."""
    try:
        return zarr.open(store=among.store, path=inside, mode="r")
    except FileNotFoundError as error:
        raise VolumeError(f"'{among.name}' has no array '{inside}': write it again, or choose another.") from error
    except Exception as error:  # metadata that is damaged, and codecs that are missing, are told in many ways
        raise VolumeError(f"'{path}' cannot be read as Zarr ({_line(error)}): write it again.") from error


def _resolutions(group: zarr.Group, path: Path | str) -> list[Resolution]:
    return resolutions_of(group.attrs.asdict(), str(path))


def _no_array(path: Path | str, group: zarr.Group, image: list[Resolution], level: int | None) -> str:
    """Why a group gives no array."""
    if image:
        return f"level = {level} of '{path}' is not there: it has levels 0 to {len(image) - 1}."
    names = ", ".join(f"'{PurePath(path).name}/{name}'" for name in _members(group)) or "nothing that it tells"
    return f"'{path}' is a Zarr group and no image: it holds {names}; name an array, or an image."


def _members(group: zarr.Group) -> list[str]:
    """Some names in a group; none where it cannot be listed, as over plain HTTP."""
    try:
        return sorted(group.keys())[:8]
    except Exception:  # stores without a list say so in many ways
        return []


def _resolution_above(path: Path | str, among: Hierarchy) -> Resolution | None:
    """What the nearest image above an array says of it."""
    parts = among.inside.split("/") if among.inside else []
    for n in range(len(parts) - 1, -1, -1):
        try:
            group = _open(path, among, "/".join(parts[:n]))
        except VolumeError:  # no group is there
            continue
        for each in _resolutions(group, path) if isinstance(group, zarr.Group) else ():
            if each.path.strip("/") == "/".join(parts[n:]):
                return each
    return None


def _with_axes(path: Path | str, among: Hierarchy, array: "zarr.Array[Any]", told: Resolution | None) -> Found:
    """The array with its axes: as the image tells them, else by their names, else by their number."""
    axes, scale = (told.axes, told.scale) if told else ((), ())
    if not axes:
        axes = tuple(map(Axis, _names(array) or ORDERS.get(array.ndim, "")))
    scale = scale or (1.0,) * len(axes)
    if len(axes) != array.ndim or len(scale) != array.ndim:
        raise VolumeError(f"'{path}' has {array.ndim} dimensions and {len(axes)} axes: choose one scalar field of it.")
    return Found(among, array, axes, scale)


def _names(array: "zarr.Array[Any]") -> tuple[str, ...]:
    """Names of the dimensions, where all are known; a field of three dimensions may call them as it likes."""
    told: Any = getattr(array.metadata, "dimension_names", None) or array.attrs.asdict().get("_ARRAY_DIMENSIONS") or ()
    names = tuple(str(name).lower() for name in told)
    known = set(names) <= {*SPACE, *CHOSEN} and len(set(names)) == len(names)
    return names if known else ()


def _pick(path: Path | str, found: Found, place: int, chosen: dict[str, int | None]) -> int:
    """The element that is read along an axis which is not of space."""
    name, length = found.axes[place].name, found.array.shape[place]
    key, pick = CHOSEN.get(name), chosen.get(name)
    if pick is None and length > 1:
        wanted = f"set {key} in the scene, from 0 to {length - 1}" if key else "save one element of it"
        raise VolumeError(f"'{path}' has {length} elements along its axis '{name}': {wanted}.")
    if not 0 <= (pick or 0) < length:
        raise VolumeError(f"{key} = {pick} is not in '{path}', which has 0 to {length - 1}.")
    return pick or 0


def _check(path: Path | str, found: Found) -> None:
    """VolumeError where the array is no 3-D field, or of a size that cannot be."""
    array, space = found.array, [axis.name for axis in found.axes if axis.name in SPACE]
    if space != list(SPACE):
        raise VolumeError(f"'{path}' has the axes {', '.join(space) or 'none'} in space: they must be z, y and x.")
    if array.size > MAX_VOXELS:
        raise VolumeError(f"'{path}' claims a shape {array.shape}, which cannot be: mend its metadata.")
    if int(np.prod([float(n) for n in array.chunks])) * array.dtype.itemsize > MAX_CHUNK:
        raise VolumeError(f"The chunks of '{path}' have {array.chunks} voxels: write it in chunks of 1 GiB or less.")


def _slabs(
    path: Path | str, array: "zarr.Array[Any]", picks: tuple[Any, ...], shape: tuple[int, ...]
) -> Iterator[np.ndarray]:
    """The array, a layer of chunks or less at a time."""
    along = next(n for n, pick in enumerate(picks) if isinstance(pick, slice))
    layer, deep = shape[1] * shape[2] * array.dtype.itemsize, array.chunks[along]
    step = deep * max(layers_of(layer) // deep, 1) if deep * layer <= MOST else layers_of(layer)
    for z in range(0, shape[0], step):
        place = (*picks[:along], slice(z, z + step), *picks[along + 1 :])
        try:
            slab = np.asarray(array[place])
        except Exception as error:  # what codecs raise on damage is of many kinds
            raise VolumeError(f"The chunks of '{path}' are damaged ({_line(error)}): copy it again.") from error
        yield slab


def _line(error: Exception) -> str:
    """What an error says, in one line that is not too long."""
    told = " ".join(str(error).split())
    return f"{type(error).__name__}: {told[:200]}" if told else type(error).__name__
