"""Lobes of an environment against closed forms: their flux, where they stand, and how wide they are."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from isogi_core.model.environment import LUMINANCE_WEIGHTS, pixel_directions, solid_angles
from isogi_core.plan.lobe_choice import MAX_SOLID_ANGLE, Outline, grow_lobe, lobe_of, moments_of, neighbours, outlines

SHAPE = (128, 256)
COLOUR = np.array([3.0, 2.0, 1.0])


def disc(towards: Sequence[float], degrees: float, radiance: float = 1e4, around: float = 0.5) -> np.ndarray:
    """A lat-long image (h, w, 3) with a disc of so many degrees across about ``towards``, in grey surroundings."""
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
    assert 2.0 * math.pi * (1.0 - math.cos(a)) == pytest.approx(angle, rel=0.1), "about the pixel's own solid angle"


@pytest.mark.parametrize(
    "towards",
    [(0.3, 0.4, 0.5), (1.0, 0.0, 0.2), (1.0, -0.001, -0.3), (0.0, 0.0, 1.0), (0.0, 0.01, -1.0)],
    ids=["anywhere", "at the seam", "across the seam", "at the pole", "beside the other pole"],
)
@pytest.mark.parametrize("degrees", [6.0, 15.0])
def test_a_disc_is_found_with_its_flux_direction_and_width(towards: tuple[float, ...], degrees: float) -> None:
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


@pytest.mark.parametrize("image", [np.full((4, 8, 3), 3.0), np.zeros((1, 1, 3)), np.zeros((8, 16, 3))])
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
    assert not len(places) and 4.0 * math.pi > MAX_SOLID_ANGLE


def test_neighbours_are_those_around_and_beyond_the_pole() -> None:
    assert neighbours(np.array([3 * 8 + 7]), 6, 8, 1).tolist() == [16, 22, 23, 24, 30, 31, 32, 38, 39]
    assert neighbours(np.array([2]), 6, 8, 1).tolist() == [1, 2, 3, 5, 6, 7, 9, 10, 11]


def test_moments_are_those_of_many_small_pieces() -> None:
    places = np.array([0, 5, 17, 63])
    fine = pixel_directions(8 * 40, 8 * 40)
    pieces = np.concatenate([fine, np.ones((*fine.shape[:2], 1))], axis=2) * solid_angles(320, 320)[..., None]
    expected = pieces.reshape(8, 40, 8, 40, 4).sum(axis=(1, 3)).reshape(64, 4)[places]
    np.testing.assert_allclose(moments_of(places, 8, 8), expected, atol=1e-5)


def test_the_irradiance_of_a_lobe_is_that_of_its_disc() -> None:
    image = disc((0.0, 0.0, 1.0), 20.0, around=0.0)
    lobe = lobe_of(image, np.flatnonzero(image.any(axis=2)), np.zeros(3))
    facing = np.maximum(pixel_directions(*SHAPE)[..., 2:], 0.0)
    np.testing.assert_allclose(lobe.irradiance, flux(image * facing), rtol=1e-3)
    assert (np.array(lobe.flux) @ LUMINANCE_WEIGHTS) > lobe.irradiance @ LUMINANCE_WEIGHTS
    assert lobe.elevation == pytest.approx(90.0, abs=0.1) and 0.0 <= lobe.azimuth < 360.0
