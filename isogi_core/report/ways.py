"""Ways to keep light: a scene by other plans than its own."""

from isogi_core.model.plan import Layer
from isogi_core.model.scene import Scene
from isogi_core.plan.planner import unit_of
from isogi_core.plan.savings import BANDS
from isogi_core.report.bench import with_plan


def as_s1(scene: Scene) -> Scene | None:
    """The scene with what S1 keeps of any; None under lamps, which harmonics do not hold."""
    if scene.lamps.any:
        return None
    whole = Layer("whole", BANDS, 3, half=False)
    return with_plan(scene, representation="transfer", layers=(whole,), order=BANDS, lobes=0, survival=1.0)


def as_irradiance(scene: Scene) -> Scene:
    """The scene under lights that stay: a texel keeps the light that it receives."""
    channels = 1 if scene.needs.grey and scene.needs.grey_light else 3
    layer = Layer("irradiance", channels=channels, scale=unit_of(scene.needs))
    return with_plan(scene, representation="irradiance", layers=(layer,), order=1, lobes=0)
