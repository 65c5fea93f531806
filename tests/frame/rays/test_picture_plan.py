"""Of the ways to bring a picture to its target the one with the fewest paths is taken."""

import math

import numpy as np
import pytest

from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.frame.rays.control_pixels import MAX_CONTROLS, TotalError
from isogi_core.frame.rays.picture_plan import (
    AWAITED,
    CLOSER,
    COUNTED_TEXEL_SHARE,
    FINER_TEXELS_FACTOR,
    HEAVIER,
    QUIETER,
    TASK,
    Ahead,
    OwnLight,
    Plan,
    by_finer,
    by_rungs,
    controls_to,
    rungs_at_once,
)

PIXELS, TARGET, CHUNKS = 4000, 0.02, 20
NONE = np.empty(0, np.int64)


def own_light(allowed: float) -> OwnLight:
    """Pixels of the luminance 1, whose light has a variance of 0.01 after 256 paths."""
    return OwnLight(np.full(PIXELS, 0.01), 256, NONE, allowed)


def cheapest(apart: float, noise: float, texels: int) -> Plan:
    """The plan for a picture that is ``apart`` from the truth besides its ``noise``, by so many ``texels``."""
    own, squares = own_light((0.85 * TARGET) ** 2), np.full(PIXELS, apart**2 + noise**2)
    climbs = [0.0, *(16.0 * texels * (2**n - 1) for n in (1, 2, 3))]
    plans = by_rungs(own, squares, np.full(PIXELS, noise**2), climbs, CHUNKS)
    plans += by_finer(own, squares, np.full(PIXELS, noise**2), texels, CHUNKS, FIRST_LEVEL, TARGET)
    return min(plans, key=lambda plan: plan.cost(AWAITED))


def test_noise_asks_for_rungs() -> None:
    plan = cheapest(apart=0.002, noise=0.03, texels=2000)
    assert plan.rungs == 2 and not plan.finer and not len(plan.choice.places)


def test_light_between_texels_asks_for_finer_ones() -> None:
    plan = cheapest(apart=0.03, noise=0.005, texels=2000)
    assert plan.finer and plan.rungs == 1 and plan.texel_paths == FINER_TEXELS_FACTOR * 2000 * FIRST_LEVEL


def test_many_texels_leave_pixels_to_light_of_their_own() -> None:
    plan = cheapest(apart=0.03, noise=0.005, texels=2_000_000)
    assert not plan.rungs and len(plan.choice.places)


def test_finer_texels_begin_with_their_first_samples_again() -> None:
    """Those of a third rung have four times the noise variance of the coarse ones at first."""
    own, errors, noise = own_light(1.0), np.full(9, 0.05), np.full(9, 0.01)
    own = OwnLight(np.full(9, 0.01), 256, NONE, 1e-12)
    asked: list[np.ndarray] = []
    by_finer(OwnLightSeen(own, asked), errors, noise, 10, CHUNKS, 4 * FIRST_LEVEL, TARGET)
    assert asked[0] == pytest.approx(CLOSER * 0.04 + 0.01 / QUIETER**2)
    assert asked[2] == pytest.approx(CLOSER * 0.04 + 0.01) and asked[3][0] < asked[2][0]


class OwnLightSeen(OwnLight):
    """Notes the errors that it is asked about."""

    def __init__(self, own: OwnLight, asked: list[np.ndarray]) -> None:
        super().__init__(own.variance, own.paths, own.own, own.allowed)
        object.__setattr__(self, "asked", asked)

    def beside(self, errors: np.ndarray):  # type: ignore[no-untyped-def]
        self.asked.append(errors)  # type: ignore[attr-defined]
        return super().beside(errors)


def test_what_is_ahead_leaves_out_what_begins_now() -> None:
    own = own_light(0.05**2)
    plan = by_rungs(own, np.full(PIXELS, 0.2), np.full(PIXELS, 0.1), [0.0, 10.0, 30.0], 5)[2]
    assert plan.cost(AWAITED) == 10 * TASK + COUNTED_TEXEL_SHARE * HEAVIER * 30.0 + plan.choice.paths
    assert plan.ahead(5.0, 100.0) == Ahead(plan.choice.paths + 110.0, 20.0, 3)
    now = by_rungs(own, np.full(PIXELS, 0.2), np.full(PIXELS, 0.1), [0.0], 5)[0]
    assert now.ahead(5.0, 100.0) == Ahead(100.0, 0.0, 1)


def test_narrow_intervals_take_more_controls() -> None:
    """256 of them leave the error within a factor of 1.2: to be sure of half of that takes four times as many."""
    measured = TotalError(0.018, 0.015, 0.018 * 1.2, 256)
    room = math.sqrt(1.2)
    assert controls_to(measured, TARGET / room, TARGET) in (1024, 1025)
    assert controls_to(measured, TARGET, TARGET) == controls_to(measured, 0.019999, TARGET) == MAX_CONTROLS


def test_cheap_rungs_are_climbed_at_once() -> None:
    assert rungs_at_once(3, [0.0, 10.0, 30.0, 70.0], check=40.0) == 2
    assert rungs_at_once(1, [0.0, 10.0, 30.0, 70.0], check=40.0) == 1
    assert rungs_at_once(3, [0.0, 50.0, 150.0, 350.0], check=40.0) == 1
