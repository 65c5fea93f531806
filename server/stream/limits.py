"""What a client may ask of its stream: how much, how often, how seldom."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from starlette.websockets import WebSocket

from server.errors import StreamError

if TYPE_CHECKING:
    from server.settings import Settings

TOO_BIG, POLICY, IDLE = 1009, 1008, 4000
"""Codes that a stream is closed with (RFC 6455, 7.4): a message is too long; too many, or no text; none for long."""


class Inbox:
    """The messages of a stream, as long as they keep within the settings."""

    def __init__(self, socket: WebSocket, settings: Settings) -> None:
        self._socket, self._settings = socket, settings
        self._second, self._count = 0, 0

    async def next(self) -> str | None:
        """The next message; None when the client has gone. Raises StreamError where it breaks a limit."""
        try:
            message = await asyncio.wait_for(self._socket.receive(), self._settings.stream_idle_seconds)
        except TimeoutError:
            raise StreamError(f"No message for {self._settings.stream_idle_seconds:g} seconds.", IDLE) from None
        if message["type"] == "websocket.disconnect":
            return None
        self._count_one()
        text = message.get("text")
        if text is None:
            raise StreamError("Messages must be text.", POLICY)
        if len(text.encode()) > self._settings.stream_bytes:
            raise StreamError(f"A message is longer than {self._settings.stream_bytes} bytes.", TOO_BIG)
        return str(text)

    def _count_one(self) -> None:
        second = int(asyncio.get_running_loop().time())
        self._count = self._count + 1 if second == self._second else 1
        self._second = second
        if self._count > self._settings.stream_rate:
            raise StreamError(f"More than {self._settings.stream_rate} messages in a second.", POLICY)
