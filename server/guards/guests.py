"""Guests: requests that are worked on while the server stops."""

import asyncio
from collections.abc import Awaitable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.problems import problem

LATE = 1.0
"""Seconds that a route has to answer after it heard that its client left; the guard answers in its place then."""


@dataclass(eq=False)
class Guest:
    """One request: whether its answer is ``endless``, that its route is told to end, and that time is up."""

    endless: bool = False
    asked_to_leave: asyncio.Event = field(default_factory=asyncio.Event)
    late: asyncio.Event = field(default_factory=asyncio.Event)


class Closing:
    """How far the server is on its way to stop; for its event loop alone.

    First it is ``begun``: answers close their connections, and endless ones end. At its end routes that are still
    at work hear that their client left, and a little later what is not answered yet is answered with 503.
    """

    def __init__(self) -> None:
        """Be open."""
        self.begun = False
        self._guests: set[Guest] = set()

    def begin(self) -> None:
        """Let what is worked on come to its end."""
        self.begun = True
        for guest in self._guests:
            if guest.endless:
                guest.asked_to_leave.set()

    async def end(self) -> None:
        """Wait no longer."""
        for guest in self._guests:
            guest.asked_to_leave.set()
        await asyncio.sleep(LATE)
        for guest in self._guests:
            guest.late.set()

    @contextmanager
    def guest(self) -> Iterator[Guest]:
        """A guest, while its request is worked on."""
        guest = Guest()
        self._guests.add(guest)
        try:
            yield guest
        finally:
            self._guests.discard(guest)


class Guests:
    """ASGI middleware: has requests end well while the server stops."""

    def __init__(self, app: ASGIApp, closing: Closing) -> None:
        self.app = app
        self.closing = closing

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; once the server stops its answer says that the connection closes."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        with self.closing.guest() as guest:
            answer, ear = Answer(send, guest, self.closing), Ear(receive, guest)
            try:
                await until(self.app(scope, ear.receive, answer.send), guest.late)
            finally:
                ear.close()
            if not answer.begun:
                await problem(503, STOPPED, scope["path"])(scope, receive, answer.send)
            elif guest.endless and not answer.whole:
                await send({"type": "http.response.body", "body": b""})


class Ear:
    """What a client says, until its guest is asked to leave."""

    def __init__(self, receive: Receive, guest: Guest) -> None:
        self._receive, self._guest = receive, guest
        self._next: asyncio.Future[Message] | None = None

    async def receive(self) -> Message:
        """The next message; that the client left once the guest is asked to.

        Who gives up waiting loses nothing: the message is the next one's.
        """
        if self._next is None:
            self._next = asyncio.ensure_future(self._receive())
        if not self._next.done() and not self._guest.asked_to_leave.is_set():
            leave = asyncio.ensure_future(self._guest.asked_to_leave.wait())
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
        """Listen no more."""
        if self._next is not None:
            self._next.cancel()


class Answer:
    """What is sent to a guest: whether it has ``begun``, and is ``whole``."""

    def __init__(self, send: Send, guest: Guest, closing: Closing) -> None:
        self.begun = self.whole = False
        self._send, self._guest, self._closing = send, guest, closing

    async def send(self, message: Message) -> None:
        """Send a message on; the first tells that the connection closes where the server stops."""
        if message["type"] == "http.response.start":
            self._begin(MutableHeaders(scope=message))
        elif message["type"] == "http.response.body":
            self.whole = not message.get("more_body", False)
        await self._send(message)

    def _begin(self, headers: MutableHeaders) -> None:
        self.begun = True
        self._guest.endless = headers.get("content-type", "").startswith("text/event-stream")
        if self._closing.begun:
            headers["Connection"] = "close"
            if self._guest.endless:
                self._guest.asked_to_leave.set()


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
