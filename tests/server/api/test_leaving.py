"""Who leaves stops costing: what nobody waits for any more is gone from the queue, whichever way it
was asked for.
"""

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect

from tests.server.asking import UPGRADE
from tests.server.idle import Idle, idle_server

SOON = 20.0
"""Seconds within which wants are gone also on a slow machine; what is not asked for again is
forgotten much later.
"""

VIEW: dict[str, Any] = {"width": 40, "height": 40, "azimuth": 77}
PATH = "/v1/scenes/small"


@pytest.fixture(scope="module")
def served(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Idle]:
    with idle_server(small_scene, tmp_path_factory.mktemp("dark"), streams=2) as idle:
        yield idle


@pytest.fixture
def idle(served: Idle) -> Idle:
    """Nothing is wanted yet."""
    asyncio.run(served.until(lambda: not served.wanted, SOON))
    return served


def stream_of(idle: Idle) -> connect:
    return connect(idle.url.replace("http", "ws") + PATH + "/stream")


@asynccontextmanager
async def watching(idle: Idle, azimuth: int = 77) -> AsyncIterator[ClientConnection]:
    """A stream whose view wants light that nobody else wants."""
    before = idle.wanted
    async with stream_of(idle) as socket:
        await socket.send(json.dumps({"id": 1, "view": VIEW | {"azimuth": azimuth}}))
        await idle.until(lambda: idle.wanted > before, 60)
        yield socket


async def test_a_stream_that_is_closed_wants_nothing_more(idle: Idle) -> None:
    async with watching(idle):
        pass
    await idle.until(lambda: not idle.wanted, SOON)


async def test_a_stream_that_is_torn_wants_nothing_more(idle: Idle) -> None:
    async with watching(idle) as socket:
        socket.transport.abort()
        await idle.until(lambda: not idle.wanted, SOON)


async def test_a_stream_that_looks_elsewhere_wants_that_alone(idle: Idle) -> None:
    async with watching(idle) as socket:
        away = {"width": 9, "height": 9, "eye": "500,0,0", "target": "900,0,0"}
        await socket.send(json.dumps({"id": 2, "view": away}))
        await idle.until(lambda: not idle.wanted, SOON)


@pytest.mark.parametrize("path", ["/frame", "/events"])
async def test_a_request_that_is_aborted_wants_nothing_more(idle: Idle, path: str) -> None:
    query = VIEW | ({"wait_ms": 10_000} if path == "/frame" else {})

    async def ask() -> None:
        async with (
            httpx.AsyncClient(timeout=60) as client,
            client.stream("GET", f"{idle.url}{PATH}{path}", params=query) as answer,
        ):
            await answer.aread()

    asking = asyncio.create_task(ask())
    await idle.until(lambda: bool(idle.wanted), 60)
    await asyncio.sleep(0.1)
    asking.cancel()
    with suppress(asyncio.CancelledError):
        await asking
    await idle.until(lambda: not idle.wanted, SOON)


async def test_what_one_viewer_leaves_another_still_wants(idle: Idle) -> None:
    async with watching(idle):
        wanted = idle.wanted
        async with watching(idle, azimuth=190):
            pass
        await idle.until(lambda: idle.wanted == wanted, SOON)


async def test_hundred_clients_that_abort_leave_nothing(idle: Idle) -> None:
    before = asyncio.all_tasks()

    async def abort(number: int) -> None:
        query = VIEW | {"azimuth": 3 * number, "wait_ms": 5000}
        async with httpx.AsyncClient() as client:
            with suppress(httpx.ReadTimeout):
                await client.get(
                    f"{idle.url}{PATH}/frame", params=query, timeout=httpx.Timeout(30, read=0.3)
                )

    await asyncio.gather(*map(abort, range(100)))
    await idle.until(lambda: not idle.wanted, SOON)
    assert asyncio.all_tasks() == before


async def test_more_streams_than_are_allowed_are_told_to_come_back(idle: Idle) -> None:
    async with (
        stream_of(idle),
        stream_of(idle),
        httpx.AsyncClient(base_url=idle.url + PATH, timeout=60) as client,
    ):
        assert (await client.get("/events", params=VIEW)).status_code == 429
        assert (await client.get("/stream", headers=UPGRADE)).status_code == 429
