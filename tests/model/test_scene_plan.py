"""What a scene plan is made of: what a texel takes by it, and the samples that an error is
worth.
"""

import numpy as np
import pytest

from isogi_core.model.scene_plan import (
    Layer,
    ScenePlan,
    most_samples,
    texel_target,
)

SINGLE = {"half": False}


@pytest.mark.parametrize(
    ("layer", "size"),
    [
        (Layer("direct"), 4),
        (Layer("whole", channels=3), 8),
        (Layer("direct", 5), 53),
        (Layer("indirect", 3, 3), 57),
        (Layer("direct", 1, 1, **SINGLE), 6),
        (Layer("direct", 5, 3, **SINGLE), 303),
    ],
)
def test_bytes_of_a_texel_are_coefficients_noises_and_level(layer: Layer, size: int) -> None:
    assert layer.bytes_per_texel == size


def test_a_plan_is_as_large_as_its_layers_are_together() -> None:
    plan = ScenePlan("transfer", (Layer("direct", 5), Layer("indirect", 3, 3)), 5, 4, 1.0, 4096)
    assert (plan.order, plan.indirect_order, plan.channels, plan.precision) == (5, 3, 3, "half")
    assert plan.bytes_per_texel == 53 + 57


def test_pixels_between_texels_just_final_are_at_the_target() -> None:
    """Eight texels of independent noise, mixed at random places between them."""
    rng = np.random.default_rng(8)
    target = 0.02
    noise = rng.normal(0.0, texel_target(target), (200_000, 2, 2, 2))
    for fraction in rng.random((3, len(noise))):
        noise = (noise[:, 0].T * (1.0 - fraction) + noise[:, 1].T * fraction).T
    assert noise.std() == pytest.approx(target, rel=0.01)


def test_a_stricter_target_is_worth_more_samples() -> None:
    worth = [most_samples(target) for target in (1.0, 0.05, 0.02, 0.01, 0.005, 1e-4)]
    assert worth == sorted(worth) and worth[2] == 2048
    assert all(n & (n - 1) == 0 for n in worth), "rungs of the ladder are powers of two"
    assert (worth[0], most_samples(1e-9), most_samples(0.0)) == (
        64,
        1 << 20,
        1 << 20,
    )
