"""What visitors who turn the object take of the server: those whose cards draw, beside those who
get drafts.

    python -m benchmarks.service visitors [SCENE.toml] [--visitors 50] [--seconds 20] [--views 12]

Starts `isogi serve`, has it bake the views all around, and then turns as many visitors as are asked
for, once by the light that their cards lack, as the page asks for it, and once by drafts over
streams. Counts seconds of the processor that the server process takes, and bytes; a busy machine
changes neither.
"""

import asyncio
import tempfile
import time
from dataclasses import dataclass, field
from typing import Any

import click
import httpx
import psutil

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from benchmarks.service.drag import RATE, START, drags
from isogi.client import Isogi

STEP = 1.2 * RATE
"""Degrees a second that the object is turned by, as ``Hand`` does."""

LIST = 1.0
"""Seconds between two lists of chunks of a view that moves: LIST_MS in
web/isogi_web/live/live.js.
"""

FIRST = 16
TOGETHER = 64
"""Chunks of a visitor's first request, and of others: those of web/isogi_web/live/feed.js."""

NEAR = 15.0
"""Degrees between the views that are listed while the camera turns: STEP in
web/isogi_web/live/view.js.
"""

LOOK = {"width": 160, "height": 160}
"""Pixels of views whose chunks are asked for: WIDEST in web/isogi_web/live/view.js."""

UNLIT = "0" * 16
"""The version of a chunk without light."""


@dataclass
class Visitor:
    """A page whose card draws: the chunks that it ``knows``, the views of whose final light it
    knows the ``lists``, the requests it has ``asked``, the ``bytes`` that came.
    """

    client: httpx.AsyncClient
    path: str
    first: float
    knows: set[str] = field(default_factory=set)
    lists: set[float] = field(default_factory=set)
    asked: int = 0
    bytes: int = 0

    async def turn(self, seconds: float) -> None:
        """Turn the object for so long, and bring what light its views read."""
        begun = time.perf_counter()
        while (passed := time.perf_counter() - begun) < seconds:
            azimuth = NEAR * round((self.first + STEP * passed) / NEAR) % 360.0
            if azimuth not in self.lists:
                await self.look(azimuth)
            await asyncio.sleep(max(begun + passed + LIST - time.perf_counter(), 0.0))

    async def look(self, azimuth: float) -> None:
        """Ask for what a view reads, and bring it."""
        listed = (await self.ask("card/chunks", {**START, **LOOK, "azimuth": azimuth})).json()[
            "chunks"
        ]
        names = [f"{each['at']}-{each['version']}" for each in listed if each["version"] != UNLIT]
        if all(each["final"] for each in listed):
            self.lists.add(azimuth)
        await self.bring([name for name in names if name not in self.knows])

    async def bring(self, names: list[str]) -> None:
        """Ask for the light of chunks, the most visible ones first."""
        while names:
            some = names[: TOGETHER if self.knows else FIRST]
            await self.ask(f"card/light/{','.join(some)}", {})
            self.knows.update(some)
            names = names[len(some) :]

    async def ask(self, what: str, query: dict[str, Any]) -> httpx.Response:
        """What the server answers; the bytes are those of the wire."""
        answer = await self.client.get(f"{self.path}/{what}", params=query)
        answer.raise_for_status()
        self.asked = self.asked + 1
        self.bytes = self.bytes + answer.num_bytes_downloaded
        return answer


async def turned(server: Served, count: int, seconds: float) -> list[Visitor]:
    """So many visitors with cards at once, once they have turned."""
    limits = httpx.Limits(max_connections=None)
    async with httpx.AsyncClient(base_url=server.url, timeout=120.0, limits=limits) as client:
        visitors = [Visitor(client, server.path, 77.0 * number) for number in range(count)]
        await asyncio.gather(*(each.turn(seconds) for each in visitors))
    return visitors


def processor(server: Served) -> float:
    """Seconds of the processor that the server process has taken, its workers left out."""
    times = psutil.Process(server.process.pid).cpu_times()
    return float(times.user + times.system)


def figures(server: Served, count: int, seconds: float, size: int) -> Figures:
    """What both kinds of visitors take."""
    before = processor(server)
    visitors = asyncio.run(turned(server, count, seconds))
    by_cards = processor(server) - before
    before = processor(server)
    hands = asyncio.run(drags(server.stream, size, seconds, count, "camera"))
    by_drafts = processor(server) - before
    drafts = sum(facts["draft"] for hand in hands for _, facts in hand.came)
    return {
        "visitors": count,
        "processor, cards, s": by_cards,
        "processor, drafts, s": by_drafts,
        "cards over drafts": by_cards / by_drafts,
        "requests of a card": sum(each.asked for each in visitors) / count,
        "KB of a card": sum(each.bytes for each in visitors) / count / 1000.0,
        "drafts a second and visitor": drafts / seconds / count,
    }


@part(size=512)
@click.argument("target", default="demo:casting")
@click.option(
    "--visitors", "count", type=click.IntRange(1), default=50, show_default=True, help="At once."
)
@click.option("--seconds", default=20.0, show_default=True, help="For which they turn.")
@click.option(
    "--views", default=12, show_default=True, help="Views all around that are baked before."
)
def visitors(target: str, count: int, seconds: float, views: int, size: int) -> Measurement:
    """What visitors who turn the object take of the server: cards beside drafts."""
    with tempfile.TemporaryDirectory() as store, serving(target, store, 2) as server:
        with Isogi(server.url, patience=600.0) as isogi:
            isogi.prewarm(isogi.scenes()[0]["id"], views=views, width=size, height=size).wait()
        found = figures(server, count, seconds, size)
    return Measurement(f"{count} visitors who turn the object for {seconds:g} s", found)
