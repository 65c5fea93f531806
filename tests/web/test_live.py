"""Who draws: the visitor's card what moves, the server what rests; and the server all where there
is no card.
"""

import json
import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, WebSocketRoute, expect

from tests.web.visits import BROWSER, TWO_FRAMES, shoot, stage_of, wait_final, written

pytestmark = BROWSER
DRAWN = "#live:not([hidden])"
SHOWN = "#live:not([hidden], [data-faded])"
FADED = "#live[data-faded]"
LOSE = """() => document.querySelector('#live').getContext('webgl2')
  .getExtension('WEBGL_lose_context').loseContext()"""


class Wire:
    """What goes over a page's stream; pictures of views at rest wait for a word where they are
    ``held``.
    """

    def __init__(self, page: Page) -> None:
        self.asked: list[dict[str, Any]] = []
        self.pictures: list[dict[str, Any]] = []
        self.held = False
        self._waiting: list[str | bytes] = []
        page.route_web_socket(re.compile("/stream$"), self._join)

    def _join(self, route: WebSocketRoute) -> None:
        server = route.connect_to_server()
        self._page = route

        def asked(message: str | bytes) -> None:
            self.asked.append(json.loads(message))
            server.send(message)

        def came(message: str | bytes) -> None:
            if isinstance(message, str):
                self.pictures.append(json.loads(message))
            if self.held:
                self._waiting.append(message)
            else:
                route.send(message)

        route.on_message(asked)
        server.on_message(came)

    def let_go(self) -> None:
        """Hand on what waits."""
        self.held = False
        for message in self._waiting:
            self._page.send(message)
        self._waiting.clear()


@pytest.fixture
def wire(fresh: Page) -> Wire:
    return Wire(fresh)


@pytest.fixture
def asked(fresh: Page) -> Iterator[list[str]]:
    """What a page asks for of the card's addresses."""
    found: list[str] = []
    fresh.on(
        "request",
        lambda request: found.append(request.url) if "/card" in request.url.split("?")[0] else None,
    )
    yield found
    found[:] = [url for url in found if "/web/" not in url]


def of_server(asked: list[str]) -> list[str]:
    return [url for url in asked if "/v1/" in url]


def open_drawn(page: Page, server: str, more: str = "draw=card") -> None:
    """Open the page, small as software draws it, and turn the view until the card draws it, where
    it is to.
    """
    page.set_viewport_size({"width": 360, "height": 480})
    page.goto(f"{server}/?scene=small&{more}")
    wait_final(page)
    while more == "draw=card" and not page.locator(DRAWN).count():
        page.focus("#stage")
        page.keyboard.press("ArrowRight")
        page.wait_for_timeout(300)
    wait_final(page)


def turn(page: Page, steps: int = 8) -> None:
    """Drag the picture, and hold it."""
    left, top, width, height = stage_of(page)
    page.mouse.move(left + width / 2, top + height / 2)
    page.mouse.down()
    for i in range(steps):
        page.mouse.move(left + width / 2 + 7 * i, top + height / 2 + 3 * i)
        page.evaluate(TWO_FRAMES)


def picture_of(page: Page, name: str) -> np.ndarray:
    """The middle of the stage as a person sees it; (h, w, 3) float."""
    left, top, width, height = stage_of(page)
    inside = {"x": left + width / 4, "y": top + 50, "width": width / 2, "height": height - 120}
    return np.asarray(Image.open(shoot(page, f"live-{name}", clip=inside)).convert("RGB"), float)


def test_the_card_draws_what_moves_and_the_server_what_rests(
    fresh: Page, wire: Wire, live_server: str
) -> None:
    open_drawn(fresh, live_server)
    wire.asked.clear()
    wire.pictures.clear()
    turn(fresh)
    expect(fresh.locator(SHOWN)).to_have_count(1)
    expect(fresh.locator("#draft")).to_be_hidden()
    moving = [each for each in wire.asked if each.get("moving")]
    assert moving and all(each["pictures"] is False for each in moving)
    fresh.mouse.up()
    wait_final(fresh)
    expect(fresh.locator(FADED)).to_have_count(1)
    assert not any(each["draft"] for each in wire.pictures)

    wire.held = True  # the card has the light of about this view now
    fresh.focus("#stage")
    fresh.keyboard.press("ArrowLeft")
    expect(fresh.locator(SHOWN)).to_have_count(1)
    smooth = settled(fresh)
    assert fresh.get_attribute("#stage", "data-state") == "updating", (
        "nothing is said of what only the card shows"
    )
    wire.let_go()
    wait_final(fresh)
    expect(fresh.locator(FADED)).to_have_count(1)
    fresh.wait_for_timeout(300)
    server = picture_of(fresh, "server")
    apart = np.abs(smooth - server).max(axis=2)
    assert server.std() > 5, "the object is in the middle"
    assert apart.mean() < 0.5 and (apart <= 8).mean() > 0.995, (apart.mean(), (apart <= 8).mean())


def settled(page: Page) -> np.ndarray:
    """What the card shows once it changes no more."""
    before = picture_of(page, "card")
    for _ in range(60):
        page.wait_for_timeout(1000)
        now = picture_of(page, "card")
        if np.array_equal(now, before):
            break
        before = now
    return now


def test_a_lost_card_leaves_the_view_to_the_server(
    fresh: Page, wire: Wire, live_server: str
) -> None:
    open_drawn(fresh, live_server)
    turn(fresh, 4)
    address = written(fresh)
    wire.pictures.clear()
    fresh.evaluate(LOSE)
    expect(fresh.locator("#live")).to_be_hidden(timeout=1000)
    left, top, width, height = stage_of(fresh)
    for i in range(12):
        fresh.mouse.move(left + width / 2 + 40 + 4 * i, top + height / 2)
        fresh.evaluate(TWO_FRAMES)
    fresh.mouse.up()
    wait_final(fresh)
    assert any(each["draft"] for each in wire.pictures)
    now = written(fresh)
    assert abs(angle(now) - angle(address)) > 5.0, "the hand went on"
    assert "draw=card" in now


def angle(search: str) -> float:
    found = re.search(r"azimuth=(-?[\d.]+)", search)
    return float(found[1]) if found else math.nan


def test_software_is_found_by_its_time(
    fresh: Page, wire: Wire, asked: list[str], live_server: str
) -> None:
    open_drawn(fresh, live_server, "")
    turn(fresh)
    expect(fresh.locator("#live")).to_be_hidden()
    fresh.mouse.up()
    wait_final(fresh)
    assert any(each["draft"] for each in wire.pictures)
    assert not of_server(asked) and not any("pictures" in each for each in wire.asked)
