"""Materials: what light does at an isosurface and behind it."""

from dataclasses import dataclass

from isogi_core.errors import SceneError
from isogi_core.model.lights import LARGEST, Colour

INDICES = (1.0, 4.0)
"""Indices of refraction that a surface may have: from that of what is around it to that of germanium."""

WINDOW_GLASS = 1.5
"""The index of refraction of a surface of glass that gives none."""


@dataclass(frozen=True)
class Material:
    """What a surface is made of, one of MATERIALS; the numbers are of glass.

    Its ``index`` of refraction, and its ``absorption``, linear RGB: of light that goes a unit of the world's length in
    it, the share exp(-absorption) is left. Raises SceneError where a number has no meaning.
    """

    kind: str = "diffuse"
    index: float = 1.0
    absorption: Colour = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        low, high = INDICES
        if not low <= self.index <= high:
            raise SceneError(f"The index of refraction is {self.index:g}: give a number from {low:g} to {high:g}.")
        if not all(0.0 <= share <= LARGEST for share in self.absorption):
            given = ", ".join(f"{share:g}" for share in self.absorption)
            raise SceneError(f"The absorption is {given}: it must not be less than 0, per unit of length.")

    @property
    def refracts(self) -> bool:
        """Whether rays go through it, and its surface keeps no texels."""
        return self.kind == "glass"


MATERIALS = ("diffuse", "glass")
"""What a surface may be made of."""

DIFFUSE = Material()
