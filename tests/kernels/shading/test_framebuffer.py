"""The planes of a frame: sums over them, light of lobes, the tone curve, the sRGB code and marks of
state.
"""

import math

import numpy as np
import pytest

from isogi_core.kernels.shading import framebuffer as film
from isogi_core.kernels.shading.framebuffer import (
    CONVERGING,
    FINAL,
    PROVISIONAL,
    Framebuffer,
    luminance,
    put_pixel,
    tally,
)
from isogi_core.kernels.shading.lobes import add_lobes
from isogi_core.model.environment import LUMINANCE_WEIGHTS


def blank(pixels):
    """Planes of so many pixels."""
    return Framebuffer(
        np.zeros((pixels, 3), np.float32), np.zeros(pixels, np.uint8), np.zeros(pixels, np.float32)
    )


def test_luminance_is_the_models():
    for light in np.random.default_rng(1).random((20, 3)):
        assert luminance(*light) == pytest.approx(light @ LUMINANCE_WEIGHTS, rel=1e-6)


def test_a_pixel_is_written_whole_and_alone():
    planes = blank(3)
    put_pixel(planes, 1, (0.25, 0.5, 0.75), CONVERGING, 0.125)
    assert planes.radiance.tolist() == [[0, 0, 0], [0.25, 0.5, 0.75], [0, 0, 0]]
    assert planes.state.tolist() == [0, CONVERGING, 0] and planes.error.tolist() == [0, 0.125, 0]


def test_tallies_count_the_surface_alone():
    rng = np.random.default_rng(2)
    planes = blank(500)
    planes.radiance[:] = rng.random((500, 3))
    planes.error[:] = rng.random(500)
    planes.state[:] = rng.choice([0, PROVISIONAL, CONVERGING, FINAL], 500)
    counts = np.zeros(4, np.int64)
    sums = np.zeros(2)
    tally(planes, counts, sums)
    assert counts.tolist() == np.bincount(planes.state, minlength=4).tolist()
    on = planes.state > 0
    light = planes.radiance[on].astype(float) @ LUMINANCE_WEIGHTS
    assert sums == pytest.approx([light.sum(), ((light * planes.error[on]) ** 2).sum()], rel=1e-5)


LIGHT = np.array([0.2126, 0.7152, 0.0722], np.float32).astype(float)


@pytest.mark.parametrize("unit", [1.0, 2.0**-40, 2.0**60])
def test_light_of_lobes_joins_a_picture_with_its_error(unit):
    rng = np.random.default_rng(8)
    before = unit * rng.random((6, 3)).astype(np.float32)
    error = np.array([0.1, 0.02, 0.5, 1.0, 0.3, 1.0], np.float32)
    state = np.array([FINAL, CONVERGING, FINAL, PROVISIONAL, 0, FINAL], np.uint8)
    planes = Framebuffer(before.copy(), state.copy(), error.copy())
    pixels = np.array([0, 1, 2, 3, 5], np.uint32)
    lit = rng.random((5, 4)).astype(np.float32)
    lit[0] = 0.0
    add_lobes(pixels, lit, unit, planes)
    after = before.astype(float)
    after[pixels] += unit * lit[:, :3]
    np.testing.assert_allclose(planes.radiance, after, rtol=1e-6)
    noise = np.hypot(error * (before @ LIGHT) / unit, np.sqrt(np.insert(lit[:, 3], 4, 0.0)))
    expected = np.minimum(noise / (after @ LIGHT) * unit, 1.0)
    expected[3] = 1.0
    expected[4] = error[4]
    np.testing.assert_allclose(planes.error, expected, rtol=1e-5)
    assert np.array_equal(planes.state, state)


LEVELS = 4096
BACKGROUND = (0.01, 0.02, 0.03)
MARK = (0.9, 0.4, 0.1)


def decode(codes):
    """Linear light of sRGB codes, after IEC 61966-2-1."""
    s = np.asarray(codes) / 255.0
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def develop(radiance, state, exposure=1.0, overlay=False, first=0):
    """The picture (h, w, 3) of `radiance` (h, w, 3) and `state` (h, w)."""
    radiance = np.ascontiguousarray(radiance, np.float32)
    curve = np.empty(LEVELS, np.uint8)
    picture = np.empty(radiance.shape, np.uint8)
    film.fill_curve(curve)
    colours = np.array([BACKGROUND, MARK], np.float32)
    film.develop_rows(
        radiance, np.asarray(state, np.uint8), first, exposure, colours, overlay, curve, picture
    )
    return picture


def greys(levels, exposure=1.0):
    """A one-row picture of neutral light, every pixel final: its red codes."""
    light = np.repeat(np.asarray(levels, np.float32)[None, :, None], 3, axis=2)
    return develop(light, np.full(light.shape[:2], FINAL), exposure)[0, :, 0]


def test_tone_curve_has_no_kink_and_deepens_shade() -> None:
    x = np.linspace(0.01, 1.0, 10_000)
    slopes = np.diff([film.tone(each) for each in x]) / np.diff(x)
    assert np.abs(np.diff(slopes)).max() < 1e-2 * slopes.max()
    assert film.tone(0.0) == 0.0
    assert film.tone(0.1) < 0.1 and film.tone(0.5) > 0.5, (
        "contrast: what is dark is darker, what is bright brighter"
    )


def test_tone_curve_rises_for_ever_and_never_passes_one():
    x = np.concatenate([np.linspace(0, 5, 5000), [10.0, 100.0, 1e6, 1e300, math.inf]])
    y = np.array([film.tone(float(v)) for v in x])
    assert (np.diff(y)[:4900] > 0).all() and (np.diff(y) >= 0).all()
    assert y[-1] == 1.0


@pytest.mark.parametrize(
    ("linear", "code"),
    [(0.0, 0.0), (0.0031308, 0.04045), (0.18, 0.46135), (0.5, 0.73536), (1.0, 1.0)],
)
def test_srgb_against_published_values(linear, code):
    assert film.srgb(linear) == pytest.approx(code, abs=2e-5)


def test_curve_is_the_rounded_srgb_code_and_goes_back():
    curve = np.empty(LEVELS, np.uint8)
    film.fill_curve(curve)
    assert curve[0] == 0 and curve[-1] == 255 and (np.diff(curve.astype(int)) >= 0).all()
    assert set(curve) == set(range(256)), "every code can be reached"
    coded = 255.0 * np.array([film.srgb(i / (LEVELS - 1)) for i in range(LEVELS)])
    assert np.array_equal(curve, np.floor(coded + 0.5))
    np.testing.assert_allclose(decode(curve), np.arange(LEVELS) / (LEVELS - 1), atol=0.005)


@pytest.mark.parametrize("exposure", [0.0, 1e-30, 1.0, 1e30])
def test_brighter_light_is_never_darker_in_the_picture(exposure):
    """From no light, which is black, to the most that a float holds."""
    codes = greys([0.0, *np.geomspace(1e-38, 3e38, 2000)], exposure).astype(int)
    assert (np.diff(codes) >= 0).all()
    assert codes[0] == 0 and codes[-1] == (255 if exposure else 0)


@pytest.mark.parametrize("gain", [0.1, 0.8, 1.5, 3.0])
def test_hue_is_kept_through_the_tone_curve(gain):
    colour = np.array([0.9, 0.5, 0.3])
    linear = decode(develop((gain * colour)[None, None], [[FINAL]])[0, 0])
    np.testing.assert_allclose(linear / linear.max(), colour / colour.max(), atol=0.02)
    assert linear.max() == pytest.approx(film.tone(gain * 0.9), abs=0.01)


def test_exposure_multiplies_the_light():
    light = np.random.default_rng(1).random((4, 5, 3)).astype(np.float32)
    state = np.full((4, 5), FINAL)
    assert np.array_equal(develop(light, state, exposure=0.5), develop(light / 2, state))


def test_off_the_surface_is_background_whatever_the_light_there():
    picture = develop(np.full((1, 2, 3), 5.0), [[0, FINAL]])
    np.testing.assert_allclose(decode(picture[0, 0]), BACKGROUND, atol=2e-3)
    assert (picture[0, 1] > 240).all()


def test_marks_show_what_is_not_final_and_nothing_else():
    state = np.zeros((24, 24))
    state[:, :8] = PROVISIONAL
    state[:, 8:16] = CONVERGING
    state[:, 16:20] = FINAL
    light = np.full((24, 24, 3), 0.3)
    plain = develop(light, state)
    marked = develop(light, state, overlay=True)
    changed = (plain != marked).any(axis=-1)
    assert changed[:, :8].all(), "provisional is veiled everywhere"
    assert 0.3 < changed[:, 8:16].mean() < 0.7, "converging is hatched"
    assert not changed[:, 16:].any()


def test_hatching_goes_on_from_tile_to_tile():
    light = np.full((30, 30, 3), 0.3)
    state = np.full((30, 30), PROVISIONAL)
    state[:, 15:] = CONVERGING
    whole = develop(light, state, overlay=True)
    for first, last in ((0, 7), (7, 16), (16, 30)):
        tile = develop(light[first:last], state[first:last], overlay=True, first=first)
        assert np.array_equal(tile, whole[first:last])


@pytest.mark.parametrize("period", [6, 12])
def test_stripes_cover_half_of_any_row(period):
    for y in range(-5, 5):
        assert sum(film.stripe(x, y, period) for x in range(period)) == period // 2
