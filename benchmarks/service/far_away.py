"""What a visitor far away sees of the page, and of published pages: requests, bytes, and when the
first picture, the card's first one (of published pages by coarse light), and all light are there.

    python -m benchmarks.service far-away [SCENE] [--published FOLDER …] [--megabits 1] [--trip 0.3]

Bytes and requests are the same on a busy machine; seconds are not.
"""

import http.server
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import click
from playwright.sync_api import Page, sync_playwright

from benchmarks.common.measurement import Measurement
from benchmarks.common.serving import serving
from benchmarks.common.suite import part
from benchmarks.service.browser import CHROMIUM
from benchmarks.service.far_link import FarLink, far_link
from isogi_server.settings import cores

CARD_FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Flags of Chromium: it draws WebGL by its processor."""

PATIENCE_MS = 300_000
LIVE_MARKS = {"first picture": "#picture:not([hidden])"}
PUBLISHED_MARKS = {
    "first picture": "#poster",
    "card draws": "#stage[data-drawn]",
    "lit": "#stage[data-lit]",
}
"""What is on the page from a moment on, by the moment's name."""


class Quiet(http.server.SimpleHTTPRequestHandler):
    """A plain file server that prints nothing, and keeps connections."""

    protocol_version = "HTTP/1.1"

    def log_message(self, *_: Any) -> None:
        """Print nothing."""


@contextmanager
def shared(folder: Path) -> Iterator[str]:
    """The address of a folder on a plain file server."""
    handler = partial(Quiet, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@part()
@click.argument("scene", default="demo:casting")
@click.option(
    "--store",
    type=click.Path(path_type=Path),
    required=True,
    help="Where the scene's light is, or will be: the second visit is to light that is there.",
)
@click.option(
    "--published",
    multiple=True,
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="A folder that isogi publish --interactive wrote; may be given again.",
)
@click.option("--megabits", type=click.FloatRange(0.01), default=1.0, show_default=True)
@click.option("--trip", type=click.FloatRange(0.0), default=0.3, show_default=True)
def far_away(
    scene: str, store: Path, published: tuple[Path, ...], megabits: float, trip: float
) -> Iterator[Measurement]:
    """What a visitor far away waits for."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(CARD_FLAGS))

        def visited(url: str, marks: dict[str, str]) -> dict[str, float]:
            where = urlsplit(url)
            target = (where.hostname or "", where.port or 80)
            page = browser.new_page(viewport={"width": 640, "height": 560})
            with far_link(target, 1e6 * megabits / 8, trip) as (address, link):
                found = seen(page, address, marks, link)
                page.close()
            return found

        with serving(scene, str(store), cores()) as served:
            for visit in ("first visit", "second visit"):
                yield Measurement(f"{scene}, {visit}", visited(served.url, LIVE_MARKS))
        for folder in published:
            with shared(folder) as url:
                yield Measurement(f"{folder.name}, published", visited(url, PUBLISHED_MARKS))
        browser.close()


def seen(page: Page, address: str, marks: dict[str, str], link: FarLink) -> dict[str, float]:
    """Seconds, requests and bytes until each mark of a page is there."""
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    found: dict[str, float] = {}
    begun = time.monotonic()
    page.goto(address, wait_until="commit")
    for name, selector in marks.items():
        page.wait_for_selector(selector, state="attached", timeout=PATIENCE_MS)
        found[f"{name}, s"] = time.monotonic() - begun
        found[f"{name}, requests"] = sum(url.startswith("http") for url in asked)
        found[f"{name}, kB"] = link.down / 1e3
    return found
