"""Materials: what light does at an isosurface and behind it."""

import math
from dataclasses import dataclass

from isogi_core.errors import SceneError
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
