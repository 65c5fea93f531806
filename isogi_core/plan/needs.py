"""What a plan is made for, and what a scene settles itself."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.kernels.harmonics import MAX_ORDER
from isogi_core.model.environment import Environment
from isogi_core.model.lamps import Lamps
from isogi_core.model.lights import Vector
from isogi_core.model.lobes import Lobe
from isogi_core.model.sky import LUMINANCE
from isogi_core.plan.bands import band_energy
from isogi_core.plan.lobes import energy_beside, find_lobes
from isogi_core.plan.projection import project_environment

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Told:
    """What a scene settles itself; None leaves it to the planner."""

    representation: str | None = None
    order: int | None = None
    indirect_order: int | None = None
    bounces: int | None = None
    precision: str | None = None
    lobes: int | None = None
    albedos: tuple[float, float] | None = None


@dataclass(frozen=True)
class Needs:
    """What a plan is made for: the lights and whether they may turn, the albedo, the relative error aimed at.

    ``centre`` and ``radius`` are those of the ball around the volume, in the world. Where views may ask for another
    ``albedo``, it is the highest of these.
    """

    environment: Environment
    lamps: Lamps
    centre: Vector
    radius: float
    rotating: bool
    albedo: Colour
    target_error: float

    @property
    def grey(self) -> bool:
        """Whether reflected light keeps its colour."""
        return self.albedo[0] == self.albedo[1] == self.albedo[2]

    @cached_property
    def grey_light(self) -> bool:
        """Whether all lights are grey."""
        lights = (self.environment.image, self.environment.constant, self.lamps.arrays.colours)
        return all(bool((light[..., 1:] == light[..., :1]).all()) for light in lights)

    @cached_property
    def constant(self) -> bool:
        """Whether the light is told to be the same from all sides."""
        return not self.lamps.any and not self.environment.image.any()

    @cached_property
    def brightest(self) -> float:
        """Irradiance over π, in luminance, of an unshadowed surface at the centre turned to the light, at most.

        Of the environment from bands 0 and 1 alone, which hold nearly all of it: mean + 2 |mean of L·ω|.
        """
        mean, *slope = (LUMINANCE @ self.harmonics[:, :4] / math.sqrt(4.0 * math.pi)).tolist()
        return mean + 2.0 * math.hypot(*slope) / math.sqrt(3.0) + self.lamps.brightest(self.centre, self.radius)

    @cached_property
    def energy(self) -> np.ndarray:
        """Mean square luminance of the environment in each band; (MAX_ORDER,) float64."""
        return band_energy(self.harmonics)

    def energy_beside(self, lobes: int) -> np.ndarray:
        """``energy`` without that of the first so many lobes, but for band 0; (MAX_ORDER,) float64."""
        return self._energies[lobes]

    @cached_property
    def _energies(self) -> tuple[np.ndarray, ...]:
        return tuple(energy_beside(self.harmonics, self.lobes[:n]) for n in range(len(self.lobes) + 1))

    @cached_property
    def lobes(self) -> tuple[Lobe, ...]:
        """The environment's lobes; none where it does not turn, and is baked as it is."""
        return find_lobes(self.environment, self.harmonics) if self.rotating else ()

    @cached_property
    def harmonics(self) -> np.ndarray:
        """The environment's coefficients, linear RGB; (3, MAX_ORDER²) float64."""
        return project_environment(self.environment, MAX_ORDER)
