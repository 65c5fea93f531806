"""Zarr volumes: arrays of Zarr v2 and v3, bare or in an OME-Zarr image, read chunk by chunk."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import zarr

from isogi_core.errors import VolumeError
from isogi_core.files.grid import ALONE, Grid, layers_of
from isogi_core.files.nrrd import MAX_VOXELS
from isogi_core.files.zarr_location import Hierarchy, hierarchy_at

SPACE = ("z", "y", "x")

PREFIXES = {
    **{"yotta": 24, "zetta": 21, "exa": 18, "peta": 15, "tera": 12, "giga": 9, "mega": 6, "kilo": 3, "hecto": 2},
    **{"deca": 1, "deci": -1, "centi": -2, "milli": -3, "micro": -6, "nano": -9, "pico": -12, "femto": -15},
    **{"atto": -18, "zepto": -21, "yocto": -24},
}
"""Powers of ten by SI prefix."""

METRES = {
    **{f"{prefix}meter": 10.0**power for prefix, power in PREFIXES.items()},
    **{"meter": 1.0, "angstrom": 1e-10, "inch": 0.0254, "foot": 0.3048, "yard": 0.9144, "mile": 1609.344},
    "parsec": 3.0856775814913673e16,
}
"""Metres of the units that NGFF names."""


@dataclass(frozen=True)
class Axis:
    """An axis of an array: its ``name``, such as z or c, and its ``unit``, empty where it has none."""

    name: str
    unit: str = ""


@dataclass(frozen=True)
class Resolution:
    """One array of a multiscale image: its ``path`` below the image, its axes, and the step along each."""

    path: str
    axes: tuple[Axis, ...]
    scale: tuple[float, ...]


def resolutions_of(attributes: Mapping[str, Any], name: str) -> list[Resolution]:
    """The resolutions of the image whose group has these ``attributes``, finest first; empty where it is no image.

    Raises VolumeError, which names the image by ``name``, where its metadata is damaged.
    """
    held = attributes.get("ome", attributes)
    images = held.get("multiscales") if isinstance(held, Mapping) else None
    if images is None:
        return []
    try:
        image = images[0]
        axes = tuple(Axis(*_axis(each)) for each in image["axes"]) if "axes" in image else ()
        whole = image.get("coordinateTransformations", [])
        return [_resolution(each, axes, whole) for each in image["datasets"]]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise VolumeError(f"The OME metadata of '{name}' is damaged ({error!r}): write it again.") from error


def spacing_of(axes: tuple[Axis, ...], scale: tuple[float, ...]) -> tuple[float, float, float]:
    """World units per voxel along x, y, z, all in the unit of x. Raises VolumeError where units cannot be compared."""
    steps = {axis.name: (step, axis.unit) for axis, step in zip(axes, scale, strict=True)}
    (x, unit), *_ = spatial = [steps[name] for name in SPACE[::-1]]
    if len({each for _, each in spatial}) == 1:
        return x, spatial[1][0], spatial[2][0]
    unknown = next((each for _, each in spatial if each not in METRES), None)
    if unknown is not None:
        raise VolumeError(f"The axes have different units, and '{unknown}' is no known one: set spacing in the scene.")
    y, z = (step * (METRES[each] / METRES[unit]) for step, each in spatial[1:])
    return x, y, z


def _axis(axis: Any) -> tuple[str, str]:
    """Name and unit of an axis; before NGFF 0.4 there was a name alone."""
    if isinstance(axis, str):
        return axis.lower(), ""
    return str(axis["name"]).lower(), str(axis.get("unit") or "").lower().replace("metre", "meter")


def _resolution(dataset: Mapping[str, Any], axes: tuple[Axis, ...], whole: list[Any]) -> Resolution:
    """One entry of the image's datasets, scaled by its own and the ``whole`` image's transformations."""
    scales = [_scale(each) for each in (*dataset.get("coordinateTransformations", []), *whole)]
    product = [math.prod(steps) for steps in zip(*filter(None, scales), strict=True)]
    return Resolution(str(dataset["path"]), axes, tuple(product) or (1.0,) * len(axes))


def _scale(transformation: Mapping[str, Any]) -> list[float]:
    """The scale of a transformation; empty for an identity or a translation."""
    kind = transformation["type"]
    if kind in ("identity", "translation"):
        return []
    if kind != "scale" or "scale" not in transformation:
        raise ValueError(f"a transformation '{kind}' that is no list of scales")
    return [float(step) for step in transformation["scale"]]


MOST = 1 << 29
"""Most bytes of a layer of chunks that is read at once; chunks of larger layers are read several times."""

MOST_CHUNKS = 1 << 22
"""Most chunks of an array: to ask for more takes hours, whatever they hold."""

MAX_CHUNK = 1 << 30
"""Most bytes of one chunk, as it must be in memory as a whole."""

ORDERS = {3: "zyx", 4: "czyx", 5: "tczyx"}
"""Assumed names of axes without names, by their number."""

CHOSEN = {"t": "time", "c": "channel"}
"""Settings of a scene that choose along axes that are not spatial."""


@dataclass(frozen=True, eq=False)
class FoundArray:
    """An ``array`` of a hierarchy, with its axes and the step along each."""

    among: Hierarchy
    array: "zarr.Array[Any]"
    axes: tuple[Axis, ...]
    scale: tuple[float, ...]


def open_zarr(path: Path | str, level: int | None = None, channel: int | None = None, time: int | None = None) -> Grid:
    """Open a Zarr array, or a resolution of an OME-Zarr image, as a grid; only metadata is read now.

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
    part = [array.path, *(pick for pick in picks if isinstance(pick, int))]
    spacing = spacing_of(found.axes, found.scale)
    times = dict(zip((axis.name for axis in found.axes), array.shape, strict=True)).get("t", 1)
    moment, unchosen = (time or 0, times) if times > 1 else ALONE, time is None and times > 1
    return Grid(
        *(shape, array.dtype, spacing, slabs, lambda: f"{found.among.stamp()} {part}"), moment=moment, unchosen=unchosen
    )


def find_array(path: Path | str, level: int | None) -> FoundArray:
    """The array at ``path``, or that of ``level`` of the image there."""
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
    except Exception as error:  # of many kinds, for damaged metadata and missing codecs
        raise VolumeError(f"'{path}' cannot be read as Zarr ({_line(error)}): write it again.") from error


def _resolutions(group: zarr.Group, path: Path | str) -> list[Resolution]:
    return resolutions_of(group.attrs.asdict(), str(path))


def _no_array(path: Path | str, group: zarr.Group, image: list[Resolution], level: int | None) -> str:
    """The message for a group without the array that is asked for."""
    if image:
        return f"level = {level} of '{path}' is not there: it has levels 0 to {len(image) - 1}."
    names = ", ".join(f"'{PurePath(path).name}/{name}'" for name in _members(group)) or "nothing that it lists"
    return f"'{path}' is a Zarr group and no image: it holds {names}; name an array, or an image."


def _members(group: zarr.Group) -> list[str]:
    """Some names in a group; empty where it cannot be listed, as over plain HTTP."""
    try:
        return sorted(group.keys())[:8]
    except Exception:  # of many kinds, for stores that cannot list
        return []


def _resolution_above(path: Path | str, among: Hierarchy) -> Resolution | None:
    """The resolution that the nearest image above an array gives for it."""
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


def _with_axes(path: Path | str, among: Hierarchy, array: "zarr.Array[Any]", given: Resolution | None) -> FoundArray:
    """The array with its axes: those of the image, else by their names, else by their number."""
    axes, scale = (given.axes, given.scale) if given else ((), ())
    if not axes:
        axes = tuple(map(Axis, _names(array) or ORDERS.get(array.ndim, "")))
    scale = scale or (1.0,) * len(axes)
    if len(axes) != array.ndim or len(scale) != array.ndim:
        raise VolumeError(f"'{path}' has {array.ndim} dimensions and {len(axes)} axes: choose one scalar field of it.")
    return FoundArray(among, array, axes, scale)


def _names(array: "zarr.Array[Any]") -> tuple[str, ...]:
    """Names of the dimensions, where all are known ones; empty otherwise."""
    given: Any = getattr(array.metadata, "dimension_names", None) or array.attrs.asdict().get("_ARRAY_DIMENSIONS") or ()
    names = tuple(str(name).lower() for name in given)
    known = set(names) <= {*SPACE, *CHOSEN} and len(set(names)) == len(names)
    return names if known else ()


def _pick(path: Path | str, found: FoundArray, place: int, chosen: dict[str, int | None]) -> int:
    """The element that is read along an axis that is not spatial."""
    name, length = found.axes[place].name, found.array.shape[place]
    key, pick = CHOSEN.get(name), chosen.get(name)
    if pick is None and length > 1 and key != "time":
        wanted = f"set {key} in the scene, from 0 to {length - 1}" if key else "save one element of it"
        raise VolumeError(f"'{path}' has {length} elements along its axis '{name}': {wanted}.")
    if not 0 <= (pick or 0) < length:
        raise VolumeError(f"{key} = {pick} is not in '{path}', which has 0 to {length - 1}.")
    return pick or 0


def _check(path: Path | str, found: FoundArray) -> None:
    """Raise VolumeError where the array is no 3-D field, or of an impossible size."""
    array, space = found.array, [axis.name for axis in found.axes if axis.name in SPACE]
    if space != list(SPACE):
        raise VolumeError(f"'{path}' has the axes {', '.join(space) or 'none'} in space: they must be z, y and x.")
    if min(array.chunks, default=0) < 1:
        raise VolumeError(f"'{path}' claims chunks of {array.chunks} voxels, which cannot be: mend its metadata.")
    if math.prod(array.shape) > MAX_VOXELS:
        raise VolumeError(f"'{path}' claims a shape {array.shape}, which cannot be: mend its metadata.")
    if int(np.prod([float(n) for n in array.chunks])) * array.dtype.itemsize > MAX_CHUNK:
        raise VolumeError(f"The chunks of '{path}' have {array.chunks} voxels: write it in chunks of 1 GiB or less.")
    if math.prod(-(-n // step) for n, step in zip(array.shape, array.chunks, strict=True)) > MOST_CHUNKS:
        raise VolumeError(f"The chunks of '{path}' have {array.chunks} voxels, and are too many: write larger ones.")


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
        except Exception as error:  # of many kinds, from codecs on damage
            raise VolumeError(f"The chunks of '{path}' are damaged ({_line(error)}): copy it again.") from error
        yield slab


def _line(error: Exception) -> str:
    """An error's type and message, on one short line."""
    message = " ".join(str(error).split())
    return f"{type(error).__name__}: {message[:200]}" if message else type(error).__name__
