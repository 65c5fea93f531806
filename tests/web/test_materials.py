"""What the surface is made of, on the page: materials, albedo and tint, and labels."""

from collections.abc import Iterator
from pathlib import Path

import nrrd
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from tests.live import serving
from tests.web.visits import (
    BROWSER,
    FINAL_MS,
    open_final,
    open_shown,
    pixels,
    query_of,
    shoot,
    slide,
    wait_final,
)

pytestmark = BROWSER


@pytest.fixture(scope="module")
def sunlit(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of a scene with a lamp, which light inside a surface cannot meet, and something that
    glows.
    """
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
    expect(page.locator("#light-note")).to_have_text(
        "Turns in steps of 5°: each is baked when it is shown."
    )
    wax = pixels(wait_final(page))
    assert np.abs(wax - own).mean() > 0.5 and np.abs(wax - glass).mean() > 0.5
    page.select_option("#material-kind", "diffuse")
    expect(page.locator("#light-note")).to_be_hidden()
    assert np.abs(pixels(wait_final(page)) - own).mean() < 1.0 and material(page) == ""


@pytest.mark.long
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


@pytest.mark.long
def test_glass_has_a_tint_beside_how_much_it_absorbs(page: Page, live_server: str) -> None:
    open_final(page, f"{live_server}/?material=glass,absorption=0.05")
    tint = page.locator("#material-absorption-tint")
    clear = pixels(page)
    expect(tint).to_have_value("#ffffff")
    expect(page.get_by_label("Tint").last).to_have_attribute("type", "color")
    tint.fill("#00ff00")
    assert material(page) == "glass,absorption=0.05,0,0.05"
    red, green, blue = (pixels(wait_final(page)).astype(int) - clear).mean(axis=(0, 1))
    assert green > max(1.0, 3.0 * abs(red), 3.0 * abs(blue)), (
        "less is absorbed of it, though bright pixels look paler"
    )
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


@pytest.fixture(scope="module")
def painted(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of the small scene at albedo 0.3, of which views may ask for 0 to 0.9."""
    scene = small_scene.with_name("paint.toml")
    scene.write_text(f"albedo = 0.3\nalbedos = [0, 0.9]\n{small_scene.read_text()}")
    with serving(scene, tmp_path_factory.mktemp("store")) as url:
        yield url


def tint(page: Page, colour: str) -> None:
    """Choose a colour, as a hand would."""
    page.eval_on_selector(
        "#tint",
        (
            '(input, colour) => { input.value = colour; input.dispatchEvent(new Event("input", { '
            "bubbles: true })); }"
        ),
        colour,
    )


def test_the_slider_brightens_and_the_link_keeps_it(page: Page, painted: str) -> None:
    page.emulate_media(color_scheme="dark")  # or the background is the brightest
    open_final(page, painted)
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


@pytest.mark.long
def test_a_tint_colours_the_surface_and_is_in_the_lines(page: Page, painted: str) -> None:
    page.emulate_media(color_scheme="dark")
    open_final(page, f"{painted}/?albedo=0.8")
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


@pytest.fixture(scope="module")
def segmented(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of a segmentation of two halves, one red and one green."""
    folder = tmp_path_factory.mktemp("labels")
    parts = np.zeros((12, 12, 12), np.uint8)
    parts[2:10, 2:10, 2:6], parts[2:10, 2:10, 6:10] = 3, 8
    nrrd.write(str(folder / "seg.nrrd"), parts, index_order="C")
    tables = ((3, "liver", "#c02020"), (8, "spleen", "#20a040"))
    labels = "".join(
        f'[[labels]]\nvalue = {v}\nname = "{name}"\ncolour = "{code}"\n' for v, name, code in tables
    )
    lit = '[[lights]]\ntype = "constant"\nradiance = 1.0\n'
    plain = 'volume = "seg.nrrd"\nbounces = 0\ntarget_error = 0.3\nprojected = false\n'
    (folder / "parts.toml").write_text(plain + lit + labels)
    with serving(folder / "parts.toml", folder / "store") as url:
        yield url


def greenness(path: Path) -> np.ndarray:
    """Which pixels of a picture are clearly green; (h, w) bool."""
    with Image.open(path) as picture:
        red, green, _ = np.moveaxis(np.asarray(picture.convert("RGB"), int), -1, 0)
    return np.asarray(green > red + 30)


@pytest.mark.long
def test_a_label_is_hidden_by_keys_and_named_in_a_saved_picture(
    page: Page, segmented: str, tmp_path: Path
) -> None:
    open_final(page, segmented)
    for values in ("#isovalue", "#isovalue-number", "#percentile", "#histogram"):
        expect(page.locator(values)).to_be_hidden()  # labels have none
    page.get_by_label("spleen").focus()
    page.keyboard.press("Space")
    expect(page.get_by_label("liver")).to_be_disabled()  # one is always shown
    wait_final(page)
    assert "hide=8" in page.url
    page.click("#save-button")
    found = []
    for _ in range(2):
        with page.expect_download(timeout=FINAL_MS) as download:
            page.click("#save-start")
        download.value.save_as(path := tmp_path / f"{len(found)}.png")
        found.append(np.asarray(Image.open(path).convert("RGB"), int))
        page.check("#save-legend")
    assert not greenness(tmp_path / "0.png").any(), "the spleen is gone"
    rows, columns = np.nonzero(np.abs(found[1] - found[0]).max(axis=-1) > 2)
    high, wide, _ = found[0].shape
    # The picture that is there is saved as large as it is, and the legend grows with it.
    assert (
        len(rows) > high * wide / 2000 and rows.min() > 0.8 * high and columns.min() > 0.7 * wide
    ), "a row for the liver"
    page.keyboard.press("Escape")
    page.click("#labels-all")
    wait_final(page)
    assert "hide" not in page.url
