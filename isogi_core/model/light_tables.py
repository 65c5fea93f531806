"""Lights as a scene writes them: each ``[[lights]]`` table becomes one light."""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from isogi_core.errors import SceneError
from isogi_core.model.lights import (
    AreaLight,
    Colour,
    ConstantLight,
    DirectionalLight,
    Light,
    PointLight,
    ProbeLight,
    SkyLight,
    Vector,
)


def light_from_mapping(mapping: Mapping[str, Any], base: Path) -> Light:
    """The light that one ``[[lights]]`` table of a scene describes; its files are relative to ``base``.

    Raises SceneError where the type or a key is unknown, missing or of the wrong kind, and LightError where
    a value has no meaning.
    """
    kind = mapping.get("type")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise SceneError(f"A light has type {kind!r}: choose one of {', '.join(_KINDS)}.")
    light, readers = _KINDS[kind]
    unknown = [key for key in mapping if key not in readers and key != "type"]
    if unknown:
        raise SceneError(f"A {kind} light has no '{unknown[0]}': choose from {', '.join(readers)}.")
    missing = [f.name for f in fields(light) if f.default is MISSING and f.name not in mapping]
    if missing:
        raise SceneError(f"A {kind} light lacks its '{missing[0]}': add it to the scene.")
    given = {key: read(key, mapping[key]) for key, read in readers.items() if key in mapping}
    if "file" in given:
        given["file"] = base / given["file"]
    return light(**given)


def _number(key: str, value: object) -> float:
    """A TOML integer or float; SceneError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SceneError(f"A light's {key} is {value!r}: give a number.")
    try:
        return float(value)
    except OverflowError as error:
        raise SceneError(f"A light's {key} is {value}: give a number that floats hold.") from error


def _colour(key: str, value: object) -> Colour:
    """A number for all three channels, or ``[r, g, b]``."""
    if not isinstance(value, list):
        grey = _number(key, value)
        return grey, grey, grey
    if len(value) != 3:
        raise SceneError(f"A light's {key} is {value!r}: give a number or [r, g, b].")
    r, g, b = (_number(key, channel) for channel in value)
    return r, g, b


def _vector(key: str, value: object) -> Vector:
    """``[x, y, z]``."""
    if not isinstance(value, list) or len(value) != 3:
        raise SceneError(f"A light's {key} is {value!r}: give [x, y, z].")
    x, y, z = (_number(key, component) for component in value)
    return x, y, z


def _path(key: str, value: object) -> Path:
    """A file name that is not empty."""
    if not isinstance(value, str) or not value:
        raise SceneError(f"A light's {key} is {value!r}: give the name of a file.")
    return Path(value)


_KINDS: dict[str, tuple[type[Light], dict[str, Callable[[str, object], Any]]]] = {
    "constant": (ConstantLight, {"radiance": _colour}),
    "sky": (
        SkyLight,
        {
            "sun_azimuth": _number,
            "sun_elevation": _number,
            "turbidity": _number,
            "ground": _colour,
            "scale": _number,
        },
    ),
    "probe": (ProbeLight, {"file": _path, "scale": _number}),
    "directional": (
        DirectionalLight,
        {"azimuth": _number, "elevation": _number, "irradiance": _colour, "angle": _number},
    ),
    "point": (PointLight, {"position": _vector, "intensity": _colour}),
    "area": (AreaLight, {"corner": _vector, "u": _vector, "v": _vector, "radiance": _colour}),
}
