"""Origins: what pages of others may do, which is nothing, and what all else may."""

from collections.abc import Callable

import httpx
import pytest
from fastapi import FastAPI, WebSocket

from server.api.access import KnownOrigins
from tests.server.api.guards.handshakes import handshake, status

Ask = Callable[..., httpx.Response]
FOREIGN = [
    {"Origin": "https://evil.example"},
    {"Origin": "http://localhost:8888"},
    {"Origin": "http://localhost.evil.example"},
    {"Origin": "http://evil.example@localhost"},
    {"Origin": "null"},
    {"Origin": ""},
    {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    {"Sec-Fetch-Site": "same-site"},
    {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"},
]
"""What a browser says of a request that a foreign page makes; the last is a form that the page sends."""

OWN = [
    {},
    {"Origin": "http://localhost"},
    {"Origin": "https://localhost", "Sec-Fetch-Site": "same-origin"},
    {"Sec-Fetch-Site": "none"},
]
LAB = "https://lab.example"


@pytest.fixture
def app(guarded: Callable[..., FastAPI]) -> FastAPI:
    app = guarded(KnownOrigins, origins=(LAB,))

    @app.websocket("/socket")
    async def socket(socket: WebSocket) -> None:
        await socket.accept()

    return app


@pytest.mark.parametrize("headers", FOREIGN)
@pytest.mark.parametrize("method", ["POST", "DELETE", "OPTIONS"])
def test_a_foreign_page_changes_nothing(ask: Ask, app: FastAPI, method: str, headers: dict[str, str]) -> None:
    answer = ask(app, method, "/data", headers={**headers, "Content-Type": "text/plain"})
    assert answer.status_code == 403
    assert answer.headers["content-type"] == "application/problem+json"
    assert app.state.changes == 0


@pytest.mark.parametrize("headers", FOREIGN)
def test_a_foreign_page_opens_no_socket(app: FastAPI, headers: dict[str, str]) -> None:
    assert status(handshake(app, **{name.replace("-", "_").lower(): value for name, value in headers.items()})) == 403


@pytest.mark.parametrize("headers", [*OWN, {"Origin": LAB, "Sec-Fetch-Site": "cross-site"}])
def test_own_pages_scripts_and_listed_origins_may(ask: Ask, app: FastAPI, headers: dict[str, str]) -> None:
    assert ask(app, "POST", "/data", headers=headers).status_code == 200
    assert app.state.changes == 1
    assert status(handshake(app, **{name.replace("-", "_").lower(): value for name, value in headers.items()})) == 101


@pytest.mark.parametrize(
    ("mode", "destination", "answered"),
    [("navigate", "document", 200), ("no-cors", "image", 403), ("navigate", "iframe", 403), ("cors", "empty", 403)],
)
def test_foreign_links_are_followed_and_foreign_pictures_refused(
    ask: Ask, app: FastAPI, mode: str, destination: str, answered: int
) -> None:
    headers = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": mode, "Sec-Fetch-Dest": destination}
    assert ask(app, "GET", "/data", headers=headers).status_code == answered
