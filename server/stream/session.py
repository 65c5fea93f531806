"""A session: one client's stream, from its first view to its leaving."""

from __future__ import annotations

import asyncio
from contextlib import aclosing, suppress
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from isogi_core.errors import IsogiError
from isogi_core.frame.stopwatch import Stopwatch
from isogi_core.model.scene import Scene
from server.errors import StreamError
from server.metrics import Metrics
from server.order import Order, Shown
from server.params import FrameParams
from server.pictures import encode, format_for
from server.renders import DRAFT
from server.service import Service, work_of
from server.stream.drafts import Drafts
from server.stream.limits import Inbox
from server.stream.messages import Receipt, Wish, answer, complaint, message_of, read_message
from server.stream.window import Window
from server.turns import Rank
from server.visits import newcomer

WANT_EVERY = 0.5
"""Seconds between two drafts of a moving view whose light is asked for: what it shows next needs much of the same."""


class Session:
    """Answers the newest view that its client sent; work on an older one ends.

    A draft alone is drawn to its end while the view goes on moving: else none would be when views come faster.
    """

    def __init__(self, socket: WebSocket, service: Service, scene: Scene) -> None:
        self._socket, self._service, self._scene = socket, service, scene
        self._metrics: Metrics = socket.app.state.metrics
        self._viewer = newcomer()
        self._inbox = Inbox(socket, service.settings)
        self._drafts, self._window = Drafts(), Window()
        self._sending = asyncio.Lock()
        self._newest: tuple[Wish, FrameParams] | None = None
        self._news = asyncio.Event()
        self._showing: asyncio.Task[None] | None = None
        self._wanted = -WANT_EVERY
        self._still = -1

    async def run(self) -> None:
        """Returns when the client has left, or was told to for what it sent; nothing is baked for it any more."""
        reading, working = asyncio.create_task(self._read()), asyncio.create_task(self._work())
        try:
            await asyncio.wait({reading, working}, return_when=asyncio.FIRST_COMPLETED)
            for task in (reading, working):
                if task.done():
                    await task
        except StreamError as error:
            await self._socket.close(error.code, str(error))
        except WebSocketDisconnect:
            pass
        finally:
            reading.cancel()
            working.cancel()
            await asyncio.wait({reading, working})
            self._service.leave(self._viewer)

    async def _read(self) -> None:
        """Take in messages until the client leaves."""
        while (text := await self._inbox.next()) is not None:
            wish: Any = None
            try:
                message = message_of(text)
                wish = message.get("id")
                self._take(read_message(message))
            except IsogiError as error:
                await self._send(complaint(wish, error, self._socket.url.path))

    def _take(self, message: Wish | Receipt) -> None:
        if isinstance(message, Receipt):
            self._window.shown(message.shown, message.took / 1000.0)
            if message.shown != self._still:
                self._drafts.shown(message.took / 1000.0)
            return
        self._still = self._still if message.moving else message.id
        older, self._newest = self._newest, (message, message.params())
        self._news.set()
        if self._showing and not (older and older[0].moving and message.moving):
            self._showing.cancel()

    async def _work(self) -> None:
        """Show the newest view, again and again."""
        while True:
            await self._news.wait()
            await self._window.room()
            self._news.clear()
            assert self._newest
            self._showing = asyncio.create_task(self._show(*self._newest))
            try:
                await asyncio.wait({self._showing})
            finally:
                self._showing.cancel()
                await asyncio.wait({self._showing})
            if not self._showing.cancelled():
                self._showing.result()

    async def _show(self, wish: Wish, params: FrameParams) -> None:
        """Answer a wish, or tell what is wrong with it."""
        try:
            form, order = format_for(params, None), self._service.order(self._scene, params)
            await (self._draft(wish, params, order) if wish.moving else self._rest(wish, params, order, form))
        except IsogiError as error:
            await self._send(complaint(wish.id, error, self._socket.url.path))

    async def _draft(self, wish: Wish, params: FrameParams, order: Order) -> None:
        """One picture of a view that moves, as large as it can come quickly, and coded as fast."""
        self._service.studio.make_way()
        small, watch, rank = order.scaled(self._drafts.scale), Stopwatch(), Rank.within(DRAFT)
        frame = await self._service.frame(small, rank, watch)
        shown = Shown(frame, None, watch, frozenset(), 0)
        await self._picture(wish, params, shown, "jpeg")
        self._drafts.drawn(work_of(shown), self._window.way)
        now = asyncio.get_running_loop().time()
        if now - self._wanted >= WANT_EVERY:
            self._wanted = now
            await self._service.renders.run(lambda: self._service.claim(small, frame.unsharpened, self._viewer), rank)

    async def _rest(self, wish: Wish, params: FrameParams, order: Order, form: str) -> None:
        """The full picture of a view at rest, and each better one, until it is final."""
        async with aclosing(self._service.refinements(order, self._viewer)) as refinements:
            async for shown in refinements:
                await self._picture(wish, params, shown, form)
                await self._window.room()

    async def _picture(self, wish: Wish, params: FrameParams, shown: Shown, form: str) -> None:
        """Send a picture and its facts."""
        exposure = self._scene.default_exposure if params.exposure is None else params.exposure

        def made() -> tuple[str, bytes]:
            with shown.watch.stage("encode"):
                picture = encode(shown.frame, form, exposure, params.overlay)
            return answer(wish.id, shown, form, wish.moving), picture

        facts, picture = await self._service.renders.run(made, Rank.within(DRAFT))
        self._window.sent(wish.id)
        self._metrics.count_picture("draft" if wish.moving else "stream", shown.frame.provisional, shown.watch.seconds)
        await self._send(facts, picture)

    async def _send(self, text: str, data: bytes | None = None) -> None:
        """Send all of it or nothing, also where whoever sends is cancelled on the way."""
        await asyncio.shield(self._send_all(text, data))

    async def _send_all(self, text: str, data: bytes | None) -> None:
        with suppress(WebSocketDisconnect, RuntimeError):
            async with self._sending:
                await self._socket.send_text(text)
                if data is not None:
                    await self._socket.send_bytes(data)
