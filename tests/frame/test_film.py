"""Developing a frame: overlays, backgrounds, smooth edges, and panoramas of the light."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from isogi_core.frame import edges as frame_edges
from isogi_core.frame import film
from isogi_core.frame.edges import find_edges, pattern
from isogi_core.frame.film import (
    averaged,
    develop,
    ground_of,
    linear_table,
    lit,
    tone_table,
)
from isogi_core.frame.frame import EdgeSamples
from isogi_core.frame.panorama import glare, paint_panorama, tone
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL
from isogi_core.model.environment import gather_lamps, solid_angles
from isogi_core.model.lights import ConstantLight, DirectionalLight, Light, PointLight, SkyLight
from isogi_core.plan.lighting import assemble_environment
from tests.frame.conftest import Workbench

STATES = (0, PROVISIONAL, CONVERGING, FINAL)


def frame_of(error: np.ndarray, light: float = 0.3) -> Any:
    """Twelve columns each of background, provisional, converging and final; ``error`` is of each
    row.
    """
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
    ("background", "codes"),
    [("light", (203, 206, 209)), ("#1f00a7", (31, 0, 167)), ("#ffffff", (255, 255, 255))],
)
def test_a_background_is_behind_the_surface_alone(background: str, codes: tuple[int, ...]) -> None:
    frame = frame_of(np.full(24, 0.05))
    picture = develop(frame, 1.0, "none", background)
    dark = develop(frame, 1.0)
    assert (picture[frame.state == 0] == codes).all()
    assert (picture[frame.state > 0] == dark[frame.state > 0]).all()


def test_what_is_lit_stands_out_from_a_light_ground() -> None:
    """A surface that shows an albedo of 0.55 to 0.7, as most are exposed to, is 10 to 35 levels
    lighter.
    """
    ground = np.array(codes_of("light"))
    for albedo in (0.55, 0.6, 0.65, 0.7):
        light = np.full((1, 1, 3), albedo, np.float32)
        shown = lit(light, np.full((1, 1), 3, np.uint8), 1.0, False)[0, 0].astype(int)
        assert (shown - ground > 9).all() and (shown - ground < 36).all()


def codes_of(background: str) -> tuple[int, ...]:
    """The sRGB codes of a background."""
    picture = develop(frame_of(np.full(24, 0.05)), 1.0, "none", background)
    return tuple(map(int, picture[frame_of(np.full(24, 0.05)).state == 0][0]))


def test_a_transparent_picture_covers_its_surface() -> None:
    frame = frame_of(np.full(24, 0.05))
    picture = develop(frame, 1.0, "error", "transparent")
    assert picture.shape[-1] == 4
    assert ((picture[..., 3] == 255) == (frame.state > 0)).all() and set(
        np.unique(picture[..., 3])
    ) == {0, 255}


def test_samples_of_a_pixel_are_averaged_as_light() -> None:
    frame = frame_of(np.full(2, 0.05))
    on = np.array([[True, False], [True, True]])
    frame.edges = EdgeSamples(np.array([0, 95], np.uint32), np.full((2, 2, 3), 0.5, np.float32), on)
    picture = develop(frame, 1.0, "none", "#ffffff")
    shown = film.linear_of(int(picture[1, 47, 0]) / 255)
    assert film.linear_of(int(picture[0, 0, 0]) / 255) == pytest.approx((shown + 1.0) / 2, abs=0.01)
    clear = develop(frame, 1.0, "none", "transparent")
    assert clear[0, 0, 3] == 128 and clear[1, 47, 3] == 255
    assert clear[0, 0, 0] == clear[1, 47, 0], "what is not covered has no colour"
    assert (
        develop(frame, 1.0, "provisional")[1, 47] == develop(frame, 1.0, "provisional")[0, 47]
    ).all()


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
    opacity = black[:, 30].sum() / table[shares].sum()
    assert 0.6 < opacity < 0.95, "the form below shows, and the colours are told apart"
    np.testing.assert_allclose(black[:, 30], table[shares] * opacity, atol=1.5)


def test_the_form_shows_through_the_colours() -> None:
    dark, bright = (
        develop(frame_of(np.full(2, 0.03), light), 1.0, "error")[0, 30].astype(int)
        for light in (0, 1)
    )
    assert ((bright - dark) > 20).all() and ((bright - dark) < 70).all()


def test_the_table_is_viridis_and_its_lightness_rises_evenly() -> None:
    matplotlib = pytest.importorskip("matplotlib")
    viridis = 255 * matplotlib.colormaps["viridis"](np.arange(256))[:, :3]
    assert np.abs(film.colour_table() - viridis).mean() < 2
    linear = np.vectorize(
        lambda code: ((code / 255 + 0.055) / 1.055) ** 2.4 if code > 10 else code / 255 / 12.92
    )
    luminance = linear(film.colour_table()) @ [0.2126, 0.7152, 0.0722]
    lightness = 116 * np.cbrt(luminance) - 16
    assert (np.diff(lightness[::8]) > 1).all()
    assert np.abs(lightness - np.linspace(lightness[0], lightness[-1], 256)).max() < 5


def test_developing_errors_leaves_the_frame_as_it_was() -> None:
    frame = frame_of(np.full(4, 0.1))
    state = frame.state.copy()
    develop(frame, 1.0, "error")
    assert np.array_equal(frame.state, state)


# --- smooth edges
# --------------------------------------------------------------------------------------------------


SIZE = 224
TRUE = 256
"""Samples of a pixel that counts as true."""


@pytest.mark.parametrize("count", [4, 8, 16, TRUE])
def test_samples_are_spread_evenly_over_the_pixel(count: int) -> None:
    places = pattern(count)
    for axis in range(2):
        assert sorted((places[:, axis] * count).astype(int)) == list(range(count))
    np.testing.assert_allclose(places.mean(axis=0), 0.5, atol=1e-6)


def test_edges_are_silhouettes_and_contrasts_and_nothing_else() -> None:
    state = np.zeros((200, 200), np.uint8)
    picture = np.full((200, 200, 3), 90, np.uint8)
    state[10:30, 10:30] = 3
    picture[10:30, 20:] = 130
    edges, count = find_edges(picture, state)
    found = np.zeros(state.size, np.bool_)
    found[edges] = True
    wanted = np.zeros(state.shape, np.bool_)
    wanted[9:31, 9:31] = True
    wanted[11:29, 11:29] = False
    wanted[10:30, 19:21] = True
    assert np.array_equal(found.reshape(state.shape), wanted) and 8 <= count <= 32


@pytest.mark.parametrize("place", [(1, 1), (1, 2), (2, 1), (2, 2)])
def test_a_brighter_pixel_is_an_edge_on_all_sides(place: tuple[int, int]) -> None:
    picture = np.full((4, 4, 3), 100, np.uint8)
    picture[place] = 130
    edges, _ = find_edges(picture, np.full((4, 4), 3, np.uint8))
    beside = {place, *((place[0] + y, place[1] + x) for y, x in ((0, 1), (1, 0), (0, -1), (-1, 0)))}
    assert {divmod(int(each), 4) for each in edges} >= beside


def test_strongest_edges_come_first_and_the_budget_holds() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (400, 400, 3)).astype(np.uint8)
    picture[:, 200:] //= 4
    edges, count = find_edges(picture, np.full((400, 400), 3, np.uint8))
    assert count == 4 and 0.6 < len(edges) * count / 400**2 <= 1.0, "fewer samples than pixels"
    assert (np.diff(edges.astype(int)) > 0).all() and (edges % 400 < 201).all()


def test_smooth_edges_are_four_times_nearer_to_the_true_ones(
    orbital: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = orbital.view(size=SIZE, smooth=True)
    exposure = orbital.scene.default_exposure
    frame = orbital.renderer.render(view)
    plain = orbital.renderer.render(replace(view, smooth=False))
    assert frame.edges is not None and plain.edges is None
    pixels = frame.edges.pixels
    monkeypatch.setattr(frame_edges, "find_edges", lambda *_: (pixels, TRUE))
    true = orbital.renderer.render(view).edges
    assert true is not None
    partly = (true.covered[:, 3] > 0.0) & (true.covered[:, 3] < 1.0)
    wanted = linear_table()[averaged(true, exposure, ground_of("dark"), clear=False)][partly]
    smooth, stairs = (
        np.sqrt(
            np.mean(
                (linear_table()[develop(each, exposure).reshape(-1, 3)[pixels[partly]]] - wanted)
                ** 2
            )
        )
        for each in (frame, plain)
    )
    assert smooth < stairs / 4
    inside = np.ones(SIZE**2, np.bool_)
    inside[pixels] = False
    assert np.array_equal(
        develop(frame, exposure).reshape(-1, 3)[inside],
        develop(plain, exposure).reshape(-1, 3)[inside],
    )


def test_moving_views_have_no_more_samples(orbital: Workbench) -> None:
    assert orbital.renderer.render(orbital.view(size=32, smooth=True, moving=True)).edges is None


def test_a_view_of_nothing_has_no_edges(orbital: Workbench) -> None:
    assert (
        orbital.renderer.render(orbital.view(size=16, distance=1000.0, smooth=True)).edges is None
    )


def test_coverage_is_of_the_samples_on_the_surface(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view(size=64, smooth=True))
    assert frame.edges is not None
    light = frame.edges.covered[:, :3]
    share = frame.edges.covered[:, 3]
    assert ((share >= 0) & (share <= 1)).all() and ((share > 0) & (share < 1)).any()
    assert (light[share > 0].sum(axis=1) > 0).all() and (light[share == 0] == 0).all()
    clear = develop(frame, 1.0, "none", "transparent").reshape(-1, 4)[frame.edges.pixels, 3]
    np.testing.assert_allclose(clear, 255 * share, atol=0.6)


# --- panoramas
# --------------------------------------------------------------------------------------------------


def painted(*lights: Light, width: int = 128) -> np.ndarray:
    return paint_panorama(assemble_environment(lights), gather_lamps(lights), width)


def brightest(picture: np.ndarray) -> tuple[float, float]:
    """Azimuth and elevation of the middle of the brightest pixels, degrees."""
    height, width = picture.shape[:2]
    rows, columns = np.nonzero(
        picture.sum(axis=2, dtype=int) >= picture.sum(axis=2, dtype=int).max()
    )
    return (columns.mean() + 0.5) / width * 360, 90 - (rows.mean() + 0.5) / height * 180


@pytest.mark.parametrize("radiance", [1e-20, 1.0, 1e20])
def test_a_constant_light_is_the_same_grey_however_bright(radiance: float) -> None:
    picture = painted(ConstantLight((radiance,) * 3))
    assert 110 < picture[0, 0, 0] < 180
    assert (picture == painted(ConstantLight((1.0,) * 3))[0, 0]).all()


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
    assert not painted(
        ConstantLight((0.0, 0.0, 0.0)), DirectionalLight(irradiance=(0.0, 0.0, 0.0))
    ).any()


def test_glare_spreads_a_small_share_and_loses_no_light() -> None:
    point = np.zeros((32, 64, 3))
    point[16, 1] = 1.0
    spread = glare(point) - point
    share = spread.sum(axis=(0, 1))
    assert 0.01 < share[0] < 0.04
    assert share == pytest.approx(share[0])
    assert np.unravel_index(spread[..., 0].argmax(), (32, 64)) == (16, 1)
    assert spread[16, [2, 0]] == pytest.approx(spread[[15, 17], 1]) and spread[16, -2].all(), (
        "round the seam"
    )


def test_tones_keep_their_order_and_their_hue() -> None:
    radiance = (
        np.geomspace(1e-3, 1e5, 64)[:, None, None]
        * np.array([1.0, 0.5, 0.25])
        * np.ones((64, 8, 1))
    )
    toned = tone(radiance)
    assert (np.diff(toned[:, 0, 1]) > 0).all() and toned.max() <= 1.0
    assert toned[:30, 0, 0] == pytest.approx(2.0 * toned[:30, 0, 1])
