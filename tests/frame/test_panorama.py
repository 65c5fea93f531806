"""Panoramas: the light around a scene as a picture in the grid of a probe."""

import numpy as np
import pytest

from isogi_core.frame.film import tone_table
from isogi_core.frame.framing import GLARE, MIDDLE_BRIGHTNESS, glare, paint_panorama, tone
from isogi_core.model.environment import gather_lamps, solid_angles
from isogi_core.model.lights import ConstantLight, DirectionalLight, Light, PointLight, SkyLight
from isogi_core.plan.lighting import assemble_environment


def painted(*lights: Light, width: int = 128) -> np.ndarray:
    return paint_panorama(assemble_environment(lights), gather_lamps(lights), width)


def brightest(picture: np.ndarray) -> tuple[float, float]:
    """Azimuth and elevation of the middle of the brightest pixels, degrees."""
    height, width = picture.shape[:2]
    rows, columns = np.nonzero(picture.sum(axis=2, dtype=int) >= picture.sum(axis=2, dtype=int).max())
    return (columns.mean() + 0.5) / width * 360, 90 - (rows.mean() + 0.5) / height * 180


@pytest.mark.parametrize("radiance", [1e-20, 1.0, 1e20])
def test_a_constant_light_is_the_same_grey_however_bright(radiance: float) -> None:
    grey = tone_table()[round(MIDDLE_BRIGHTNESS / (1 + MIDDLE_BRIGHTNESS) * 4095)]
    assert (painted(ConstantLight((radiance,) * 3)) == grey).all()


@pytest.mark.parametrize("width", [16, 33, 256, 512])
def test_the_picture_is_half_as_high_as_it_is_wide(width: int) -> None:
    assert painted(SkyLight(), width=width).shape == (width // 2, width, 3)


@pytest.mark.parametrize(("azimuth", "elevation"), [(30.0, 50.0), (200.0, 10.0), (350.0, 80.0)])
def test_the_sun_is_where_the_scene_puts_it(azimuth: float, elevation: float) -> None:
    picture = painted(SkyLight(azimuth, elevation))
    assert brightest(picture) == pytest.approx((azimuth, elevation), abs=4.0)
    blue = picture[..., 2].astype(int) - picture[..., 0]
    assert blue[:32].mean() > 0.0 > blue[32:].mean(), "the sky is above, and the ground is warm"


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 0.0), (100.0, -40.0), (77.0, 89.0)])
def test_a_directional_light_is_marked_in_its_colour(azimuth: float, elevation: float) -> None:
    picture = painted(DirectionalLight(azimuth, elevation, (3.0, 1.5, 0.0)), width=256)
    marked = picture.any(axis=2)
    row = round((90 - elevation) / 180 * 128 - 0.5)
    column = round(azimuth / 360 * 256 - 0.5) % 256
    assert marked[row, column] and 0 < (solid_angles(128, 256) * marked).sum() < 0.02, "steradians"
    assert picture[marked].tolist() == [[255, tone_table()[2048], 0]] * int(marked.sum())


def test_a_panorama_without_distant_light_is_black() -> None:
    assert not painted(PointLight((1.0, 2.0, 3.0), (5.0, 5.0, 5.0))).any()
    assert not painted(ConstantLight((0.0, 0.0, 0.0)), DirectionalLight(irradiance=(0.0, 0.0, 0.0))).any()


def test_glare_spreads_a_small_share_and_loses_no_light() -> None:
    point = np.zeros((32, 64, 3))
    point[16, 1] = 1.0
    spread = glare(point) - point
    assert spread.sum(axis=(0, 1)) == pytest.approx([GLARE] * 3)
    assert np.unravel_index(spread[..., 0].argmax(), (32, 64)) == (16, 1)
    assert spread[16, [2, 0]] == pytest.approx(spread[[15, 17], 1]) and spread[16, -2].all(), "round the seam"


def test_tones_keep_their_order_and_their_hue() -> None:
    radiance = np.geomspace(1e-3, 1e5, 64)[:, None, None] * np.array([1.0, 0.5, 0.25]) * np.ones((64, 8, 1))
    toned = tone(radiance)
    assert (np.diff(toned[:, 0, 1]) > 0).all() and toned.max() <= 1.0
    assert toned[:30, 0, 0] == pytest.approx(2.0 * toned[:30, 0, 1])
