"""The start and the end of a service: pictures without light come first, and open requests are
completed before the end.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from isogi_core.errors import Cancelled
from isogi_core.plan.scene import Scene
from isogi_server.errors import BusyError, StartingError
from isogi_server.problems import problem
from isogi_server.render.engine import RenderEngine
from isogi_server.render.viewers import run_until

log = logging.getLogger("isogi.server")

LATE = 1.0
"""Seconds that a route has to answer once it was told that its client left; then it is answered
with 503.
"""


class Closing:
    """The state of a server that stops. For its event loop only.

    First ``begun`` is set: answers close their connections, and endless ones end. At the end,
    routes that still work are told that their client left, and after LATE seconds requests without
    an answer get 503.
    """

    def __init__(self) -> None:
        """Create the state of a server that does not stop yet."""
        self.begun = False
        self._open: set[OpenRequest] = set()

    def begin(self) -> None:
        """Begin to stop: end endless answers, and let the other requests be completed."""
        self.begun = True
        for request in self._open:
            if request.endless:
                request.ending.set()

    async def end(self) -> None:
        """Wait no longer: tell all routes that their client left, and give them up after LATE
        seconds.
        """
        for request in self._open:
            request.ending.set()
        await asyncio.sleep(LATE)
        for request in self._open:
            request.late.set()

    @contextmanager
    def admitted(self, receive: Receive, send: Send) -> Iterator[OpenRequest]:
        """Count a request among the open ones for the block."""
        request = OpenRequest(receive, send, self)
        self._open.add(request)
        try:
            yield request
        finally:
            self._open.discard(request)
            request.close()


class OpenRequest:
    """A request that is worked on, and the state of its answer: ``begun``, ``endless`` (a stream of
    events), ``whole`` (sent completely).

    Once ``ending`` is set, its route reads that the client left; once ``late`` is set, the route is
    cancelled.
    """

    def __init__(self, receive: Receive, send: Send, closing: Closing) -> None:
        """Read messages of the client by ``receive``, and answer by ``send``."""
        self.begun = self.endless = self.whole = False
        self.ending = asyncio.Event()
        self.late = asyncio.Event()
        self._receive = receive
        self._send = send
        self._closing = closing
        self._next: asyncio.Future[Message] | None = None

    async def receive(self) -> Message:
        """Return the next message of the client; a disconnect once the request is to end.

        A call that is cancelled loses no message: the next call returns it.
        """
        # The pending receive outlives this call.
        if self._next is None:
            self._next = asyncio.ensure_future(self._receive())
        if not self._next.done() and not self.ending.is_set():
            leave = asyncio.ensure_future(self.ending.wait())
            both: set[asyncio.Future[Any]] = {self._next, leave}
            try:
                await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            finally:
                leave.cancel()
        if not self._next.done():
            return {"type": "http.disconnect"}
        message = self._next.result()
        self._next = None
        return message

    async def send(self, message: Message) -> None:
        """Send a message on. If the server stops, the first message says that the connection
        closes.
        """
        if message["type"] == "http.response.start":
            self._begin(MutableHeaders(scope=message))
        elif message["type"] == "http.response.body":
            self.whole = not message.get("more_body", False)
        await self._send(message)

    def close(self) -> None:
        """Read no more messages."""
        if self._next is not None:
            self._next.cancel()

    def _begin(self, headers: MutableHeaders) -> None:
        """Note the start of the answer. If the server stops, close the connection after it, and
        end it now if it is endless.
        """
        self.begun = True
        self.endless = headers.get("content-type", "").startswith("text/event-stream")
        if self._closing.begun:
            headers["Connection"] = "close"
            if self.endless:
                self.ending.set()


class GracefulShutdown:
    """ASGI middleware that completes open requests while the server stops."""

    def __init__(self, app: ASGIApp, closing: Closing) -> None:
        self.app = app
        self.closing = closing

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, until it is answered or late."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        with self.closing.admitted(receive, send) as request:
            with suppress(Cancelled):
                await run_until(self.app(scope, request.receive, request.send), request.late.wait())
            # Complete the answer of a route that was cancelled.
            if not request.begun:
                await problem(503, STOPPED, scope["path"])(scope, receive, request.send)
            elif request.endless and not request.whole:
                await send({"type": "http.response.body", "body": b""})


STOPPED = "The server stops, and this was not done in time: ask again in a while."


LOOK = 0.02
"""Seconds between two checks if the service is ready."""

SCENE_NOT_OPEN = "isogi is starting: its scene is not open yet."
COMPILING = (
    "What draws {shading} pictures is being compiled, once on this machine: ask again in a while."
)


class Startup:
    """The start of an ``engine``. For the event loop only.

    ``settled`` is set once pictures can be drawn, or ``failure`` says why not. ``lit`` is set once
    kernels of light are loaded, which takes longer if these must be compiled.
    """

    def __init__(self, engine: RenderEngine) -> None:
        """Start nothing yet."""
        self._engine = engine
        self.settled = asyncio.Event()
        self.lit = asyncio.Event()
        self._all = asyncio.Event()
        self.failure: Exception | None = None
        self._compiling: asyncio.Task[None] | None = None
        self._closing = False

    async def run(self, prepare: Callable[[], None], survey: Callable[[Scene], None]) -> None:
        """Open the engine, and call ``prepare`` for all that comes with it.

        Then, in the background, compile kernels of light if need be, call ``survey`` with each
        scene, and compile the other kernels.
        """
        try:
            await asyncio.to_thread(self._engine.open)
            await asyncio.to_thread(prepare)
            # If all kernels are compiled, lit pictures are ready with the first ones.
            if self._engine.kernels.progress is None:
                await self._light()
        except Exception as error:
            self.failure = error
        self._compiling = asyncio.create_task(self._compile(survey))
        self.settled.set()

    async def close(self) -> None:
        """Stop compiling, once the engine is open."""
        self._closing = True
        await self.settled.wait()
        if self._compiling:
            self._engine.stop()
            await self._compiling

    async def ready(self) -> None:
        """Return once the service is ready, or has failed to start."""
        await self.settled.wait()
        while not self.failure and await asyncio.to_thread(self.reasons) != []:
            await asyncio.sleep(LOOK)

    def starting(self) -> list[str]:
        """Return the reasons why no picture can be drawn; an empty list if one can."""
        if not self.settled.is_set():
            return [self._engine.kernels.compiling or SCENE_NOT_OPEN]
        if self.failure:
            return [f"isogi did not start: {self.failure}"]
        return []

    def reasons(self) -> list[str]:
        """Return the reasons why pictures do not become final; an empty list if all is well."""
        return self.starting() or self._engine.unready()

    @property
    def open(self) -> bool:
        """Return True if the engine is open."""
        return self.settled.is_set() and not self.failure

    def check(self) -> None:
        """Raise StartingError until the engine is open."""
        if not self.open:
            raise StartingError(self.starting()[0])

    async def others(self, shading: str, patience: float) -> None:
        """Wait for kernels of a ``shading`` that scenes do not need by default. Raises
        BusyError if they take more than ``patience`` seconds.
        """
        await within(patience, self._all)
        if not self._all.is_set():
            raise BusyError(COMPILING.format(shading=shading), "compiling")

    async def _light(self) -> None:
        """Compile and load kernels of light, and start the workers."""
        await asyncio.to_thread(self._engine.light)
        self.lit.set()

    async def _compile(self, survey: Callable[[Scene], None]) -> None:
        """Compile kernels of light, ``survey`` scenes, then compile the kernels that scenes do
        not need by default; nothing of this after a failure.
        """
        try:
            if self.failure:
                return
            if not self.lit.is_set():
                await self._light()
            await self._survey(survey)
            await self._compile_others()
        except Exception as error:
            self.failure = error
        finally:
            # Requests that wait for kernels go on, also after a failure: drawing then raises an
            # error.
            self.lit.set()
            self._all.set()

    async def _survey(self, survey: Callable[[Scene], None]) -> None:
        """Call ``survey`` with each scene until the service closes. If that fails for a scene,
        pictures can be drawn all the same.
        """
        for scene in list(self._engine.scenes.values()):
            if self._closing:
                return
            try:
                await asyncio.to_thread(survey, scene)
            except Exception:
                log.exception("The document of the scene %s could not be computed.", scene.id)

    async def _compile_others(self) -> None:
        """Compile the kernels that scenes do not need by default. If that fails, all other pictures
        can be drawn.
        """
        try:
            await asyncio.to_thread(self._engine.kernels.others)
        except Exception:
            log.exception("Kernels that few pictures need could not be compiled.")


async def within(seconds: float, event: asyncio.Event) -> None:
    """Return when the event is set, or after this number of seconds."""
    if not event.is_set():
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await event.wait()
