"""The card in a real page, over a real server: its picture of a view at rest, whatever the shading
or the colours, is the server's; a shader that draws another is found, and the page says so.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import nrrd
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from isogi_core.frame.card.obstacles import SHADINGS
from tests.live import serving
from tests.web.conftest import watched
from tests.web.visits import BROWSER, FINAL_MS, load_modules, wait_final

pytestmark = [BROWSER, pytest.mark.slow]

STAGE = 300
"""Width of the window in pixels, small as software draws it."""

ROUNDED = 8
"""Levels of 255 by which pixels of one colour may differ."""

EDGE = 12
"""Contrast to a neighbour, in levels, from which pixels are left out: both smooth edges, by other
samples.
"""

TURNS = 30
"""Small turns after which the card is ready at the latest."""

KEEP = """(async () => {
  window.readings = [];
  window.notices = [];
  document.addEventListener("DOMContentLoaded", () => {
    const notice = document.querySelector("#notice");
    const note = () => window.notices.push(notice.textContent);
    new MutationObserver(note).observe(notice, { childList: true });
  });
  const { Card } = await import("/web/card/card.js");
  const { read } = Card.prototype;
  Card.prototype.read = function () {
    const found = read.call(this);
    const { width, height } = this.canvas;
    const shown = document.querySelector("#picture");
    const paint = new OffscreenCanvas(width, height).getContext("2d");
    paint.drawImage(shown, 0, 0);
    const server = paint.getImageData(0, 0, width, height).data;
    const { shading } = this.last.view;
    window.readings.push({ shading, width, height, card: [...found], server: [...server] });
    return found;
  };
})()"""
"""Keeps what the page compares by itself, the card's pixels and the server's, and its notices,
which it shows for some seconds.
"""

DIFFERENT = "of the pixels differently from the server: the server draws."

BALLS = """\
volume = "balls.nrrd"
isovalue = 0.5
isovalues = [0.4, 0.6]
bounces = 1
lattice = 0.5
target_error = 0.1
lights = [{ type = "constant", radiance = 0.5 }, { type = "sky" }]
"""
PINNED = "[[surfaces]]\nisovalue = 0.25\nalbedo = [0.3, 0.5, 0.8]\nclear = 0.6\n"
COLOUR = '[[volumes]]\nuse = "colour"\nof = "gradient"\nmap = "coolwarm"\n'
MORE = {"plain": "", "coloured": COLOUR, "in a shell": PINNED}


@pytest.fixture(scope="module")
def server(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[str]:
    """A server of two balls that touch, in one colour, in colours of their gradient, or in a clear
    shell.
    """
    folder = tmp_path_factory.mktemp(request.param.replace(" ", "-"))
    z, y, x = np.mgrid[:16, :20, :24]
    balls = [
        np.exp(-(((x - cx) / 5) ** 2) - ((y - 9.5) / 5) ** 2 - ((z - 7.5) / 4) ** 2)
        for cx in (8, 16)
    ]
    nrrd.write(str(folder / "balls.nrrd"), sum(balls).astype(np.float32), index_order="C")
    scene = folder / "balls.toml"
    scene.write_text(BALLS + MORE[request.param])
    with serving(scene, folder / "store") as url:
        yield url


@contextmanager
def visited(browser: Browser, address: str, spoiled: str = "") -> Iterator[Page]:
    """A page at an address whose card draws; one of its shaders may be ``spoiled``."""
    with watched(browser) as (page, complaints):
        page.set_viewport_size({"width": STAGE, "height": 480})
        load_modules(page)
        page.add_init_script(KEEP)
        if spoiled:
            page.route("**/web/card/shaders.json", lambda route: spoil(route, spoiled))
        page.goto(address, wait_until="commit")
        wait_final(page)
        yield page
    assert complaints == []


def spoil(route: Route, name: str) -> None:
    """Hand on the shaders, of which one draws too brightly."""
    shaders = route.fetch().json()
    right, wrong = WRONG[name]
    assert shaders["view.glsl"].count(right) == 1
    route.fulfill(json={**shaders, "view.glsl": shaders["view.glsl"].replace(right, wrong)})


def reading(page: Page) -> dict[str, Any]:
    """What the page has compared: it does so at the first rest after the card was ready to draw."""
    for _ in range(TURNS):
        if page.locator("#live:not([hidden])").count():
            break
        page.focus("#stage")
        page.keyboard.press("ArrowRight")
        page.wait_for_timeout(300)
        wait_final(page)
    page.wait_for_function("() => window.readings.length > 0", timeout=FINAL_MS)
    found: dict[str, Any] = page.evaluate("window.readings[0]")
    return found


def share_that_differs(found: dict[str, Any]) -> tuple[float, int]:
    """The share of the surface's inner pixels that differ by more than rounding, and how many
    there are.
    """
    shape = (found["height"], found["width"], 4)
    card, server = (
        np.array(found[name], np.uint8).reshape(shape)[..., :3].astype(int)
        for name in ("card", "server")
    )
    card = card[::-1]  # its rows come from below
    inner = server[1:-1, 1:-1]
    near = [
        np.abs(server[1 + j : shape[0] - 1 + j, 1 + i : shape[1] - 1 + i] - inner).max(axis=2)
        for j in (-1, 0, 1)
        for i in (-1, 0, 1)
    ]
    contrast = np.max(near, axis=0)
    compared = (contrast > 0) & (contrast < EDGE)
    apart = np.abs(card[1:-1, 1:-1] - inner).max(axis=2)[compared]
    return float((apart > ROUNDED).mean()), len(apart)


@pytest.mark.long
@pytest.mark.parametrize(
    ("server", "shading"),
    [
        *(("plain", shading) for shading in SHADINGS),
        *(("coloured", shading) for shading in ("gi", "phong")),
        *(("in a shell", shading) for shading in ("gi", "lambert_shadow")),
    ],
    indirect=["server"],
)
def test_a_resting_card_shows_what_the_server_does(
    browser: Browser, server: str, shading: str
) -> None:
    with visited(browser, f"{server}/?draw=card&shading={shading}") as page:
        found = reading(page)
        assert found["shading"] == shading
        share, compared = share_that_differs(found)
        assert compared > 2000
        assert share < 0.01, (share, compared)
        page.focus("#stage")
        page.keyboard.press("ArrowRight")
        expect(page.locator("#live:not([hidden])")).to_have_count(1)
        wait_final(page)
        assert not any(DIFFERENT in each for each in page.evaluate("window.notices"))


WRONG = {
    "light": ("return unit * albedo * tint(p) * light", "return 0.1 * unit * albedo * light"),
    "local models": ("return albedo * tint(p) * local", "return 1.6 * albedo * local"),
}
"""What a driver may draw wrongly: the text of a shader, and what replaces it."""


@pytest.mark.long
@pytest.mark.parametrize(
    ("server", "shading", "wrong"),
    [
        ("plain", "gi", "light"),
        ("plain", "lambert_fog", "local models"),
        ("in a shell", "gi", "light"),
    ],
    indirect=["server"],
)
def test_the_page_says_that_its_card_draws_wrongly(
    browser: Browser, server: str, shading: str, wrong: str
) -> None:
    with visited(browser, f"{server}/?draw=card&shading={shading}", wrong) as page:
        share, _ = share_that_differs(reading(page))
        assert share > 0.5
        assert any(DIFFERENT in each for each in page.evaluate("window.notices"))
        page.focus("#stage")
        page.keyboard.press("ArrowRight")
        wait_final(page)
        expect(page.locator("#live:not([hidden], [data-faded])")).to_have_count(0)
