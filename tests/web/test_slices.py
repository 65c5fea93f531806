"""Slices beside the picture: what a cut takes away is hatched in them, and their lines move its planes."""

import io
from urllib.parse import parse_qs, parse_qsl, urlsplit

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, FloatRect, Locator, Page, expect

from tests.web.visits import BROWSER, SHOTS, click, findings, position, stage_of, written

ADDRESS = "?shading=lambert&azimuth=25&elevation=15&distance=3"
SIZE = (24, 20, 16)

pytestmark = BROWSER


def sliced(page: Page, address: str) -> Page:
    """The page with slices through a point of its picture, for which nothing is baked."""
    page.goto(address)
    page.wait_for_selector("#picture:not([hidden])")
    *_, width, height = stage_of(page)
    click(page, width // 2 + 20, height // 2 - 10)
    page.click("#slices summary")
    expect(page.locator("#slices img")).to_have_count(3)
    for number in range(3):
        expect(page.locator("#slices img").nth(number)).not_to_have_js_property("naturalWidth", 0)
    return page


def figure(page: Page, axis: str) -> Locator:
    return page.locator("#slices figure").nth("zyx".index(axis))


def line(page: Page, axis: str, plane: str) -> Locator:
    """The line of a plane in a slice."""
    return figure(page, axis).get_by_role("slider", name=f"Cut, {plane}")


def box_of(locator: Locator) -> FloatRect:
    box = locator.bounding_box()
    assert box is not None
    return box


def middle(locator: Locator) -> tuple[float, float]:
    box = box_of(locator)
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def share(line: Locator) -> float:
    """How far to the right a line is, in shares of its slice."""
    return float((line.locator(".line").get_attribute("x1") or "").removesuffix("%")) / 100


def cut_of(page: Page) -> str:
    return parse_qs(urlsplit(written(page)).query).get("cut", [""])[0]


def grey(locator: Locator) -> np.ndarray:
    """What is on the screen there."""
    return np.asarray(Image.open(io.BytesIO(locator.screenshot())).convert("L"), float)


def test_slices_go_through_the_point_once_they_are_wanted(page: Page, live_server: str) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if "/slice?" in request.url else None)
    page.goto(f"{live_server}/{ADDRESS}")
    page.wait_for_selector("#picture:not([hidden])")
    *_, width, height = stage_of(page)
    click(page, width // 2 + 20, height // 2 - 10)
    expect(page.locator("#point")).to_be_visible()
    assert asked == []
    page.click("#slices summary")
    expect(page.locator("#slices img")).to_have_count(3)
    for number, (wide, high) in enumerate([(24, 20), (24, 16), (20, 16)]):
        expect(page.locator("#slices img").nth(number)).to_have_js_property("naturalWidth", wide)
        expect(page.locator("#slices img").nth(number)).to_have_js_property("naturalHeight", high)
    queries = [dict(parse_qsl(urlsplit(url).query)) for url in asked]
    at = {query["axis"]: float(query["at"]) for query in queries}
    assert [at[axis] for axis in "xyz"] == pytest.approx(position(page), abs=0.01), "this volume's spacing is 1"
    click(page, width // 2 + 60, height // 2)
    expect(page.locator("#slices figcaption span").first).not_to_have_text(f"z {round(at['z'], 1):g}")
    assert len(asked) == 6


def test_what_a_cut_takes_away_is_hatched(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}")
    whole = grey(figure(page, "z").locator("img"))
    assert cut_of(page) == ""
    page.eval_on_selector("#cuts", "details => { details.open = true; }")
    page.focus("#cut-y-to")
    page.keyboard.press("PageDown")
    y = float(cut_of(page).removeprefix("y>"))
    hatched = np.abs(grey(figure(page, "z").locator("img")) - whole)
    row = round(len(whole) * (1 - (y + 0.5) / SIZE[1]))
    assert hatched[3 : row - 3].mean() > 10
    assert np.median(hatched[row + 5 :]) < 1
    expect(line(page, "z", "y to")).to_be_visible()
    expect(line(page, "x", "y to")).to_be_visible()
    expect(line(page, "y", "y to")).to_be_hidden()
    expect(figure(page, "z").get_by_role("slider")).to_have_count(4)
    assert share(line(page, "x", "y to")) == pytest.approx((y + 0.5) / SIZE[1])
    page.click("#add-plane")
    expect(line(page, "z", "plane 1")).to_be_visible()


def test_a_line_is_dragged_and_the_cut_follows(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}&cut=x%3E14")
    dragged, other = line(page, "z", "x to"), line(page, "y", "x to")
    assert share(dragged) == share(other) == pytest.approx(14.5 / SIZE[0])
    (x, y), width = middle(dragged), box_of(figure(page, "z").locator("img"))["width"]
    page.mouse.move(x, y - 20)
    page.mouse.down()
    page.mouse.move(x - width / 4, y - 15, steps=4)
    assert share(other) == pytest.approx(8.5 / SIZE[0], abs=0.01), "while it is held"
    page.mouse.up()
    assert float(cut_of(page).removeprefix("x>")) == pytest.approx(8, abs=0.2)
    expect(page.locator("#point")).to_be_visible()
    page.mouse.move(x, y)
    assert float(cut_of(page).removeprefix("x>")) == pytest.approx(8, abs=0.2), "it was let go"


def test_keys_move_lines_as_arrows_point(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}&cut=x%3E14")
    turned = urlsplit(written(page)).query.split("azimuth=")[1].split("&")[0]
    line(page, "z", "x to").focus()
    page.keyboard.press("ArrowLeft")
    assert cut_of(page) == "x>13.8"
    page.keyboard.press("PageUp")
    assert cut_of(page) == "x>15.8"
    line(page, "y", "z from").focus()
    page.keyboard.press("ArrowUp")
    assert cut_of(page) == "x>15.8;z<0.1"
    page.keyboard.press("Home")
    assert cut_of(page) == "x>15.8"
    assert f"azimuth={turned}&" in page.url, "arrows turn nothing there"


def test_cut_here_cuts_along_the_slice_on_the_near_side(page: Page, live_server: str) -> None:
    sliced(page, f"{live_server}/{ADDRESS}")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if "/slice?" in request.url else None)
    x, y, z = position(page)
    for axis, at in (("y", y), ("z", z)):  # the eye is at plus x, y and z
        figure(page, axis).get_by_role("button", name="Cut here").click()
        taken, limit = cut_of(page).split(";")[-1].split(">")
        assert taken == axis and float(limit) == pytest.approx(at, abs=0.01)
    expect(page.locator("#cuts")).to_have_attribute("open", "")
    expect(page.locator("#slices img")).to_have_count(3)
    assert share(line(page, "x", "y to")) == pytest.approx((y + 0.5) / SIZE[1], abs=1e-3)
    assert findings(page) == []
    page.focus("#stage")
    page.keyboard.press("Shift+X")
    figure(page, "x").get_by_role("button", name="Cut here").click()
    sides = dict(term.split("<") for term in cut_of(page).split(";") if "<" in term)
    assert float(sides["x"]) == pytest.approx(x, abs=0.01), "now from the other side"
    assert asked == [], "slices stay at their point"


def test_a_finger_drags_a_line_on_a_phone(browser: Browser, live_server: str) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(f"{live_server}/{ADDRESS}&cut=x%3E14")
    page.wait_for_selector("#picture:not([hidden])")
    left, top, width, height = stage_of(page)
    page.touchscreen.tap(left + width / 2, top + 0.45 * height)
    page.locator("#slices summary").tap()
    expect(page.locator("#slices img")).to_have_count(3)
    stage, card = page.locator("#stage").bounding_box(), page.locator("#point").bounding_box()
    assert stage and card and card["x"] >= stage["x"] and card["x"] + card["width"] <= stage["x"] + stage["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    dragged = line(page, "z", "x to")
    dragged.scroll_into_view_if_needed()
    (x, y), wide = middle(dragged), box_of(figure(page, "z").locator("img"))["width"]
    session = context.new_cdp_session(page)
    for step in range(6):
        points = [{"x": x - step / 5 * wide / 4, "y": y + 4 * step, "id": 1}]
        session.send("Input.dispatchTouchEvent", {"type": "touchMove" if step else "touchStart", "touchPoints": points})
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    assert float(cut_of(page).removeprefix("x>")) == pytest.approx(8, abs=0.4)
    assert middle(line(page, "z", "x to"))[1] == pytest.approx(y, abs=1), "the card has not scrolled"
    page.screenshot(path=SHOTS / "slices-390.png")
    context.close()
