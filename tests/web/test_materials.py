"""Materials on the page: chosen, with numbers that are applied when their slider is let go, and kept in the address."""

from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.live import serving
from tests.web.visits import BROWSER, open_final, open_shown, pixels, query_of, slide, wait_final

pytestmark = BROWSER


@pytest.fixture(scope="module")
def sunlit(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of a scene with a lamp, which light inside a surface cannot meet, and something that glows."""
    folder = tmp_path_factory.mktemp("sunlit")
    lamp = '[[lights]]\ntype = "directional"\nazimuth = 0\nelevation = 50\nirradiance = 1\n'
    glow = "[[glow]]\nsphere = [40, 40, 40, 5]\nradiance = 1\n"
    plain = 'volume = "demo:orbital"\nbounces = 0\ntarget_error = 0.5\nprojected = false\n'
    (folder / "sunlit.toml").write_text(plain + lamp + glow)
    with serving(folder / "sunlit.toml", folder / "store") as url:
        yield url


def material(page: Page) -> str:
    """What the address says of it."""
    return query_of(page).get("material", "")


def test_a_material_is_chosen_and_the_picture_follows(page: Page, live_server: str) -> None:
    own = pixels(open_final(page, live_server))
    expect(page.locator("#material .value")).to_have_text("Diffuse")
    page.click("#material summary")
    expect(page.locator("#material-numbers input")).to_have_count(0)
    page.select_option("#material-kind", "glass")
    expect(page.locator("output[for=material-index]")).to_have_text("1.5")
    glass = pixels(wait_final(page))
    assert np.abs(glass - own).mean() > 2.0 and material(page) == "glass"
    page.select_option("#material-kind", "subsurface")
    expect(page.locator("#light-note")).to_have_text("The light of this scene is fixed.")
    wax = pixels(wait_final(page))
    assert np.abs(wax - own).mean() > 0.5 and np.abs(wax - glass).mean() > 0.5
    page.select_option("#material-kind", "diffuse")
    expect(page.locator("#light-note")).to_be_hidden()
    assert np.abs(pixels(wait_final(page)) - own).mean() < 1.0 and material(page) == ""


def test_a_number_is_applied_once_its_slider_is_let_go(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?material=glass,index=1.2")
    expect(page.locator("#material")).to_have_attribute("open", "")
    before = pixels(page)
    slide(page, "material-index", 0.8)
    expect(page.locator("output[for=material-index]")).to_have_text("2.2")
    assert material(page) == "glass,index=1.2", "it is held"
    page.dispatch_event("#material-index", "change")
    assert material(page) == "glass,index=2.2"
    assert np.abs(pixels(wait_final(page)) - before).mean() > 0.5
    page.focus("#material-index")
    page.keyboard.down("ArrowRight")
    page.keyboard.down("ArrowRight")
    assert material(page) == "glass,index=2.2", "so is a key"
    page.keyboard.up("ArrowRight")
    assert float(material(page).removeprefix("glass,index=")) > 2.2
    page.click("#reset")
    expect(page.locator("#material-kind")).to_have_value("diffuse")


def test_glass_has_a_tint_beside_how_much_it_absorbs(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?material=glass,absorption=0.05")
    tint, clear = page.locator("#material-absorption-tint"), pixels(page)
    expect(tint).to_have_value("#ffffff")
    expect(page.get_by_label("Tint").last).to_have_attribute("type", "color")
    tint.fill("#00ff00")
    assert material(page) == "glass,absorption=0.05,0,0.05"
    red, green, blue = (pixels(wait_final(page)).astype(int) - clear).mean(axis=(0, 1))
    assert green > max(1.0, 3.0 * abs(red), 3.0 * abs(blue)), "less is absorbed of it, though bright pixels look paler"
    expect(tint).to_have_value("#3fff3f")
    slide(page, "material-absorption", 0)
    page.dispatch_event("#material-absorption", "change")
    expect(tint).to_have_value("#3fff3f")  # none keeps its colour
    assert material(page) == "glass"


def test_a_link_of_a_material_that_there_is_not_is_told(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?material=jelly")
    expect(page.locator("#notice")).to_have_text("“jelly” is no material of this scene.")


def test_where_a_scene_allows_its_own_alone_there_is_no_choice(page: Page, sunlit: str) -> None:
    open_shown(page, sunlit)
    expect(page.locator("#material")).to_be_hidden()
