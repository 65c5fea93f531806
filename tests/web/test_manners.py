"""Manners of the page in a real browser: the way back, the whole screen, and what it says of what
cannot be shown.
"""

import re

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.web.visits import (
    BROWSER,
    VIEWPORTS,
    are_apart,
    box_of,
    open_final,
    pixels,
    slide,
    stage_of,
    wait_final,
)

pytestmark = BROWSER


@pytest.fixture
def sketched(steady: Page, live_server: str) -> Page:
    """The page with a shading for which nothing is baked."""
    steady.set_viewport_size({"width": 900, "height": 640})
    return open_final(steady, f"{live_server}/?shading=lambert")


def test_a_typed_isovalue_without_a_surface_is_told(sketched: Page) -> None:
    most = float(sketched.get_attribute("#isovalue", "max") or "nan")
    sketched.fill("#isovalue-number", "9999")
    sketched.press("#isovalue-number", "Enter")
    expect(sketched.locator("#notice")).to_have_text(re.compile("^No surface at 9999: .* to 0.8.$"))
    assert float(sketched.input_value("#isovalue")) == pytest.approx(most)
    sketched.fill("#isovalue-number", "0.5")
    sketched.press("#isovalue-number", "Enter")
    expect(sketched.locator("#notice")).to_be_hidden()


def test_back_and_forward_walk_through_views(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?shading=lambert")
    start = float(page.input_value("#azimuth"))
    for share in (0.2, 0.7):
        slide(page, "azimuth", share)
        slide(page, "azimuth", share + 0.05)
        page.wait_for_timeout(1300)  # a pause makes an entry
    assert float(page.input_value("#azimuth")) == 90.0
    for wanted in (-90.0, start):
        page.go_back()
        expect(page.locator("#azimuth")).to_have_js_property("valueAsNumber", wanted)
    page.go_forward()
    expect(page.locator("#azimuth")).to_have_js_property("valueAsNumber", -90)
    assert wait_final(page).locator("#trouble").is_hidden()


def test_a_view_that_was_lost_is_found_again(page: Page, live_server: str) -> None:
    """Reset, and a step back: the view is as it was."""
    open_final(page, f"{live_server}/?shading=lambert")
    for knob, share in (("azimuth", 0.25), ("elevation", 0.75)):
        slide(page, knob, share)
    page.wait_for_timeout(1300)
    lost = page.url
    page.click("#reset")
    page.wait_for_function("before => location.href !== before", arg=lost)
    page.go_back()
    expect(page.locator("#azimuth")).to_have_js_property("valueAsNumber", -90)
    expect(page.locator("#elevation")).to_have_js_property("valueAsNumber", 45)
    assert page.url == lost


def test_full_screen_and_back(sketched: Page) -> None:
    sketched.click("#full-screen")
    sketched.wait_for_function("document.fullscreenElement?.id === 'stage'")
    wait_final(sketched)
    sketched.keyboard.press("f")
    sketched.wait_for_function("document.fullscreenElement === null")


def test_a_picture_at_rest_has_the_screens_own_pixels(browser: Browser, live_server: str) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 700}, device_scale_factor=3)
    page = open_final(context.new_page(), f"{live_server}/?shading=lambert")
    whole = 3 * int(page.evaluate("document.querySelector('#stage').clientWidth"))
    page.wait_for_function(
        "width => document.querySelector('#picture').naturalWidth === width", arg=whole
    )
    page.focus("#stage")
    page.keyboard.press("ArrowLeft")
    page.wait_for_function(
        "width => document.querySelector('#picture').naturalWidth < width", arg=whole
    )
    page.wait_for_function(
        "width => document.querySelector('#picture').naturalWidth === width", arg=whole
    )
    context.close()


def test_drafts_lie_over_the_picture_until_the_view_rests(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?shading=lambert")
    left, top, width, height = stage_of(page)
    draft = page.locator("#draft")
    words = page.locator("#picture").get_attribute("alt") or ""
    expect(draft).to_be_hidden()
    page.mouse.move(left + width / 2, top + height / 2)
    page.mouse.down()
    for step in range(200):
        page.mouse.move(left + width / 2 + step % 100, top + height / 2)
        if draft.is_visible():
            break
    else:
        pytest.fail("no draft was shown")
    shape = "each => each.naturalWidth || each.width"
    assert 0 < draft.evaluate(shape) <= page.locator("#picture").evaluate(shape)
    assert pixels(page, "#draft").std() > 5.0, "it shows a surface"
    expect(page.locator("#picture")).not_to_have_attribute("alt", words)
    page.mouse.up()
    wait_final(page)
    expect(draft).to_be_hidden()


def test_a_picture_that_is_late_is_said_to_come(fresh: Page, live_server: str) -> None:
    fresh.route_web_socket("**/stream", lambda _: None)  # open, and silent
    fresh.goto(live_server)
    fresh.wait_for_selector("#stage[data-busy]:not([data-late])")
    fresh.wait_for_selector("#stage[data-late]")
    moves = "busy => getComputedStyle(busy).animationName"
    assert fresh.locator("#busy").evaluate(moves) == "busy"


def test_escape_closes_the_panel_of_saving_from_anywhere(sketched: Page) -> None:
    sketched.click("#save-button")
    sketched.focus("#stage")
    sketched.click("#help-button")
    sketched.keyboard.press("Escape")
    expect(sketched.locator("#help")).to_be_hidden()
    expect(sketched.locator("#save")).to_be_visible()
    sketched.keyboard.press("Escape")
    expect(sketched.locator("#save")).to_be_hidden()


@pytest.mark.parametrize(("width", "height"), VIEWPORTS)
def test_no_panel_covers_the_controls(sketched: Page, width: int, height: int) -> None:
    sketched.set_viewport_size({"width": width, "height": height})
    for name in ("save", "share"):
        sketched.click(f"#{name}-button")
        panel, controls = (box_of(sketched.locator(f"#{each}")) for each in (name, "controls"))
        assert (
            are_apart(panel, controls)
            and panel["x"] >= 0
            and panel["y"] + panel["height"] <= height
        ), name
        sketched.keyboard.press("Escape")


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (2560, 1440)])
def test_the_picture_uses_a_wide_screen(sketched: Page, width: int, height: int) -> None:
    sketched.set_viewport_size({"width": width, "height": height})
    *_, wide, high = stage_of(wait_final(sketched))
    assert wide >= width - 24 - 24 - 28 - 348 and high >= height - 140
    assert sketched.evaluate("document.documentElement.scrollWidth") <= width
    assert sketched.evaluate("document.querySelector('#picture').naturalWidth") == wide


def test_a_phone_has_room_for_long_lines_and_small_numbers(sketched: Page) -> None:
    sketched.set_viewport_size({"width": 390, "height": 844})
    long = "Refining, about 1.7 % error, not measured yet, longer than expected, about 15 s left"
    holds = """(line, text) => {
      const before = line.clientHeight;
      line.textContent = text;
      const cut = line.scrollWidth > line.clientWidth || line.scrollHeight > line.clientHeight;
      return !cut && line.clientHeight === before;
    }"""
    assert sketched.eval_on_selector("#status-line", holds, long), "all of it, and nothing moves"
    lines = "(end, text) => { end.textContent = text; return end.getClientRects().length; }"
    ends = ("#isovalue-min", "#isovalue-max")
    assert [sketched.eval_on_selector(end, lines, "1.66103e-11") for end in ends] == [1, 1]


@pytest.mark.parametrize(("width", "height"), [(1280, 620), (390, 844)])
def test_key_c_brings_its_section_into_sight(sketched: Page, width: int, height: int) -> None:
    sketched.set_viewport_size({"width": width, "height": height})
    sketched.focus("#stage")
    sketched.keyboard.press("c")
    summary = sketched.locator("#cuts summary")
    expect(summary).to_be_in_viewport(ratio=1)
    assert are_apart(box_of(summary), box_of(sketched.locator("#stage"))), (
        "the picture does not cover it"
    )
    sketched.keyboard.press("c")
    expect(sketched.locator("#cuts")).not_to_have_attribute("open", "")
