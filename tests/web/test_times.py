"""Time on the page: a slider of steps where the volume is a series, kept in the address."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.live import serving
from tests.series import STEPS, write_series
from tests.web.visits import BROWSER, open_final, pixels, shoot, slide, wait_final

pytestmark = BROWSER


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder: Path = tmp_path_factory.mktemp("series")
    with serving(write_series(folder), folder / "light") as url:
        yield url


def test_a_slider_leafs_through_the_steps(page: Page, series: str) -> None:
    first = pixels(open_final(page, series))
    expect(page.locator("#time")).to_be_visible()
    expect(page.locator("output[for=time]")).to_have_text("step 0")
    assert [page.get_attribute("#time", name) for name in ("min", "max", "step")] == ["0", "3", "1"]
    slide(page, "time", 1.0)
    last = pixels(wait_final(page))
    expect(page.locator("output[for=time]")).to_have_text("step 3")
    assert "time=3" in page.url and np.abs(last - first).mean() > 2.0
    page.locator("#time").scroll_into_view_if_needed()
    shoot(page, "times")
    page.focus("#time")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("output[for=time]")).to_have_text("step 2")


def test_a_link_opens_at_its_step(page: Page, series: str) -> None:
    open_final(page, f"{series}/?time=2")
    expect(page.locator("output[for=time]")).to_have_text("step 2")


def test_the_series_is_played_round_and_round(page: Page, series: str) -> None:
    """No step is skipped: what the slider says goes up by one, and from the last step to the first."""
    open_final(page, series)
    page.evaluate(
        """() => {
          window.seen = [];
          const output = document.querySelector("output[for=time]");
          new MutationObserver(() => {
            if (window.seen.at(-1) !== output.textContent) window.seen.push(output.textContent);
          }).observe(output, { childList: true });
        }"""
    )
    page.get_by_role("button", name="Play").click()
    for _ in range(600):
        if len(page.evaluate("() => window.seen")) >= 6:
            break
        page.wait_for_timeout(100)
    page.get_by_role("button", name="Pause").click()
    assert page.evaluate("() => window.seen")[:6] == [f"step {n % STEPS}" for n in range(1, 7)]
    page.locator("#play").scroll_into_view_if_needed()
    shoot(page, "player")
    seen = page.evaluate("() => window.seen")
    wait_final(page)
    page.wait_for_timeout(1500)
    assert page.evaluate("() => window.seen") == seen
    page.get_by_role("button", name="Play").click()
    page.focus("#time")
    page.keyboard.press("Home")
    page.keyboard.press("End")
    expect(page.get_by_role("button", name="Play")).to_be_visible()


def test_slices_are_of_the_step_that_is_shown(page: Page, series: str) -> None:
    page.goto(f"{series}/?shading=lambert&slices=9,9,7")
    for share, places in ((0.0, (9.5, 13.5)), (1.0, (6.5, 16.5))):
        slide(page, "time", share)
        told = sum(np.exp(-(((9 - at) / 5) ** 2) - 0.25 / 25 - 0.25 / 16) for at in places)
        expect(page.locator("#slices-voxel")).to_have_text(re.compile(f"value {told:.4f}"[:-1]))
    expect(page.locator("#slices figure[data-old]")).to_have_count(0)


def test_what_is_no_series_has_no_slider(page: Page, live_server: str) -> None:
    open_final(page, live_server)
    expect(page.locator("#time")).to_be_hidden()
    expect(page.locator("#play")).to_be_hidden()
    assert "time=" not in page.url
