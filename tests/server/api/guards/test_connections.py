"""Slow clients and crowds, on real sockets."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from fastapi import WebSocket
from starlette.responses import Response
from starlette.websockets import WebSocketDisconnect

from isogi_server.api import connections
from isogi_server.api.connections import too_many
from isogi_server.settings import Patience, Settings
from tests.server.asking import UPGRADE
from tests.server.sockets import (
    HEAD,
    LARGE,
    Running,
    answer,
    running,
    small_app,
    status,
    wait_for,
)

POST = b"POST /small HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n"
DEFAULT = Patience().head_seconds
"""Seconds for a head and a body where nothing else is set."""

SLOW = 20
"""Slow clients at once; 200 of them were tried by hand."""


@pytest.fixture(scope="module")
def server() -> Iterator[Running]:
    with running(
        head_seconds=1, body_seconds=1, upload_seconds=3, stall_seconds=1, idle_seconds=1
    ) as server:
        yield server


@pytest.mark.parametrize(
    ("said", "answered"),
    [
        (HEAD, 408),
        (b"G", 408),
        (b"", 0),
        (POST, 200),
        (POST[:-2], 408),
        (HEAD + b"X: " + b"x" * 200_000, 400),
    ],
)
def test_half_a_request_is_not_waited_for(server: Running, said: bytes, answered: int) -> None:
    """A body that the route does not read is not missed, but it ends the connection too."""
    begun = time.monotonic()
    with server.connect(said) as client:
        told = answer(client)
    assert status(told) == answered
    assert time.monotonic() - begun < DEFAULT
    if answered >= 400:
        head, _, body = told.partition(b"\r\n\r\n")
        assert b"application/problem+json" in head and b"connection: close" in head.lower()
        assert json.loads(body)["status"] == answered


def test_an_upload_has_time_of_its_own(server: Running) -> None:
    begun = time.monotonic()
    with server.connect(POST.replace(b"/small", b"/v1/volumes") + b"half") as client:
        told = answer(client)
    assert status(told) == 408 and b"within 3 s" in told
    assert time.monotonic() - begun >= 3


def drip(server: Running, said: bytes, stop: threading.Event) -> None:
    """Say this, then a byte now and then, and come back when the server has closed."""
    while not stop.is_set():
        try:
            with server.connect(said) as client:
                while not stop.wait(0.2):
                    client.sendall(b"x")
        except OSError:
            continue


@pytest.mark.parametrize("said", [HEAD + b"X: ", POST.replace(b"9", b"9999"), b""])
def test_dripping_clients_are_closed_and_do_not_keep_others_out(
    server: Running, said: bytes
) -> None:
    stop = threading.Event()
    before = server.closed("head") + server.closed("body")
    threads = [threading.Thread(target=drip, args=(server, said, stop)) for _ in range(SLOW)]
    for thread in threads:
        thread.start()
    try:
        assert wait_for(lambda: server.held() >= SLOW)
        assert {server.ask() for _ in range(20)} == {200}
        assert wait_for(lambda: server.closed("head") + server.closed("body") >= before + SLOW)
        assert {server.ask() for _ in range(20)} == {200}
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def test_who_does_not_take_an_answer_is_closed(server: Running) -> None:
    with server.connect(HEAD.replace(b"small", b"large") + b"\r\n") as client:
        assert wait_for(lambda: server.closed("answer") == 1)
        assert len(answer(client)) < LARGE
    assert wait_for(lambda: server.held() == 0)


def test_who_neither_sends_nor_takes_is_given_up_once() -> None:
    """Its request was answered before all of its body had come."""
    app = small_app()
    app.add_api_route("/large", lambda: Response(bytes(LARGE)), methods=["POST"])
    with running(app, body_seconds=1, stall_seconds=2) as server:
        with server.connect(POST.replace(b"small", b"large")):
            assert wait_for(lambda: server.closed("body") == 1 and server.held() == 0)
        assert server.closed("answer") == 0


def test_who_takes_it_slowly_but_surely_gets_all_of_it(server: Running) -> None:
    taken = 0
    with server.connect(HEAD.replace(b"small", b"large") + b"Connection: close\r\n\r\n") as client:
        while part := client.recv(1 << 20):
            taken += len(part)
            time.sleep(0.04)
    assert taken > LARGE


def test_a_quiet_connection_is_closed_in_silence(server: Running) -> None:
    with server.connect(HEAD + b"\r\n") as client:
        told = answer(client)
    assert told.count(b"HTTP/1.1") == 1


def test_the_end_of_an_answer_is_not_held_back(server: Running) -> None:
    with server.connect(HEAD) as _:
        assert wait_for(lambda: server.held() == 1)
        (connection,) = server.server.server_state.connections
        connected = connection.transport.get_extra_info("socket")
        assert connected.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_the_slowest_makes_room_where_answers_pile_up() -> None:
    with running(unsent_mb=LARGE * 3 // 2 >> 20) as server:
        request = HEAD.replace(b"small", b"large") + b"Connection: close\r\n\r\n"
        with server.connect(request) as slow:
            assert wait_for(lambda: server.unsent() > LARGE * 3 // 4)
            with server.connect(request) as quick:
                assert wait_for(lambda: server.closed("memory") == 1)
                assert len(answer(quick)) > LARGE
            assert server.closed("memory") == 1
            assert len(answer(slow)) < LARGE


@pytest.mark.parametrize("limit", ["max_connections", "max_client_connections"])
def test_in_a_crowd_who_waits_longest_makes_room(limit: str) -> None:
    with running(**{limit: 4}) as server:
        waiting = [server.connect(HEAD) for _ in range(4)]
        assert wait_for(lambda: server.held() == 4)
        assert server.ask() == 200
        assert status(answer(waiting[0])) == 408
        waiting[3].sendall(b"Connection: close\r\n\r\n")
        assert status(answer(waiting[3])) == 200
        for each in waiting:
            each.close()


@pytest.mark.parametrize(
    ("hosts", "many"),
    [
        (["2001:db8::1", "2001:db8::ffff:2", "2001:db8::3"], 3),
        (["2001:db8::1", "2001:db8:0:1::1", "2001:db8:0:2::1"], 0),
        (["::ffff:192.0.2.1", "192.0.2.1", "192.0.2.1"], 3),
        (["192.0.2.1", "192.0.2.2", "192.0.2.3"], 0),
    ],
)
def test_a_network_of_ipv6_is_one_client(hosts: list[str], many: int) -> None:
    held: Any = [SimpleNamespace(client=(host, 1000 + number)) for number, host in enumerate(hosts)]
    assert len(too_many(held[0], held, Settings(max_client_connections=2))) == many


def test_where_all_are_at_work_a_newcomer_is_told_to_come_back() -> None:
    with running(max_connections=2) as server:
        slow = HEAD.replace(b"small", b"slow?seconds=1") + b"Connection: close\r\n\r\n"
        busy = [server.connect(slow) for _ in range(2)]
        assert wait_for(lambda: len(server.server.server_state.tasks) == 2)
        assert server.ask() == 503
        assert [status(answer(each)) for each in busy] == [200, 200]
        assert server.ask() == 200
        for each in busy:
            each.close()


HANDSHAKE = (
    b"GET /stream HTTP/1.1\r\nHost: localhost\r\n"
    + "".join(f"{name}: {value}\r\n" for name, value in UPGRADE.items()).encode()
    + b"\r\n"
)
PING_FRAME = b"\x89\x04"
ASKED = b"\x81\x82" + bytes(4) + b"hi"
PONG = b"\x8a\x84" + bytes(4)
"""The head of a ping of four bytes, a text, and the head of a pong; their mask changes nothing."""


@pytest.fixture
def streaming(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Running, list[str]]]:
    """A server whose stream sends a large picture, with pings that come soon; and what became of
    its streams.
    """
    monkeypatch.setattr(connections, "PING", 0.2)
    app = small_app()
    ends = list[str]()

    async def stream(client: WebSocket) -> None:
        await client.accept()
        try:
            await client.send_bytes(bytes(LARGE))
            while await asyncio.wait_for(client.receive_text(), 30):
                await client.send_text("heard")
        except WebSocketDisconnect as end:
            ends.append(str(end.code))

    app.add_api_websocket_route("/stream", stream)
    with running(app, stall_seconds=1) as server:
        yield server, ends


def test_a_stream_lives_while_its_client_takes_a_picture(
    streaming: tuple[Running, list[str]],
) -> None:
    """Its pings wait behind that, many times longer than a client may take for one."""
    server, ends = streaming
    with server.connect(HANDSHAKE, seconds=30) as client:
        said = bytearray()
        while len(said) < LARGE:
            said += heard(client, 1 << 17)
            time.sleep(0.05)
        while (at := said.find(PING_FRAME, LARGE)) < 0 or len(said) < at + 6:
            said += heard(client)
        client.sendall(PONG + said[at + 2 : at + 6] + ASKED)
        while b"heard" not in said:
            said += heard(client)
        assert not ends


def heard(client: socket.socket, most: int = 1 << 16) -> bytes:
    """What a client is sent next; it was not closed."""
    part = client.recv(most)
    assert part, "the stream was closed"
    return part


def test_a_stream_whose_client_takes_nothing_is_closed(
    streaming: tuple[Running, list[str]],
) -> None:
    server, ends = streaming
    with server.connect(HANDSHAKE):
        assert wait_for(lambda: ends, 20)
