"""Chromium that drags over the page: what each page sent, what came, and when it was shown.

A picture counts as shown at the end of the frame that paints it, an input from when the browser had
it.
"""

import asyncio
import math
import time
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import psutil
from playwright.async_api import FloatRect, Page, ViewportSize, async_playwright

CHROMIUM = "/usr/bin/chromium"
FLAGS = ("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")
BUTTONS: dict[str, Literal["left", "right"]] = {"camera": "left", "light": "right"}

RATE = 60.0
"""Moves of the pointer a second."""

SWING = 4.0
"""Seconds in which the pointer goes to and fro once."""

SETTLED = 3.0
"""Seconds after the end of a drag within which its last picture is shown."""

RECORDER = """
window.record = {inputs: [], sent: [], came: [], shown: []};
addEventListener("pointermove", (event) => record.inputs.push(event.timeStamp), true);
const painted = new MessageChannel();
const drawn = [];
painted.port1.onmessage = () =>
  drawn.splice(0).forEach((id) => record.shown.push([performance.now(), id]));
window.WebSocket = class extends WebSocket {
  constructor(...given) {
    super(...given);
    this.addEventListener("message", ({ data }) => {
      if (typeof data === "string") this.facts = JSON.parse(data);
      else record.came.push([performance.now(), this.facts]);
    });
  }
  send(text) {
    const { id, moving, shown } = JSON.parse(text);
    super.send(text);
    if (shown === undefined) return void record.sent.push([performance.now(), id, Boolean(moving)]);
    requestAnimationFrame(() => { drawn.push(shown); painted.port2.postMessage(null); });
  }
};
"""
"""Notes on each page when the pointer moved, views went out, pictures came, and when they were
painted.
"""

SHAPE = (
    "(stage, size) => Object.assign(stage.style, {width: `${size}px`, height: `${size}px`, "
    "minHeight: 0})"
)


@dataclass(frozen=True, eq=False)
class Track:
    """What one page saw, in milliseconds of its own clock, all in the order of time.

    When there was input; when which views were sent; when pictures came, with what the stream told
    of them; and when which of these were painted.
    """

    inputs: np.ndarray
    sent: np.ndarray
    sent_ids: np.ndarray
    came: np.ndarray
    told: list[dict[str, Any]]
    shown: np.ndarray
    shown_ids: np.ndarray

    @property
    def legs(self) -> dict[str, np.ndarray]:
        """How long each input took to the picture that answers it, one of a view sent since; and
        the legs of that.
        """
        first = np.searchsorted(self.sent, self.inputs)
        inputs = self.inputs[first < len(self.sent)]
        first = first[first < len(self.sent)]
        drafts = np.array([told["id"] for told in self.told if told["draft"]])
        came = np.array(
            [at for at, told in zip(self.came, self.told, strict=True) if told["draft"]]
        )
        return {
            "input to shown": self._shown(self.sent_ids[first]) - inputs,
            "input to sent": self.sent[first] - inputs,
            "sent to came": came - self.sent[np.searchsorted(self.sent_ids, drafts)],
            "came to shown": self._shown(drafts) - came,
        }

    @property
    def drafts(self) -> list[dict[str, Any]]:
        """What was told of the drafts that were painted."""
        return [told for told in self.told if told["draft"] and told["id"] in self.shown_ids]

    def _shown(self, ids: np.ndarray) -> np.ndarray:
        """When each of these views, or a later one, was first on the screen."""
        return self.shown[np.searchsorted(self.shown_ids, ids)]


def track(record: dict[str, list[Any]]) -> Track:
    """The track in what a page noted."""
    inputs, sent, came, shown = (record[name] for name in ("inputs", "sent", "came", "shown"))
    times = [np.array([each[0] for each in part]) for part in (sent, came, shown)]
    ids = [np.array([each[1] for each in part]) for part in (sent, shown)]
    return Track(
        np.array(inputs), times[0], ids[0], times[1], [told for _, told in came], times[2], ids[1]
    )


class Tab:
    """A page whose stage is a square of ``size`` CSS pixels, and the pointer over it."""

    def __init__(self, page: Page, size: int) -> None:
        self._page = page
        self._size = size

    async def open(self, url: str) -> None:
        """Open the page and wait until it shows its first pictures of that size."""
        await self._page.add_init_script(RECORDER)
        await self._page.goto(url)
        await self._page.wait_for_selector("#picture:not([hidden])", timeout=60_000)
        await self._page.locator("#stage").evaluate(SHAPE, self._size)
        await self._page.locator("#stage").scroll_into_view_if_needed()
        await asyncio.sleep(SETTLED)

    async def drag(self, seconds: float, turn: str) -> Track:
        """Drag to and fro over the stage, let go, and tell what there was until the view had
        rested.
        """
        mouse = self._page.mouse
        button = BUTTONS[turn]
        box = await self._page.locator("#stage").bounding_box()
        assert box is not None
        await mouse.move(*self._place(box, 0.0))
        await mouse.down(button=button)
        await self._page.evaluate("Object.values(record).forEach((list) => list.length = 0)")
        begun = time.perf_counter()
        while (passed := time.perf_counter() - begun) < seconds:
            await mouse.move(*self._place(box, passed))
            await asyncio.sleep(max(0.0, 1.0 / RATE - (time.perf_counter() - begun - passed)))
        await mouse.up(button=button)
        await asyncio.sleep(SETTLED)
        return track(await self._page.evaluate("record"))

    def _place(self, box: FloatRect, passed: float) -> tuple[float, float]:
        """Where the pointer is after so many seconds."""
        turn = 2.0 * math.pi * passed / SWING
        across = 0.5 + 0.35 * math.sin(turn)
        down = 0.5 + 0.1 * math.cos(turn)
        return box["x"] + self._size * across, box["y"] + self._size * down


async def drags(
    url: str, size: int, seconds: float, pages: int, turn: str
) -> tuple[list[Track], dict[str, float]]:
    """What so many pages at once saw, and how many cores each kind of process under this one took
    meanwhile.
    """
    async with async_playwright() as playwright:
        chromium = await playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        viewport = ViewportSize(width=size + 48, height=size + 240)
        tabs = [
            Tab(await (await chromium.new_context(viewport=viewport)).new_page(), size)
            for _ in range(pages)
        ]
        for tab in tabs:
            await tab.open(url)
        before = processor_seconds()
        begun = time.perf_counter()
        tracks = await asyncio.gather(*(tab.drag(seconds, turn) for tab in tabs))
        passed = time.perf_counter() - begun
        cores = {
            kind: (taken - before[kind]) / passed
            for kind, taken in sorted(processor_seconds().items())
        }
        await chromium.close()
    return tracks, cores


def processor_seconds() -> defaultdict[str, float]:
    """Seconds of the processor that the processes under this one have taken, by their kind."""
    taken: defaultdict[str, float] = defaultdict(float)
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.NoSuchProcess), process.oneshot():
            taken[kind_of(process)] += sum(process.cpu_times()[:2])
    return taken


def kind_of(process: psutil.Process) -> str:
    """What a process under this one is: Chromium's, the server, a worker, or what drives the
    browser.
    """
    if "chrom" in process.name():
        return "chromium"
    command = process.cmdline()
    if "serve" in command:
        return "server"
    if any("multiprocessing" in part for part in command):
        return "workers"
    return "driver"
