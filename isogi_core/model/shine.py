"""Shine: how a surface mirrors light, roughly, besides what it scatters; a coat of plastic, or metal."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from isogi_core.errors import SceneError, ViewError, advice
from isogi_core.files.scene_file import is_number

KINDS = ("plastic", "metal")
"""What a surface may shine as. Plastic mirrors 4 % of what arrives head on, in its own colour; metal its albedo."""

SMOOTHEST = 0.02
"""The least roughness: such a surface mirrors light within about a twentieth of a degree."""


@dataclass(frozen=True)
class Shine:
    """The shine of a surface: its ``kind``, the ``roughness`` of its facets, and how much it counts, ``strength``.

    Roughness is the square root of GGX's α. Of metal the strength is the share of the surface that is metal; the rest
    is diffuse. Raises ViewError where a number has no meaning.
    """

    kind: str = "plastic"
    roughness: float = 0.3
    strength: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ViewError(f"A surface cannot shine as '{self.kind}': choose {' or '.join(KINDS)}.")
        if not SMOOTHEST <= self.roughness <= 1.0:
            raise ViewError(f"The roughness of shine is {self.roughness:g}: it must be from {SMOOTHEST:g} to 1.")
        if not 0.0 <= self.strength <= 1.0:
            raise ViewError(f"The strength of shine is {self.strength:g}: it must be from 0 to 1.")

    @property
    def alpha(self) -> float:
        """GGX's α (Burley 2012)."""
        return self.roughness**2


SHINE_KNOBS = {"shine" if each.name == "kind" else each.name: each.name for each in fields(Shine)}
"""Parameters of views that change the shine, and the fields of Shine that they are."""

DULL = Shine(strength=0.0)
"""What views ask for that are to show diffuse light alone."""


def shine_from_mapping(table: Mapping[str, Any]) -> Shine:
    """The shine that a scene's ``[shine]`` table describes. SceneError where a key is unknown or has no meaning."""
    known = {"kind": "a word", "roughness": "a number", "strength": "a number"}
    for key, value in table.items():
        if key not in known:
            raise SceneError(f"Shine has no '{key}': {advice(key, known)}")
        if not (isinstance(value, str) if key == "kind" else is_number(value)):
            raise SceneError(f"The {key} of shine is {value!r}: give {known[key]}.")
    try:
        return Shine(**table)
    except ViewError as error:
        raise SceneError(str(error)) from None
