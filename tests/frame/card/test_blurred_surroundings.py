"""The surroundings that cards mirror, beside sums over the sphere."""

import gc
import math
import weakref

import numpy as np
import pytest

from isogi_core.frame.card.blurred_surroundings import blurred, blurred_surroundings
from isogi_core.model.environment import Environment, mean_radiance, pixel_directions, solid_angles

RNG = np.random.default_rng(7)


def environment(image: np.ndarray, constant: float = 0.0) -> Environment:
    """An environment of an image (h, w, 3)."""
    return Environment(np.full(3, constant), image.astype(np.float32), "", "")


@pytest.mark.parametrize("width", [0.1, 0.4, 1.0])
def test_a_blur_is_a_mean_over_the_sphere(width: float) -> None:
    """By all pairs of directions, weighted by solid angle."""
    image = RNG.random((32, 64, 3)) ** 8
    source = pixel_directions(32, 64).reshape(-1, 3)
    towards = pixel_directions(16, 32).reshape(-1, 3)
    weights = np.exp((towards @ source.T - 1.0) / width**2) * solid_angles(32, 64).ravel()
    expected = weights @ image.reshape(-1, 3) / weights.sum(axis=1, keepdims=True)
    found = blurred(image, width)
    np.testing.assert_allclose(found.reshape(-1, 3), expected, rtol=1e-3, atol=1e-6)


def test_even_light_stays_as_it_is() -> None:
    found = blurred_surroundings(environment(np.zeros((1, 1, 3)), 0.7))
    assert [level.shape for level in found.levels] == [(8, 16, 3)]
    np.testing.assert_allclose(found.brightness * found.levels[0].astype(float), 0.7, rtol=1e-3)


def test_no_light_is_black() -> None:
    found = blurred_surroundings(environment(np.zeros((1, 1, 3))))
    assert not any(level.any() for level in found.levels) and found.brightness == 1.0


def test_a_sun_keeps_its_light_at_every_level() -> None:
    """It is a million times as bright as the sky, and halves hold both."""
    image = np.full((300, 600, 3), 0.5)
    image[91, 77] = [1e6, 5e5, 1e5]
    found = blurred_surroundings(environment(image))
    assert [len(level) for level in found.levels] == [256, 128, 64, 32, 16, 8]
    assert found.nbytes == len(found.tobytes()) == sum(12 * (256 >> k) ** 2 for k in range(6))
    mean = mean_radiance(image)
    for level in found.levels[:-1]:
        shown = found.brightness * level.astype(float)
        np.testing.assert_allclose(mean_radiance(shown), mean, rtol=0.02)
        assert shown.min() == pytest.approx(0.5, rel=0.01)


def test_levels_are_kept_as_long_as_their_environment() -> None:
    around = environment(RNG.random((8, 16, 3)))
    assert blurred_surroundings(around) is blurred_surroundings(around)
    known = weakref.ref(around), weakref.ref(blurred_surroundings(around))
    del around
    gc.collect()
    assert [each() for each in known] == [None, None]


def test_a_blur_is_as_wide_as_the_pixels_of_its_level() -> None:
    """That of a sun has its standard deviation along each axis."""
    image = np.zeros((256, 512, 3))
    image[127:129, 255:257] = 1.0
    level = blurred_surroundings(environment(image)).levels[2].astype(float)[..., 0]
    middle = pixel_directions(64, 128)[32, 64]
    angles = np.arccos(np.clip(pixel_directions(64, 128) @ middle, -1.0, 1.0))
    weights = level * solid_angles(64, 128)
    spread = math.sqrt((weights * angles**2).sum() / weights.sum() / 2.0)
    assert spread == pytest.approx(math.pi / 64, rel=0.15)
