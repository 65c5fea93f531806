"""Materials: what light does at an isosurface and behind it; and shine, the light that a surface mirrors, roughly."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from isogi_core.errors import SceneError, ViewError, advice
from isogi_core.files.scene_file import is_number
from isogi_core.model.lights import LARGEST_LIGHT, Colour

INDICES = (1.0, 4.0)
"""Indices of refraction that a surface may have: from that of what is around it to that of germanium."""

WINDOW_GLASS = 1.5
"""The index of refraction of a surface of glass that gives none."""


@dataclass(frozen=True)
class Material:
    """What a surface is made of, one of MATERIALS.

    Glass has an ``index`` of refraction, and an ``absorption``, linear RGB: of light that goes a unit of the world's
    length in it, the share exp(-absorption) is left. In a subsurface light goes the ``mean_free_path`` on the average,
    in the world's units, until it is scattered, evenly to all sides; the surface's albedo is the share that is left of
    it then. Raises SceneError where a number has no meaning.
    """

    kind: str = "diffuse"
    index: float = 1.0
    absorption: Colour = (0.0, 0.0, 0.0)
    mean_free_path: float = math.inf

    def __post_init__(self) -> None:
        low, high = INDICES
        if not low <= self.index <= high:
            raise SceneError(f"The index of refraction is {self.index:g}: give a number from {low:g} to {high:g}.")
        if not all(0.0 <= share <= LARGEST_LIGHT for share in self.absorption):
            given = ", ".join(f"{share:g}" for share in self.absorption)
            raise SceneError(f"The absorption is {given}: it must not be less than 0, per unit of length.")
        if not self.mean_free_path > 0.0:
            raise SceneError(f"The mean free path is {self.mean_free_path:g}: it must be more than 0.")

    @property
    def refracts(self) -> bool:
        """Whether rays go through it, and its surface keeps no texels."""
        return self.kind == "glass"

    @property
    def scatters(self) -> bool:
        """Whether light goes in and comes out elsewhere."""
        return self.kind == "subsurface"

    @property
    def passable(self) -> bool:
        """Whether rays go in at all."""
        return self.refracts or self.scatters


MATERIALS = ("diffuse", "glass", "subsurface")
"""What a surface may be made of."""

DIFFUSE = Material()


SHINE_KINDS = ("plastic", "metal")
"""What a surface may shine as. Plastic mirrors 4 % of what arrives head on, in its own colour; metal its albedo."""

MIN_ROUGHNESS = 0.02
"""The least roughness: such a surface mirrors light within about a twentieth of a degree."""


@dataclass(frozen=True)
class Shine:
    """The shine of a surface: its ``kind``, the ``roughness`` of its facets, and how much it counts, ``strength``.

    Roughness is the square root of GGX's α. Of metal the strength is the share of the surface that is metal; the rest
    is diffuse. Raises ViewError where a number has no meaning.
    """

    kind: str = "plastic"
    roughness: float = field(default=0.3, metadata={"range": (MIN_ROUGHNESS, 1)})
    strength: float = field(default=1.0, metadata={"range": (0, 1)})

    def __post_init__(self) -> None:
        if self.kind not in SHINE_KINDS:
            raise ViewError(f"A surface cannot shine as '{self.kind}': choose {' or '.join(SHINE_KINDS)}.")
        for name, (low, high) in SHINE_RANGES.items():
            if not low <= getattr(self, name) <= high:
                given = f"The {name} of shine is {getattr(self, name):g}"
                raise ViewError(f"{given}: it must be from {low:g} to {high:g}.")

    @property
    def alpha(self) -> float:
        """GGX's α (Burley 2012)."""
        return self.roughness**2


SHINE_RANGES: dict[str, tuple[float, float]] = {
    each.name: each.metadata["range"] for each in fields(Shine) if "range" in each.metadata
}
"""The least and the greatest value of each number of a shine."""

SHINE_KNOBS = {"shine" if each.name == "kind" else each.name: each.name for each in fields(Shine)}
"""Parameters of views that change the shine, and the fields of Shine that they are."""

DULL = Shine(strength=0.0)
"""What views ask for that are to show diffuse light alone."""


def shine_from_mapping(table: Mapping[str, Any]) -> Shine:
    """The shine that a scene's ``[shine]`` table describes. SceneError where a key is unknown or has no meaning."""
    known = {each.name: "a number" if each.name in SHINE_RANGES else "a word" for each in fields(Shine)}
    for key, value in table.items():
        if key not in known:
            raise SceneError(f"Shine has no '{key}': {advice(key, known)}")
        if not (isinstance(value, str) if key == "kind" else is_number(value)):
            raise SceneError(f"The {key} of shine is {value!r}: give {known[key]}.")
    try:
        return Shine(**table)
    except ViewError as error:
        raise SceneError(str(error)) from None
