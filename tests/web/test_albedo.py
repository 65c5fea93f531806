"""The surface's albedo in a real browser: a slider and a tint where the scene's light is of any, else neither."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.live import serving
from tests.web.visits import BROWSER, open_final, pixels, query_of, shoot, slide, wait_final

pytestmark = BROWSER


@pytest.fixture(scope="module")
def server(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of the small scene at albedo 0.3, of which views may ask for 0 to 0.9."""
    scene = small_scene.with_name("paint.toml")
    scene.write_text(f"albedo = 0.3\nalbedos = [0, 0.9]\n{small_scene.read_text()}")
    with serving(scene, tmp_path_factory.mktemp("store")) as url:
        yield url


def tint(page: Page, colour: str) -> None:
    """Choose a colour, as a hand would."""
    page.eval_on_selector(
        "#tint",
        '(input, colour) => { input.value = colour; input.dispatchEvent(new Event("input", { bubbles: true })); }',
        colour,
    )


def test_the_slider_brightens_and_the_link_keeps_it(page: Page, server: str) -> None:
    page.emulate_media(color_scheme="dark")  # or the background is the brightest
    open_final(page, server)
    expect(page.locator("output[for=albedo]")).to_have_text("0.30")
    expect(page.locator("#tint")).to_have_value("#ffffff")
    dark = pixels(page)
    slide(page, "albedo", 1.0)
    wait_final(page)
    bright = pixels(page)
    expect(page.locator("output[for=albedo]")).to_have_text("0.90")
    assert bright.max() > dark.max() + 40.0
    assert query_of(page)["albedo"] == "0.9" and "tint" not in query_of(page)
    again = page.url
    page.click("#reset")
    wait_final(page)
    assert abs(pixels(page) - dark).max() == 0.0
    assert abs(pixels(open_final(page, again)) - bright).max() == 0.0


def test_a_tint_colours_the_surface_and_is_in_the_lines(page: Page, server: str) -> None:
    page.emulate_media(color_scheme="dark")
    open_final(page, f"{server}/?albedo=0.8")
    tint(page, "#ff8000")
    wait_final(page)
    red, green, blue = (pixels(page)[..., c].max() for c in range(3))
    assert red > green + 20.0 > blue + 40.0
    assert query_of(page)["tint"] == "#ff8000"
    page.click("#share-button")
    line = page.locator("#share-curl")
    expect(line).to_contain_text("albedo=0.8%2C0.1727%2C0")
    shoot(page, "tint")


def test_a_surface_of_one_albedo_has_neither(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?albedo=0.9&tint=%23ff0000&shading=phong")
    expect(page.locator("#albedo")).to_be_hidden()
    expect(page.locator("#tint")).to_be_hidden()
    slide(page, "exposure", 0.6)
    wait_final(page)
    assert "exposure" in query_of(page) and not {"albedo", "tint"} & set(query_of(page))
