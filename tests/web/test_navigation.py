"""Moving the picture, points that a person clicks, and marks that stay where they are as the camera
turns.
"""

from urllib.parse import urljoin

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from isogi_core.model.view import orbit
from tests.web.visits import (
    BROWSER,
    box_of,
    click,
    drag,
    fact,
    middle,
    open_shown,
    position,
    query_of,
    stage_of,
    surface_of,
    written,
)

pytestmark = BROWSER


ADDRESS = "?shading=lambert&azimuth=25&elevation=15&distance=3"
AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
CENTRE = (11.5, 9.5, 7.5)
OUT = np.array(orbit((0.0, 0.0, 0.0), 1.0, 25.0, 15.0, 1.0, 30.0).eye)
RIGHT = 70
DOWN = -40  # pixels of a drag


@pytest.fixture
def shown(page: Page, live_server: str) -> Page:
    """The page with a picture, at a view that is none of the sides."""
    return open_shown(page, f"{live_server}/{ADDRESS}")


def target_of(page: Page) -> list[float]:
    return [float(x) for x in query_of(page)["target"].split(",")]


def pull(page: Page, hand: str, way: int) -> None:
    """Drag the picture, by the middle button, two fingers, or the left button while a key is
    held.
    """
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
    """Two fingers, 80 pixels from each other, that move and end up ``apart`` times as far from each
    other.
    """
    session = page.context.new_cdp_session(page)
    for step in range(6):
        share = step / 5
        type_ = "touchMove" if step else "touchStart"
        middle = (x + way * share * RIGHT, y + way * share * DOWN)
        half = 40 * (1 + share * (apart - 1))
        points = [
            {"x": middle[0] + side * half, "y": middle[1], "id": side + 1} for side in (-1, 1)
        ]
        session.send("Input.dispatchTouchEvent", {"type": type_, "touchPoints": points})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def test_the_surface_follows_the_pointer_pixel_by_pixel(shown: Page) -> None:
    *_, height = stage_of(shown)
    pixel = 2 * 3 * np.linalg.norm(CENTRE) * np.tan(np.radians(15)) / height
    kept = query_of(shown)
    before = surface_of(shown)
    way = 1
    for hand in ("middle", "Control", "Alt", "fingers"):
        pull(shown, hand, way)
        assert kept.items() <= query_of(shown).items(), (
            f"nothing but the target has changed: {hand}"
        )
        after = surface_of(shown)
        level = np.abs((before - CENTRE) @ OUT) < 0.5  # as deep as the target, or nearly so
        moved = np.roll(before, (way * DOWN, way * RIGHT), (0, 1)) - after
        error = np.linalg.norm(moved[np.roll(level, (way * DOWN, way * RIGHT), (0, 1))], axis=1)
        assert np.nanmedian(error) < 1.5 * pixel, hand
        before = after
        way = -way


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
    row = height // 2 + 30
    column = width // 2 - 60
    assert np.isfinite(before[row, column]).all()
    shown.mouse.dblclick(left + column + 0.5, top + row + 0.5)
    shown.wait_for_url(lambda url: "target=" in url)
    target = target_of(shown)
    assert np.linalg.norm(np.subtract(target, before[row, column])) < 0.2
    with shown.expect_response("**/frame?*"):
        shown.mouse.dblclick(left + 3, top + 3)
    assert target_of(shown) == target, "there is no surface in the corner"


@pytest.mark.long
def test_axis_views_keep_distance_and_target(shown: Page) -> None:
    shown.focus("#stage")
    shown.keyboard.press("d")
    kept = {
        name: value
        for name, value in query_of(shown).items()
        if name not in ("azimuth", "elevation")
    }
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
            assert {
                name: value
                for name, value in clicked.items()
                if name not in ("azimuth", "elevation")
            } == kept


def mark(page: Page) -> tuple[float, float]:
    """Column and row of the mark."""
    node = page.locator("#marks circle")
    return float(node.get_attribute("cx") or "nan"), float(node.get_attribute("cy") or "nan")


def nearest(points: np.ndarray, position: list[float]) -> tuple[int, int, float]:
    """Column and row of the pixel that shows what is nearest to a position, and how near that
    is.
    """
    away = np.nan_to_num(np.linalg.norm(points - position, axis=-1), nan=np.inf)
    row, column = np.unravel_index(np.argmin(away), away.shape)
    return int(column), int(row), float(away.min())


@pytest.mark.journey
def test_a_click_tells_the_point_under_it(shown: Page) -> None:
    points = surface_of(shown)
    *_, width, height = stage_of(shown)
    for column, row in ((width // 2, height // 2), (width // 2 - 60, height // 2 + 30)):
        click(shown, column, row)
        expect(shown.locator("#point")).to_be_visible()
        wanted = points[row, column]
        for _ in range(100):  # until the card has the answer to this click
            if position(shown) == pytest.approx(wanted, abs=0.02):
                break
            shown.wait_for_timeout(100)
        assert position(shown) == pytest.approx(wanted, abs=0.02)
        assert mark(shown) == pytest.approx((column + 0.5, row + 0.5), abs=0.6)
        assert fact(shown, "Value") == "0.5"
        assert len(fact(shown, "Normal").split(",")) == 3 and "linear, #" in fact(shown, "Light")


def test_the_mark_stays_on_its_point_as_the_camera_turns(shown: Page) -> None:
    *_, width, height = stage_of(shown)
    click(shown, width // 2 + 20, height // 2 - 10)
    expect(shown.locator("#marks circle")).to_be_visible()
    point = position(shown)
    shown.focus("#stage")
    for key in ("ArrowLeft", "ArrowLeft", "ArrowUp", "+", "d"):
        shown.keyboard.press(key)
    column, row, away = nearest(surface_of(shown), point)
    assert away < 0.1
    assert mark(shown) == pytest.approx((column + 0.5, row + 0.5), abs=2.0)
    assert position(shown) == point


def test_the_mark_hides_behind_the_surface_and_comes_back(shown: Page) -> None:
    *_, width, height = stage_of(shown)
    click(shown, width // 2, height // 2)
    expect(shown.locator("#marks circle")).to_be_visible()
    shown.focus("#stage")
    shown.keyboard.press("Shift+X")
    expect(shown.locator("#marks circle")).to_have_count(0)
    expect(shown.locator("#point .note")).to_have_text("Behind the surface from here")
    shown.keyboard.press("x")
    expect(shown.locator("#marks circle")).to_have_count(1)
    expect(shown.locator("#point .note")).to_be_empty()


def test_the_card_goes_when_it_is_not_wanted(shown: Page) -> None:
    *_, width, height = stage_of(shown)
    card = shown.locator("#point")
    for leave in (
        lambda: shown.keyboard.press("Escape"),
        lambda: click(shown, 3, 3),
        lambda: shown.click("#point .close"),
        lambda: shown.keyboard.press("]"),
    ):
        shown.focus("#stage")
        shown.keyboard.press("p")
        expect(card).to_be_visible()
        assert mark(shown) == pytest.approx((width / 2, height / 2), abs=1.0)
        leave()
        expect(card).to_be_hidden()
        expect(shown.locator("#marks circle")).to_have_count(0)


def test_a_press_that_leaves_the_card_spoils_no_click(shown: Page) -> None:
    left, top, width, height = stage_of(shown)
    click(shown, width // 2, height // 2)
    expect(shown.locator("#point")).to_be_visible()
    card = box_of(shown.locator("#point"))
    x, y = card["x"] + 20, card["y"] + 20
    drag(shown, (x, y), left + width / 2 - x, top + height + 60 - y)
    before = shown.locator("#marks circle").get_attribute("cx") or ""
    click(shown, width // 2 - 60, height // 2 + 30)
    expect(shown.locator("#marks circle")).not_to_have_attribute("cx", before)
    assert mark(shown) == pytest.approx((width // 2 - 59.5, height // 2 + 30.5), abs=1.0)


def test_a_drag_is_no_click_and_neither_is_shift(shown: Page) -> None:
    left, top, width, height = stage_of(shown)
    x, y = left + width / 2, top + height / 2
    shown.mouse.move(x, y)
    shown.mouse.down()
    shown.mouse.move(x + 30, y, steps=3)
    shown.mouse.move(x, y, steps=3)
    shown.mouse.up()
    shown.keyboard.down("Shift")
    shown.mouse.click(x, y)
    shown.keyboard.up("Shift")
    shown.mouse.click(x, y, button="right")
    shown.wait_for_timeout(500)
    expect(shown.locator("#point")).to_be_hidden()


def measured(page: Page) -> list[str]:
    """The measures in the list."""
    return [
        text.replace("×", "").strip() for text in page.locator("#measures li").all_inner_texts()
    ]


def in_voxels(text: str) -> float:
    assert text.startswith("Distance ") and text.endswith(" voxels")
    return float(text.split()[1])


def test_two_points_give_a_distance_and_three_an_angle(shown: Page) -> None:
    points = surface_of(shown)
    *_, width, height = stage_of(shown)
    places = [
        (width // 2 + 60, height // 2),
        (width // 2 - 70, height // 2 + 10),
        (width // 2, height // 2 - 40),
    ]
    a, b, c = (points[row, column] for column, row in places)
    click(shown, *places[0])
    shown.click("#point-measure")
    expect(shown.locator("#point")).to_be_hidden()
    expect(shown.locator("#measuring")).to_contain_text("second point")
    click(shown, *places[1])
    expect(shown.locator("#measures li")).to_have_count(1)
    assert in_voxels(measured(shown)[0]) == pytest.approx(np.linalg.norm(a - b), abs=0.1)
    click(shown, *places[2])
    expect(shown.locator("#measuring")).to_be_hidden()
    u, v = a - b, c - b
    angle = np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v)))
    assert [
        float(text.removeprefix("Angle ").rstrip("°")) for text in measured(shown)
    ] == pytest.approx([angle], abs=1.0)
    assert shown.locator("#marks text").inner_html() == measured(shown)[0].removeprefix("Angle ")


def test_measures_live_in_the_address_until_they_are_removed(shown: Page) -> None:
    *_, width, height = stage_of(shown)
    shown.focus("#stage")
    for column in (width // 2 - 40, width // 2 + 40):
        shown.keyboard.press("m")
        click(shown, column, height // 2)
        expect(shown.locator("#measuring")).to_contain_text("second point")
        shown.keyboard.press("p")
        expect(shown.locator("#measuring")).to_contain_text("third point")
        shown.keyboard.press("Escape")
        expect(shown.locator("#measuring")).to_be_hidden()
    before = measured(shown)
    assert len(before) == 2
    written(shown)
    shown.reload()
    expect(shown.locator("#measures li")).to_have_count(2)
    assert measured(shown) == before
    expect(shown.locator("#marks text")).to_have_count(2)
    shown.get_by_role("button", name="Remove").first.click()
    assert measured(shown) == before[1:]
    shown.get_by_role("button", name="Remove").first.click()
    expect(shown.locator("#measures")).to_be_hidden()
    expect(shown.locator("#marks > *")).to_have_count(0)
    assert "measure" not in written(shown)


def test_lines_end_on_their_points_as_the_camera_turns(shown: Page) -> None:
    a, b = (16.0, 9.5, 11.5), (8.0, 9.5, 11.5)
    open_shown(shown, f"{shown.url}&measure={','.join(map(str, a))};{','.join(map(str, b))}")
    shown.focus("#stage")
    shown.keyboard.press("ArrowLeft")
    shown.keyboard.press("z")
    *_, width, height = stage_of(shown)
    line = shown.locator("#marks polyline.line").get_attribute("points") or ""
    ends = [tuple(map(float, end.split(","))) for end in line.split()]
    eye = np.array(CENTRE) + 3 * np.linalg.norm(CENTRE) * np.array([0, 0, 1])
    for point, end in zip((a, b), ends, strict=True):  # from above, x goes to the right and y up
        right, up, out = np.subtract(point, eye)
        scale = height / (2 * -out * np.tan(np.radians(15)))
        assert end == pytest.approx((width / 2 + right * scale, height / 2 - up * scale), abs=0.5)
    expect(shown.locator("#marks polyline.line.hidden")).to_have_count(0)
    shown.keyboard.press("Shift+Z")
    expect(shown.locator("#marks polyline.line.hidden")).to_have_count(1)


def test_scale_and_axes_are_switched_by_a_key(shown: Page) -> None:
    rulers = shown.locator("#rulers")
    expect(rulers.locator("text")).to_have_count(5)
    expect(rulers).to_contain_text("voxels")
    line = rulers.locator("polyline.line").last.get_attribute("points") or ""
    (left, _), (right, _) = (map(float, place.split(",")) for place in line.split()[1:3])
    *_, height = stage_of(shown)
    pixel = 2 * 3 * np.linalg.norm(CENTRE) * np.tan(np.radians(15)) / height
    words = rulers.locator("text").nth(3).inner_html()
    assert (right - left) * pixel == pytest.approx(float(words.removesuffix(" voxels")), rel=1e-3)
    shown.focus("#stage")
    shown.keyboard.press("r")
    expect(rulers).to_be_hidden()
    assert "rulers=off" in written(shown)
    shown.keyboard.press("r")
    expect(rulers.locator("text")).to_have_count(5)


def test_marks_hold_under_parallel_rays(shown: Page) -> None:
    shown.eval_on_selector("#camera", "details => { details.open = true; }")
    shown.select_option("#projection", "orthographic")
    shown.evaluate("scrollTo(0, 0)")  # where the stage begins at a whole pixel
    points = surface_of(shown)
    assert "projection=orthographic" in shown.url
    *_, width, height = stage_of(shown)
    column = width // 2 - 50
    row = height // 2 + 25
    click(shown, column, row)
    expect(shown.locator("#marks circle")).to_be_visible()
    point = position(shown)
    assert point == pytest.approx(points[row, column], abs=0.02)
    assert "depth" not in shown.locator("#rulers").inner_html()
    shown.focus("#stage")
    for key in ("ArrowLeft", "ArrowUp", "d"):
        shown.keyboard.press(key)
    column, row, away = nearest(surface_of(shown), point)
    assert away < 0.1
    assert mark(shown) == pytest.approx((column + 0.5, row + 0.5), abs=2.0)
    shown.keyboard.press("Shift+X")
    expect(shown.locator("#marks circle")).to_have_count(0)


def test_a_tap_on_a_phone_docks_the_card_away_from_it(browser: Browser, live_server: str) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    page = context.new_page()
    open_shown(page, f"{live_server}/{ADDRESS}")
    left, top, width, height = stage_of(page)
    page.touchscreen.tap(left + width / 2, top + 0.45 * height)
    expect(page.locator("#point")).to_be_visible()
    card = box_of(page.locator("#point"))
    assert card["x"] >= left and card["x"] + card["width"] <= left + width
    assert top + 0.45 * height < card["y"] and card["y"] + card["height"] <= top + height
    page.locator("#point .close").tap()
    page.touchscreen.tap(left + width / 2, top + 0.65 * height)
    expect(page.locator("#point[data-low]")).to_be_visible()
    card = box_of(page.locator("#point"))
    assert top <= card["y"] and card["y"] + card["height"] < top + 0.65 * height
    context.close()
