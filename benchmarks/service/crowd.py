"""A crowd: clients of all kinds at once on one server, each with views of its own, and what they
were answered.
"""

import asyncio
import json
import random
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import httpx
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from isogi_core.model.choices import VIEW_SHADINGS

SIDES = (48, 96, 160, 256)
VIEWS = 12
"""Views that one client knows: it comes back to them, with the tags of what it has seen."""

PATIENCE = 30.0
"""Seconds after which a client counts an answer as lost."""

PAUSE = 0.2
"""Seconds that a client looks at what it got, on average."""


@dataclass
class Answers:
    """What a crowd was answered: how often which status came; and of streams whose views move, each
    one's pictures a second (``rates``), and the ``ages`` of pictures: seconds from when a view was
    sent until its picture came."""

    counts: Counter[str] = field(default_factory=Counter)
    rates: list[float] = field(default_factory=list)
    ages: list[float] = field(default_factory=list)


class Client:
    """One of the crowd. It does one kind of thing until told to end, and counts what comes of
    it.
    """

    def __init__(
        self, number: int, url: str, path: str, isovalues: tuple[float, ...], answers: Answers
    ) -> None:
        self._random = random.Random(number)
        self._url = url
        self._path = path
        self._answers = answers
        self._counts = answers.counts
        self._views = [self._view(isovalues) for _ in range(VIEWS)]
        self._tags: dict[int, str] = {}
        kinds: tuple[Callable[[httpx.AsyncClient], Awaitable[None]], ...]
        kinds = (
            self.spec,
            self.drag,
            self.cover,
            self.wait,
            self.spec,
            self.listen,
            self.drag,
            self.abort,
        )
        self._heard = 0
        self._do = kinds[number % len(kinds)]

    async def run(self, end: asyncio.Event) -> None:
        """Ask, look, ask again, until the ``end``."""
        async with httpx.AsyncClient(base_url=self._url, timeout=PATIENCE) as http:
            while not end.is_set():
                try:
                    await self._do(http)
                except (httpx.HTTPError, OSError) as error:
                    self._counts[type(error).__name__] += 1
                await asyncio.sleep(self._random.expovariate(1.0 / PAUSE))

    async def spec(self, http: httpx.AsyncClient) -> None:
        """A frame, as it is; where it was seen before, only if it has changed."""
        number = self._random.randrange(VIEWS)
        if number in self._tags:
            known = {"If-None-Match": self._tags[number]}
        else:
            known = {}
        answer = await http.get(f"{self._path}/frame", params=self._views[number], headers=known)
        self._counts[str(answer.status_code)] += 1
        if "etag" in answer.headers:
            self._tags[number] = answer.headers["etag"]

    async def wait(self, http: httpx.AsyncClient) -> None:
        """A frame that may wait for light."""
        params = self._any() | {"wait_ms": self._random.randrange(1000)}
        self._counts[str((await http.get(f"{self._path}/frame", params=params)).status_code)] += 1

    async def cover(self, http: httpx.AsyncClient) -> None:
        """How far a view is baked."""
        self._counts[
            str((await http.get(f"{self._path}/coverage", params=self._any())).status_code)
        ] += 1

    async def listen(self, http: httpx.AsyncClient) -> None:
        """What becomes of a view, for a while."""
        async with http.stream("GET", f"{self._path}/events", params=self._any()) as answer:
            self._counts[str(answer.status_code)] += 1
            with suppress(TimeoutError):
                async with asyncio.timeout(self._random.uniform(0.5, 4.0)):
                    await answer.aread()

    async def abort(self, http: httpx.AsyncClient) -> None:
        """A frame that nobody stays for."""
        params = self._any() | {"wait_ms": 10_000, "max_error": 0.0001}
        with suppress(TimeoutError):
            async with asyncio.timeout(self._random.uniform(0.01, 0.5)):
                self._counts[
                    str((await http.get(f"{self._path}/frame", params=params)).status_code)
                ] += 1

    async def drag(self, _: httpx.AsyncClient) -> None:
        """A stream: a hand that drags, rests, and leaves, sometimes without a word."""
        try:
            async with connect(
                f"{self._url.replace('http', 'ws', 1)}{self._path}/stream", max_size=None
            ) as socket:
                view = self._any()
                sent = list[float]()
                hearing = asyncio.create_task(self._hear(socket, sent))
                for step in range(steps := self._random.randrange(60, 150)):
                    sent.append(time.monotonic())
                    moved = view | {"azimuth": (view["azimuth"] + step) % 360}
                    await socket.send(
                        json.dumps({"id": step, "view": moved, "moving": step + 1 < steps})
                    )
                    await asyncio.sleep(1.0 / 30.0)
                self._answers.rates.append(self._heard / (time.monotonic() - sent[0]))
                await asyncio.sleep(self._random.uniform(0.0, 2.0))
                hearing.cancel()
                if self._random.random() < 0.5:
                    socket.transport.abort()
        except InvalidStatus as refused:
            self._counts[str(refused.response.status_code)] += 1
        except ConnectionClosed as closed:
            self._counts[f"stream closed with {closed.rcvd or 'nothing'}"] += 1

    async def _hear(self, socket: Any, sent: list[float]) -> None:
        """Take what a stream tells of views that were ``sent`` then; each picture counts as an
        answer.
        """
        newest = -1
        self._heard = 0
        with suppress(ConnectionClosed):
            while True:
                told = json.loads(await socket.recv())
                if "problem" in told:
                    self._counts[str(told["problem"]["status"])] += 1
                    continue
                await socket.recv()
                self._counts["200"] += 1
                self._heard += 1
                if told["id"] > newest:
                    newest = told["id"]
                    self._answers.ages.append(time.monotonic() - sent[newest])
                await socket.send(json.dumps({"shown": told["id"]}))

    def _any(self) -> dict[str, Any]:
        return dict(self._random.choice(self._views))

    def _view(self, isovalues: tuple[float, ...]) -> dict[str, Any]:
        shading = self._random.choice(
            ("gi", "gi", "gi", *(each for each in VIEW_SHADINGS if each != "path_traced"))
        )
        side = self._random.choice(SIDES)
        view = {
            "isovalue": self._random.choice(isovalues),
            "shading": shading,
            "width": side,
            "height": side,
        }
        return view | {
            "azimuth": self._random.randrange(0, 270),
            "elevation": self._random.randrange(-60, 60),
            "yaw": self._random.randrange(0, 360, 10),
        }


async def crowd(
    url: str, path: str, isovalues: tuple[float, ...], clients: int, end: asyncio.Event
) -> Answers:
    """So many clients until the ``end``, and what they were answered."""
    answers = Answers()
    await asyncio.gather(
        *(Client(number, url, path, isovalues, answers).run(end) for number in range(clients))
    )
    return answers
