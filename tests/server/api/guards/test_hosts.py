"""Host names."""

from collections.abc import Callable

import httpx
import pytest
from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.responses import Response

from server.api.access import KnownHosts
from server.settings import LOOPBACK_HOSTS
from tests.server.api.guards.handshakes import handshake, status

Ask = Callable[..., httpx.Response]
OTHERS = [
    *("evil.example", "127.0.0.1.evil.example", "evil.example:80", "localhost.", "", "[::2]", "[", "a@localhost"),
    *("[127.0.0.1]evil", "[127.0.0.1]", "[::1]evil", "[::1]:8000.evil", "localhost:evil"),
]


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.1:80", "localhost:8000", "LOCALHOST", "[::1]", "[::1]:8000"])
def test_loopback_names_are_known(host: str) -> None:
    assert KnownHosts(Response(), LOOPBACK_HOSTS).knows(Headers({"host": host}))


@pytest.mark.parametrize("host", OTHERS)
def test_other_names_are_not(ask: Ask, guarded: Callable[..., FastAPI], host: str) -> None:
    app = guarded(KnownHosts, hosts=LOOPBACK_HOSTS)
    answer = ask(app, "POST", "/data", headers={"Host": host})
    assert answer.status_code == 421
    assert answer.headers["content-type"] == "application/problem+json"
    assert status(handshake(app, host=host)) == 421
    assert app.state.changes == 0


def test_any_name_is_known_where_none_is_listed(ask: Ask, guarded: Callable[..., FastAPI]) -> None:
    assert ask(guarded(KnownHosts, hosts=None), "GET", "/data", headers={"Host": "evil.example"}).status_code == 200
