"""A small app on a real socket, and clients that do not behave."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from fastapi import FastAPI, Request
from starlette.responses import Response
from websockets.asyncio.client import connect

from isogi_server.api.lifespan import Closing, GracefulShutdown
from isogi_server.cli.serve import Server, listen
from isogi_server.render.metrics import Metrics
from isogi_server.settings import Patience, Settings

HEAD = b"GET /small HTTP/1.1\r\nHost: localhost\r\n"
LARGE = 4 << 20
"""Bytes of an answer, far more than the buffers of the system take."""

BUFFER = 1 << 16
"""Bytes of each of these buffers: by default they grow to many MB while a client reads."""


def small_app() -> FastAPI:
    """Answers that are small, large, slow, and endless; it has what ``Server`` needs."""
    closing = Closing()
    app = FastAPI()
    app.add_middleware(GracefulShutdown, closing=closing)
    app.state.closing = closing
    app.state.metrics = Metrics()

    async def slow(seconds: float) -> float:
        await asyncio.sleep(seconds)
        return seconds

    async def length(request: Request) -> int:
        return len(await request.body())

    app.add_api_route("/small", lambda: {"a": 1})
    app.add_api_route("/v1/volumes", length, methods=["POST"])
    app.add_api_route("/large", lambda: Response(bytes(LARGE)))
    app.add_api_route("/slow", slow)
    app.add_api_route("/small", lambda: {"a": 1}, methods=["POST"])
    return app


class Running:
    """A server on a thread, its address, and the app's counters."""

    def __init__(self, server: Server, address: tuple[str, int], metrics: Metrics) -> None:
        self.server = server
        self.address = address
        self.metrics = metrics

    def connect(
        self, *said: bytes, seconds: float = 10.0, source: str = "127.0.0.1"
    ) -> socket.socket:
        """A connection on which this was said, from an address of this machine."""
        connection = socket.socket()
        connection.bind((source, 0))
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        connection.settimeout(seconds)
        try:
            connection.connect(self.address)
            for each in said:
                connection.sendall(each)
        except OSError:
            connection.close()
            raise
        return connection

    def ask(self, path: str = "/small") -> int:
        """The status that a client gets that behaves well."""
        with self.connect(
            f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode()
        ) as client:
            return status(answer(client))

    def closed(self, why: str) -> float:
        """How many connections were given up for this."""
        return (
            self.metrics.registry.get_sample_value("isogi_connections_closed_total", {"why": why})
            or 0.0
        )

    def held(self) -> int:
        """How many connections the server holds."""
        return len(self.server.server_state.connections)

    def unsent(self) -> int:
        """Bytes of answers that the server keeps, for its clients do not take them."""
        connections: list[Any] = list(self.server.server_state.connections)
        return sum(connection.unsent for connection in connections)


def settings_of(**given: Any) -> Settings:
    """Settings, of which some may be of the server's patience."""
    patience = {name: given.pop(name) for name in Patience._fields if name in given}
    return Settings(**given).with_patience(Patience(**patience))


@contextmanager
def running(app: FastAPI | None = None, **given: Any) -> Iterator[Running]:
    """A server for a while, with these settings."""
    app = app or small_app()
    app.state.settings = settings_of(**given)
    with listen("127.0.0.1", 0) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)  # connections inherit it
        server = Server(app)
        thread = threading.Thread(target=server.run, args=([listener],))
        address = listener.getsockname()
        thread.start()
        try:
            wait_for(lambda: server.started)
            yield Running(server, address, app.state.metrics)
        finally:
            server.should_exit = True
            thread.join()


def answer(connection: socket.socket) -> bytes:
    """All that the server says until it closes."""
    said = bytearray()
    while part := connection.recv(65536):
        said += part
    return bytes(said)


def status(said: bytes) -> int:
    """The status in an answer; 0 where there is none."""
    return int(said.split(b" ", 2)[1]) if said else 0


def wait_for(condition: Any, seconds: float = 10.0) -> bool:
    """Whether the condition came true in time."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


async def pictures_on(stream: str, views: Sequence[Mapping[str, Any]]) -> list[bytes]:
    """The picture that a ``stream`` sends of each view, one after the other; none may be
    refused.
    """
    pictures = []
    async with connect(stream.replace("http", "ws"), max_size=None) as connection:
        for number, view in enumerate(views):
            await connection.send(
                json.dumps({"id": number, "view": {"width": 40, "height": 40, "f": "png", **view}})
            )
            while (
                json.loads(facts := await asyncio.wait_for(connection.recv(), 120))["id"] != number
            ):
                await connection.recv()
            assert "problem" not in json.loads(facts)
            picture = await connection.recv()
            assert isinstance(picture, bytes)
            pictures.append(picture)
            await connection.send(json.dumps({"shown": number}))
    return pictures
