"""Stops of the isovalue slider: ticks below the histogram, and keys that go from one to the next."""

import numpy as np
import pytest
from playwright.sync_api import Page

from tests.web.visits import BROWSER, open_final

pytestmark = BROWSER


@pytest.fixture
def shown(page: Page, live_server: str) -> Page:
    """The page with a shading for which nothing is baked."""
    return open_final(page, f"{live_server}/?shading=lambert")


@pytest.fixture
def stops(shown: Page, live_server: str) -> list[float]:
    found: list[float] = shown.request.get(f"{live_server}/v1/scenes/small").json()["stops"]
    return found


def isovalue(page: Page) -> float:
    return float(page.input_value("#isovalue-number"))


def test_page_keys_on_the_slider_go_to_stops_and_arrows_are_fine(shown: Page, stops: list[float]) -> None:
    above = [stop for stop in stops if stop > 0.5]
    shown.focus("#isovalue")
    for key, wanted in (("PageUp", above[0]), ("PageUp", above[1]), ("PageDown", above[0])):
        shown.keyboard.press(key)
        assert isovalue(shown) == wanted, key
    shown.keyboard.press("ArrowRight")
    assert above[0] < isovalue(shown) < above[1]
    for _ in range(len(above) + 2):
        shown.keyboard.press("PageUp")
    assert isovalue(shown) == stops[-1]


@pytest.mark.parametrize("width", [1280, 390])
def test_ticks_stand_where_the_sliders_thumb_does(shown: Page, stops: list[float], width: int) -> None:
    shown.set_viewport_size({"width": width, "height": 800})
    box = "element => Object.values(element.getBoundingClientRect().toJSON())"
    left, top, across, _ = shown.eval_on_selector("#stops path", box)[:4]
    x, y, wide, high = shown.eval_on_selector("#isovalue", box)[:4]
    ends = (x + 8, x + wide - 8)  # the middle of its thumb
    assert [left, left + across] == pytest.approx(np.interp([stops[0], stops[-1]], [0.2, 0.8], ends).tolist(), abs=0.1)
    assert 0 <= top - (y + high) <= 2
    assert (shown.get_attribute("#stops path", "d") or "").count("M") == len(stops)
