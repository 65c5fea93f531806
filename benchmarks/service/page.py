"""Pictures of the page: provisional, final, with slices, and with two shadings side by side.

    python -m benchmarks.service page [SCENE.toml] [-o docs/page]

Starts `isogi serve` on an empty store and looks at its page in a headless Chromium.
"""

import io
import tempfile
import time
from pathlib import Path

import click
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.common.measurement import Measurement
from benchmarks.common.serving import serving
from benchmarks.common.suite import part
from benchmarks.service.browser import CHROMIUM
from isogi_server.settings import cores

WINDOW = (1280, 800)
"""Width and height of the window that is pictured."""

FINAL_MS = 600_000
VIEW = "azimuth=35&elevation=28&distance=3"
COMPARED = f"/?{VIEW}&compare=phong_shadow&overlay=error"
SOME = 20
"""Percent of the surface that are final in pictures of a page that is provisional."""

COLOURS = 255


@part()
@click.argument("scene", default="demo:casting")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), default=Path("docs/page")
)
def page(scene: str, output: Path) -> Measurement:
    """Pictures of the page, written into a folder, and the seconds to its first and its final
    ones.
    """
    output.mkdir(parents=True, exist_ok=True)
    figures: dict[str, float] = {}
    with (
        tempfile.TemporaryDirectory() as store,
        serving(scene, store, cores()) as served,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        address = served.url
        begun = time.monotonic()
        shown = opened(browser, f"{address}/?{VIEW}")
        figures["page opened after, s"] = time.monotonic() - begun
        while int(shown.get_attribute("#progress", "aria-valuenow") or 0) < SOME:
            shown.wait_for_timeout(200)
        for state in ("provisional", "final"):
            save(shown, output / f"{state}-1280-light.png", state)
            figures[f"{state} after, s"] = time.monotonic() - begun
        shown.click("#slices-button")
        shown.wait_for_selector("#slices figure:not([data-old])")
        shown.wait_for_selector("#stage[data-sharp]", timeout=FINAL_MS)
        save(shown, output / "slices.png", "final")
        compared = opened(browser, address + COMPARED)
        compared.wait_for_selector("#comparison[data-state=final]", timeout=FINAL_MS)
        save(compared, output / "compared.png", "final")
        browser.close()
    return Measurement(f"the page of {Path(scene).stem}", figures)


def opened(browser: Browser, address: str) -> Page:
    """A page with its first picture."""
    width, height = WINDOW
    page = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="light"
    ).new_page()
    page.goto(address)
    page.wait_for_selector("#stage[data-state]:not([data-state=loading])", timeout=FINAL_MS)
    return page


def save(page: Page, file: Path, state: str) -> None:
    """The page as it is seen, once its picture is in this state."""
    page.wait_for_selector(f"#stage[data-state={state}]", timeout=FINAL_MS)
    page.wait_for_timeout(300)
    with Image.open(io.BytesIO(page.screenshot())) as shot:
        few = shot.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(file, optimize=True)
    click.echo(f"{file}: {state}, {file.stat().st_size // 1024} KiB", err=True)
