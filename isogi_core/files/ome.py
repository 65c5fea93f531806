"""OME-Zarr: what the metadata of a multiscale image says of its resolutions, axes and spacing.

Specification: NGFF 0.4 (Zarr v2) and 0.5 (Zarr v3), https://ngff.openmicroscopy.org; the differences between
them are where the metadata lies and the order of nothing that is read here.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from isogi_core.errors import VolumeError

SPACE = ("z", "y", "x")

PREFIXES = {
    **{"yotta": 24, "zetta": 21, "exa": 18, "peta": 15, "tera": 12, "giga": 9, "mega": 6, "kilo": 3, "hecto": 2},
    **{"deca": 1, "deci": -1, "centi": -2, "milli": -3, "micro": -6, "nano": -9, "pico": -12, "femto": -15},
    **{"atto": -18, "zepto": -21, "yocto": -24},
}
"""Powers of ten by the SI's names."""

METRES = {
    **{f"{prefix}meter": 10.0**power for prefix, power in PREFIXES.items()},
    **{"meter": 1.0, "angstrom": 1e-10, "inch": 0.0254, "foot": 0.3048, "yard": 0.9144, "mile": 1609.344},
    "parsec": 3.0856775814913673e16,
}
"""Lengths of the units that NGFF names."""


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
    """The resolutions of the image whose group has these ``attributes``, finest first; none where it is no image.

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
    (x, unit), *_ = own = [steps[name] for name in SPACE[::-1]]
    if len({each for _, each in own}) == 1:
        return x, own[1][0], own[2][0]
    unknown = next((each for _, each in own if each not in METRES), None)
    if unknown is not None:
        raise VolumeError(f"The axes have different units, and '{unknown}' is no known one: set spacing in the scene.")
    y, z = (step * (METRES[each] / METRES[unit]) for step, each in own[1:])
    return x, y, z


def _axis(told: Any) -> tuple[str, str]:
    """Name and unit of an axis; before NGFF 0.4 there was a name alone."""
    if isinstance(told, str):
        return told.lower(), ""
    return str(told["name"]).lower(), str(told.get("unit") or "").lower().replace("metre", "meter")


def _resolution(dataset: Mapping[str, Any], axes: tuple[Axis, ...], whole: list[Any]) -> Resolution:
    """One entry of the image's datasets, with what its own and the ``whole`` image's transformations scale by."""
    scales = [_scale(each) for each in (*dataset.get("coordinateTransformations", []), *whole)]
    product = [math.prod(steps) for steps in zip(*filter(None, scales), strict=True)]
    return Resolution(str(dataset["path"]), axes, tuple(product) or (1.0,) * len(axes))


def _scale(transformation: Mapping[str, Any]) -> list[float]:
    """The steps of a transformation, none where it moves or leaves alone what it is of."""
    kind = transformation["type"]
    if kind in ("identity", "translation"):
        return []
    if kind != "scale" or "scale" not in transformation:
        raise ValueError(f"a transformation '{kind}' that is no list of scales")
    return [float(step) for step in transformation["scale"]]
