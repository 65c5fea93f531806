"""Draws docs/page/film.webp: the page in use, from the first picture to a turn, another isovalue
and other light.

    .venv/bin/python docs/draw_film.py [TARGET] [-o FILE]

Starts `isogi serve` on an empty store, and looks at its page in a headless Chromium. Everything is
done by pointer as a person would, at that pace; what the film shows is what this machine showed.
"""

import io
import math
import re
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import click
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from benchmarks.common.serving import serving
from benchmarks.service.browser import CHROMIUM
from isogi_server.settings import cores

WINDOW = (1080, 640)
SHOWN = (810, 480)
"""Width and height of the window, and of the film."""

FPS = 8.0
PATIENCE_MS = 600_000
MOST = 2 << 20
"""Bytes that the film may have."""

GOOD = 5.0
"""Percent of error at which a picture has been watched for long enough."""

SHARE = (
    "(() => { const s = document.querySelector('#isovalue'); return (s.value - s.min) / "
    "(s.max - s.min); })()"
)
"""Where the slider of isovalues is, as a share of its way."""

POINTER = """() => {
  const dot = document.createElement("div");
  dot.style.cssText = "position:fixed;z-index:99;width:18px;height:18px;margin:-9px;" +
    "border-radius:50%;background:#efb75acc;box-shadow:0 0 0 2px #0006;" +
    "pointer-events:none;left:50%;top:50%";
  document.body.append(dot);
  addEventListener("pointermove", (event) => {
    dot.style.left = `${event.clientX}px`;
    dot.style.top = `${event.clientY}px`;
  }, true);
}"""
"""Shows where the pointer is: headless browsers draw none."""


@dataclass
class Camera:
    """Takes pictures of a ``page``, FPS a second where the machine keeps up, and notes when each
    was ``taken``.
    """

    page: Page
    frames: list[Image.Image] = field(default_factory=list)
    taken: list[float] = field(default_factory=list)
    due: float = field(default_factory=time.monotonic)

    def take(self) -> None:
        """The next picture, when it is due."""
        self.page.wait_for_timeout(max(0.0, 1000.0 * (self.due - time.monotonic())))
        self.due = max(self.due + 1.0 / FPS, time.monotonic())
        self.taken.append(time.monotonic())
        with Image.open(io.BytesIO(self.page.screenshot())) as shot:
            self.frames.append(shot.convert("RGB").resize(SHOWN, Image.Resampling.LANCZOS))

    def durations(self) -> list[int]:
        """Milliseconds from each picture to the next, as they were taken."""
        return [
            round(1000.0 * (after - before))
            for before, after in pairwise([*self.taken, time.monotonic()])
        ]

    def rest(self, least: float, most: float = 0.0) -> None:
        """Watch what happens by itself, ``least`` seconds, and up to ``most`` until the picture's
        error is GOOD.
        """
        begun = time.monotonic()
        former = self.shown()
        while (spent := time.monotonic() - begun) < least or (
            spent < most and not self.good(former)
        ):
            self.take()

    def shown(self) -> str:
        """The picture on the stage."""
        return str(self.page.get_attribute("#picture", "src"))

    def good(self, former: str) -> bool:
        """Whether another picture than the ``former`` is shown, and the line under it tells at most
        GOOD.
        """
        told = re.search(r"([\d.]+) % error", self.page.inner_text("#status-line"))
        return self.shown() != former and told is not None and float(told[1]) <= GOOD


def steps(count: int) -> Iterator[float]:
    """Shares of a way, from rest to rest."""
    return (0.5 - 0.5 * math.cos(math.pi * (n + 1) / count) for n in range(count))


def drag(
    camera: Camera, start: tuple[float, float], way: tuple[float, float], seconds: float
) -> None:
    """Drag from ``start`` along a ``way``, pixels."""
    mouse = camera.page.mouse
    mouse.move(*start)
    mouse.down()
    for share in steps(round(seconds * FPS)):
        mouse.move(start[0] + way[0] * share, start[1] + way[1] * share)
        camera.take()
    mouse.up()


def middle(page: Page, selector: str) -> tuple[float, float]:
    """The middle of a part of the page."""
    box = page.locator(selector).bounding_box()
    assert box is not None, f"{selector} is on the page"
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def play(camera: Camera) -> None:
    """What the film shows."""
    page = camera.page
    stage = middle(camera.page, "#stage")
    camera.rest(3.0, 8.0)
    drag(camera, stage, (-120.0, -20.0), 2.0)
    camera.rest(1.5, 7.0)
    box = page.locator("#isovalue").bounding_box()
    assert box is not None
    at = float(page.evaluate(SHARE))
    drag(
        camera,
        (box["x"] + 8 + at * (box["width"] - 16), box["y"] + 9),
        (-0.06 * box["width"], 0.0),
        1.6,
    )
    camera.rest(1.5, 7.0)
    for light in ("studio", "evening"):
        page.mouse.move(*middle(page, "#environment"))
        page.select_option("#environment", light)
        camera.rest(2.5, 9.0)
    drag(camera, middle(page, "#globe"), (-40.0, 6.0), 1.6)
    camera.rest(2.5, 7.0)


@click.command()
@click.argument("target", default="demo:casting")
@click.option("-o", "--output", default=Path(__file__).parent / "page" / "film.webp", type=Path)
@click.option("--quality", default=60)
def main(target: str, output: Path, quality: int) -> None:
    """Draw the film of the page that shows TARGET."""
    with (
        tempfile.TemporaryDirectory() as store,
        serving(target, store, cores()) as served,
        sync_playwright() as browsers,
    ):
        browser = browsers.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        width, height = WINDOW
        page = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme="light"
        ).new_page()
        page.goto(served.url)
        page.wait_for_selector("#picture:not([hidden])", timeout=PATIENCE_MS)
        page.evaluate(POINTER)
        camera = Camera(page)
        play(camera)
        durations = camera.durations()
        browser.close()
    first, *others = camera.frames
    first.save(
        output,
        save_all=True,
        append_images=others,
        duration=durations,
        loop=0,
        quality=quality,
        method=6,
    )
    size = output.stat().st_size
    click.echo(f"{output}: {len(camera.frames)} frames, {size // 1024} KiB")
    if size > MOST:
        raise click.ClickException(f"The film may have {MOST} bytes: give a lower --quality.")


if __name__ == "__main__":
    main()
