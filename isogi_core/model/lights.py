"""Lights that a scene may name, read from its ``[[lights]]`` tables."""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from isogi_core.errors import LightError, SceneError, advice, readable
from isogi_core.files.scene_file import (
    TableReaders,
    read_colour,
    read_name,
    read_number,
    read_table,
    read_vector,
)
from isogi_core.files.vector import Vector

LARGEST_LIGHT = 1e30
"""Largest number of a light: squares and products of such numbers are finite in the kernels."""

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class ConstantLight:
    """Light of one linear RGB radiance from everywhere. Raises LightError if it is not from 0
    to LARGEST_LIGHT.
    """

    radiance: Colour = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _check_range("radiance", self.radiance)

    @property
    def name(self) -> str:
        """The light's kind, for display."""
        return "constant"


@dataclass(frozen=True)
class SkyLight:
    """Clear daylight after Preetham et al. 1999, with the disc of the sun, over a diffuse ground.

    - ``sun_azimuth``: degrees from +x towards +y; ``sun_elevation``: degrees above the horizon, 0
      to 90.
    - ``turbidity``: haze, 1.9 to 10.
    - ``ground``: albedo of the lower half.
    - ``scale``: mean luminance over the sphere; with 1, a scene is about as bright as under a
      constant light of radiance 1.
    """

    sun_azimuth: float = 135.0
    sun_elevation: float = 45.0
    turbidity: float = 3.0
    ground: Colour = (0.4, 0.36, 0.3)
    scale: float = 1.0

    def __post_init__(self) -> None:
        _check_range("sun_azimuth", (self.sun_azimuth,), low=-LARGEST_LIGHT)
        _check_range("sun_elevation", (self.sun_elevation,), high=90.0)
        _check_range("turbidity", (self.turbidity,), 1.9, 10.0)
        _check_range("ground", self.ground, high=1.0)
        _check_range("scale", (self.scale,))

    @property
    def name(self) -> str:
        """The light's kind, for display."""
        return "sky"


@dataclass(frozen=True)
class ProbeLight:
    """A lat-long Radiance picture of the surroundings, times ``scale``."""

    file: Path
    scale: float = 1.0

    def __post_init__(self) -> None:
        _check_range("scale", (self.scale,))

    @property
    def name(self) -> str:
        """The light's kind, for display."""
        return f"probe {readable(self.file.name)}"


@dataclass(frozen=True)
class DirectionalLight:
    """A lamp as far away as the sun: the same light, from the same direction, everywhere.

    - ``azimuth``: degrees from +x towards +y; ``elevation``: degrees above the horizon; both
      towards the light.
    - ``irradiance``: of a surface that faces the light; with π that surface has the radiance R.
    - ``angle``: apparent diameter in degrees, 0 to 90, of a disc of even radiance; 0 makes hard
      shadows.
    """

    azimuth: float = 135.0
    elevation: float = 45.0
    irradiance: Colour = (math.pi, math.pi, math.pi)
    angle: float = 0.0

    def __post_init__(self) -> None:
        _check_range("azimuth", (self.azimuth,), low=-LARGEST_LIGHT)
        _check_range("elevation", (self.elevation,), -90.0, 90.0)
        _check_range("irradiance", self.irradiance)
        _check_range("angle", (self.angle,), high=90.0)

    @property
    def name(self) -> str:
        """The light's kind, for display."""
        return "directional"


@dataclass(frozen=True)
class PointLight:
    """A lamp without size at the world ``position``. A surface that faces it at distance r
    receives intensity/r².
    """

    position: Vector
    intensity: Colour

    def __post_init__(self) -> None:
        _check_range("position", self.position, low=-LARGEST_LIGHT)
        _check_range("intensity", self.intensity)

    @property
    def name(self) -> str:
        """The light's kind, for display."""
        return "point"


@dataclass(frozen=True)
class AreaLight:
    """A parallelogram that emits ``radiance`` evenly from the side that u × v points to; its back
    is black.

    Its corners are ``corner``, and ``corner`` plus ``u``, ``v`` and both, in the world. Rays pass
    through it.
    """

    corner: Vector
    u: Vector
    v: Vector
    radiance: Colour = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("corner", "u", "v"):
            _check_range(name, getattr(self, name), low=-LARGEST_LIGHT)
        _check_range("radiance", self.radiance)
        if not any(_cross(self.u, self.v)):
            raise LightError(
                "An area light's u and v span no area: give two edges that are not parallel."
            )

    @property
    def name(self) -> str:
        """The light's kind, for display."""
        return "area"


ENVIRONMENTS = {
    "overcast": "Overcast sky",
    "studio": "Studio, two soft boxes",
    "noon": "Clear sky at noon",
    "evening": "Clear sky in the evening",
    "gallery": "Gallery under skylights",
}
"""Environments by formula, see ``model.environment``, with their titles."""


@dataclass(frozen=True)
class EnvironmentLight:
    """One of ENVIRONMENTS, by its name. Its mean luminance over the sphere is 1, as that of a
    sky.
    """

    environment: str

    @property
    def name(self) -> str:
        """The environment's title, for display."""
        return ENVIRONMENTS[self.environment]


Lamp = DirectionalLight | PointLight | AreaLight
Light = ConstantLight | SkyLight | ProbeLight | EnvironmentLight | Lamp


PROBE_SUFFIXES = (".hdr", ".exr")
"""What names of probes end in."""


def light_named(environment: str, base: Path) -> EnvironmentLight | ProbeLight:
    """Return the environment of that name, or the probe in a file, relative to ``base``. Raises
    SceneError if it is neither.
    """
    if environment in ENVIRONMENTS:
        return EnvironmentLight(environment)
    if environment.lower().endswith(PROBE_SUFFIXES):
        return ProbeLight(base / environment)
    names = ", ".join(ENVIRONMENTS)
    raise SceneError(
        f"There is no environment '{environment[:80]}': choose {names}, or the file of a "
        "probe, .hdr or .exr."
    )


def _cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _check_range(
    name: str, values: tuple[float, ...], low: float = 0.0, high: float = LARGEST_LIGHT
) -> None:
    """Raise LightError if a value is outside of [low, high] or not a number."""
    if not all(low <= value <= high for value in values):
        given = ", ".join(f"{value:g}" for value in values)
        raise LightError(f"A light's {name} is {given}: it must be from {low:g} to {high:g}.")


def light_from_mapping(mapping: Mapping[str, Any], base: Path) -> Light:
    """Read the light of one ``[[lights]]`` table of a scene; its files are relative to ``base``.

    Environments by formula are not among these lights: ``light_named`` reads them.

    Raises SceneError if the type or a key is unknown, missing or of the wrong kind, and LightError
    if a value has no meaning.
    """
    kind = mapping.get("type")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise SceneError(f"A light has type {kind!r}: {advice(str(kind), _KINDS)}")
    light, readers = _KINDS[kind]
    needed = [each.name for each in fields(light) if each.default is MISSING]
    table = {key: value for key, value in mapping.items() if key != "type"}
    given = read_table(table, f"A {kind} light", readers, needed)
    if "file" in given:
        given = {**given, "file": base / given["file"]}
    return light(**given)


_KINDS: dict[str, tuple[type[Light], TableReaders]] = {
    "constant": (ConstantLight, {"radiance": read_colour}),
    "sky": (
        SkyLight,
        {
            "sun_azimuth": read_number,
            "sun_elevation": read_number,
            "turbidity": read_number,
            "ground": read_colour,
            "scale": read_number,
        },
    ),
    "probe": (ProbeLight, {"file": read_name, "scale": read_number}),
    "directional": (
        DirectionalLight,
        {
            "azimuth": read_number,
            "elevation": read_number,
            "irradiance": read_colour,
            "angle": read_number,
        },
    ),
    "point": (PointLight, {"position": read_vector, "intensity": read_colour}),
    "area": (
        AreaLight,
        {"corner": read_vector, "u": read_vector, "v": read_vector, "radiance": read_colour},
    ),
}
"""Types of lights, with their class and the readers of their keys."""
