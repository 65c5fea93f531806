"""Environments by formula, beside closed forms and independent counts."""

import math
from pathlib import Path

import numpy as np
import pytest

from isogi_core.errors import SceneError
from isogi_core.model.environment import (
    FORMULAS,
    GALLERY_HALF_SIZES,
    GROUND,
    LUMINANCE_WEIGHTS,
    SKYLIGHTS,
    SOFT_BOXES,
    environment_image,
    pixel_directions,
    solid_angles,
)
from isogi_core.model.lights import ENVIRONMENTS, EnvironmentLight, ProbeLight, light_named

DIRECTIONS, ANGLES = pixel_directions(128, 256), solid_angles(128, 256)


def seen(name: str) -> np.ndarray:
    """The luminance of an environment."""
    return environment_image(EnvironmentLight(name), DIRECTIONS, ANGLES) @ LUMINANCE_WEIGHTS


def towards(azimuth: float, elevation: float) -> np.ndarray:
    """A unit direction, from degrees."""
    turn, tilt = math.radians(azimuth), math.radians(elevation)
    return np.array([math.cos(tilt) * math.cos(turn), math.cos(tilt) * math.sin(turn), math.sin(tilt)])


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_its_mean_luminance_is_one(name: str) -> None:
    image = environment_image(EnvironmentLight(name), DIRECTIONS, ANGLES)
    assert np.isfinite(image).all() and image.min() >= 0.0
    assert np.sum(ANGLES * (image @ LUMINANCE_WEIGHTS)) / (4.0 * np.pi) == pytest.approx(1.0, rel=1e-9)


def test_an_overcast_sky_is_three_times_as_bright_above() -> None:
    sky = seen("overcast")
    assert sky[0].mean() / sky[63].mean() == pytest.approx(3.0 / (1.0 + 2.0 * math.sin(math.pi / 256)), rel=2e-3)


def test_its_ground_reflects_what_falls_on_it() -> None:
    sky = seen("overcast")
    up = DIRECTIONS[..., 2] > 0.0
    falling = np.sum((ANGLES * DIRECTIONS[..., 2] * sky)[up])
    assert sky[~up].max() == sky[~up].min() == pytest.approx(GROUND * falling / math.pi, rel=1e-3)


def test_the_studio_has_two_boxes_where_they_stand() -> None:
    image = seen("studio")
    bright = image > 2.0 * np.median(image)
    for (azimuth, elevation), (half, _), _ in SOFT_BOXES:
        apart = np.degrees(np.arccos(np.clip(DIRECTIONS @ towards(azimuth, elevation), -1.0, 1.0)))
        assert bright[apart < 0.8 * half].all()
    apart = [DIRECTIONS @ towards(*place) for place, _, _ in SOFT_BOXES]
    assert not bright[np.maximum(*apart) < math.cos(math.radians(45.0))].any(), "nothing else is bright"


def test_the_gallery_has_as_much_glass_as_it_should() -> None:
    """Rays to even points of the ceiling meet glass in the share of it that is glass."""
    across, along = np.meshgrid(
        np.linspace(-1, 1, 201) * GALLERY_HALF_SIZES[0], np.linspace(-1, 1, 441) * GALLERY_HALF_SIZES[1]
    )
    points = np.stack([across, along, np.full_like(across, GALLERY_HALF_SIZES[2])], axis=-1)[1:-1, 1:-1]
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    light = FORMULAS["gallery"](rays, np.ones(rays.shape[:2])) @ LUMINANCE_WEIGHTS
    assert (light > 2.0).mean() == pytest.approx((SKYLIGHTS[1] - SKYLIGHTS[0]) / GALLERY_HALF_SIZES[1], abs=0.01)


def test_noon_is_brighter_above_and_bluer_than_the_evening() -> None:
    noon, evening = (environment_image(EnvironmentLight(name), DIRECTIONS, ANGLES) for name in ("noon", "evening"))
    colours = [np.sum(ANGLES[..., None] * image, axis=(0, 1)) for image in (noon, evening)]
    assert colours[0][2] / colours[0][0] > 1.0 > colours[1][2] / colours[1][0]
    heights = [np.sum(ANGLES * DIRECTIONS[..., 2] * (image @ LUMINANCE_WEIGHTS)) for image in (noon, evening)]
    assert heights[0] > heights[1]


def test_a_light_is_named_by_word_or_by_file() -> None:
    assert light_named("studio", Path("scenes")) == EnvironmentLight("studio")
    assert light_named("hall.HDR", Path("scenes")) == ProbeLight(Path("scenes/hall.HDR"))
    assert EnvironmentLight("studio").name == ENVIRONMENTS["studio"]
    with pytest.raises(SceneError, match=r"no environment 'moon': choose overcast, .*\.hdr"):
        light_named("moon", Path())
