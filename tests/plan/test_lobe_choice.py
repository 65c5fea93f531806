"""Lobes of an environment against closed forms, what they leave to harmonics, and how many of them
pay.
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.kernels.transport.harmonics import MAX_ORDER
from isogi_core.model.environment import (
    LUMINANCE_WEIGHTS,
    Environment,
    Lobe,
    gather_lamps,
    pixel_directions,
    solid_angles,
)
from isogi_core.model.scene_plan import ScenePlan
from isogi_core.plan.bands import band_energy, project_environment, project_image, truncation_error
from isogi_core.plan.inputs import PlanInputs, PlanOverrides
from isogi_core.plan.lobe_choice import (
    Outline,
    disc_means,
    find_lobes,
    grow_lobe,
    lobe_of,
    moments_of,
    neighbours,
    outlines,
    project_lobes,
)
from isogi_core.plan.planner import plan_scene

SHAPE = (128, 256)
COLOUR = np.array([3.0, 2.0, 1.0])


def disc(
    towards: Sequence[float], degrees: float, radiance: float = 1e4, around: float = 0.5
) -> np.ndarray:
    """A lat-long image (h, w, 3) with a disc of so many degrees across about ``towards``, in grey
    surroundings.
    """
    axis = np.array(towards) / np.linalg.norm(towards)
    inside = pixel_directions(*SHAPE) @ axis >= math.cos(math.radians(degrees / 2.0))
    return np.where(inside[..., None], radiance * COLOUR, around)


def flux(radiance: np.ndarray) -> np.ndarray:
    """The radiance integrated over the sphere, (3,)."""
    return np.asarray((radiance * solid_angles(*SHAPE)[..., None]).sum(axis=(0, 1)))


def found(radiance: np.ndarray) -> Outline:
    """The first outline of a radiance: its edge is where half of the peak is."""
    return next(iter(outlines(radiance)))


@pytest.mark.parametrize("radiance", [1e2, 1e6, 1e30])
def test_one_hot_pixel_is_a_lobe_as_wide_as_the_pixel(radiance: float) -> None:
    image = np.full((*SHAPE, 3), 0.25)
    image[40, 100] = radiance * COLOUR
    lobe = found(image).lobe
    angle = solid_angles(*SHAPE)[40, 0]
    np.testing.assert_allclose(lobe.flux, angle * (radiance * COLOUR - 0.25), rtol=1e-12)
    np.testing.assert_allclose(lobe.towards, pixel_directions(*SHAPE)[40, 100], atol=1e-4)
    a = math.acos(lobe.cosine)
    assert 2.0 * math.pi * (1.0 - math.cos(a)) == pytest.approx(angle, rel=0.1), (
        "about the pixel's own solid angle"
    )


@pytest.mark.parametrize(
    "towards",
    [(0.3, 0.4, 0.5), (1.0, 0.0, 0.2), (1.0, -0.001, -0.3), (0.0, 0.0, 1.0), (0.0, 0.01, -1.0)],
    ids=["anywhere", "at the seam", "across the seam", "at the pole", "beside the other pole"],
)
@pytest.mark.parametrize("degrees", [6.0, 15.0])
def test_a_disc_is_found_with_its_flux_direction_and_width(
    towards: tuple[float, ...], degrees: float
) -> None:
    image = disc(towards, degrees)
    lobe = found(image).lobe
    np.testing.assert_allclose(lobe.flux, flux(image - 0.5), rtol=1e-9)
    assert np.dot(lobe.towards, towards) / np.linalg.norm(towards) > math.cos(math.radians(0.5))
    assert lobe.angle == pytest.approx(degrees, abs=1.0), "to a texel"
    np.testing.assert_allclose(np.linalg.norm(lobe.towards), 1.0)


def test_a_lobe_and_what_is_left_are_the_whole() -> None:
    rng = np.random.default_rng(4)
    image = disc((0.2, -0.7, 0.4), 9.0) * rng.random((*SHAPE, 1))
    for each in outlines(image):
        rest = image.copy()
        each.clear(rest)
        np.testing.assert_allclose(np.array(each.lobe.flux) + flux(rest), flux(image), rtol=1e-9)
        assert (rest <= image).all() and (rest[image < 1.0] == image[image < 1.0]).all()


def test_the_brightest_of_two_comes_first_and_the_other_next() -> None:
    image = np.maximum(disc((1.0, 0.0, 0.0), 5.0, 100.0), disc((0.0, 1.0, 0.0), 5.0, 70.0))
    first = found(image)
    assert first.lobe.towards[0] > 0.99
    first.clear(image)
    assert found(image).lobe.towards[1] > 0.99


def test_edges_are_sought_down_to_a_small_share_of_the_peak() -> None:
    image = np.maximum(disc((0.0, 1.0, 0.3), 4.0, 100.0), disc((0.0, 1.0, 0.3), 12.0, 4.0))
    angles = [each.lobe.angle for each in outlines(image)]
    assert len(angles) == 2 and angles[0] == pytest.approx(4.0, abs=1.0) and angles[1] > 5.0


@pytest.mark.parametrize(
    "image", [np.full((4, 8, 3), 3.0), np.zeros((1, 1, 3)), np.zeros((8, 16, 3))]
)
def test_even_and_black_light_has_none(image: np.ndarray) -> None:
    assert not list(outlines(image))


def test_light_that_is_wide_is_no_lobe() -> None:
    assert not list(outlines(disc((0.0, 0.0, 1.0), 30.0)))


@pytest.mark.parametrize("seed", [(0, 0), (64, 255), (127, 30), (1, 128)])
def test_a_region_grows_over_seam_and_poles_and_no_farther(seed: tuple[int, int]) -> None:
    towards = pixel_directions(*SHAPE)[seed]
    near = pixel_directions(*SHAPE) @ towards > math.cos(math.radians(8.0))
    far = pixel_directions(*SHAPE) @ -towards > math.cos(math.radians(8.0))
    places = grow_lobe(near | far, seed[0] * SHAPE[1] + seed[1], solid_angles(*SHAPE)[:, 0])
    assert np.array_equal(places, np.flatnonzero(near))


def test_a_region_that_fills_too_much_is_none() -> None:
    places = grow_lobe(np.ones(SHAPE, bool), 0, solid_angles(*SHAPE)[:, 0])
    assert not len(places)


def test_neighbours_are_those_around_and_beyond_the_pole() -> None:
    assert neighbours(np.array([3 * 8 + 7]), 6, 8, 1).tolist() == [
        16,
        22,
        23,
        24,
        30,
        31,
        32,
        38,
        39,
    ]
    assert neighbours(np.array([2]), 6, 8, 1).tolist() == [1, 2, 3, 5, 6, 7, 9, 10, 11]


def test_moments_are_those_of_many_small_pieces() -> None:
    places = np.array([0, 5, 17, 63])
    fine = pixel_directions(8 * 40, 8 * 40)
    pieces = (
        np.concatenate([fine, np.ones((*fine.shape[:2], 1))], axis=2)
        * solid_angles(320, 320)[..., None]
    )
    expected = pieces.reshape(8, 40, 8, 40, 4).sum(axis=(1, 3)).reshape(64, 4)[places]
    np.testing.assert_allclose(moments_of(places, 8, 8), expected, atol=1e-5)


def test_the_irradiance_of_a_lobe_is_that_of_its_disc() -> None:
    image = disc((0.0, 0.0, 1.0), 20.0, around=0.0)
    lobe = lobe_of(image, np.flatnonzero(image.any(axis=2)), np.zeros(3))
    facing = np.maximum(pixel_directions(*SHAPE)[..., 2:], 0.0)
    np.testing.assert_allclose(lobe.irradiance, flux(image * facing), rtol=1e-3)
    assert (np.array(lobe.flux) @ LUMINANCE_WEIGHTS) > lobe.irradiance @ LUMINANCE_WEIGHTS
    assert lobe.elevation == pytest.approx(90.0, abs=0.1) and 0.0 <= lobe.azimuth < 360.0


# --- lobes in the plan
# ------------------------------------------------------------------------------------------------


SHARE = math.sqrt(0.5)
"""Share of the target for direct and for reflected light each, whose errors add in quadrature."""

SUNS = [(0.6, 0.0, 0.8), (-0.8, 0.6, 0.0), (0.0, -1.0, 0.0), (0.0, 0.6, -0.8), (0.6, 0.8, 0.0)]


def light_of(*suns: tuple[float, float], around: float = 1.0) -> Environment:
    """Even light with ``suns``, each so many degrees across and of such a radiance."""
    image = np.full((*SHAPE, 3), around, np.float32)
    for towards, (degrees, radiance) in zip(SUNS, suns, strict=False):
        image[pixel_directions(*SHAPE) @ towards >= math.cos(math.radians(degrees / 2.0))] = (
            radiance
        )
    return Environment(np.zeros(3), image, str(suns), "suns")


def inputs_of(*suns: tuple[float, float], **settings: Any) -> PlanInputs:
    given = {"rotating": True, "albedo": (0.7, 0.7, 0.7), "target_error": 0.02, **settings}
    return PlanInputs(light_of(*suns), gather_lamps([]), (0.0, 0.0, 0.0), 1.0, **given)


def plan_of(
    *suns: tuple[float, float], overrides: PlanOverrides | None = None, **settings: Any
) -> ScenePlan:
    return plan_scene(inputs_of(*suns, **settings), overrides or PlanOverrides())


@cache
def most_bands() -> int:
    """The bands of direct light that is too sharp for harmonics."""
    return plan_of((3.0, 5000.0), overrides=PlanOverrides(lobes=0)).layers[0].order


@pytest.mark.parametrize("degrees", [3.0, 10.0, 19.0])
def test_coefficients_of_a_disc_are_those_of_its_picture(degrees: float) -> None:
    towards = np.array([0.48, -0.6, 0.64])
    shape = (1024, 2048)
    cosine = math.cos(math.radians(degrees / 2.0))
    image = np.where(
        (pixel_directions(*shape) @ towards >= cosine)[..., None], [3.0, 2.0, 1.0], 0.0
    )
    expected = project_image(image, MAX_ORDER)
    flux = expected[:, 0] * math.sqrt(4.0 * math.pi)
    found = project_lobes(
        [Lobe((0.48, -0.6, 0.64), cosine, (flux[0], flux[1], flux[2]))], MAX_ORDER
    )
    np.testing.assert_allclose(found, expected, atol=0.01 * expected[0, 0])


def test_a_lobe_without_size_is_its_harmonics_alone() -> None:
    np.testing.assert_allclose(disc_means(1.0, MAX_ORDER), 1.0)
    point = project_lobes([Lobe((0.0, 0.0, 1.0), 1.0, (1.0, 1.0, 1.0))], MAX_ORDER)
    zonal = [l * (l + 1) for l in range(MAX_ORDER)]
    np.testing.assert_allclose(
        point[0, zonal], [math.sqrt((2 * l + 1) / (4 * math.pi)) for l in range(MAX_ORDER)]
    )
    assert np.abs(np.delete(point[0], zonal)).max() < 1e-12


@pytest.mark.parametrize("suns", [0, 1, 3, 5])
def test_suns_are_found_until_few_are_enough(suns: int) -> None:
    environment = light_of(*[(3.0, 2000.0 / (1 + n)) for n in range(suns)])
    lobes = find_lobes(environment, project_environment(environment, MAX_ORDER), 0.02)
    assert len(lobes) == min(suns, 4)
    for lobe, towards in zip(lobes, SUNS, strict=False):
        assert np.dot(lobe.towards, towards) > math.cos(math.radians(0.5))


def test_a_street_of_lamps_has_more_lobes_than_a_few() -> None:
    rng = np.random.default_rng(3)
    image = np.full((32, 64, 3), 0.02, np.float32)
    image[rng.integers(8, 24, 40), rng.integers(0, 64, 40)] = rng.uniform(5.0, 50.0, (40, 1))
    street = Environment(np.zeros(3), image, "street", "street")
    inputs = PlanInputs(street, gather_lamps([]), (0.0, 0.0, 0.0), 1.0, True, (0.7,) * 3, 0.02)
    errors = [
        truncation_error(inputs.energy_beside(n), most_bands(), "direct")
        for n in range(len(inputs.lobes) + 1)
    ]
    plan = plan_scene(inputs, PlanOverrides())
    assert 4 < plan.lobes <= 64 and errors[plan.lobes] <= SHARE * 0.02 < errors[4]


def test_what_suns_leave_has_nothing_that_harmonics_lack() -> None:
    inputs = inputs_of((3.0, 2000.0), (5.0, 900.0))
    errors = [truncation_error(inputs.energy_beside(n), 6, "direct") for n in range(3)]
    assert errors[0] > errors[1] > errors[2] and errors[2] < 0.25 * 0.02
    np.testing.assert_allclose(
        [inputs.energy_beside(n)[0] for n in range(3)], inputs.energy[0], rtol=1e-12
    )
    np.testing.assert_allclose(inputs.energy_beside(0), inputs.energy)
    left = band_energy(inputs.harmonics - project_lobes(inputs.lobes, MAX_ORDER))
    np.testing.assert_allclose(inputs.energy_beside(2)[1:], left[1:])


def test_black_light_and_light_that_stays_have_none() -> None:
    black = light_of(around=0.0)
    assert find_lobes(black, project_environment(black, MAX_ORDER), 0.02) == ()
    assert inputs_of((3.0, 2000.0), rotating=False).lobes == ()


def test_the_plan_takes_the_fewest_lobes_within_the_share() -> None:
    inputs = inputs_of((3.0, 5000.0), (3.0, 3000.0), (3.0, 20.0))
    errors = [
        truncation_error(inputs.energy_beside(n), most_bands(), "direct")
        for n in range(len(inputs.lobes) + 1)
    ]
    plan = plan_scene(inputs, PlanOverrides())
    assert errors[plan.lobes] <= SHARE * inputs.target_error < errors[plan.lobes - 1]
    direct = plan.layers[0].order
    assert (
        truncation_error(inputs.energy_beside(plan.lobes), direct, "direct")
        <= SHARE * inputs.target_error
    )
    assert (
        truncation_error(inputs.energy_beside(plan.lobes), direct - 1, "direct")
        > SHARE * inputs.target_error
    )


def test_lobes_are_taken_where_they_nearly_reach_the_best() -> None:
    inputs = inputs_of((3.0, 5000.0), (3.0, 3000.0), target_error=1e-4)
    errors = [
        truncation_error(inputs.energy_beside(n), most_bands(), "direct")
        for n in range(len(inputs.lobes) + 1)
    ]
    plan = plan_scene(inputs, PlanOverrides())
    assert errors[plan.lobes] <= 1.25 * min(errors)
    assert plan.notes and "expect an error of" in plan.notes[0]


def test_soft_and_even_light_is_left_to_harmonics() -> None:
    assert plan_of((18.0, 1.2)).lobes == 0
    assert plan_of().representation == "constant" and plan_of().lobes == 0


def test_a_plan_with_lobes_keeps_less_and_errs_less() -> None:
    plain = plan_of((1.5, 9000.0), overrides=PlanOverrides(lobes=0))
    sharp = plan_of((1.5, 9000.0))
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
    (left,) = [
        each for each in plan.left_out if "of the light" in each.what and "lobe" in each.what
    ]
    assert left.what == "lobe 2 of the light" and left.saves[0].amount == 1
    assert not [each for each in plan_of((3.0, 5000.0)).left_out if "lobe" in each.what]
