"""Who a client is: what headers say of it counts from proxies alone that the settings name."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from fastapi import Request

from isogi_server.settings import Settings
from tests.server.sockets import Running, answer, running, small_app, wait_for

FORGED = (
    b"X-Forwarded-For: 203.0.113.7, 198.51.100.2\r\nX-Forwarded-Proto: "
    b"https\r\nForwarded: for=203.0.113.9\r\n"
)
ASKED = b"GET /who HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"


@contextmanager
def telling(**settings: Any) -> Iterator[Running]:
    """A server that tells what it takes its client for."""
    app = small_app()

    async def who(request: Request) -> list[str | None]:
        return [request.client.host if request.client else None, request.url.scheme]

    app.add_api_route("/who", who)
    with running(app, **settings) as server:
        yield server


def who(server: Running, *headers: bytes) -> Any:
    """The client's address and scheme, as a server takes them from these headers."""
    with server.connect(ASKED, *headers, b"\r\n") as client:
        return json.loads(answer(client).partition(b"\r\n\r\n")[2])


def test_no_header_names_the_client_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORWARDED_ALLOW_IPS", "*")
    with telling() as server:
        assert who(server, FORGED) == ["127.0.0.1", "http"]


@pytest.mark.parametrize(
    ("proxies", "host"), [("127.0.0.1", "198.51.100.2"), ("127.0.0.0/8", "198.51.100.2")]
)
def test_a_proxy_that_is_named_names_the_client(proxies: str, host: str) -> None:
    with telling(trusted_proxies=proxies) as server:
        assert who(server, FORGED) == [host, "https"]
        assert who(server) == ["127.0.0.1", "http"]


def test_what_the_client_of_a_proxy_forges_does_not_count() -> None:
    with telling(trusted_proxies="127.0.0.1,198.51.100.2") as server:
        assert who(
            server,
            b"X-Forwarded-For: 10.0.0.1, 203.0.113.7\r\n",
            b"X-Forwarded-For: 198.51.100.2\r\n",
        ) == [
            "203.0.113.7",
            "http",
        ]


def test_a_header_of_another_proxy_is_ignored() -> None:
    with telling(trusted_proxies="192.0.2.1") as server:
        assert who(server, FORGED) == ["127.0.0.1", "http"]


def test_a_proxy_may_have_connections_of_many_clients() -> None:
    waiting = b"GET /slow?seconds=1 HTTP/1.1\r\nHost: localhost\r\n\r\n"
    for proxies, answered in (("", 503), ("127.0.0.1", 200)):
        with (
            running(max_client_connections=2, trusted_proxies=proxies) as server,
            server.connect(waiting),
            server.connect(waiting),
        ):
            assert wait_for(lambda: len(server.server.server_state.tasks) == 2)
            assert server.ask() == answered


@pytest.mark.parametrize("name", ["*", "lab.example", "10.0.0.1/8", "", "10.0.0.0/33"])
def test_a_proxy_is_an_address_or_a_network(name: str) -> None:
    with pytest.raises(ValueError, match="is no address or network"):
        Settings(trusted_proxies=(name,))
