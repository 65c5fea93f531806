"""How requests end when the server stops, on real sockets."""

import asyncio
import socket
import threading
import time
from collections.abc import AsyncIterator

import pytest
from fastapi import FastAPI, Request
from starlette.responses import StreamingResponse

from isogi_server.cli.serve import queued
from tests.server.sockets import HEAD, Running, answer, running, small_app, status, wait_for


@pytest.fixture
def app() -> FastAPI:
    app = small_app()

    async def patient(request: Request) -> str:
        """Ends when the client leaves, as frames do."""
        while not await request.is_disconnected():
            await asyncio.sleep(0.02)
        return "left"

    async def ticks() -> AsyncIterator[str]:
        while True:
            yield "data: tick\n\n"
            await asyncio.sleep(0.02)

    app.add_api_route("/patient", patient)
    app.add_api_route("/events", lambda: StreamingResponse(ticks(), media_type="text/event-stream"))
    return app


def asked(server: Running, path: str) -> socket.socket:
    """A connection on which ``path`` is being worked on."""
    client = server.connect(HEAD.replace(b"/small", path.encode()) + b"\r\n")
    assert wait_for(lambda: len(server.server.server_state.tasks) == 1)
    return client


def stopped(client: socket.socket, server: Running) -> tuple[bytes, float]:
    """What the client hears from the moment on when the server stops, and for how many seconds."""
    begun = time.monotonic()
    server.server.should_exit = True
    with client:
        return answer(client), time.monotonic() - begun


def test_open_requests_are_answered_with_connection_close(app: FastAPI) -> None:
    with running(app) as server:
        told, _ = stopped(asked(server, "/slow?seconds=1"), server)
    assert status(told) == 200
    assert b"connection: close" in told.lower()


def test_what_is_not_done_in_time_is_told_that_its_client_left(app: FastAPI) -> None:
    with running(app, shutdown_seconds=1) as server:
        told, seconds = stopped(asked(server, "/patient"), server)
    assert told.endswith(b'"left"')
    assert seconds >= 1.0


def test_who_does_not_listen_is_answered_for(app: FastAPI) -> None:
    with running(app, shutdown_seconds=1) as server:
        told, seconds = stopped(asked(server, "/slow?seconds=60"), server)
    assert status(told) == 503
    assert b"application/problem+json" in told and b"retry-after: 1" in told.lower()
    assert seconds < 30.0


def test_what_is_endless_ends_at_once_and_whole(app: FastAPI) -> None:
    with running(app) as server:
        told, seconds = stopped(asked(server, "/events"), server)
    assert status(told) == 200
    assert b"data: tick" in told and told.endswith(b"0\r\n\r\n")
    assert seconds < 8.0


def test_a_request_that_was_on_its_way_is_answered(app: FastAPI) -> None:
    with running(app) as server:
        quiet = server.connect(HEAD + b"\r\n")
        assert wait_for(lambda: len(quiet.recv(65536, socket.MSG_PEEK)) > 0)
        server.server.should_exit = True
        assert wait_for(lambda: server.server.closing.begun)
        quiet.sendall(HEAD + b"\r\n")
        told = answer(quiet)
        quiet.close()
    assert told.count(b"HTTP/1.1 200") == 2
    assert told.lower().count(b"connection: close") == 1


@pytest.mark.slow
def test_a_stop_breaks_off_no_answer(app: FastAPI) -> None:
    """Each client opens a connection for each request, and finds the port closed, perhaps while it
    connects.
    """
    ends: list[type[Exception]] = []

    def go_on(server: Running) -> None:
        try:
            while True:
                assert server.ask() == 200
        except Exception as error:
            ends.append(type(error))

    with running(app) as server:
        threads = [threading.Thread(target=go_on, args=(server,)) for _ in range(8)]
        for thread in threads:
            thread.start()
        time.sleep(0.5)
    for thread in threads:
        thread.join()
    assert len(ends) == 8 and set(ends) <= {ConnectionRefusedError, ConnectionResetError}


def test_connections_that_wait_are_taken_before_the_end() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        waiting = [socket.create_connection(listener.getsockname()) for _ in range(3)]
        listener.setblocking(False)
        last = list(queued(listener))
        listener.close()
        for client, accepted in zip(waiting, last, strict=True):
            with client, accepted:
                accepted.sendall(b"welcome")
                assert client.recv(16) == b"welcome"
