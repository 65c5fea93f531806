"""Developing a frame: which overlay changes which pixels, and the colours of errors."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from isogi_core.frame import film
from isogi_core.frame.film import COVER, develop
from isogi_core.frame.frame import EdgeSamples
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL

STATES = (0, PROVISIONAL, CONVERGING, FINAL)


def frame_of(error: np.ndarray, light: float = 0.3) -> Any:
    """Twelve columns each of background, provisional, converging and final; ``error`` is of each row."""
    state = np.repeat(np.array(STATES, np.uint8), 12)[None].repeat(len(error), axis=0)
    radiance = np.full((*state.shape, 3), light, np.float32)
    return SimpleNamespace(
        edges=None,
        left=None,
        airy=None,
        radiance=radiance,
        state=state,
        total_error=np.repeat(error[:, None], 48, 1).astype(np.float32),
    )


def changed(overlay: str) -> list[float]:
    """The share of pixels that an overlay changes, by state."""
    frame = frame_of(np.full(24, 0.05))
    different = (develop(frame, 1.0, overlay) != develop(frame, 1.0)).any(axis=-1)
    return [float(different[frame.state == state].mean()) for state in STATES]


def test_each_overlay_marks_its_pixels() -> None:
    assert changed("none") == [0.0, 0.0, 0.0, 0.0]
    assert changed("provisional") == [0.0, 1.0, 0.5, 0.0]
    assert changed("error") == [0.0, 1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("background", "codes"), [("light", (226, 228, 230)), ("#1f00a7", (31, 0, 167)), ("#ffffff", (255, 255, 255))]
)
def test_a_background_is_behind_the_surface_alone(background: str, codes: tuple[int, ...]) -> None:
    frame = frame_of(np.full(24, 0.05))
    picture, dark = develop(frame, 1.0, "none", background), develop(frame, 1.0)
    assert (picture[frame.state == 0] == codes).all()
    assert (picture[frame.state > 0] == dark[frame.state > 0]).all()


def test_a_transparent_picture_covers_its_surface() -> None:
    frame = frame_of(np.full(24, 0.05))
    picture = develop(frame, 1.0, "error", "transparent")
    assert picture.shape[-1] == 4
    assert ((picture[..., 3] == 255) == (frame.state > 0)).all() and set(np.unique(picture[..., 3])) == {0, 255}


def test_samples_of_a_pixel_are_averaged_as_light() -> None:
    frame, on = frame_of(np.full(2, 0.05)), np.array([[True, False], [True, True]])
    frame.edges = EdgeSamples(np.array([0, 95], np.uint32), np.full((2, 2, 3), 0.5, np.float32), on)
    picture = develop(frame, 1.0, "none", "#ffffff")
    shown = film.linear_of(int(picture[1, 47, 0]) / 255)
    assert film.linear_of(int(picture[0, 0, 0]) / 255) == pytest.approx((shown + 1.0) / 2, abs=0.01)
    clear = develop(frame, 1.0, "none", "transparent")
    assert clear[0, 0, 3] == 128 and clear[1, 47, 3] == 255
    assert clear[0, 0, 0] == clear[1, 47, 0], "what is not covered has no colour"
    assert (develop(frame, 1.0, "provisional")[1, 47] == develop(frame, 1.0, "provisional")[0, 47]).all()


def test_unlit_pixels_are_hatched_without_an_error_colour() -> None:
    few, many = (develop(frame_of(np.full(24, error)), 1.0, "error") for error in (0.002, 0.9))
    hatched = develop(frame_of(np.full(24, 0.5)), 1.0, "provisional")
    assert np.array_equal(few[:, :24], many[:, :24])
    assert np.array_equal(few[:, 12:24], hatched[:, 12:24])
    assert (few[:, 24:] != many[:, 24:]).any(axis=-1).all()


def test_equal_factors_of_error_are_equal_steps_of_the_scale() -> None:
    errors = np.array([0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 7.0])
    shares = [0, 0, 0, 85, 170, 255, 255]
    table = film.colour_table()
    assert np.array_equal(film.error_colours(errors), table[shares])
    black = develop(frame_of(errors, light=0.0), 1.0, "error")
    np.testing.assert_allclose(black[:, 30], table[shares] * (COVER / 256), atol=1)


def test_the_form_shows_through_the_colours() -> None:
    dark, bright = (develop(frame_of(np.full(2, 0.03), light), 1.0, "error")[0, 30].astype(int) for light in (0, 1))
    assert ((bright - dark) > 20).all() and ((bright - dark) < 70).all()


def test_the_table_is_viridis_and_its_lightness_rises_evenly() -> None:
    matplotlib = pytest.importorskip("matplotlib")
    viridis = 255 * matplotlib.colormaps["viridis"](np.arange(256))[:, :3]
    assert np.abs(film.colour_table() - viridis).mean() < 2
    linear = np.vectorize(lambda code: ((code / 255 + 0.055) / 1.055) ** 2.4 if code > 10 else code / 255 / 12.92)
    luminance = linear(film.colour_table()) @ [0.2126, 0.7152, 0.0722]
    lightness = 116 * np.cbrt(luminance) - 16
    assert (np.diff(lightness[::8]) > 1).all()
    assert np.abs(lightness - np.linspace(lightness[0], lightness[-1], 256)).max() < 5


def test_developing_errors_leaves_the_frame_as_it_was() -> None:
    frame = frame_of(np.full(4, 0.1))
    state = frame.state.copy()
    develop(frame, 1.0, "error")
    assert np.array_equal(frame.state, state)
