"""The ball that mirrors the light: the sun is where a mirror would show it, and goes where it is dragged."""

import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from isogi_core.model.view import orbit, quaternion_from_angles, rotation_matrix
from tests.web.visits import BROWSER, box_of, drag, middle, open_shown, pixels

SUN = (30.0, 50.0)  # azimuth and elevation in the scene

pytestmark = BROWSER


def opened(page: Page, address: str) -> Page:
    page.goto(address)
    page.wait_for_selector("#globe[data-painted]")
    return page


def sun_on(page: Page) -> np.ndarray:
    """Where the ball shows the sun, x to the right and y up, in radii of the ball."""
    light = pixels(page, "#globe", None).sum(axis=2)
    size = len(light)
    rows, columns = np.nonzero(light > 0.97 * light.max())
    return np.array([(2 * columns.mean() + 1) / size - 1, 1 - (2 * rows.mean() + 1) / size])


def mirrored(azimuth: float, elevation: float, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Where a mirror ball shows the sun: where its normal is half-way between the sun and the eye."""
    camera = orbit((0.0, 0.0, 0.0), 1.0, azimuth, elevation, 1.0, 30.0)
    sun = rotation_matrix(quaternion_from_angles(yaw, pitch, roll)) @ orbit((0.0, 0.0, 0.0), 1.0, *SUN, 1.0, 30.0).eye
    halfway = sun + camera.eye
    right, up, _ = camera.basis()
    return np.array([halfway @ right, halfway @ up]) / np.linalg.norm(halfway)


def dragged(page: Page, right: int, down: int) -> np.ndarray:
    """How far the sun moves, in pixels right and down, when the ball is dragged."""
    before = sun_on(page)
    page.locator("#globe").scroll_into_view_if_needed()
    drag(page, middle(page.locator("#globe")), right, down)
    radius = 0.5 * box_of(page.locator("#globe"))["width"]
    return (sun_on(page) - before) * (radius, -radius)


TURNED = (
    {"azimuth": 30, "elevation": 20},
    {"azimuth": -20, "elevation": 70},
    {"azimuth": 60, "elevation": 0, "yaw": 80, "pitch": -30, "roll": 20},
)
"""Views and lights, in degrees."""


def test_the_sun_is_where_a_mirror_shows_it(page: Page, live_server: str) -> None:
    for angles in TURNED:
        query = "&".join(f"{name}={value}" for name, value in angles.items())
        opened(page, f"{live_server}/?shading=lambert&{query}")
        assert sun_on(page) == pytest.approx(mirrored(**angles), abs=0.05), angles


def test_what_is_mirrored_follows_the_pointer(page: Page, live_server: str) -> None:
    for elevation in (40, 90):
        opened(page, f"{live_server}/?shading=lambert&azimuth=30&elevation={elevation}")
        for wanted in ((14, 0), (-14, 10)):
            way, moved = np.divide(wanted, np.hypot(*wanted)), dragged(page, *wanted)
            assert 0.5 < moved @ way / np.hypot(*wanted) < 1.2, "less than the pointer, away from the ball's middle"
            assert np.linalg.norm(moved - moved @ way * way) < 0.25 * np.hypot(*wanted), elevation


def test_arrows_turn_it_and_its_knobs_follow(page: Page, live_server: str) -> None:
    opened(page, f"{live_server}/?shading=lambert&azimuth=30&elevation=20")
    before, azimuth = sun_on(page), page.input_value("#azimuth")
    page.focus("#globe")
    page.keyboard.press("ArrowRight")
    after = sun_on(page)
    assert after[0] > before[0] + 0.04
    page.keyboard.press("ArrowDown")
    assert sun_on(page)[1] < after[1] - 0.04
    assert float(page.input_value("#yaw")) > 5
    assert page.input_value("#azimuth") == azimuth, "the object stays"


def test_a_light_that_is_fixed_is_shown_and_cannot_be_turned(page: Page, live_server: str) -> None:
    def still(route: Route) -> None:
        route.fulfill(json={**route.fetch().json(), "turns": False, "rotating": False})

    page.route("**/v1/scenes/small", still)
    opened(page, f"{live_server}/?shading=lambert&azimuth=0&elevation=10")
    assert sun_on(page) == pytest.approx(mirrored(0, 10), abs=0.05)
    assert dragged(page, 14, 0) == pytest.approx((0, 0), abs=0.1)
    expect(page.locator("#globe")).to_have_attribute("role", "img")
    expect(page.locator("#yaw")).to_be_hidden()


def test_without_a_sky_picture_the_light_still_turns(page: Page, live_server: str) -> None:
    page.route("**/sky?*", lambda route: route.abort())
    open_shown(page, f"{live_server}/?shading=lambert").focus("#globe")
    page.keyboard.press("ArrowRight")
    assert float(page.input_value("#yaw")) > 5
