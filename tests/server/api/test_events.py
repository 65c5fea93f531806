"""How a view becomes final, told as server-sent events over a real socket."""

import asyncio
import json
from collections.abc import AsyncGenerator, Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from isogi_server.api.routes.events import answers, events_of
from tests.live import serving

PATH = "/v1/scenes/small/events"
VIEW: dict[str, Any] = {
    "width": 40,
    "height": 40,
    "azimuth": 133,
    "elevation": -31,
    "isovalue": 0.74,
    "max_error": 0.2,
}
Event = dict[str, str]


@pytest.fixture(scope="module")
def client(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """Of a server of its own: others have light baked that is to be told of here."""
    with (
        serving(small_scene, tmp_path_factory.mktemp("light")) as url,
        httpx.Client(base_url=url, timeout=180) as client,
    ):
        yield client


def events(client: httpx.Client, seen: str = "", **more: Any) -> list[Event]:
    """All events up to the end of the stream, each by its fields."""
    headers = {"Last-Event-ID": seen} if seen else {}
    with client.stream("GET", PATH, params={**VIEW, **more}, headers=headers) as answer:
        assert answer.status_code == 200, answer.read()
        assert answer.headers["content-type"].startswith("text/event-stream")
        assert answer.headers["cache-control"] == "no-store"
        text = "".join(answer.iter_text())
    return [
        dict(line.split(": ", 1) for line in block.splitlines())
        for block in text.strip().split("\n\n")
    ]


def test_events_come_until_a_view_is_final_and_resume_by_id(client: httpx.Client) -> None:
    told = events(client)
    kinds = [event["event"] for event in told]
    assert kinds[-1] == "final"
    assert set(kinds[:-1]) <= {"refined", "progress"}
    assert "refined" in kinds
    shares = [
        json.loads(event["data"])["coverage"]["final"]
        for event in told
        if event["event"] != "progress"
    ]
    assert shares == sorted(shares) and shares[-1] == 1.0
    last = told[-1]
    assert json.loads(last["data"]) == client.get("/v1/scenes/small/coverage", params=VIEW).json()
    again = events(client, seen=told[0]["id"])
    assert [event["event"] for event in again] == ["final"]
    known = client.get(PATH, params=VIEW, headers={"Last-Event-ID": last["id"]})
    assert (known.status_code, known.content) == (204, b"")


def test_progress_tells_the_time_left(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("isogi_server.api.routes.events.TIME_LEFT_SECONDS", 0.01)
    told = [
        json.loads(each["data"])
        for each in events(client, azimuth=190)
        if each["event"] == "progress"
    ]
    assert told
    assert all(each["waiting"] >= 0 for each in told)
    left = [each["time_left"] for each in told if each["time_left"]]
    assert all(0.0 <= each["low"] <= each["likely"] <= each["high"] for each in left)


def frame_of(final: bool) -> Any:
    """A picture at one version, final or still coming, as a service shows it."""
    frame = SimpleNamespace(final=final, version="one")
    place = SimpleNamespace(leave=lambda: None)
    return SimpleNamespace(frame=frame, coming=not final, place=place)


async def ids_told(
    seen: str, monkeypatch: pytest.MonkeyPatch, pictures: tuple[bool, ...] = (False, True)
) -> list[str]:
    """The kinds and ids of events on ``pictures`` of the same version, each final or not: by
    default one that becomes final by measuring alone.
    """
    monkeypatch.setattr("isogi_server.api.routes.events.coverage", lambda _: {})

    async def refinements(order: Any, viewer: Any) -> AsyncGenerator[Any, None]:
        for final in pictures:
            yield frame_of(final)

    place = SimpleNamespace(check=lambda: None)
    service: Any = SimpleNamespace(
        refinements=refinements,
        connections=SimpleNamespace(admitted=lambda _: nullcontext(place)),
        engine=SimpleNamespace(unfinished=lambda *_: None),
        leave=lambda _: None,
    )
    picture: Any = SimpleNamespace(scene=None, goal=None)
    viewer: Any = None
    told = [each.decode() async for each in events_of(service, picture, seen, viewer, "a client")]
    fields = [dict(line.split(": ", 1) for line in each.strip().splitlines()) for each in told]
    return [f"{each['event']} {each['id']}" for each in fields]


async def test_a_client_that_comes_back_hears_final(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if measuring alone has made the picture final, at the version that it knows."""
    refined, final = await ids_told("", monkeypatch)
    assert (refined.split()[0], final.split()[0]) == ("refined", "final")
    assert await ids_told(refined.split()[1], monkeypatch) == [final]
    assert await ids_told(final.split()[1], monkeypatch, (True,)) == []


async def test_a_client_that_comes_back_hears_all_that_is_new(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each new error of the picture that it knows, and the end of one that is measured again."""
    refined, final = await ids_told("", monkeypatch)
    more = await ids_told(refined.split()[1], monkeypatch, (False, False, True))
    assert more == [refined, final]
    assert await ids_told(final.split()[1], monkeypatch) == [refined, final]


def test_a_path_traced_view_ends_with_its_samples(client: httpx.Client) -> None:
    (last,) = events(client, shading="path_traced", samples=8, max_error=0.0001)
    assert last["event"] == "failed"
    assert "All samples are taken (8 per pixel)" in json.loads(last["data"])["detail"]


@pytest.mark.parametrize(("name", "text"), [("isovalue", "nan"), ("wait_ms", "5"), ("f", "png")])
def test_bad_input_is_a_problem_and_no_event(client: httpx.Client, name: str, text: str) -> None:
    answer = client.get(PATH, params={**VIEW, name: text})
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert name in answer.json()["detail"]


async def test_a_cancelled_listener_closes_its_refinements() -> None:
    """As a cancelled scope does, until whoever is in it has left."""
    closed: list[str] = []

    async def refinements(order: Any, viewer: Any) -> AsyncGenerator[str, None]:
        try:
            yield "first"
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0.05)
            closed.append("in order")

    async def listen() -> None:
        service: Any = SimpleNamespace(refinements=refinements)
        async for _ in answers(service, None, None):  # type: ignore[arg-type]
            pass

    listener = asyncio.create_task(listen())
    await asyncio.sleep(0.05)
    while not listener.done():
        listener.cancel()
        await asyncio.sleep(0)
    assert closed == ["in order"]
