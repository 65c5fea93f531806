"""A web socket's handshake, as a server would pass it to an app."""

import asyncio
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from fastapi import FastAPI

Guarded = Callable[..., FastAPI]
"""What the fixture ``guarded`` is."""


def handshake(
    app: FastAPI, headers: Mapping[str, str] = MappingProxyType({})
) -> list[dict[str, Any]]:
    """What the app sends to who opens a socket with these headers."""
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        if not sent:
            return {"type": "websocket.connect"}
        return {"type": "websocket.disconnect", "code": 1001}

    async def send(message: Any) -> None:
        sent.append(message)

    named = {"host": "localhost", **{name.lower(): value for name, value in headers.items()}}
    scope = {
        **{
            "type": "websocket",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "scheme": "ws",
            "path": "/socket",
        },
        **{
            "raw_path": b"/socket",
            "query_string": b"",
            "root_path": "",
            "subprotocols": [],
            "state": {},
        },
        **{"headers": [(name.encode(), value.encode()) for name, value in named.items()]},
        **{
            "server": ("localhost", 80),
            "client": ("localhost", 1),
            "extensions": {"websocket.http.response": {}},
        },
    }
    asyncio.run(app(scope, receive, send))  # type: ignore[arg-type]
    return sent


def status(sent: list[dict[str, Any]]) -> int:
    """The status of a handshake's answer; 101 where the socket was accepted."""
    if sent[0]["type"] == "websocket.accept":
        return 101
    return int(sent[0].get("status", 403))
