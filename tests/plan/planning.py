"""Plans of lights, as the planner makes them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from isogi_core.model.environment import gather_lamps
from isogi_core.model.lights import Light
from isogi_core.model.scene_plan import ScenePlan
from isogi_core.plan.inputs import PlanInputs, PlanOverrides
from isogi_core.plan.lighting import assemble_environment
from isogi_core.plan.planner import plan_scene

NOTHING = PlanOverrides()


def inputs_of(
    lights: Sequence[Light],
    rotating: bool = True,
    albedo: float | Sequence[float] = 0.7,
    target: float = 0.02,
) -> PlanInputs:
    r, g, b = np.broadcast_to(albedo, 3).tolist()
    return PlanInputs(
        assemble_environment(lights),
        gather_lamps(lights),
        (0.0, 0.0, 0.0),
        1.0,
        rotating,
        (r, g, b),
        target,
    )


def plan_of(
    lights: Sequence[Light], overrides: PlanOverrides = NOTHING, **settings: Any
) -> ScenePlan:
    return plan_scene(inputs_of(lights, **settings), overrides)
