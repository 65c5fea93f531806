"""Lobes in the plan: what they leave to harmonics, and how many of them pay."""

import math
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.environment import Environment, Lobe, gather_lamps, pixel_directions
from isogi_core.model.scene_plan import ScenePlan
from isogi_core.plan.bands import band_energy, project_environment, project_image, truncation_error
from isogi_core.plan.budget import HARMONICS
from isogi_core.plan.inputs import PlanInputs, PlanOverrides
from isogi_core.plan.lobe_choice import (
    FEW_LOBES_SEARCHED,
    JUDGED_ORDER,
    LOBE_ERROR,
    MANY_LOBES_SEARCHED,
    disc_means,
    find_lobes,
    project_lobes,
)
from isogi_core.plan.planner import MOST_BANDS, MUCH, plan_scene

SHAPE = (128, 256)
SUNS = [(0.6, 0.0, 0.8), (-0.8, 0.6, 0.0), (0.0, -1.0, 0.0), (0.0, 0.6, -0.8), (0.6, 0.8, 0.0)]


def light_of(*suns: tuple[float, float], around: float = 1.0) -> Environment:
    """Even light with ``suns``, each so many degrees across and of such a radiance."""
    image = np.full((*SHAPE, 3), around, np.float32)
    for towards, (degrees, radiance) in zip(SUNS, suns, strict=False):
        image[pixel_directions(*SHAPE) @ towards >= math.cos(math.radians(degrees / 2.0))] = radiance
    return Environment(np.zeros(3), image, str(suns), "suns")


def inputs_of(*suns: tuple[float, float], **settings: Any) -> PlanInputs:
    given = {"rotating": True, "albedo": (0.7, 0.7, 0.7), "target_error": 0.02, **settings}
    return PlanInputs(light_of(*suns), gather_lamps([]), (0.0, 0.0, 0.0), 1.0, **given)


def plan_of(*suns: tuple[float, float], overrides: PlanOverrides | None = None, **settings: Any) -> ScenePlan:
    return plan_scene(inputs_of(*suns, **settings), overrides or PlanOverrides())


@pytest.mark.parametrize("degrees", [3.0, 10.0, 19.0])
def test_coefficients_of_a_disc_are_those_of_its_picture(degrees: float) -> None:
    towards, shape = np.array([0.48, -0.6, 0.64]), (1024, 2048)
    cosine = math.cos(math.radians(degrees / 2.0))
    image = np.where((pixel_directions(*shape) @ towards >= cosine)[..., None], [3.0, 2.0, 1.0], 0.0)
    expected = project_image(image, MAX_ORDER)
    flux = expected[:, 0] * math.sqrt(4.0 * math.pi)
    found = project_lobes([Lobe((0.48, -0.6, 0.64), cosine, (flux[0], flux[1], flux[2]))], MAX_ORDER)
    np.testing.assert_allclose(found, expected, atol=0.01 * expected[0, 0])


def test_a_lobe_without_size_is_its_harmonics_alone() -> None:
    np.testing.assert_allclose(disc_means(1.0, MAX_ORDER), 1.0)
    point = project_lobes([Lobe((0.0, 0.0, 1.0), 1.0, (1.0, 1.0, 1.0))], MAX_ORDER)
    zonal = [l * (l + 1) for l in range(MAX_ORDER)]
    np.testing.assert_allclose(point[0, zonal], [math.sqrt((2 * l + 1) / (4 * math.pi)) for l in range(MAX_ORDER)])
    assert np.abs(np.delete(point[0], zonal)).max() < 1e-12


@pytest.mark.parametrize("suns", [0, 1, 3, 5])
def test_suns_are_found_until_few_are_enough(suns: int) -> None:
    environment = light_of(*[(3.0, 2000.0 / (1 + n)) for n in range(suns)])
    lobes = find_lobes(environment, project_environment(environment, MAX_ORDER), 0.02)
    assert len(lobes) == min(suns, FEW_LOBES_SEARCHED)
    for lobe, towards in zip(lobes, SUNS, strict=False):
        assert np.dot(lobe.towards, towards) > math.cos(math.radians(0.5))


def test_a_street_of_lamps_has_more_lobes_than_a_few() -> None:
    rng = np.random.default_rng(3)
    image = np.full((32, 64, 3), 0.02, np.float32)
    image[rng.integers(8, 24, 40), rng.integers(0, 64, 40)] = rng.uniform(5.0, 50.0, (40, 1))
    street = Environment(np.zeros(3), image, "street", "street")
    inputs = PlanInputs(street, gather_lamps([]), (0.0, 0.0, 0.0), 1.0, True, (0.7,) * 3, 0.02)
    errors = [truncation_error(inputs.energy_beside(n), MOST_BANDS, "direct") for n in range(len(inputs.lobes) + 1)]
    plan = plan_scene(inputs, PlanOverrides())
    assert (
        FEW_LOBES_SEARCHED < plan.lobes <= MANY_LOBES_SEARCHED
        and errors[plan.lobes] <= HARMONICS * 0.02 < errors[FEW_LOBES_SEARCHED]
    )


def test_what_suns_leave_has_nothing_that_harmonics_lack() -> None:
    inputs = inputs_of((3.0, 2000.0), (5.0, 900.0))
    errors = [truncation_error(inputs.energy_beside(n), JUDGED_ORDER, "direct") for n in range(3)]
    assert errors[0] > errors[1] > errors[2] and errors[2] < LOBE_ERROR
    np.testing.assert_allclose([inputs.energy_beside(n)[0] for n in range(3)], inputs.energy[0], rtol=1e-12)
    np.testing.assert_allclose(inputs.energy_beside(0), inputs.energy)
    left = band_energy(inputs.harmonics - project_lobes(inputs.lobes, MAX_ORDER))
    np.testing.assert_allclose(inputs.energy_beside(2)[1:], left[1:])


def test_black_light_and_light_that_stays_have_none() -> None:
    black = light_of(around=0.0)
    assert find_lobes(black, project_environment(black, MAX_ORDER), 0.02) == ()
    assert inputs_of((3.0, 2000.0), rotating=False).lobes == ()


def test_the_plan_takes_the_fewest_lobes_within_the_share() -> None:
    inputs = inputs_of((3.0, 5000.0), (3.0, 3000.0), (3.0, 20.0))
    errors = [truncation_error(inputs.energy_beside(n), MOST_BANDS, "direct") for n in range(len(inputs.lobes) + 1)]
    plan = plan_scene(inputs, PlanOverrides())
    assert errors[plan.lobes] <= HARMONICS * inputs.target_error < errors[plan.lobes - 1]
    direct = plan.layers[0].order
    assert truncation_error(inputs.energy_beside(plan.lobes), direct, "direct") <= HARMONICS * inputs.target_error
    assert truncation_error(inputs.energy_beside(plan.lobes), direct - 1, "direct") > HARMONICS * inputs.target_error


def test_lobes_are_taken_where_they_nearly_reach_the_best() -> None:
    inputs = inputs_of((3.0, 5000.0), (3.0, 3000.0), target_error=1e-4)
    errors = [truncation_error(inputs.energy_beside(n), MOST_BANDS, "direct") for n in range(len(inputs.lobes) + 1)]
    plan = plan_scene(inputs, PlanOverrides())
    assert errors[plan.lobes] <= MUCH * min(errors)
    assert plan.notes and "expect an error of" in plan.notes[0]


def test_soft_and_even_light_is_left_to_harmonics() -> None:
    assert plan_of((18.0, 1.2)).lobes == 0
    assert plan_of().representation == "constant" and plan_of().lobes == 0


def test_a_plan_with_lobes_keeps_less_and_errs_less() -> None:
    plain, sharp = plan_of((1.5, 9000.0), overrides=PlanOverrides(lobes=0)), plan_of((1.5, 9000.0))
    assert sharp.lobes == 1 and sharp.bytes_per_texel < plain.bytes_per_texel
    assert dict(sharp.errors)["harmonics"] < 0.2 * dict(plain.errors)["harmonics"]


def test_lobes_of_the_scene_are_taken_or_refused() -> None:
    suns = [(3.0, 5000.0), (3.0, 3000.0)]
    assert [plan_of(*suns, overrides=PlanOverrides(lobes=n)).lobes for n in (0, 1, 2)] == [0, 1, 2]
    with pytest.raises(SceneError, match="at most 2"):
        plan_of(*suns, overrides=PlanOverrides(lobes=3))
    with pytest.raises(SceneError, match="lobes = 1"):
        plan_of(overrides=PlanOverrides(lobes=1))
    with pytest.raises(SceneError, match="lobes = 1"):
        plan_of(*suns, overrides=PlanOverrides(lobes=1), rotating=False)


def test_lobes_left_to_harmonics_are_listed_with_their_gain() -> None:
    plan = plan_of((3.0, 5000.0), (3.0, 3000.0), overrides=PlanOverrides(lobes=1))
    (left,) = [each for each in plan.left_out if "of the light" in each.what and "lobe" in each.what]
    assert left.what == "lobe 2 of the light" and left.saves[0].amount == 1
    assert not [each for each in plan_of((3.0, 5000.0)).left_out if "lobe" in each.what]
