"""A published page in a real browser: whether all of it is seen at once, on which ground, and where
it begins.
"""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page

from isogi_server.cli.publish import page_of, shots_of, sliders_of
from isogi_server.cli.reel import Reel
from tests.loaded import load_scene
from tests.web.visits import BROWSER

WINDOWS = ((1280, 800), (1920, 1080), (390, 844), (844, 390))
GRID = {
    "isovalue": "0.01:0.03:0.02",
    "azimuth": "0:315:45",
    "elevation": "5:45:20",
    "yaw": "0:180:180",
}
SIZE = {"width": "96", "height": "72"}
CAPTION = "An orbital <3d>.\nIts light is a sky's."

pytestmark = BROWSER


def published(folder: Path, **knobs: str) -> str:
    """The address of a page with four sliders, whose pictures are all of one colour."""
    scene = load_scene("demo:orbital")
    sliders = sliders_of(GRID)
    reel = Reel(folder, scene, shots_of(sliders, {**GRID, **SIZE, **knobs}))
    reel.facts = {name: {"error": 0.02, "final": True} for name in reel.shots}
    (folder / "pictures").mkdir(parents=True)
    colour = Image.new("RGB", (96, 72), "#804020")
    for name in reel.shots:
        colour.save(folder / name)
    (folder / "index.html").write_text(page_of(scene, sliders, reel, CAPTION))
    return (folder / "index.html").as_uri()


def opened(browser: Browser, address: str, width: int, height: int, dark: bool = False) -> Page:
    scheme = "dark" if dark else "light"
    page = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme
    ).new_page()
    page.goto(address)
    page.wait_for_function("document.images[0].complete && document.images[0].naturalWidth")
    return page


@pytest.mark.parametrize(("width", "height"), WINDOWS)
def test_picture_sliders_and_error_fit_the_window(
    browser: Browser, tmp_path: Path, width: int, height: int
) -> None:
    page = opened(browser, published(tmp_path / "out"), width, height)
    assert page.inner_text("#caption") == CAPTION
    for what in ("h1", "img", "#caption", "input", "output", "[role=status]"):
        for box in (each.bounding_box() for each in page.locator(what).all()):
            assert box is not None and box["width"] > 0
            assert min(box["x"], box["y"]) >= 0.0
            assert box["x"] + box["width"] <= width and box["y"] + box["height"] <= height
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert page.evaluate("document.documentElement.scrollHeight") <= height
    shot = np.asarray(Image.open(_shot(page, tmp_path)).convert("RGB")).astype(int)
    seen = (np.abs(shot - [0x80, 0x40, 0x20]) < 12).all(axis=2)
    assert seen.mean() > 0.2, "the picture has a fair share of the window"


def _shot(page: Page, folder: Path) -> Path:
    page.screenshot(path=folder / "shot.png")
    return folder / "shot.png"


@pytest.mark.parametrize(
    ("background", "dark", "paper"),
    [
        ("light", True, (203, 206, 209)),
        ("dark", False, (26, 29, 34)),
        ("transparent", False, (255, 255, 255)),
    ],
)
def test_the_page_has_the_ground_of_its_pictures(
    browser: Browser, tmp_path: Path, background: str, dark: bool, paper: tuple[int, ...]
) -> None:
    """Whatever the browser's scheme; where they have none, that of the browser. Letters stand out
    from it.
    """
    page = opened(browser, published(tmp_path / "out", background=background), 800, 600, dark)
    shot = np.asarray(Image.open(_shot(page, tmp_path)).convert("RGB"))
    assert tuple(shot[2, 2].tolist()) == paper
    ink = page.evaluate("getComputedStyle(document.querySelector('h1')).color")
    assert abs(int(ink.split("(")[1].split(",")[0]) - paper[0]) > 150


def test_it_begins_with_the_first_view(browser: Browser, tmp_path: Path) -> None:
    page = opened(browser, published(tmp_path / "out"), 800, 600)
    assert [each.inner_text() for each in page.locator("output").all()] == [
        "0.03",
        "45°",
        "25°",
        "0°",
    ]
    assert page.locator("img").get_attribute("src") == "pictures/1-1-1-0.webp"
