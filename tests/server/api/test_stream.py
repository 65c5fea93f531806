"""The stream over a real socket: what a client sends, what it is sent, and what of it the baker
still wants.
"""

import asyncio
import json
import threading
from collections.abc import AsyncIterator
from typing import Any

import httpx
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from isogi_core.errors import Cancelled
from isogi_core.frame.frame import Frame
from isogi_core.model.view import View
from isogi_server.api import stream as window
from isogi_server.render.engine import RenderEngine
from tests.server.asking import UPGRADE

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


@pytest.fixture
async def client(live_server: str) -> AsyncIterator[Client]:
    """A client that is connected."""
    async with connect(
        live_server.replace("http", "ws") + "/v1/scenes/small/stream", max_size=None
    ) as socket:
        yield Client(socket)


def frame(base: str, **more: Any) -> httpx.Response:
    return httpx.get(f"{base}/v1/scenes/small/frame", params={**VIEW, **more}, timeout=60)


async def test_drafts_come_first_then_full_pictures_until_final(client: Client) -> None:
    view = {**VIEW, "isovalue": 0.41, "azimuth": 217, "max_error": 0.3}
    await client.say(id=1, view=view, moving=True)
    draft, picture = await client.hear()
    assert (draft["id"], draft["draft"], draft["final"], draft["media_type"]) == (
        1,
        True,
        False,
        "image/jpeg",
    )
    assert (draft["width"], draft["height"]) == (24, 20)
    assert picture[:3] == b"\xff\xd8\xff"
    await client.say(shown=1)
    await client.say(id=2, view=view)
    heard = await client.final(2)
    facts = [each for each, _ in heard]
    assert all(
        (each["id"], each["draft"], each["width"], each["height"]) == (2, False, 48, 40)
        for each in facts
    )
    assert facts[0]["facts"]["provisional"], (
        "the full picture comes at once, with the light that there is"
    )
    assert len(facts) > 1, "and again when there is more"
    shares = [each["facts"]["coverage"]["final"] for each in facts]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert facts[-1]["facts"]["chunks"]["final"] == facts[-1]["facts"]["chunks"]["needed"] > 0
    assert {"primary", "encode", "queue"} <= facts[0]["timing"].keys()


@pytest.mark.parametrize("form", ["png", "npy"])
async def test_the_picture_at_rest_is_that_of_the_frame(
    client: Client, live_server: str, form: str
) -> None:
    await client.say(id=3, view={**VIEW, "f": form, "yaw": 30})
    assert (await client.final(3))[-1][1] == frame(live_server, f=form, yaw=30).content


async def test_numbers_may_be_numbers_and_rows_may_be_lists(
    client: Client, live_server: str
) -> None:
    view = {"width": 32, "height": 32, "eye": [60.0, 9.5, 7.5], "target": [11.5, 9.5, 7.5]}
    query = {**view, "eye": "60,9.5,7.5", "target": "11.5,9.5,7.5"}
    await client.say(id=0, view=view)
    assert (await client.final(0))[-1][1] == httpx.get(
        f"{live_server}/v1/scenes/small/frame", params=query
    ).content


async def test_the_newest_view_wins(client: Client) -> None:
    for wish in range(40):
        await client.say(id=wish, view={**VIEW, "azimuth": 9.0 * wish}, moving=wish < 39)
    heard = [facts["id"] for facts, _ in await client.final(39)]
    assert heard == sorted(heard)
    assert len({wish for wish in heard if wish < 39}) < 20, "not all that were overtaken are drawn"


async def test_work_on_an_older_view_ends(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = threading.Event()
    ended = threading.Event()
    survey = RenderEngine.survey

    def watched(engine: RenderEngine, scene: str, view: View, *more: Any) -> Frame:
        if view.width != 1024:
            return survey(engine, scene, view, *more)
        begun.set()
        try:
            return survey(engine, scene, view, *more)
        except Cancelled:
            ended.set()
            raise

    monkeypatch.setattr(RenderEngine, "survey", watched)
    await client.say(
        id=1, view={"width": 1024, "height": 1024, "shading": "path_traced", "samples": 64}
    )
    assert await asyncio.to_thread(begun.wait, PATIENCE)
    await client.say(id=2, view=VIEW)
    facts, _ = await client.hear()
    assert facts["id"] == 2
    assert ended.wait(PATIENCE)


BAD = [
    *[(f'{{"id": 5, "view": {view}}}', "view") for view in ("[]", "7")],
    *[(f'{{"id": 5, "view": {{"width": {width}}}}}', "width") for width in ("0", "true")],
    *[
        (f'{{"id": 5, "view": {{"isovalue": {value}}}}}', "isovalue")
        for value in ('"nan"', '"\\ud800"')
    ],
    *[(f'{{"id": 5, "view": {{"{name}": 5}}}}', name) for name in ("colour", "wait_ms")],
    *[(f'{{"id": 5, "{name}": 1}}', name) for name in ("moving", "speed")],
    *[(text, "id") for text in ('{"id": -1}', '{"id": 0.5}', '{"view": {}}')],
    *[(text, "JSON") for text in ('{"id": 5, "view": {"fov": NaN}}', "[" * 5000, "hello")],
    ('{"id": 5, "view": {"f": "npy", "exposure": 2}}', "exposure"),
    ('{"id": 5, "view": {"overlay": "\\ud800"}}', "overlay must be one of"),
    ('{"shown": "x"}', "shown"),
    ("[]", "object"),
]


async def test_a_bad_message_is_a_problem_and_the_stream_stays_open(client: Client) -> None:
    for text, named in BAD:
        await client.socket.send(text)
        told, _ = await client.hear()
        problem = told["problem"]
        assert problem["status"] == 422 and named in problem["detail"], (text, problem)
        assert told["id"] in (5, -1, None)
    await client.say(id=6, view=VIEW)
    assert (await client.hear())[0]["id"] == 6


async def test_no_more_than_two_pictures_are_under_way(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(window, "RECEIPT_SECONDS", PATIENCE)
    for wish in range(2):
        await client.say(id=wish, view=VIEW, moving=True)
        await client.hear()
    for wish in range(2, 4):
        await client.say(id=wish, view=VIEW, moving=True)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(client.hear(), 0.3)
        await client.say(shown=wish - 2)
        assert (await client.hear())[0]["id"] == wish


@pytest.mark.parametrize("message", ["x" * 20_000, b"binary"])
async def test_a_message_that_breaks_a_limit_ends_the_stream(
    client: Client, message: str | bytes
) -> None:
    await client.socket.send(message)
    with pytest.raises(ConnectionClosed):
        await client.hear()
    assert client.socket.close_code == (1009 if isinstance(message, str) else 1008)


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
    answer = httpx.get(f"{live_server}/v1/scenes/{scene}/stream", headers=UPGRADE | headers)
    assert answer.status_code == status
    assert answer.json()["detail"].startswith(detail)
