"""Inputs of the planner: lights, albedo and target, and the choices that a scene makes itself."""

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

FOUND: WeakKeyDictionary[Any, dict[Hashable, Any]] = WeakKeyDictionary()
"""What was worked out of the environments and volumes in use, which scenes share that have the
same.
"""

Input = TypeVar("Input")


def found(subject: Environment | Volume, what: Hashable, find: Callable[[], Input]) -> Input:
    """What was found of a ``subject``, or is found now: ``what`` holds all that it depends on
    besides.
    """
    known = FOUND.setdefault(subject, {})
    if what not in known:
        known[what] = find()
    kept: Input = known[what]
    return kept


@dataclass(frozen=True)
class PlanOverrides:
    """Choices that a scene makes itself; None leaves one to the planner."""

    representation: str | None = None
    order: int | None = None
    indirect_order: int | None = None
    bounces: int | None = None
    precision: str | None = None
    lobes: int | None = None
    albedos: tuple[float, float] | None = None


@dataclass(frozen=True)
class PlanInputs:
    """Facts of a scene that its plan depends on: lights, whether they may turn, albedo, and
    relative target error.

    ``centre`` and ``radius`` are of the ball around the volume, in world units. ``albedo`` is the
    highest that views may ask for, ``walls`` are the albedos of walls, or of several surfaces. The
    surface may have its albedo ``by_data``, at most this one, and is then ``coloured`` where these
    are not all grey. So many ``glows`` are in the volume.
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
        """The most that anything reflects of each colour, the surface or a wall."""
        return triple(max(shares) for shares in zip(self.albedo, *self.walls, strict=True))

    @property
    def grey(self) -> bool:
        """Whether reflected light keeps its colour."""
        alike = all(red == green == blue for red, green, blue in (self.albedo, *self.walls))
        return alike and not self.coloured

    @cached_property
    def grey_light(self) -> bool:
        """Whether all lights are grey."""
        lights = (self.environment.image, self.environment.constant, self.lamps.arrays.colours)
        return all(bool((light[..., 1:] == light[..., :1]).all()) for light in lights)

    @cached_property
    def constant(self) -> bool:
        """Whether the scene's light is a constant one."""
        return not self.lamps.any and not self.environment.image.any()

    @cached_property
    def brightest(self) -> float:
        """Upper bound of irradiance over π, in luminance, of an unshadowed surface at the centre
        facing the light.

        The environment's part is taken from bands 0 and 1, which hold nearly all of it: mean + 2
        |mean of L·ω|.
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
        """``energy`` without that of the first ``lobes`` lobes, band 0 excepted; (MAX_ORDER,)
        float64.
        """
        return self._energies[lobes]

    @cached_property
    def _energies(self) -> tuple[np.ndarray, ...]:
        return tuple(
            energy_beside(self.harmonics, self.lobes[:n]) for n in range(len(self.lobes) + 1)
        )

    @cached_property
    def lobes(self) -> tuple[Lobe, ...]:
        """The environment's lobes; none where it does not turn, as it is then baked as it is."""
        find = partial(find_lobes, self.environment, self.harmonics, self.target_error)
        if self.rotating:
            return found(self.environment, self.target_error, find)
        return ()

    @cached_property
    def harmonics(self) -> np.ndarray:
        """The environment's coefficients, linear RGB; (3, MAX_ORDER²) float64."""
        project = partial(project_environment, self.environment, MAX_ORDER)
        return found(self.environment, "harmonics", project)
