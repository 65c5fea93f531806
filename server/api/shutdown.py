"""Shutdown: requests that are worked on while the server stops."""

import asyncio
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.problems import problem

LATE = 1.0
"""Seconds that a route has to answer after it read that its client left; then it is answered with 503."""


@dataclass(eq=False)
class OpenRequest:
    """A request: whether its answer is ``endless``; events that its route shall end, and that it is too late."""

    endless: bool = False
    ending: asyncio.Event = field(default_factory=asyncio.Event)
    late: asyncio.Event = field(default_factory=asyncio.Event)


class Closing:
    """How far the server is on its way to stop; for its event loop alone.

    First it is ``begun``: answers close their connections, and endless ones end. At its end, routes that are still
    at work read that their client left; a little later, requests without an answer get 503.
    """

    def __init__(self) -> None:
        """Be open."""
        self.begun = False
        self._open: set[OpenRequest] = set()

    def begin(self) -> None:
        """Let open requests come to their end."""
        self.begun = True
        for request in self._open:
            if request.endless:
                request.ending.set()

    async def end(self) -> None:
        """Wait no longer."""
        for request in self._open:
            request.ending.set()
        await asyncio.sleep(LATE)
        for request in self._open:
            request.late.set()

    @contextmanager
    def admitted(self) -> Iterator[OpenRequest]:
        """Keep a request among the open ones while it is worked on."""
        request = OpenRequest()
        self._open.add(request)
        try:
            yield request
        finally:
            self._open.discard(request)


class GracefulShutdown:
    """ASGI middleware: has requests end well while the server stops."""

    def __init__(self, app: ASGIApp, closing: Closing) -> None:
        self.app = app
        self.closing = closing

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; once the server stops its answer says that the connection closes."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        with self.closing.admitted() as request:
            answer, incoming = Answer(send, request, self.closing), Incoming(receive, request)
            try:
                await until(self.app(scope, incoming.receive, answer.send), request.late)
            finally:
                incoming.close()
            if not answer.begun:
                await problem(503, STOPPED, scope["path"])(scope, receive, answer.send)
            elif request.endless and not answer.whole:
                await send({"type": "http.response.body", "body": b""})


class Incoming:
    """What a client sends, until its request shall end."""

    def __init__(self, receive: Receive, request: OpenRequest) -> None:
        self._receive, self._request = receive, request
        self._next: asyncio.Future[Message] | None = None

    async def receive(self) -> Message:
        """The next message; a disconnect once the request shall end.

        A cancelled wait loses nothing: the next call has the message.
        """
        if self._next is None:
            self._next = asyncio.ensure_future(self._receive())
        if not self._next.done() and not self._request.ending.is_set():
            leave = asyncio.ensure_future(self._request.ending.wait())
            both: set[asyncio.Future[Any]] = {self._next, leave}
            try:
                await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            finally:
                leave.cancel()
        if not self._next.done():
            return {"type": "http.disconnect"}
        message, self._next = self._next.result(), None
        return message

    def close(self) -> None:
        """Read no more."""
        if self._next is not None:
            self._next.cancel()


class Answer:
    """The answer to a request: whether it has ``begun``, and is ``whole``."""

    def __init__(self, send: Send, request: OpenRequest, closing: Closing) -> None:
        self.begun = self.whole = False
        self._send, self._request, self._closing = send, request, closing

    async def send(self, message: Message) -> None:
        """Send a message on; the first says that the connection closes where the server stops."""
        if message["type"] == "http.response.start":
            self._begin(MutableHeaders(scope=message))
        elif message["type"] == "http.response.body":
            self.whole = not message.get("more_body", False)
        await self._send(message)

    def _begin(self, headers: MutableHeaders) -> None:
        self.begun = True
        self._request.endless = headers.get("content-type", "").startswith("text/event-stream")
        if self._closing.begun:
            headers["Connection"] = "close"
            if self._request.endless:
                self._request.ending.set()


STOPPED = "The server stops, and this was not done in time: ask again in a while."


async def until(work: Awaitable[None], end: asyncio.Event) -> None:
    """Do the work; give it up where the ``end`` comes first. Raises what it raises."""
    working, ending = asyncio.ensure_future(work), asyncio.ensure_future(end.wait())
    both: set[asyncio.Future[Any]] = {working, ending}
    try:
        await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        if working.done():
            working.result()
    finally:
        working.cancel()
        ending.cancel()
        del both, working, ending  # an error in them would hold itself until garbage is looked for
