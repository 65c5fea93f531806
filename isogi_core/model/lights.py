"""Lights that a scene may name: a constant, an analytic sky and a probe around it, and lamps, which stay in place."""

import math
from dataclasses import dataclass
from pathlib import Path

from isogi_core.errors import LightError

LARGEST = 1e30
"""No number of a light may be larger: what kernels make of them, squares and products, is then finite too."""

Colour = tuple[float, float, float]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ConstantLight:
    """The same linear RGB radiance from everywhere. LightError where it is negative, above LARGEST or no number."""

    radiance: Colour = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _check_range("radiance", self.radiance)

    @property
    def name(self) -> str:
        """What the light is, for a person."""
        return "constant"


@dataclass(frozen=True)
class SkyLight:
    """Clear daylight after Preetham et al. 1999, with a sun disc over a diffuse ground.

    ``sun_azimuth`` in degrees from +x towards +y, ``sun_elevation`` in degrees above the horizon (0 to 90),
    ``turbidity`` (haze) from 1.9 to 10, ``ground`` the albedo of the lower half. ``scale`` is the mean
    luminance over the sphere: with 1, a scene is about as bright as under a constant light of radiance 1.
    """

    sun_azimuth: float = 135.0
    sun_elevation: float = 45.0
    turbidity: float = 3.0
    ground: Colour = (0.2, 0.2, 0.2)
    scale: float = 1.0

    def __post_init__(self) -> None:
        _check_range("sun_azimuth", (self.sun_azimuth,), low=-LARGEST)
        _check_range("sun_elevation", (self.sun_elevation,), high=90.0)
        _check_range("turbidity", (self.turbidity,), 1.9, 10.0)
        _check_range("ground", self.ground, high=1.0)
        _check_range("scale", (self.scale,))

    @property
    def name(self) -> str:
        """What the light is, for a person."""
        return "sky"


@dataclass(frozen=True)
class ProbeLight:
    """A lat-long Radiance picture of the light around, times ``scale``."""

    file: Path
    scale: float = 1.0

    def __post_init__(self) -> None:
        _check_range("scale", (self.scale,))

    @property
    def name(self) -> str:
        """What the light is, for a person."""
        return f"probe {self.file.name}"


@dataclass(frozen=True)
class DirectionalLight:
    """A lamp as far away as the sun: the same light, from the same direction, everywhere.

    ``azimuth`` in degrees from +x towards +y, ``elevation`` in degrees above the horizon, both towards the
    light; ``irradiance`` is what a surface that faces it receives: with π that surface has the radiance R.
    ``angle`` is the apparent diameter in degrees (0 to 90) of a disc of even radiance; 0 makes hard shadows.
    """

    azimuth: float = 135.0
    elevation: float = 45.0
    irradiance: Colour = (math.pi, math.pi, math.pi)
    angle: float = 0.0

    def __post_init__(self) -> None:
        _check_range("azimuth", (self.azimuth,), low=-LARGEST)
        _check_range("elevation", (self.elevation,), -90.0, 90.0)
        _check_range("irradiance", self.irradiance)
        _check_range("angle", (self.angle,), high=90.0)

    @property
    def name(self) -> str:
        """What the light is, for a person."""
        return "directional"


@dataclass(frozen=True)
class PointLight:
    """A lamp without size at the world ``position``; a surface that faces it at distance r receives intensity/r²."""

    position: Vector
    intensity: Colour

    def __post_init__(self) -> None:
        _check_range("position", self.position, low=-LARGEST)
        _check_range("intensity", self.intensity)

    @property
    def name(self) -> str:
        """What the light is, for a person."""
        return "point"


@dataclass(frozen=True)
class AreaLight:
    """A parallelogram that emits ``radiance`` evenly from the side that u × v points to; its back is black.

    Its corners are ``corner``, and that plus ``u``, ``v`` and both, in the world. Rays pass through it.
    """

    corner: Vector
    u: Vector
    v: Vector
    radiance: Colour = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("corner", "u", "v"):
            _check_range(name, getattr(self, name), low=-LARGEST)
        _check_range("radiance", self.radiance)
        if not any(_cross(self.u, self.v)):
            raise LightError("An area light's u and v span no area: give two edges that are not parallel.")

    @property
    def name(self) -> str:
        """What the light is, for a person."""
        return "area"


Lamp = DirectionalLight | PointLight | AreaLight
Light = ConstantLight | SkyLight | ProbeLight | Lamp


def _cross(a: Vector, b: Vector) -> Vector:
    """The vector product a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _check_range(name: str, values: tuple[float, ...], low: float = 0.0, high: float = LARGEST) -> None:
    """LightError where a value is outside [low, high] or no number."""
    if not all(low <= value <= high for value in values):
        given = ", ".join(f"{value:g}" for value in values)
        raise LightError(f"A light's {name} is {given}: it must be from {low:g} to {high:g}.")
