"""The planner: from a scene's lights, albedo and target error to the least that its texels must keep."""

import math
from dataclasses import dataclass, replace

from isogi_core.errors import SceneError
from isogi_core.model.environment import Environment
from isogi_core.model.lamps import Lamps
from isogi_core.model.plan import Layer, ScenePlan, most_samples

DEFAULT_ORDER = 5
LONGEST_PATH = 64

HALF_ERROR = 0.002
"""Target errors below this keep single floats."""


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
    lamps: Lamps
    rotating: bool
    albedo: tuple[float, float, float]
    target_error: float

    @property
    def constant(self) -> bool:
        """Whether light is the same from everywhere."""
        return not (self.lamps.any or self.environment.image.any())

    @property
    def grey(self) -> bool:
        """Whether reflected light keeps its colour."""
        return self.albedo[0] == self.albedo[1] == self.albedo[2]


def plan_scene(needs: Needs, told: Told) -> ScenePlan:
    """Derive the plan. Raises SceneError where what is told does not fit the scene's lights."""
    bounces = bounces_for(needs.albedo, needs.target_error) if told.bounces is None else told.bounces
    representation = told.representation or choose(needs, bounces)
    check(representation, needs)
    if representation == "vicinity":
        bounces = 0
    half = (told.precision or ("half" if needs.target_error >= HALF_ERROR else "single")) == "half"
    layers = tuple(replace(layer, half=half) for layer in layers_of(representation, needs, told, bounces))
    order = max(layer.order for layer in layers)
    return ScenePlan(representation, layers, bounces, (1.0,) * order, most_samples(needs.target_error))


def choose(needs: Needs, bounces: int) -> str:
    """The representation that keeps least."""
    if needs.constant:
        return "constant" if bounces else "vicinity"
    return "transfer" if needs.rotating else "irradiance"


def check(representation: str, needs: Needs) -> None:
    """Raise SceneError where a representation cannot show the scene's light."""
    if representation in ("vicinity", "constant") and not needs.constant:
        raise SceneError(f"representation = '{representation}' shows constant light alone: leave it out.")
    if representation == "irradiance" and needs.rotating:
        raise SceneError("representation = 'irradiance' is of light that does not turn: set rotating = false.")


def layers_of(representation: str, needs: Needs, told: Told, bounces: int) -> tuple[Layer, ...]:
    """The layers of a representation."""
    channels = 1 if needs.grey else 3
    if representation == "vicinity":
        return (Layer("direct"),)
    if representation == "constant":
        return (Layer("whole", channels=channels),)
    if representation == "irradiance":
        return (Layer("irradiance", channels=3),)
    order = told.order or DEFAULT_ORDER
    direct = Layer("direct", order)
    if not bounces:
        return (direct,)
    return direct, Layer("indirect", min(told.indirect_order or order, order), channels)


def vicinity_plan(plan: ScenePlan) -> ScenePlan:
    """The plan of vicinity shading in a scene: band 0 of direct light, out of a layer that is kept anyway if it may."""
    direct = next((layer for layer in plan.layers if layer.kind == "direct"), Layer("direct"))
    return ScenePlan("vicinity", (direct,), 0, (1.0,), plan.samples)


def bounces_for(albedo: tuple[float, float, float], target_error: float) -> int:
    """Fewest bounces after which what is cut off, at most R^(bounces + 1) of the light, is half the target error."""
    brightest = max(albedo)
    if brightest <= 0.0:
        return 0
    if brightest >= 1.0:
        return LONGEST_PATH
    return min(max(math.ceil(math.log(target_error / 2) / math.log(brightest)) - 1, 0), LONGEST_PATH)
