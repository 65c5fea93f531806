"""Dragging over a stream while the workers bake: how long from an input to the picture that answers
it.

    python -m benchmarks.service drag [SCENE.toml] [--size 512] [--seconds 10] [--pages 1] [--turn
    light] [--browser]

Starts `isogi serve` on an empty store. Each page sends 60 views a second, as a hand does that
drags; an input is answered by the first picture of its view or of a later one. Then the view rests
until its full picture is there. With ``--browser`` pages are those of headless Chromium, and a
picture counts from when it is painted.
"""

import asyncio
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import click
import numpy as np
from websockets.asyncio.client import ClientConnection, connect

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.scenes import scene_file
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from benchmarks.service.browser import Track
from benchmarks.service.browser import drags as drags_in_browser

RATE = 60.0
"""Inputs a second."""

START: dict[str, Any] = {"elevation": 30.0, "distance": 3.0, "fov": 30.0}
STEPS = {"camera": "azimuth", "light": "yaw"}
PARTS = {"median": 50, "95 %": 95, "longest": 100}


class Hand:
    """One page: what it sent, and what came when."""

    def __init__(self, socket: ClientConnection, size: int, turn: str, first: float) -> None:
        self._socket = socket
        self._turn = turn
        self._first = first
        self._view = {**START, "azimuth": 40.0 + first, "width": size, "height": size}
        self.sent: list[float] = []
        self.came: list[tuple[float, dict[str, Any]]] = []
        self.full = asyncio.Event()

    async def drag(self, seconds: float) -> None:
        """Drag for so long, then rest until the full picture is there."""
        listening = asyncio.create_task(self._listen())
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            await self._say(moving=True)
            await asyncio.sleep(1.0 / RATE)
        await self._say(moving=False)
        await self.full.wait()
        listening.cancel()

    async def _say(self, moving: bool) -> None:
        number = len(self.sent)
        angle = (self._first + 1.2 * number) % 360.0
        message = {"id": number, "view": self._view | {STEPS[self._turn]: angle}, "moving": moving}
        await self._socket.send(json.dumps(message))
        self.sent.append(time.perf_counter())

    async def _listen(self) -> None:
        while True:
            facts = json.loads(await self._socket.recv())
            await self._socket.recv()
            self.came.append((time.perf_counter(), facts))
            await self._socket.send(json.dumps({"shown": facts["id"]}))
            if not facts["draft"]:
                self.full.set()

    @property
    def waits(self) -> Iterator[float]:
        """Seconds from each input to the picture that answers it."""
        arrivals = iter(self.came)
        at, facts = next(arrivals)
        for number, sent in enumerate(self.sent):
            while facts["id"] < number:
                at, facts = next(arrivals)
            yield at - sent


async def drags(url: str, size: int, seconds: float, pages: int, turn: str) -> list[Hand]:
    """So many pages at once."""
    sockets = [await connect(url, max_size=None, compression=None) for _ in range(pages)]
    hands = [Hand(socket, size, turn, 77.0 * page) for page, socket in enumerate(sockets)]
    await asyncio.gather(*(hand.drag(seconds) for hand in hands))
    for socket in sockets:
        await socket.close()
    return hands


def figures(hands: list[Hand], seconds: float) -> dict[str, float | int | str]:
    """What all hands saw, in milliseconds."""
    waits = 1000.0 * np.array([wait for hand in hands for wait in list(hand.waits)[:-1]])
    drafts = [facts for hand in hands for _, facts in hand.came if facts["draft"]]
    gaps = 1000.0 * np.array(
        [b - a for hand in hands for (a, _), (b, _) in zip(hand.came, hand.came[1:], strict=False)]
    )
    full = [1000.0 * list(hand.waits)[-1] for hand in hands]
    stages = sorted({stage for facts in drafts for stage in facts["timing"]})
    medians = {
        f"{stage}, median": float(np.median([facts["timing"].get(stage, 0.0) for facts in drafts]))
        for stage in stages
    }
    return {
        "input to picture, median": float(np.median(waits)),
        "input to picture, 95 %": float(np.percentile(waits, 95)),
        "input to picture, longest": float(waits.max()),
        "drafts a second and page": len(drafts) / seconds / len(hands),
        "between pictures, 95 %": float(np.percentile(gaps, 95)),
        "pixels along a draft, median": float(np.median([facts["width"] for facts in drafts])),
        "rest to full picture, longest": max(full),
        "final at the end, %": 100.0 * hands[0].came[-1][1]["facts"]["coverage"]["final"],
        **medians,
    }


def over_sockets(server: Served, size: int, seconds: float, pages: int, turn: str) -> Figures:
    """Drag over sockets of this process."""
    url = server.stream
    return figures(asyncio.run(drags(url, size, seconds, pages, turn)), seconds)


def in_browser(server: Served, size: int, seconds: float, pages: int, turn: str) -> Figures:
    """Drag on pages in Chromium."""
    tracks, cores = asyncio.run(drags_in_browser(server.url, size, seconds, pages, turn))
    return browser_figures(tracks, cores, seconds)


def browser_figures(
    tracks: list[Track], cores: dict[str, float], seconds: float
) -> dict[str, float | int | str]:
    """What pages in a browser saw, in milliseconds, and how many cores what took."""
    legs = {leg: np.concatenate([track.legs[leg] for track in tracks]) for leg in tracks[0].legs}
    drafts = [told for track in tracks for told in track.drafts]
    stages = sorted({stage for told in drafts for stage in told["timing"]})
    return {
        **{
            f"{leg}, {name}": float(np.percentile(legs[leg], q))
            for leg in legs
            for name, q in PARTS.items()
        },
        "drafts a second and page": len(drafts) / seconds / len(tracks),
        "pixels along a draft, median": float(np.median([told["width"] for told in drafts])),
        **{
            f"{s}, median": float(np.median([told["timing"].get(s, 0.0) for told in drafts]))
            for s in stages
        },
        **{f"cores, {kind}": cores[kind] for kind in cores},
    }


@part(size=512)
@click.argument("target", required=False)
@click.option("--seconds", default=10.0, show_default=True, help="Seconds to drag for.")
@click.option("--pages", default=1, show_default=True, help="Pages that drag at once.")
@click.option(
    "--turn",
    type=click.Choice(list(STEPS)),
    default="camera",
    show_default=True,
    help="What is turned.",
)
@click.option("--workers", default=2, show_default=True, help="Worker processes.")
@click.option("--browser", is_flag=True, help="Drag in headless Chromium.")
def drag(
    target: str | None,
    size: int,
    seconds: float,
    pages: int,
    turn: Literal["camera", "light"],
    workers: int,
    browser: bool,
) -> Measurement:
    """From an input to the picture that answers it, while a hand drags and the workers bake."""
    with tempfile.TemporaryDirectory() as folder:
        scene = target or scene_file(Path(folder))
        with serving(scene, f"{folder}/light", workers) as server:
            found = (in_browser if browser else over_sockets)(server, size, seconds, pages, turn)
    title = (
        f"{Path(scene).stem}, {size} × {size}, {pages} page(s), {turn} turned, {workers} workers"
    )
    return Measurement(title, found, variant="-".join([turn, *(["browser"] if browser else [])]))
