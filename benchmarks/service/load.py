"""Load on one server: many clients with mixed views, for a while.

    python -m benchmarks.service load [SCENE.toml] [--clients 64] [--before 0] [--seconds 20]
    [--memory-mb 128]

Starts `isogi serve` on an empty store. Clients look (with the tags of what they know), wait for
light, ask for coverage, listen to events, drag on streams, and leave early. Tells how many pictures
streams had while views moved and how old these were, how often which status came (200, 304 and 429
are as they should be), how long `/livez` took meanwhile, and what the server took: memory, open
files, processes. What they ask `before` is not counted, but its light is baked.
"""

import asyncio
import http.client
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from urllib.parse import urlsplit

import click
import numpy as np

from benchmarks.common.measurement import Figures, Measurement
from benchmarks.common.scenes import scene_file
from benchmarks.common.serving import Served, serving
from benchmarks.common.suite import part
from benchmarks.service.crowd import Answers, crowd

LOOKS = (30.0, 60.0, 120.0, 300.0)
"""Seconds after which it is looked at what the server takes, besides half of the time and the
end.
"""

EVERY = 0.05
"""Seconds between two probes."""

AFTER = 3.0
"""Seconds after which nothing of clients that have left may be there any more."""


class Probe(threading.Thread):
    """Asks `/livez` again and again on a connection of its own; ``seconds`` are how long each
    answer took.
    """

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self._place = urlsplit(url).netloc
        self._ended = threading.Event()
        self.seconds: list[float] = []
        self.statuses: Counter[int] = Counter()

    def run(self) -> None:
        """Ask until it is to end."""
        while not self._ended.wait(EVERY):
            begun = time.perf_counter()
            connection = http.client.HTTPConnection(self._place, timeout=30)
            connection.request("GET", "/livez")
            self.statuses[connection.getresponse().status] += 1
            connection.close()
            self.seconds.append(time.perf_counter() - begun)

    def stop(self) -> None:
        """Ask no more."""
        self._ended.set()
        self.join()


Footprints = dict[float, dict[str, float]]
"""What the server took after so many seconds."""


async def loaded(server: Served, clients: int, seconds: float) -> tuple[Answers, Footprints]:
    """What clients were answered, and what the server took meanwhile."""
    end = asyncio.Event()
    footprints = Footprints()
    scene = server.client.get(server.path).json()
    low, high = scene["ranges"]["isovalue"]["min"], scene["ranges"]["isovalue"]["max"]
    isovalues = tuple(low + share * (high - low) for share in (0.25, 0.3, 0.4, 0.5))
    going = asyncio.create_task(crowd(server.url, server.path, isovalues, clients, end))
    before = 0.0
    for spec in sorted({seconds / 2.0, seconds, *(each for each in LOOKS if each < seconds)}):
        await asyncio.sleep(spec - before)
        footprints[spec] = server.footprint()
        before = spec
    end.set()
    return await going, footprints


def figures(answers: Answers, probe: Probe, footprints: Footprints) -> Figures:
    """All that was found."""
    waits = 1000.0 * np.array(probe.seconds)
    rates = np.array(answers.rates or [0.0])
    ages = np.array(answers.ages or [np.inf])
    return {
        "pictures a second, worst stream": float(rates.min()),
        "pictures a second, 5 % of streams": float(np.percentile(rates, 5)),
        "pictures a second, median": float(np.median(rates)),
        "streams": len(answers.rates),
        "streams without a picture": int((rates == 0.0).sum()),
        "age of a picture, median, s": float(np.median(ages)),
        "age of a picture, 95 %, s": float(np.percentile(ages, 95, method="inverted_cdf")),
        **{f"answered {status}": count for status, count in sorted(answers.counts.items())},
        "livez, answers": len(waits),
        "livez, median, ms": float(np.median(waits)),
        "livez, 99 %, ms": float(np.percentile(waits, 99)),
        "livez, longest, ms": float(waits.max()),
        **{
            f"{what}, {at:g} s": taken[what]
            for what in footprints[max(footprints)]
            for at, taken in footprints.items()
        },
    }


@part()
@click.argument("target", required=False)
@click.option("--clients", default=64, show_default=True, help="Clients at once.")
@click.option(
    "--before", default=0.0, show_default=True, help="Seconds for which they ask before it counts."
)
@click.option("--seconds", default=20.0, show_default=True, help="How long they ask.")
@click.option("--workers", default=2, show_default=True, help="Worker processes.")
@click.option(
    "--memory-mb", default=128, show_default=True, help="Megabytes that the scene keeps in memory."
)
def load(
    target: str | None, clients: int, before: float, seconds: float, workers: int, memory_mb: int
) -> Measurement:
    """Many clients with mixed views: what they were answered, and what the server took."""
    with tempfile.TemporaryDirectory() as folder:
        scene = target or scene_file(Path(folder))
        with serving(scene, f"{folder}/light", workers, "--memory-mb", str(memory_mb)) as server:
            if before:
                asyncio.run(loaded(server, clients, before))
            probe = Probe(server.url)
            probe.start()
            answers, footprints = asyncio.run(loaded(server, clients, seconds))
            probe.stop()
            time.sleep(AFTER)
            left = {
                "requests in progress, afterwards": server.metric("isogi_requests_in_progress")
                - 1.0,
                "chunks wanted, afterwards": server.metric("isogi_queue_chunks"),
                "open files, afterwards": server.footprint()["open files"],
            }
    found = {**figures(answers, probe, footprints), **left}
    return Measurement(f"{Path(scene).stem}, {clients} clients, {seconds:g} s", found)
