"""What clients break leaves no error in the log, and no connection behind."""

import logging
import time
from collections.abc import Iterator

import pytest
from fastapi import WebSocket

from isogi_server import problems
from isogi_server.problems import problem
from tests.server.sockets import Running, answer, running, small_app, status, wait_for

KEY = b"Sec-WebSocket-Key: x3JJHMbDL1EzLkh9GBhXDw==\r\nSec-WebSocket-Version: 13\r\n"
UPGRADE = b" HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n" + KEY
CHUNKED = b" HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n"
OPEN = b"GET /open" + UPGRADE + b"\r\n"
REFUSED = b"GET /refused" + UPGRADE + b"\r\n"
SOON = 5.0


def frame(kind: int, data: bytes, final: int = 0x80) -> bytes:
    """One frame of a client, its mask zero (RFC 6455, 5.2)."""
    return bytes([final | kind, 0x80 | len(data)]) + bytes(4) + data


@pytest.fixture(scope="module")
def server() -> Iterator[Running]:
    app = small_app()
    problems.install(app)

    @app.websocket("/refused")
    async def refused(socket: WebSocket) -> None:
        await socket.send_denial_response(problem(429, "Too many.", "/refused"))

    @app.websocket("/open")
    async def opened(socket: WebSocket) -> None:
        await socket.accept()
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass

    with running(app, head_seconds=1, idle_seconds=1) as server:
        yield server


@pytest.mark.parametrize(
    ("said", "more", "answered"),
    [
        (REFUSED, b"", 429),
        (OPEN, frame(1, b"\xff\xfe"), 101),
        (OPEN, frame(1, b"a\xc3", 0) + frame(0, b"b"), 101),
        (OPEN, frame(7, b"a"), 101),
        (OPEN, frame(8, b"\x03\xe8\xff"), 101),
        (b"GET /open" + UPGRADE + b"X: y\r\n" * 300 + b"\r\n", b"", 400),
        (b"GET /open" + UPGRADE + b"X: " + b"x" * 20_000 + b"\r\n\r\n", b"", 400),
        (b"GET /open?" + b"x" * 20_000 + UPGRADE + b"\r\n", b"", 400),
        (b"GET /open" + UPGRADE + b"Content-Length: 5\r\n\r\nhello", b"", 400),
        (b"POST /small" + CHUNKED, b"", 400),
        (b"POST /v1/volumes" + CHUNKED, b"", 400),
        (b"\xff\xfe\r\n\r\n", b"", 400),
    ],
)
def test_what_a_client_breaks_is_no_error(
    server: Running, caplog: pytest.LogCaptureFixture, said: bytes, more: bytes, answered: int
) -> None:
    begun = time.monotonic()
    with server.connect(said) as client:
        told = client.recv(65536) if more else b""
        client.sendall(more)
        assert status(told + answer(client)) == answered
    assert time.monotonic() - begun < SOON
    assert wait_for(lambda: not server.held() and not server.server.server_state.tasks)
    assert not [
        record for record in caplog.records if record.levelno >= logging.ERROR or record.exc_info
    ]


def test_a_client_that_leaves_in_its_body_is_no_error(
    server: Running, caplog: pytest.LogCaptureFixture
) -> None:
    with server.connect(
        b"POST /v1/volumes HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\nhalf"
    ):
        assert wait_for(lambda: len(server.server.server_state.tasks) == 1)
    assert wait_for(lambda: not server.held() and not server.server.server_state.tasks)
    assert not [
        record for record in caplog.records if record.levelno >= logging.ERROR or record.exc_info
    ]
