"""The stream over a real socket: what a client sends, what it is sent, and what of it the baker still wants."""

import asyncio
import json
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from isogi_core.errors import Cancelled
from isogi_core.frame.frame import Frame
from isogi_core.model.view import View
from server.api import stream as window
from server.render.engine import RenderEngine

VIEW: dict[str, Any] = {"width": 48, "height": 40, "azimuth": 40}
PATIENCE = 600.0
"""Seconds within which a first bake ends on a slow machine, which compiles its kernels too."""


class Client:
    """One connection; it acknowledges what it is told to."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket

    async def say(self, **message: Any) -> None:
        await self.socket.send(json.dumps(message))

    async def hear(self) -> tuple[dict[str, Any], bytes]:
        """The next facts and their picture; a problem has none."""
        facts: dict[str, Any] = json.loads(await asyncio.wait_for(self.socket.recv(), PATIENCE))
        if "problem" in facts:
            return facts, b""
        picture = await asyncio.wait_for(self.socket.recv(), PATIENCE)
        assert isinstance(picture, bytes)
        return facts, picture

    async def final(self, wish: int) -> list[tuple[dict[str, Any], bytes]]:
        """All that comes up to the final picture of a view, each acknowledged."""
        heard = []
        while True:
            heard.append(await self.hear())
            await self.say(shown=heard[-1][0]["id"])
            if heard[-1][0]["id"] == wish and heard[-1][0]["final"]:
                return heard


Play = Callable[[Client], Coroutine[Any, Any, Any]]


@pytest.fixture
def play(live_server: str) -> Callable[[Play], Any]:
    """Plays a scene with a connected client."""

    async def connected(act: Play) -> Any:
        address = live_server.replace("http", "ws") + "/v1/scenes/small/stream"
        async with connect(address, max_size=None) as socket:
            return await act(Client(socket))

    return lambda act: asyncio.run(connected(act))


def frame(base: str, **more: Any) -> httpx.Response:
    return httpx.get(f"{base}/v1/scenes/small/frame", params={**VIEW, **more}, timeout=60)


def test_drafts_come_first_then_full_pictures_until_final(play: Callable[[Play], Any]) -> None:
    async def act(client: Client) -> None:
        view = {**VIEW, "isovalue": 0.41, "azimuth": 217, "max_error": 0.3}
        await client.say(id=1, view=view, moving=True)
        draft, picture = await client.hear()
        assert (draft["id"], draft["draft"], draft["final"], draft["media_type"]) == (1, True, False, "image/jpeg")
        assert (draft["width"], draft["height"]) == (24, 20)
        assert picture[:3] == b"\xff\xd8\xff"
        await client.say(shown=1)
        await client.say(id=2, view=view)
        heard = await client.final(2)
        facts = [each for each, _ in heard]
        assert all((each["id"], each["draft"], each["width"], each["height"]) == (2, False, 48, 40) for each in facts)
        assert facts[0]["facts"]["provisional"], "the full picture comes at once, with the light that there is"
        assert len(facts) > 1, "and again when there is more"
        shares = [each["facts"]["coverage"]["final"] for each in facts]
        assert shares == sorted(shares)
        assert shares[-1] == 1.0
        assert facts[-1]["facts"]["chunks"]["final"] == facts[-1]["facts"]["chunks"]["needed"] > 0
        assert {"primary", "encode", "queue"} <= facts[0]["timing"].keys()

    play(act)


@pytest.mark.parametrize("form", ["png", "npy"])
def test_the_picture_at_rest_is_that_of_the_frame(play: Callable[[Play], Any], live_server: str, form: str) -> None:
    async def act(client: Client) -> bytes:
        await client.say(id=3, view={**VIEW, "f": form, "yaw": 30})
        return (await client.final(3))[-1][1]

    assert play(act) == frame(live_server, f=form, yaw=30).content


def test_numbers_may_be_numbers_and_rows_may_be_lists(play: Callable[[Play], Any], live_server: str) -> None:
    view = {"width": 32, "height": 32, "eye": [60.0, 9.5, 7.5], "target": [11.5, 9.5, 7.5]}

    async def act(client: Client) -> bytes:
        await client.say(id=0, view=view)
        return (await client.final(0))[-1][1]

    query = {**view, "eye": "60,9.5,7.5", "target": "11.5,9.5,7.5"}
    assert play(act) == httpx.get(f"{live_server}/v1/scenes/small/frame", params=query).content


def test_the_newest_view_wins(play: Callable[[Play], Any]) -> None:
    async def act(client: Client) -> None:
        for wish in range(40):
            await client.say(id=wish, view={**VIEW, "azimuth": 9.0 * wish}, moving=wish < 39)
        heard = [facts["id"] for facts, _ in await client.final(39)]
        assert heard == sorted(heard)
        assert len({wish for wish in heard if wish < 39}) < 20, "not all that were overtaken are drawn"

    play(act)


def test_work_on_an_older_view_ends(play: Callable[[Play], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended, survey = threading.Event(), threading.Event(), RenderEngine.survey

    def watched(engine: RenderEngine, scene: str, view: View, *more: Any) -> Frame:
        if view.width != 1024:
            return survey(engine, scene, view, *more)
        begun.set()
        try:
            return survey(engine, scene, view, *more)
        except Cancelled:
            ended.set()
            raise

    async def act(client: Client) -> None:
        await client.say(id=1, view={"width": 1024, "height": 1024, "shading": "path_traced", "samples": 64})
        assert await asyncio.to_thread(begun.wait, PATIENCE)
        await client.say(id=2, view=VIEW)
        facts, _ = await client.hear()
        assert facts["id"] == 2

    monkeypatch.setattr(RenderEngine, "survey", watched)
    play(act)
    assert ended.wait(PATIENCE)


BAD = [
    ('{"id": 5, "view": {"isovalue": "nan"}}', "isovalue"),
    ('{"id": 5, "view": {"width": 0}}', "width"),
    ('{"id": 5, "view": {"width": true}}', "width"),
    ('{"id": 5, "view": {"colour": 1}}', "colour"),
    ('{"id": 5, "view": {"wait_ms": 5}}', "wait_ms"),
    ('{"id": 5, "view": {"f": "npy", "exposure": 2}}', "exposure"),
    ('{"id": 5, "view": []}', "view"),
    ('{"id": 5, "moving": 1}', "moving"),
    ('{"id": 5, "speed": 1}', "speed"),
    ('{"id": -1}', "id"),
    ('{"id": 0.5}', "id"),
    ('{"view": {}}', "id"),
    ('{"shown": "x"}', "shown"),
    ('{"id": 5, "view": {"fov": NaN}}', "JSON"),
    ('{"id": 5, "view": {"overlay": "\\ud800"}}', "overlay must be one of"),
    ('{"id": 5, "view": {"isovalue": "\\ud800"}}', "isovalue"),
    ("[" * 5000, "JSON"),
    ("[]", "object"),
    ("hello", "JSON"),
]


def test_a_bad_message_is_a_problem_and_the_stream_stays_open(play: Callable[[Play], Any]) -> None:
    async def act(client: Client) -> None:
        for text, named in BAD:
            await client.socket.send(text)
            told, _ = await client.hear()
            problem = told["problem"]
            assert problem["status"] == 422, text
            assert named in problem["detail"], (text, problem)
            assert told["id"] in (5, -1, None)
        await client.say(id=6, view=VIEW)
        assert (await client.hear())[0]["id"] == 6

    play(act)


def test_no_more_than_two_pictures_are_under_way(play: Callable[[Play], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    async def act(client: Client) -> None:
        for wish in range(2):
            await client.say(id=wish, view=VIEW, moving=True)
            await client.hear()
        for wish in range(2, 4):
            await client.say(id=wish, view=VIEW, moving=True)
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(client.hear(), 0.3)
            await client.say(shown=wish - 2)
            assert (await client.hear())[0]["id"] == wish

    monkeypatch.setattr(window, "RECEIPT_SECONDS", PATIENCE)
    play(act)


@pytest.mark.parametrize("message", ["x" * 20_000, b"binary"])
def test_a_message_that_breaks_a_limit_ends_the_stream(play: Callable[[Play], Any], message: str | bytes) -> None:
    async def act(client: Client) -> int | None:
        await client.socket.send(message)
        with pytest.raises(ConnectionClosed):
            await client.hear()
        return client.socket.close_code

    assert play(act) == (1009 if isinstance(message, str) else 1008)


@pytest.mark.parametrize(
    ("scene", "headers", "status", "detail"),
    [
        ("none", {}, 404, "There is no scene 'none'"),
        ("small", {"Host": "evil.example"}, 421, "This host name is not served here"),
    ],
)
def test_what_is_refused_is_told_before_the_stream_begins(
    live_server: str, scene: str, headers: dict[str, str], status: int, detail: str
) -> None:
    """Over a bare request: the client's library sets the Host header by itself."""
    key = {"Sec-WebSocket-Key": "x3JJHMbDL1EzLkh9GBhXDw==", "Sec-WebSocket-Version": "13"}
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", **key}
    answer = httpx.get(f"{live_server}/v1/scenes/{scene}/stream", headers=upgrade | headers)
    assert answer.status_code == status
    assert answer.json()["detail"].startswith(detail)
