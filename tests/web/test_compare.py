"""Parts of the picture: two shadings side by side, and what cuts take away."""

import re
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.server.uploads.site import Site
from tests.web.visits import (
    BROWSER,
    FINAL_MS,
    drag,
    middle,
    open_final,
    open_shown,
    pixels,
    query_of,
    slide,
    stage_of,
    wait_final,
    written,
)

pytestmark = BROWSER


SHADING = "lambert"
OTHER = "lambert_fog"
"""Two that are final without any light."""

WATCH = """() => {
  const comparison = document.querySelector("#comparison");
  const other = document.querySelector("#other");
  window.seen = [];
  const right = comparison.querySelector(".right");
  const note = () => seen.push([comparison.dataset.state, other.hidden, right.textContent]);
  const watched = { attributes: true, attributeFilter: ["data-state"] };
  new MutationObserver(note).observe(comparison, watched);
}"""
"""Notes the right side's state, whether it is hidden, and its words, each time that its state
changes.
"""


@pytest.fixture
def compared(page: Page, live_server: str) -> Page:
    """Diffuse shading beside depth fog, both sides final."""
    return both_final(open_final(page, f"{live_server}/?shading={SHADING}&compare={OTHER}"))


def both_final(page: Page) -> Page:
    wait_final(page).wait_for_selector("#comparison[data-state=final]", timeout=FINAL_MS)
    return page


def test_each_side_shows_its_shading_and_they_change_places(compared: Page) -> None:
    left = pixels(compared)
    right = pixels(compared, "#other")
    assert np.abs(left - right).mean() > 0.3
    assert compared.locator(".side").all_inner_texts() == [
        "Diffuse, no shadows",
        "Diffuse, depth fog",
    ]
    compared.select_option("#shading", OTHER)
    both_final(compared)
    assert compared.input_value("#compare") == SHADING
    assert np.array_equal(pixels(compared), right)
    assert np.array_equal(pixels(compared, "#other"), left)


def test_another_isovalue_is_the_picture_of_it_alone(page: Page, live_server: str) -> None:
    """Byte for byte, before and after both sides are turned."""
    start = f"{live_server}/?shading={SHADING}"
    page.goto(start)
    page.select_option("#compare", "isovalue")
    at = page.locator("#compare-number")
    at.evaluate("(input) => { input.value = 0.75; input.dispatchEvent(new Event('change')); }")
    both_final(page)
    assert page.locator(".side").all_inner_texts() == ["isovalue 0.5", "isovalue 0.75"]
    x, y = middle(page.locator("#stage"))
    drag(page, (x - 100, y), -60, 0)
    both_final(page)
    right = pixels(page, "#other")
    address = written(page)
    assert "compare=isovalue%3A0.75" in address
    alone = address.replace("isovalue=0.5", "isovalue=0.75").replace("&compare=isovalue%3A0.75", "")
    open_final(page, alone)
    assert np.array_equal(pixels(page), right)
    page.goto(address)
    both_final(page)
    assert np.array_equal(pixels(page, "#other"), right)


def test_another_scene_turns_along(page: Page, site: Site) -> None:
    """A volume that was uploaded lies beside the server's."""
    kept = site.send(12)
    other = kept["id"]
    open_shown(page, str(site.client.base_url) + f"/?shading={SHADING}&compare=scene:{other}")
    both_final(page)
    before = pixels(page, "#other")
    x, y = middle(page.locator("#stage"))
    with page.expect_request(lambda asked: f"/{other}/frame" in asked.url) as asked:
        drag(page, (x - 100, y), -60, 0)
    both_final(page)
    right = dict(parse_qsl(urlsplit(asked.value.url).query))
    assert float(right["azimuth"]) == float(query_of(page)["azimuth"])
    assert np.abs(pixels(page, "#other") - before).mean() > 0.3
    page.goto(f"{site.client.base_url}/?compare=scene:nothing")
    expect(page.locator("#notice")).to_contain_text("no scene “nothing” to compare with")
    expect(page.locator("#comparison")).to_be_hidden()
    page.goto("about:blank")  # a page that asks on for what is deleted complains
    site.client.delete(kept["href"])


def test_while_the_view_moves_the_right_side_shows_nothing_old(compared: Page) -> None:
    before = pixels(compared, "#other")
    compared.evaluate(WATCH)
    x, y = middle(compared.locator("#stage"))
    drag(compared, (x - 100, y), -60, 0)
    both_final(compared)
    expect(compared.locator("#other")).to_be_visible()
    seen = compared.evaluate("seen")
    assert ["moving", True, "Diffuse, depth fog · when the view rests"] in seen
    assert all(hidden for state, hidden, _ in seen if state in ("moving", "coming"))
    assert np.abs(pixels(compared, "#other") - before).mean() > 0.3


def test_the_divider_is_moved_by_hand_and_by_keys(compared: Page) -> None:
    address = compared.url
    divider = compared.locator("#divider")
    (left, _, width, _) = stage_of(compared)
    drag(compared, middle(divider), left + 0.25 * width - middle(divider)[0], 60)
    expect(divider).to_have_attribute("aria-valuenow", re.compile(r"^(24|25)(\.\d)?$"))
    assert middle(divider)[0] == pytest.approx(left + 0.25 * width, abs=2)
    divider.focus()
    for key, place in (
        ("Home", 0),
        ("ArrowRight", 2),
        ("PageUp", 12),
        ("Shift+ArrowLeft", 2),
        ("End", 100),
    ):
        compared.keyboard.press(key)
        expect(divider).to_have_attribute("aria-valuenow", str(place))
    expect(divider).to_have_attribute(
        "aria-valuetext", "100 % Diffuse, no shadows, 0 % Diffuse, depth fog"
    )
    assert written(compared) == address, "the object did not turn"


def test_the_address_holds_what_is_compared(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?shading={SHADING}&compare=nonsense")
    expect(page.locator("#comparison")).to_be_hidden()
    page.select_option("#compare", "phong")
    assert written(page).endswith("compare=phong")
    hidden = page.eval_on_selector_all(
        "#compare option", "all => all.filter(o => o.disabled).map(o => o.value)"
    )
    assert hidden == [SHADING]


def test_the_right_side_says_that_it_is_lost_and_comes_back(page: Page, live_server: str) -> None:
    page.route("**/frame?*", lambda route: route.abort())
    open_final(page, f"{live_server}/?shading={SHADING}&compare={OTHER}")
    expect(page.locator(".side.right")).to_have_text("Diffuse, depth fog · not up to date")
    expect(page.locator("#other")).to_be_hidden()
    page.unroute("**/frame?*")
    both_final(page)
    expect(page.locator(".side.right")).to_have_text("Diffuse, depth fog")


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


@pytest.mark.long
def test_a_slider_is_moved_by_keys_alone(page: Page, live_server: str) -> None:
    open_final(page, live_server)
    unfold(page)
    page.focus("#cut-y-from")
    page.keyboard.press("PageUp")
    expect(page.locator("#uncut")).to_be_enabled()
    wait_final(page)
    assert "cut=y%3C" in page.url


@pytest.mark.long
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
    assert re.fullmatch(r"x>\d+(\.\d+)?;y<\d+(\.\d+)?|y<\d+(\.\d+)?;x>\d+(\.\d+)?", query["cut"]), (
        query
    )
    assert query["window"].count(",") == 2, "a plane that faces the viewer"
    page.locator("#oblique").get_by_role("button", name="Remove").click()
    expect(page.locator(".handle")).to_have_count(6)
