"""Pictures of the page: three widths, both colour schemes, provisional and final; and two shadings side by side.

    python -m benchmarks.page_pictures [SCENE.toml] [-o docs/page]

Starts `isogi serve` on an empty store and looks at its page in a headless Chromium.
"""

import io
import tempfile
from pathlib import Path
from typing import Literal

import click
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.serving import serving
from server.settings import cores

CHROMIUM = "/usr/bin/chromium"
SIZES = ((1280, 800), (768, 1024), (390, 844))
SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
FINAL_MS = 600_000
VIEW = "azimuth=35&elevation=28&distance=3"
COMPARED = f"/?{VIEW}&compare=phong_shadow&overlay=error"
SOME = 20
"""Percent of the surface that are final in pictures of a page that is provisional."""

COLOURS = 255


@click.command()
@click.argument("scene", default="demo:casting")
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), default=Path("docs/page"))
def main(scene: str, output: Path) -> None:
    """Write the pictures of the page that shows SCENE into a folder."""
    output.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as store,
        serving(scene, store, cores()) as served,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        address = served.url
        pages = {
            f"{width}-{scheme}": opened(browser, f"{address}/?{VIEW}", width, height, scheme)
            for scheme in SCHEMES
            for width, height in SIZES
        }
        watched = next(iter(pages.values()))
        while int(watched.get_attribute("#progress", "aria-valuenow") or 0) < SOME:
            watched.wait_for_timeout(200)
        for name, page in pages.items():
            save(page, output / f"provisional-{name}.png", "provisional")
        for name, page in pages.items():
            save(page, output / f"final-{name}.png", "final")
        compared = opened(browser, address + COMPARED, *SIZES[0], "light")
        compared.wait_for_selector("#wipe[data-state=final]", timeout=FINAL_MS)
        save(compared, output / "compared.png", "final")
        browser.close()


def opened(browser: Browser, address: str, width: int, height: int, scheme: Literal["light", "dark"]) -> Page:
    """A page with its first picture."""
    page = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme).new_page()
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
    click.echo(f"{file}: {state}, {file.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main()
