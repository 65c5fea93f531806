"""Area and volume on the page: of the surface that the controls ask for, and none while it is measured."""

import re

import httpx
from playwright.sync_api import Page, expect

from tests.web.visits import BROWSER, open_final, shoot, slide

pytestmark = BROWSER


def rows(page: Page) -> dict[str, str]:
    """What is told of the size, by its names."""
    names, texts = (page.locator(f"#size {tag}").all_inner_texts() for tag in ("dt", "dd"))
    return dict(zip(names, texts, strict=True))


def test_area_and_volume_are_those_of_the_surface(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?shading=lambert&isovalue=0.4")
    asked: list[str] = []
    page.on("request", lambda request: "/size?" in request.url and asked.append(request.url))
    page.click("#size summary")
    expect(page.locator("#size dd").first).to_have_text(re.compile(r"^[\d.]+ ± [\d.]+ voxel²$"))
    before = rows(page)
    known = httpx.get(f"{live_server}/v1/scenes/small/size", params={"isovalue": 0.4}, timeout=60).json()
    for name in ("area", "volume"):
        value, error = (float(text) for text in re.findall(r"[\d.]+", before[name.capitalize()])[:2])
        assert abs(value - known[name]) < 0.1 * error
        assert abs(error / known[f"{name}_error"] - 1) < 0.06, "of two digits"
    expect(page.locator("#size .note")).to_contain_text("Of the whole surface")
    page.locator("#size").scroll_into_view_if_needed()
    shoot(page, "size")
    slide(page, "isovalue", 0.6)
    assert rows(page) == {} and page.inner_text("#size .note") == "Measuring…"
    expect(page.locator("#size dd")).to_have_count(2)
    assert rows(page) != before
    count = len(asked)
    slide(page, "azimuth", 0.6)
    page.click("#size summary")
    slide(page, "isovalue", 0.3)
    page.wait_for_timeout(600)
    assert len(asked) == count == 2, "none for another camera, and none while it is folded"


def test_a_server_that_is_away_is_asked_again(page: Page, live_server: str) -> None:
    page.route("**/size?*", lambda route: route.abort())
    open_final(page, f"{live_server}/?shading=lambert").click("#size summary")
    expect(page.locator("#size .note")).to_contain_text("The page keeps asking")
    assert rows(page) == {}
    page.unroute("**/size?*")
    expect(page.locator("#size dd")).to_have_count(2)
