"""Cutting away on the page: by sliders, with light coming in or not, kept in the address, and shown whole again."""

import re

import numpy as np
from playwright.sync_api import Page, expect

from tests.web.visits import BROWSER, drag, middle, open_final, pixels, query_of, slide, wait_final

pytestmark = BROWSER


def unfold(page: Page) -> None:
    page.click("#cuts summary")


def test_a_slider_cuts_and_light_comes_in(page: Page, live_server: str) -> None:
    whole = pixels(open_final(page, live_server))
    unfold(page)
    slide(page, "cut-x-to", 0.5)
    cut = pixels(wait_final(page))
    assert "cut=x%3E11.5" in page.url
    assert np.abs(cut - whole).mean() > 2.0
    page.uncheck("#opened")
    dark = pixels(wait_final(page))
    assert "window=x%3E11.5" in page.url
    assert np.abs(dark - cut).mean() > 0.5
    page.click("#uncut")
    again = pixels(wait_final(page))
    assert "window" not in page.url and "cut" not in page.url
    assert np.abs(again - whole).mean() < 0.5


def test_a_link_opens_with_its_cut(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?cut=x%3E11.5%3Bz%3C2")
    expect(page.locator("#cuts")).to_have_attribute("open", "")
    expect(page.locator("output[for=cut-x-to]")).to_have_text("11.5")
    expect(page.locator("output[for=cut-z-from]")).to_have_text("2")
    page.goto(f"{live_server}/?cut=wall")
    expect(page.locator("#notice")).to_have_text("“wall” is no cut: it is planes such as x>40.")


def test_a_slider_is_moved_by_keys_alone(page: Page, live_server: str) -> None:
    open_final(page, live_server)
    unfold(page)
    page.focus("#cut-y-from")
    page.keyboard.press("PageUp")
    expect(page.locator("#uncut")).to_be_enabled()
    wait_final(page)
    assert "cut=y%3C" in page.url


def test_handles_in_the_picture_move_planes(page: Page, live_server: str) -> None:
    open_final(page, live_server)
    page.keyboard.press("c")
    (ax, ay), (bx, by) = (middle(page.get_by_label(f"Cut, x {end}")) for end in ("from", "to"))
    drag(page, (bx, by), 0.3 * (ax - bx), 0.3 * (ay - by))
    expect(page.locator("#uncut")).to_be_enabled()
    turn = float(page.input_value("#azimuth"))
    page.keyboard.press("ArrowLeft")
    assert float(page.input_value("#azimuth")) == turn + 5.0, "after a drag arrows turn the object"
    page.get_by_label("Cut, y from").focus()
    page.keyboard.press("PageUp")
    page.click("#add-plane")
    wait_final(page)
    query = query_of(page)
    assert re.fullmatch(r"x>\d+(\.\d+)?;y<\d+(\.\d+)?|y<\d+(\.\d+)?;x>\d+(\.\d+)?", query["cut"]), query
    assert query["window"].count(",") == 2, "a plane that faces the viewer"
    page.locator("#oblique").get_by_role("button", name="Remove").click()
    expect(page.locator(".handle")).to_have_count(6)
