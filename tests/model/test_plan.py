"""The scene plan: what a scene is found to need, and what it is said to do without."""

import pytest

from isogi_core.model.plan import DEFAULT_ORDER, LONGEST_PATH, bounces_for, plan_scene

GREY, RED = (0.7, 0.7, 0.7), (0.8, 0.2, 0.2)


@pytest.mark.parametrize("albedo", [0.05, 0.3, 0.5, 0.7, 0.9, 0.99])
@pytest.mark.parametrize("target", [0.2, 0.02, 0.001])
def test_bounces_are_the_fewest_that_cut_off_half_the_target(albedo: float, target: float) -> None:
    bounces = bounces_for((albedo, 0.0, 0.0), target)
    if bounces < LONGEST_PATH:
        assert albedo ** (bounces + 1) <= target / 2 * (1 + 1e-12)
    if bounces > 0:
        assert albedo**bounces > target / 2


@pytest.mark.parametrize(("albedo", "bounces"), [(0.0, 0), (1.0, LONGEST_PATH), (0.999, LONGEST_PATH), (0.7, 12)])
def test_bounces_at_the_ends(albedo: float, bounces: int) -> None:
    assert bounces_for((albedo,) * 3, 0.02) == bounces


def test_the_brightest_channel_decides() -> None:
    assert bounces_for((0.1, 0.9, 0.1), 0.02) == bounces_for((0.9,) * 3, 0.02)


def test_a_grey_scene_needs_one_channel_and_says_so() -> None:
    plan = plan_scene(GREY, 0.02, 4, None)
    assert (plan.order, plan.channels, plan.bounces) == (DEFAULT_ORDER, 1, 4)
    assert [left.what for left in plan.left_out] == ["two of three colour channels"]


def test_a_coloured_scene_that_says_its_bounces_leaves_nothing_out() -> None:
    plan = plan_scene(RED, 0.02, 4, 7)
    assert (plan.order, plan.channels, plan.bounces, plan.left_out) == (7, 3, 4, ())


def test_bounces_that_nobody_told_are_left_out_with_a_reason() -> None:
    dark, bright = (plan_scene((a, a, a), 0.02, None, None) for a in (0.0, 0.7))
    assert dark.bounces == 0 and "no light is reflected" in dark.left_out[-1].why
    assert bright.bounces == 12
    assert bright.left_out[-1].what == "bounces after number 12" and "0.02" in bright.left_out[-1].why


def test_zero_bounces_are_taken_at_their_word() -> None:
    assert plan_scene(GREY, 0.02, 0, None).bounces == 0


@pytest.mark.parametrize(("albedo", "order", "planes"), [(GREY, 5, 3 + 75), (RED, 5, 3 + 175), (GREY, 1, 6)])
def test_planes_have_names_of_their_own_and_four_bytes(
    albedo: tuple[float, float, float], order: int, planes: int
) -> None:
    plan = plan_scene(albedo, 0.02, 4, order)
    assert len(plan.planes) == len(set(plan.planes)) == planes
    assert plan.planes[:3] == ("samples", "isovalue", "error")
    assert plan.bytes_per_texel == 4 * planes
