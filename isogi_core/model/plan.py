"""The scene plan: what a scene needs, and what is left out and why."""

import math
from dataclasses import dataclass

DEFAULT_ORDER = 5
LONGEST_PATH = 64


@dataclass(frozen=True)
class LeftOut:
    """One thing that a scene does without, and the reason in one sentence."""

    what: str
    why: str


@dataclass(frozen=True)
class ScenePlan:
    """What is baked per texel: ``order``² SH coefficients of direct and of indirect transfer.

    ``channels`` is 1 where the albedo is grey, else 3; ``bounces`` counts surface hits after the first.
    """

    order: int
    channels: int
    bounces: int
    left_out: tuple[LeftOut, ...] = ()
    representation: str = "transfer"

    @property
    def planes(self) -> tuple[str, ...]:
        """Names of the float32 numbers kept per texel, in their order in a chunk."""
        n = self.order**2
        colours = ("",) if self.channels == 1 else ("_r", "_g", "_b")
        return (
            "samples",
            "isovalue",
            "error",
            *(f"direct_{i}" for i in range(n)),
            *(f"indirect{c}_{i}" for c in colours for i in range(n)),
            *(f"spread{c}_{i}" for c in colours for i in range(n)),
        )

    @property
    def bytes_per_texel(self) -> int:
        """Bytes that one texel takes in the store before compression."""
        return 4 * len(self.planes)


def bounces_for(albedo: tuple[float, float, float], target_error: float) -> int:
    """Fewest bounces after which what is cut off, at most R^(bounces + 1) of the light, is half the target error."""
    brightest = max(albedo)
    if brightest <= 0.0:
        return 0
    if brightest >= 1.0:
        return LONGEST_PATH
    return min(max(math.ceil(math.log(target_error / 2) / math.log(brightest)) - 1, 0), LONGEST_PATH)


def plan_scene(
    albedo: tuple[float, float, float], target_error: float, bounces: int | None, order: int | None
) -> ScenePlan:
    """Derive the plan from the albedo and the target; ``bounces`` and ``order`` are taken where they are told."""
    grey = albedo[0] == albedo[1] == albedo[2]
    left_out = []
    if grey:
        left_out.append(LeftOut("two of three colour channels", "the albedo is grey, so transfer has no colour"))
    if bounces is None:
        bounces = bounces_for(albedo, target_error)
        why = "no light is reflected at albedo 0" if bounces == 0 else f"less than half of {target_error:g} is cut off"
        left_out.append(LeftOut(f"bounces after number {bounces}", why))
    return ScenePlan(order or DEFAULT_ORDER, 1 if grey else 3, bounces, tuple(left_out))
