"""Inputs of the planner: the scene's lights, albedo and target error, and the choices that its
file makes itself.
"""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from isogi_core.files.vector import Vector, triple
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.environment import LUMINANCE_WEIGHTS, Environment, Lamps, Lobe
from isogi_core.model.lights import Colour
from isogi_core.model.volume import Volume
from isogi_core.plan.bands import band_energy, project_environment
from isogi_core.plan.lobe_choice import energy_beside, find_lobes

RESULTS: WeakKeyDictionary[Any, dict[Hashable, Any]] = WeakKeyDictionary()
"""Results that were computed from environments and volumes in use, by subject; scenes with the
same environment or volume share them.
"""

Input = TypeVar("Input")


def find_once(subject: Environment | Volume, what: Hashable, find: Callable[[], Input]) -> Input:
    """Return the kept result of ``find`` for a ``subject``, or compute and keep it.

    ``what`` names the result, and holds everything besides the subject that it depends on.
    """
    known = RESULTS.setdefault(subject, {})
    if what not in known:
        known[what] = find()
    kept: Input = known[what]
    return kept


@dataclass(frozen=True)
class PlanOverrides:
    """The choices of the plan that a scene's file makes itself; None leaves a choice to the
    planner.
    """

    representation: str | None = None
    order: int | None = None
    indirect_order: int | None = None
    bounces: int | None = None
    precision: str | None = None
    lobes: int | None = None
    albedos: tuple[float, float] | None = None


@dataclass(frozen=True)
class PlanInputs:
    """The facts of a scene that its plan depends on.

    - ``environment``, ``lamps``: the lights; ``rotating``: True if views may turn them.
    - ``centre``, ``radius``: the ball around the volume, in world units.
    - ``albedo``: the highest that views may ask for, or the scene's plus its transmission, linear
      RGB.
    - ``target_error``: relative error of pictures.
    - ``walls``: albedos of walls, and those of surfaces if light passes through some surface or
      enters it.
    - ``by_data``: True if the surface has its albedo by data, at most ``albedo``; ``coloured``:
      True if some of these colours are not grey.
    - ``glows``: number of glows in the volume.
    """

    environment: Environment
    lamps: Lamps
    centre: Vector
    radius: float
    rotating: bool
    albedo: Colour
    target_error: float
    walls: tuple[Colour, ...] = ()
    coloured: bool = False
    by_data: bool = False
    glows: int = 0

    @property
    def reflecting(self) -> Colour:
        """The highest albedo of the surface and all walls, in each channel."""
        return triple(max(shares) for shares in zip(self.albedo, *self.walls, strict=True))

    @property
    def grey(self) -> bool:
        """True if reflection leaves the colour of light unchanged."""
        alike = all(red == green == blue for red, green, blue in (self.albedo, *self.walls))
        return alike and not self.coloured

    @cached_property
    def grey_light(self) -> bool:
        """True if all lights are grey."""
        lights = (self.environment.image, self.environment.constant, self.lamps.arrays.colours)
        return all(bool((light[..., 1:] == light[..., :1]).all()) for light in lights)

    @cached_property
    def constant(self) -> bool:
        """True if the scene's light is the same constant from all sides."""
        return not self.lamps.any and not self.environment.image.any()

    @cached_property
    def brightest(self) -> float:
        """Upper bound of the irradiance over π, as luminance, of an unshadowed surface at the
        centre that faces the light.

        The part of the environment is taken from bands 0 and 1, which hold nearly all of it: mean +
        2 |mean of L·ω|.
        """
        mean, *slope = (
            LUMINANCE_WEIGHTS @ self.harmonics[:, :4] / math.sqrt(4.0 * math.pi)
        ).tolist()
        return (
            mean
            + 2.0 * math.hypot(*slope) / math.sqrt(3.0)
            + self.lamps.brightest(self.centre, self.radius)
        )

    @cached_property
    def energy(self) -> np.ndarray:
        """Mean square luminance of the environment in each band; (MAX_ORDER,) float64."""
        return band_energy(self.harmonics)

    def energy_beside(self, lobes: int) -> np.ndarray:
        """Return ``energy`` without the first ``lobes`` lobes, except in band 0; (MAX_ORDER,)
        float64.
        """
        return self._energies[lobes]

    @cached_property
    def _energies(self) -> tuple[np.ndarray, ...]:
        """The result of ``energy_beside`` for each number of lobes."""
        return tuple(
            energy_beside(self.harmonics, self.lobes[:n]) for n in range(len(self.lobes) + 1)
        )

    @cached_property
    def lobes(self) -> tuple[Lobe, ...]:
        """The lobes of the environment; none if it does not turn, as it is then baked as it is."""
        find = partial(find_lobes, self.environment, self.harmonics, self.target_error)
        if self.rotating:
            return find_once(self.environment, self.target_error, find)
        return ()

    @cached_property
    def harmonics(self) -> np.ndarray:
        """SH coefficients of the environment, linear RGB; (3, MAX_ORDER²) float64."""
        project = partial(project_environment, self.environment, MAX_ORDER)
        return find_once(self.environment, "harmonics", project)
