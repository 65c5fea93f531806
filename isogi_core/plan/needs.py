"""What a plan is made for, and what a scene settles itself."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isogi_core.kernels.harmonics import MAX_ORDER
from isogi_core.model.environment import Environment
from isogi_core.plan.bands import band_energy
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


@dataclass(frozen=True)
class Needs:
    """What a plan is made for: the lights and whether they may turn, the albedo, the relative error aimed at."""

    environment: Environment
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
        image = self.environment.image
        same = (image[..., 1:] == image[..., :1]).all()
        return bool(same and np.ptp(self.environment.constant) == 0.0)

    @cached_property
    def constant(self) -> bool:
        """Whether the light is told to be the same from all sides."""
        return not self.environment.image.any()

    @cached_property
    def energy(self) -> np.ndarray:
        """Mean square luminance of the environment in each band; (MAX_ORDER,) float64."""
        return band_energy(project_environment(self.environment, MAX_ORDER))
