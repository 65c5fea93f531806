"""What a person sees of a new scene: the page from its first moment on, in pictures, words, and the
time left it told.

    python -m benchmarks.service first-look SCENE [SCENE …] [--window 1280x800] [--ratio 1] [--until
    60] [-o FOLDER]

Each scene has a server and an empty store of its own. A time left counts as held where the picture
was done between half of it and twice it; what was not done by the end is told as that.
"""

import math
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click
from playwright.sync_api import Page, sync_playwright

from benchmarks.common.measurement import Measurement
from benchmarks.common.serving import serving
from benchmarks.common.suite import part
from benchmarks.service.browser import CHROMIUM, FLAGS
from isogi_server.settings import cores

MOMENTS = (0.3, 1.0, 2.0, 5.0, 10.0, 20.0)
"""Seconds after the page was asked for at which it is pictured."""

PAUSE_MS = 50
"""Between two looks at what the page says."""

LEFT = re.compile(r"about ([\d.]+) (s|min|h) left")
SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True)
class Told:
    """What the page said, so many ``seconds`` after it was asked for: its ``state`` and
    ``words``.
    """

    seconds: float
    state: str
    words: str

    @property
    def left(self) -> float | None:
        """Seconds that it said are left; None where it said nothing of that."""
        found = LEFT.search(self.words)
        if found is None:
            return None
        return float(found[1]) * SECONDS[found[2]]


@part()
@click.argument("scenes", nargs=-1, required=True)
@click.option(
    "--window", default="1280x800", show_default=True, help="Width and height, in CSS pixels."
)
@click.option(
    "--ratio",
    type=click.FloatRange(0.5, 4),
    default=1.0,
    show_default=True,
    help="Device pixels of each.",
)
@click.option(
    "--until",
    type=click.FloatRange(min=1),
    default=60.0,
    show_default=True,
    help="Seconds to look.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    help="A folder for the pictures.",
)
def first_look(
    scenes: tuple[str, ...], window: str, ratio: float, until: float, output: Path | None
) -> Iterator[Measurement]:
    """What a person sees of new scenes, and whether the time left was true."""
    width, height = map(int, window.split("x"))
    for scene in scenes:
        name = Path(scene).stem
        with tempfile.TemporaryDirectory() as store, serving(scene, store, cores()) as served:
            if output is None:
                folder = None
            else:
                folder = output / f"{name}-{window}-{ratio:g}"
            told = looked_at(served.url, (width, height), ratio, until, folder)
            yield Measurement(
                f"{name}, {window} at {ratio:g} device pixels",
                {"ready after, s": served.ready_after} | figures(told, until),
            )


def looked_at(
    url: str, size: tuple[int, int], ratio: float, until: float, folder: Path | None
) -> list[Told]:
    """All that the page says, as it changes, until it is done or the time is over; MOMENTS become
    pictures.
    """
    width, height = size
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        page = browser.new_page(
            viewport={"width": width, "height": height},
            device_scale_factor=ratio,
            has_touch=width < 600,
        )
        begun = time.monotonic()
        page.goto(url, wait_until="commit")
        told = list(watched(page, begun, until, folder))
        browser.close()
    return told


def watched(page: Page, begun: float, until: float, folder: Path | None) -> Iterator[Told]:
    """What the page says whenever that changes, and at each of the MOMENTS."""
    moments = list(MOMENTS)
    before = ("", "")
    while (passed := time.monotonic() - begun) < until:
        found = page.locator("#stage"), page.locator("#status-line")
        said = (found[0].get_attribute("data-state") or "", found[1].text_content() or "")
        due = bool(moments) and passed >= moments[0]
        if due:
            moment = moments.pop(0)
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
                page.screenshot(path=folder / f"{moment:04.1f}s.png")
        if due or said != before:
            before = said
            yield Told(passed, *said)
        if said[0] == "final" and not moments:
            return
        page.wait_for_timeout(PAUSE_MS)


def first(told: list[Told], holds: Callable[[Told], bool]) -> float:
    """After how many seconds something held first; infinite where it never did."""
    return next((each.seconds for each in told if holds(each)), math.inf)


def figures(told: list[Told], until: float) -> dict[str, float | str | bool]:
    """When the first picture came, what was said at each moment, when it was done, and whether the
    time left held.
    """
    found: dict[str, float | str | bool] = {}
    end = first(told, lambda each: each.state == "final")
    for name, seconds in (
        ("first picture", first(told, lambda each: each.state not in ("", "loading"))),
        ("with light", first(told, lambda each: each.words.startswith(("Refining", "Done")))),
        ("done", end),
    ):
        if math.isfinite(seconds):
            found[f"{name} after, s"] = seconds
        else:
            found[f"{name} after, s"] = f"not within {until:g}"
    for moment in MOMENTS:
        at = next((each for each in told if each.seconds >= moment), told[-1])
        found[f"at {moment:g} s"] = at.words or at.state
        if at.left is not None and math.isfinite(end):
            held = (end - at.seconds) / 2 <= at.left <= 2 * (end - at.seconds)
            found[f"left at {moment:g} s, s"] = end - at.seconds
            found[f"time left held, {moment:g} s"] = held
    return found
