"""A published page on a plain file server: what a visitor sees, slides, turns and lights, beside
isogi's pictures.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, Route

from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.film import develop
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.plan.assembly import load_scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.storage.store import Store
from isogi_server.cli.command import run
from isogi_server.parameters import FrameParams, read
from isogi_server.settings import Settings
from isogi_server.views import view_of
from isogi_worker import pool
from tests.published import document_in
from tests.server.inline import InlinePool
from tests.web.plain_server import shared
from tests.web.visits import box_of, drag, middle

SCENE = """\
volume = "demo:orbital"
bounces = 1
target_error = 0.1
projected = false
[[lights]]
type = "sky"
sun_azimuth = 30
sun_elevation = 50
"""
SIZE = {"width": 280, "height": 400}
READY_MS = 120_000


class Site:
    """A published folder, the scene that it is of, and isogi's own pictures of what it shows."""

    def __init__(self, folder: Path, address: str) -> None:
        self.page = folder / "page"
        self.address = address
        self.document = document_in(self.page / "index.html")
        self.scene = load_scene(folder / "scene.toml", target_error=0.5 * 0.1)
        self.renderer = Renderer(
            Caches(PreparedScene(self.scene), Store(str(folder / "store")), 1 << 28), Tiles()
        )

    def picture(self, width: int, height: int, **knobs: Any) -> tuple[np.ndarray, np.ndarray]:
        """isogi's picture of the page's first view with other ``knobs``, (h, w, 3), and where it is
        flat.
        """
        start = self.document["scene"]["start"]
        asked = {
            name: start[name] for name in ("azimuth", "elevation", "distance", "isovalue")
        } | knobs
        texts = {name: repr(value) for name, value in asked.items()}
        target = ",".join(map(repr, start["target"]))
        size = {"width": str(width), "height": str(height)}
        view = view_of(
            self.scene, read(FrameParams, {**texts, **size, "target": target}.items()), Settings()
        )  # type: ignore[call-arg]
        exposure = self.document["scene"]["defaults"]["exposure"]
        shown = develop(self.renderer.render(view), exposure, background="light")
        codes = shown.astype(int)
        about = [np.roll(codes, (dy, dx), axis=(0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
        return codes, (np.ptp(about, axis=0).max(axis=2) < 10)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A page of the orbital's isovalues 0.01 to 0.02, on a plain file server."""
    folder = tmp_path_factory.mktemp("published")
    (folder / "scene.toml").write_text(SCENE)
    words = [
        "-o",
        str(folder / "page"),
        "--interactive",
        "--isovalue",
        "0.01:0.02",
        "--background",
        "light",
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "start_pool", InlinePool)
        assert (
            run(["publish", str(folder / "scene.toml"), *words, "--store", str(folder / "store")])
            == 0
        )
    with shared(folder / "page") as address:
        yield Site(folder, address)


@pytest.fixture(scope="module")
def page(browser: Browser, site: Site) -> Iterator[Page]:
    """The page in a window, lit and drawn, for all tests of it; its console stays free of
    errors.
    """
    complaints: list[str] = []
    page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
    page.set_default_timeout(READY_MS)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda line: complaints.append(line.text) if line.type == "error" else None)
    page.goto(site.address)
    page.wait_for_selector("#stage[data-lit]")
    yield page
    page.close()
    assert complaints == []


def seen(page: Page, folder: Path) -> np.ndarray:
    """The picture of a view at rest, as it is on the screen; (h, w, 3) int."""
    page.wait_for_selector("#stage[data-still]")
    hidden = "#rulers { visibility: hidden !important }"
    page.locator("canvas").screenshot(path=folder / "shot.png", style=hidden)
    return np.asarray(Image.open(folder / "shot.png").convert("RGB")).astype(int)


def put(page: Page, knob: str, value: float) -> float:
    """Put a slider as near to a value as its steps allow; where it was."""
    script = """(slider, value) => {
      const before = slider.valueAsNumber;
      slider.value = value;
      slider.dispatchEvent(new Event("input", { bubbles: true }));
      return before;
    }"""
    return float(page.eval_on_selector(f"input[name={knob}]", script, value))


def assert_isogis(shown: np.ndarray, site: Site, **knobs: Any) -> None:
    """A picture is isogi's, but for rounding, noise, and edges that are smoothed by other
    samples.
    """
    expected, flat = site.picture(shown.shape[1], shown.shape[0], **knobs)
    surface = np.abs(expected - expected[0, 0]).max(axis=2) > 2
    apart = np.abs(shown - expected).max(axis=2)
    near, far = ((apart[flat & surface] <= most).mean() for most in (2, 8))
    assert (flat & surface).sum() > 2000
    assert near > 0.8 and far > 0.995 and apart[flat].mean() < 0.5, (near, far, apart[flat].mean())


@pytest.fixture(scope="module")
def first(page: Page, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """The picture that the page opens with."""
    return seen(page, tmp_path_factory.mktemp("first"))


def test_the_page_shows_isogis_picture(page: Page, site: Site, first: np.ndarray) -> None:
    assert_isogis(first, site)
    said = page.inner_text("[role=status]")
    assert "isovalues 0.01 to 0.02" in said and "relative error" in said and said.endswith("MB.")


def test_light_is_coarse_and_says_so_until_all_is_there(
    browser: Browser, page: Page, site: Site, first: np.ndarray, tmp_path: Path
) -> None:
    other = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
    other.set_default_timeout(READY_MS)
    held: list[Route] = []
    holding = True

    def hold(route: Route) -> None:
        if holding:
            held.append(route)
        else:
            route.continue_()

    other.route(re.compile(r"light/\d+\.bin"), hold)
    other.goto(site.address)
    # Both stages are as large only if what is said takes as many lines.
    height = box_of(page.locator("[role=status]"))["height"]
    other.add_style_tag(content=f"[role=status] {{ height: {height}px }}")
    other.wait_for_selector("#stage[data-drawn]")
    coarse = seen(other, tmp_path)
    assert "still coarse: 0 %" in other.inner_text("[role=status]")
    assert not other.locator("#stage[data-lit]").count()
    surface = np.abs(first - first[0, 0]).max(axis=2) > 2
    apart = np.abs(coarse - first).max(axis=2)[surface]
    assert apart.max() > 2, "light of texels is not there"
    assert (apart <= 24).mean() > 0.9
    assert abs(coarse[surface].mean() - first[surface].mean()) < 4
    holding = False
    for each in held:
        each.continue_()
    other.wait_for_selector("#stage[data-lit]")
    lit = seen(other, tmp_path)
    other.close()
    assert (np.abs(lit - first) <= 1).mean() > 0.999, "nothing of the coarse light is left"


@pytest.mark.long
@pytest.mark.parametrize(
    ("knob", "value"),
    [
        ("isovalue", 0.014),
        pytest.param("azimuth", 100.0, marks=pytest.mark.long),
        pytest.param("yaw", 120.0, marks=pytest.mark.long),
        pytest.param("pitch", -40.0, marks=pytest.mark.long),
    ],
)
def test_what_slides_is_drawn_without_a_request(
    page: Page, site: Site, first: np.ndarray, tmp_path: Path, knob: str, value: float
) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    start = put(page, knob, value)
    after = seen(page, tmp_path)
    put(page, knob, start)
    assert (np.abs(after - first).max(axis=2) > 8).mean() > 0.02, "the picture changes"
    assert_isogis(after, site, **{knob: value})
    assert asked == []


@pytest.mark.long
def test_a_drag_turns_the_surfaceand_the_exposure_lightens(
    page: Page, first: np.ndarray, tmp_path: Path
) -> None:
    drag(page, middle(page.locator("canvas")), 40, 10)
    turned = seen(page, tmp_path)
    assert (np.abs(turned - first).max(axis=2) > 8).mean() > 0.05
    page.click("summary")  # a page as small as this one folds its controls
    slider = page.locator("input[name=exposure]")
    slider.focus()
    turned = seen(page, tmp_path)
    for _ in range(3):
        page.keyboard.press("PageUp")
    lighter = seen(page, tmp_path)
    page.click("summary")
    assert lighter.mean() > turned.mean() + 3


@pytest.mark.long
def test_the_page_fits_windows_of_all_sizes(page: Page) -> None:
    for width, height in ((1280, 800), (390, 844), (844, 390)):
        page.set_viewport_size({"width": width, "height": height})
        page.reload()
        page.wait_for_selector("#stage[data-drawn]")
        open_parts = [f"details[open] {part}" for part in ("input", "output")]
        assert page.locator(open_parts[0]).count() or page.locator("summary").is_visible()
        for what in ("h1", "#stage", "button:visible", *open_parts, "[role=status]"):
            for box in map(box_of, page.locator(what).all()):
                assert box["width"] > 0 and min(box["x"], box["y"]) >= 0
                assert box["x"] + box["width"] <= width and box["y"] + box["height"] <= height, what


@pytest.mark.long
def test_the_first_camera_fits_narrow_and_low_stages(
    page: Page, site: Site, tmp_path: Path
) -> None:
    """The object is whole and large; on a phone it was cut off at both sides."""
    for width, height in ((390, 844), (560, 420), (844, 390)):
        page.set_viewport_size({"width": width, "height": height})
        page.reload()
        page.wait_for_selector("#stage[data-lit]")
        page.evaluate("document.querySelector('#rulers').toggleAttribute('hidden', true)")
        shown = seen(page, tmp_path)
        rows, columns = np.nonzero((np.abs(shown - shown[2, 2]) > 3).any(axis=2))
        high, wide = shown.shape[:2]
        assert rows.min() > 0 and columns.min() > 0
        assert rows.max() < high - 1 and columns.max() < wide - 1
        filled = max(np.ptp(rows) / high, np.ptp(columns) / wide)
        assert filled > 0.7, (width, height, filled)
        assert high > 0.5 * height


def test_the_page_takes_few_requests(page: Page, site: Site) -> None:
    asked: list[str] = []
    note = lambda request: asked.append(request.url)  # noqa: E731
    page.on("request", note)
    page.reload()
    page.wait_for_selector("#stage[data-lit]")
    page.remove_listener("request", note)
    beside = len(list(site.page.rglob("*.bin")))
    assert len([url for url in asked if url.startswith("http")]) == 1 + beside


def test_a_link_shows_the_view_that_it_names(page: Page, browser: Browser, site: Site) -> None:
    page.set_viewport_size(SIZE)  # type: ignore[arg-type]
    put(page, "azimuth", 77.0)
    page.wait_for_function("location.hash.includes('azimuth=77')")
    other = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
    other.goto(page.url)
    other.wait_for_function("document.querySelector('#azimuth').valueAsNumber === 77")
    assert "distance" not in page.url, "a camera that fits is the visitor's"
    other.close()
    page.click("#reset")
    page.locator("#stage").focus()
    before = page.input_value("#azimuth")
    page.keyboard.press("ArrowRight")
    assert page.input_value("#azimuth") != before
    page.click("#reset")
    assert page.input_value("#azimuth") == before
    assert page.locator("#rulers text").count() >= 4, "a scale bar, and axes"


def test_without_webgl_the_page_says_what_it_needs(browser: Browser, site: Site) -> None:
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null;")
    page.goto(site.address)
    page.wait_for_function(
        "document.querySelector('[role=status]').textContent.includes('WebGL 2')"
    )
    page.close()


def test_from_a_disk_the_page_says_where_to_put_it(browser: Browser, site: Site) -> None:
    page = browser.new_page()
    page.goto((site.page / "index.html").as_uri())
    page.wait_for_function(
        "document.querySelector('[role=status]').textContent.includes('http.server')"
    )
    page.close()


def test_a_file_that_is_missing_is_named(browser: Browser, site: Site) -> None:
    page = browser.new_page()
    page.route("**/light/0.bin", lambda route: route.fulfill(status=404))
    page.goto(site.address)
    page.wait_for_function(
        "document.querySelector('[role=status]').textContent.includes('light/0.bin')",
        timeout=READY_MS,
    )
    page.close()
