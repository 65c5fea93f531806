"""Moving the picture and looking along an axis: what the page asks for, and what the server then shows there."""

from urllib.parse import urljoin

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from isogi_core.model.view import orbit
from tests.web.visits import BROWSER, drag, middle, open_shown, query_of, stage_of, surface_of

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
CENTRE = (11.5, 9.5, 7.5)
OUT = np.array(orbit((0.0, 0.0, 0.0), 1.0, 25.0, 15.0, 1.0, 30.0).eye)
RIGHT, DOWN = 70, -40  # pixels of a drag

pytestmark = BROWSER


@pytest.fixture
def shown(page: Page, live_server: str) -> Page:
    """The page with a picture, at a view that is none of the sides."""
    return open_shown(page, f"{live_server}/?shading=lambert&azimuth=25&elevation=15&distance=3")


def target_of(page: Page) -> list[float]:
    return [float(x) for x in query_of(page)["target"].split(",")]


def pull(page: Page, hand: str, way: int) -> None:
    """Drag the picture, by the middle button, two fingers, or the left button while a key is held."""
    place = middle(page.locator("#stage"))
    if hand == "fingers":
        drag_fingers(page, *place, way)
    elif hand == "middle":
        drag(page, place, way * RIGHT, way * DOWN, "middle")
    else:
        page.keyboard.down(hand)
        drag(page, place, way * RIGHT, way * DOWN)
        page.keyboard.up(hand)


def drag_fingers(page: Page, x: float, y: float, way: int, apart: float = 1.0) -> None:
    """Two fingers, 80 pixels from each other, that move and end up ``apart`` times as far from each other."""
    session = page.context.new_cdp_session(page)
    for step in range(6):
        share, type_ = step / 5, "touchMove" if step else "touchStart"
        middle, half = (x + way * share * RIGHT, y + way * share * DOWN), 40 * (1 + share * (apart - 1))
        points = [{"x": middle[0] + side * half, "y": middle[1], "id": side + 1} for side in (-1, 1)]
        session.send("Input.dispatchTouchEvent", {"type": type_, "touchPoints": points})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def test_the_surface_follows_the_pointer_pixel_by_pixel(shown: Page) -> None:
    *_, height = stage_of(shown)
    pixel = 2 * 3 * np.linalg.norm(CENTRE) * np.tan(np.radians(15)) / height
    kept, before, way = query_of(shown), surface_of(shown), 1
    for hand in ("middle", "Control", "Alt", "fingers"):
        pull(shown, hand, way)
        assert kept.items() <= query_of(shown).items(), f"nothing but the target has changed: {hand}"
        after = surface_of(shown)
        level = np.abs((before - CENTRE) @ OUT) < 0.5  # as deep as the target, or nearly so
        moved = np.roll(before, (way * DOWN, way * RIGHT), (0, 1)) - after
        error = np.linalg.norm(moved[np.roll(level, (way * DOWN, way * RIGHT), (0, 1))], axis=1)
        assert np.nanmedian(error) < 1.5 * pixel, hand
        before, way = after, -way


def test_two_fingers_move_and_zoom_at_once(shown: Page) -> None:
    drag_fingers(shown, *middle(shown.locator("#stage")), 1, apart=2.0)
    view = query_of(shown)
    assert float(view["distance"]) == pytest.approx(1.5, rel=0.01)
    assert "target" in view and view["azimuth"] == "25"


def test_keys_move_the_picture_and_reset_brings_it_back(shown: Page) -> None:
    shown.focus("#stage")
    shown.keyboard.press("d")
    right = np.array([-np.sin(np.radians(25)), np.cos(np.radians(25)), 0.0])
    moved = np.subtract(target_of(shown), CENTRE)
    assert moved @ right < 0 and np.cross(moved, right) == pytest.approx(0, abs=1e-3)
    shown.keyboard.press("a")
    assert target_of(shown) == pytest.approx(CENTRE, abs=1e-3)
    shown.keyboard.press("w")
    assert target_of(shown)[2] < CENTRE[2]
    shown.keyboard.press("s")
    assert target_of(shown) == pytest.approx(CENTRE, abs=1e-3)
    shown.keyboard.press("0")
    *_, width, height = stage_of(shown)
    asked = {"width": width, "height": height}
    fit = shown.request.get(urljoin(shown.url, "/v1/scenes/small/fit"), params=asked).json()
    assert target_of(shown) == pytest.approx(fit["target"], abs=1e-3)


def test_a_double_click_brings_the_surface_to_the_middle(shown: Page) -> None:
    left, top, width, height = stage_of(shown)
    before = surface_of(shown)
    row, column = height // 2 + 30, width // 2 - 60
    assert np.isfinite(before[row, column]).all()
    shown.mouse.dblclick(left + column + 0.5, top + row + 0.5)
    shown.wait_for_url(lambda url: "target=" in url)
    target = target_of(shown)
    assert np.linalg.norm(np.subtract(target, before[row, column])) < 0.2
    with shown.expect_response("**/frame?*"):
        shown.mouse.dblclick(left + 3, top + 3)
    assert target_of(shown) == target, "there is no surface in the corner"


def test_axis_views_keep_distance_and_target(shown: Page) -> None:
    shown.focus("#stage")
    shown.keyboard.press("d")
    kept = {name: value for name, value in query_of(shown).items() if name not in ("azimuth", "elevation")}
    for name, axis in AXES.items():
        for sign, word, key in ((1, "plus", name), (-1, "minus", f"Shift+{name.upper()}")):
            button = shown.get_by_role("button", name=f"From {word} {name}", exact=True)
            expect(button).to_have_attribute("aria-pressed", "false")
            button.click()
            clicked = query_of(shown)
            expect(button).to_have_attribute("aria-pressed", "true")
            assert np.nanmean(surface_of(shown) - CENTRE, axis=(0, 1)) @ axis * sign > 0.5
            shown.focus("#stage")
            shown.keyboard.press("ArrowLeft")
            shown.keyboard.press(key)
            assert query_of(shown) == clicked
            assert {name: value for name, value in clicked.items() if name not in ("azimuth", "elevation")} == kept
