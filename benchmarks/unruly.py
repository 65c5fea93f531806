"""Clients that do not behave, and a server that has to go: what others notice, and what is left behind.

    python -m benchmarks.unruly [SCENE.toml] [--slow 200] [--aborting 100] [--clients 32] [--seconds 10] [--json]

Slow clients send a head or a body byte by byte, or do not take their answers, while one that behaves asks for
frames. Then clients leave while they wait for light. At last the server is told to stop while others ask on.
"""

import asyncio
import itertools
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import click
import httpx

from benchmarks.common import Figures, show
from benchmarks.first_view import write_scene
from benchmarks.serving import Served, serving

SMALL: dict[str, Any] = {"width": 64, "height": 64}
LARGE = "frame?width=512&height=512&shading=lambert&f=npy"
PATIENT: dict[str, Any] = {**SMALL, "wait_ms": 10_000, "max_error": 0.0001}
"""A view whose light takes longer than anybody waits for it."""

DRIP = 0.5
"""Seconds between two bytes of a slow client."""

STAY, SOON = 2.0, 2.0
"""Seconds after which aborting clients leave, and after which nothing may be left of them."""


@asynccontextmanager
async def slow(server: Served, count: int) -> AsyncIterator[None]:
    """So many slow clients, by turns of three kinds, for a while."""
    head = f"GET {server.path}/{LARGE} HTTP/1.1\r\nHost: localhost\r\n"
    body = "POST /livez HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9999\r\n\r\n"
    kinds = (head + "X-Slow: ", body, head + "\r\n")
    dripping = [asyncio.create_task(drip(server, kinds[n % 3], n % 3 < 2)) for n in range(count)]
    try:
        yield
    finally:
        for task in dripping:
            task.cancel()
        await asyncio.wait(dripping)


async def drip(server: Served, said: str, more: bool) -> None:
    """Say this on a connection, and ``more`` byte by byte, or take nothing; again each time that it is closed."""
    place = urlsplit(server.url)
    while True:
        with suppress(OSError):
            reader, writer = await asyncio.open_connection(place.hostname, place.port, limit=1)
            try:
                writer.write(said.encode())
                while not writer.is_closing() and not reader.at_eof():
                    await asyncio.sleep(DRIP)
                    writer.write(b"x" * more)
                    await writer.drain()
            finally:
                writer.transport.abort()
        await asyncio.sleep(DRIP)


async def beside_slow(server: Served, count: int, seconds: float) -> Figures:
    """How a client fares that behaves."""
    ends: Counter[str] = Counter()
    async with slow(server, count):
        await asyncio.sleep(1.0)
        await ask(server, ends, asyncio.get_running_loop().time() + seconds)
    asked = sum(ends.values())
    return {
        f"beside {count} slow clients, asked": asked,
        "answered 200, %": 100.0 * ends["200"] / asked,
    }


async def after_aborts(server: Served, count: int) -> Figures:
    """What is left of clients that wait for light and leave."""
    files, wanted = server.footprint()["open files"], server.metric("isogi_queue_chunks")

    async def wait(number: int) -> None:
        with suppress(httpx.TimeoutException):
            async with httpx.AsyncClient(base_url=server.url, timeout=httpx.Timeout(30.0, read=STAY)) as http:
                await http.get(f"{server.path}/frame", params=PATIENT | {"azimuth": 3 * number})

    await asyncio.gather(*map(wait, range(count)))
    begun = time.perf_counter()
    while time.perf_counter() - begun < SOON and remains(server) > wanted:
        await asyncio.sleep(0.05)
    return {
        f"{count} clients have left: seconds until nothing of them was": time.perf_counter() - begun,
        "chunks wanted more than before": max(server.metric("isogi_queue_chunks") - wanted, 0.0),
        "requests in progress still": server.metric("isogi_requests_in_progress") - 1.0,
        "open files more than before": server.footprint()["open files"] - files,
    }


def remains(server: Served) -> float:
    """Chunks that wait, and requests besides the one that asks."""
    return server.metric("isogi_queue_chunks") + server.metric("isogi_requests_in_progress") - 1.0


async def through_stop(server: Served, count: int, seconds: float) -> Figures:
    """How clients fare, every other one with a connection for each request, while the server is told to stop."""
    ends: Counter[str] = Counter()
    assert server.path  # asked for while it is there
    asking = [asyncio.create_task(ask(server, ends, None, number)) for number in range(count)]
    await asyncio.sleep(seconds)
    answered = sum(ends.values())
    took = await asyncio.to_thread(server.stop)
    await asyncio.wait(asking)
    return {
        f"{count} clients until it stops: answered": answered,
        "seconds to its end": took,
        "exit status": server.process.returncode,
        **{f"answered {end}" if end.isdigit() else end: many for end, many in sorted(ends.items())},
    }


async def ask(server: Served, ends: Counter[str], until: float | None, number: int = 0) -> None:
    """Ask for one view after the other, until then or until the server is gone, and count how each ended."""
    headers = {"Connection": "close"} if number % 2 else {}
    async with httpx.AsyncClient(base_url=server.url, headers=headers, timeout=30.0) as http:
        for step in itertools.count():
            if until is not None and asyncio.get_running_loop().time() >= until:
                return
            wait = {"wait_ms": 9000} if number % 8 == 7 else {}
            try:
                view = SMALL | {"azimuth": 7 * (number + step) % 360} | wait
                ends[str((await http.get(f"{server.path}/frame", params=view)).status_code)] += 1
            except httpx.ConnectError:
                ends["found it gone"] += 1
                if until is None:
                    return
            except httpx.TransportError as error:
                ends[type(error).__name__] += 1


@click.command()
@click.argument("target", required=False)
@click.option("--slow", "slow_clients", default=200, show_default=True, help="Slow clients.")
@click.option("--aborting", default=100, show_default=True, help="Clients that leave.")
@click.option("--clients", default=32, show_default=True, help="Clients while it stops.")
@click.option("--seconds", default=10.0, show_default=True, help="How long each part goes on.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(target: str | None, slow_clients: int, aborting: int, clients: int, seconds: float, as_json: bool) -> None:
    """Behave badly, and tell what came of it."""
    with tempfile.TemporaryDirectory() as folder:
        scene = target or write_scene(Path(folder))
        with serving(scene, f"{folder}/light", 2) as server:
            found = {
                **asyncio.run(beside_slow(server, slow_clients, seconds)),
                **asyncio.run(after_aborts(server, aborting)),
                **asyncio.run(through_stop(server, clients, seconds / 2.0)),
            }
    show(scene, found, as_json)


if __name__ == "__main__":
    main()
