"""What one client may take of a server, on real sockets: all of it, until others ask."""

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from tests.server.idle import Idle, idle_server
from tests.server.sockets import HEAD, answer, running, status, wait_for

GREEDY = "127.0.0.2"
OTHER = "127.0.0.3"
THIRD = "127.0.0.4"
"""Addresses that clients on this machine ask from."""

FRAME: dict[str, Any] = {"width": 24, "height": 24}
SOON = 20.0
PLACES = 4


@pytest.fixture(scope="module")
def server(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Idle]:
    limits = {"streams": PLACES, "jobs": PLACES, "render_threads": 2, "render_queue": PLACES - 2}
    with idle_server(small_scene, tmp_path_factory.mktemp("store"), **limits) as server:
        yield server


@asynccontextmanager
async def asking(server: Idle, address: str) -> AsyncIterator[httpx.AsyncClient]:
    """A client at an address of its own."""
    transport = httpx.AsyncHTTPTransport(local_address=address)
    async with httpx.AsyncClient(
        transport=transport, base_url=f"{server.url}/v1", timeout=SOON
    ) as client:
        yield client


async def opened(server: Idle, address: str, stack: AsyncExitStack) -> ClientConnection:
    """A stream from an address."""
    stream = connect(
        f"{server.url.replace('http', 'ws')}/v1/scenes/small/stream", local_addr=(address, 0)
    )
    return await stack.enter_async_context(stream)


async def closed(socket: ClientConnection) -> tuple[int | None, str | None]:
    """How the server closes a stream."""
    with pytest.raises(ConnectionClosed):
        while True:
            await asyncio.wait_for(socket.recv(), SOON)
    return socket.close_code, socket.close_reason


async def test_a_newcomer_takes_the_idlest_stream_of_the_greediest(server: Idle) -> None:
    async with AsyncExitStack() as stack:
        greedy = [await opened(server, GREEDY, stack) for _ in range(PLACES)]
        with pytest.raises(InvalidStatus, match="429"):
            await opened(server, GREEDY, stack)
        await greedy[0].send(json.dumps({"id": 1, "view": {**FRAME, "shading": "lambert"}}))
        await asyncio.wait_for(greedy[0].recv(), SOON)
        others = [await opened(server, OTHER, stack) for _ in range(2)]
        assert [await closed(each) for each in greedy[1:3]] == [
            (
                1013,
                (
                    f"Another client needed this place, and you have {more} more: ask again in a "
                    "while."
                ),
            )
            for more in (3, 2)
        ]
        with pytest.raises(InvalidStatus, match="429"):
            await opened(server, GREEDY, stack)
        for each in (greedy[0], greedy[3], *others):
            await each.send(json.dumps({"id": 2, "view": {**FRAME, "shading": "lambert"}}))
            await asyncio.wait_for(each.recv(), SOON)


async def test_a_newcomer_takes_the_newest_frame_of_the_greediest(server: Idle) -> None:
    waiting = {**FRAME, "wait_ms": 4000}
    async with asking(server, GREEDY) as greedy, asking(server, OTHER) as other:
        begun = []
        for number in range(PLACES):
            begun.append(
                asyncio.create_task(
                    greedy.get("/scenes/small/frame", params=waiting | {"yaw": number})
                )
            )
            await asyncio.sleep(0.2)
        asked = await other.get("/scenes/small/frame", params={**FRAME, "shading": "lambert"})
        assert asked.status_code == 200
        answers = [each.status_code for each in await asyncio.gather(*begun)]
        assert answers == [200] * (PLACES - 1) + [429]


async def test_a_newcomer_takes_the_newest_job_of_the_greediest(server: Idle) -> None:
    later = {"headers": {"Prefer": "respond-async"}}
    async with asking(server, GREEDY) as greedy, asking(server, OTHER) as other:
        asked = [
            await greedy.get("/scenes/small/frame", params={"yaw": n}, **later)
            for n in range(PLACES + 1)
        ]
        assert [each.status_code for each in asked] == [202] * PLACES + [429]
        assert (
            await other.get("/scenes/small/frame", params={"yaw": 60}, **later)
        ).status_code == 202
        jobs = (await other.get("/jobs")).json()["jobs"]
        ended = {job["jobID"]: job["message"] for job in jobs if job["status"] == "dismissed"}
        assert list(ended) == [asked[PLACES - 1].json()["jobID"]]
        assert "Another client needed this place" in str(ended)
        for job in jobs:
            await other.delete(f"/jobs/{job['jobID']}")


async def test_an_event_listener_loses_its_place_too(server: Idle) -> None:
    async with asking(server, GREEDY) as greedy, AsyncExitStack() as stack:
        events = greedy.stream("GET", "/scenes/small/events", params=FRAME)
        heard = (await stack.enter_async_context(events)).aiter_lines()
        await anext(heard)
        for _ in range(PLACES - 1):
            await opened(server, GREEDY, stack)
        await opened(server, OTHER, stack)
        lines = [line async for line in heard]
        assert any("Another client needed this place" in line for line in lines)
        assert "event: failed" in lines


def test_the_address_with_most_connections_makes_room() -> None:
    body = HEAD.replace(b"GET /small", b"POST /v1/volumes") + b"Content-Length: 9\r\n\r\nhalf"
    with running(max_connections=4) as server:
        alone = server.connect(HEAD, source=THIRD)
        greedy = [server.connect(body, source=GREEDY) for _ in range(3)]
        assert wait_for(lambda: server.held() == 4)
        assert server.ask() == 200
        assert status(answer(greedy[0])) == 408
        alone.sendall(b"Connection: close\r\n\r\n")
        assert status(answer(alone)) == 200
        for each in (alone, *greedy):
            each.close()
