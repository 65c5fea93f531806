"""The isovalue on the page, and what it shows: presets, stops of the slider, area and volume, and
steps in time.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from tests.live import serving
from tests.series import STEPS, write_series
from tests.web.visits import BROWSER, open_final, pixels, shoot, slide, wait_final

pytestmark = BROWSER


PRESETS = [
    {"name": "shell", "isovalue": 0.3, "suggested": False},
    {"name": "0.62", "isovalue": 0.62, "suggested": True},
]


@pytest.fixture
def preset(page: Page, live_server: str) -> Page:
    """The page of a scene with two presets."""

    def with_presets(route: Route) -> None:
        route.fulfill(json={**route.fetch().json(), "presets": PRESETS})

    page.route("**/v1/scenes/small", with_presets)
    page.goto(f"{live_server}/?shading=lambert")
    page.wait_for_selector("#presets .chip")
    return page


def chips(page: Page) -> list[str]:
    return page.locator("#presets .chip").all_inner_texts()


def test_a_chip_sets_the_isovalue_and_is_pressed_while_it_is_set(preset: Page) -> None:
    assert chips(preset) == ["start 0.5", "shell 0.3", "0.62"]
    shell = preset.get_by_role("button", name="shell 0.3")
    found = preset.get_by_role("button", name="0.62")
    expect(preset.get_by_role("button", name="start 0.5")).to_have_attribute("aria-pressed", "true")
    shell.click()
    expect(preset.locator("#isovalue-number")).to_have_value("0.3")
    expect(shell).to_have_attribute("aria-pressed", "true")
    found.press("Enter")
    expect(preset.locator("#isovalue-number")).to_have_value("0.62")
    expect(shell).to_have_attribute("aria-pressed", "false")
    expect(found).to_have_attribute("title", re.compile("found in the volume"))


def test_an_isovalue_is_kept_over_a_reload_until_it_is_forgotten(preset: Page) -> None:
    expect(preset.locator("#presets .keep")).to_be_disabled()
    slide(preset, "isovalue", 0.4)
    isovalue = preset.input_value("#isovalue-number")
    preset.get_by_role("button", name=f"Keep isovalue {isovalue}").click()
    expect(preset.locator("#presets .keep")).to_be_focused()
    assert chips(preset)[-1] == f"★ {isovalue}"
    preset.reload()
    chip = preset.get_by_role("button", name=f"★ {isovalue}")
    preset.get_by_role("button", name="shell 0.3").click()
    chip.click()
    expect(preset.locator("#isovalue-number")).to_have_value(isovalue)
    preset.get_by_role("button", name=f"Forget isovalue {isovalue}").click()
    expect(chip).to_have_count(0)
    preset.reload()
    preset.wait_for_selector("#presets .chip")
    assert len(chips(preset)) == 3


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


def test_page_keys_on_the_slider_go_to_stops_and_arrows_are_fine(
    shown: Page, stops: list[float]
) -> None:
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
def test_ticks_stand_where_the_sliders_thumb_does(
    shown: Page, stops: list[float], width: int
) -> None:
    shown.set_viewport_size({"width": width, "height": 800})
    box = "element => Object.values(element.getBoundingClientRect().toJSON())"
    left, top, across, _ = shown.eval_on_selector("#stops path", box)[:4]
    x, y, wide, high = shown.eval_on_selector("#isovalue", box)[:4]
    ends = (x + 8, x + wide - 8)  # the middle of its thumb
    assert [left, left + across] == pytest.approx(
        np.interp(np.log10([stops[0], stops[-1]]), np.log10([0.2, 0.8]), ends).tolist(), abs=0.1
    )
    assert 0 <= top - (y + high) <= 2
    assert (shown.get_attribute("#stops path", "d") or "").count("M") == len(stops)


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
    known = httpx.get(
        f"{live_server}/v1/scenes/small/size", params={"isovalue": 0.4}, timeout=60
    ).json()
    for name in ("area", "volume"):
        value, error = (
            float(text) for text in re.findall(r"[\d.]+", before[name.capitalize()])[:2]
        )
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


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder: Path = tmp_path_factory.mktemp("series")
    with serving(write_series(folder), folder / "light") as url:
        yield url


@pytest.mark.long
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


@pytest.mark.long
def test_the_series_is_played_round_and_round(page: Page, series: str) -> None:
    """No step is skipped: what the slider says goes up by one, and from the last step to the
    first.
    """
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
