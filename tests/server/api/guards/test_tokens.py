"""The token."""

from collections.abc import Callable

import httpx
import pytest
from fastapi import FastAPI, WebSocket

from server.api.access import Token, TokenBearers
from server.bearers import Bearer
from tests.server.api.guards.handshakes import handshake, status

Ask = Callable[..., httpx.Response]
TOKEN = "correct horse battery"
BEARER = {"Authorization": f"Bearer {TOKEN}"}


@pytest.fixture
def app(guarded: Callable[..., FastAPI]) -> FastAPI:
    app = guarded(TokenBearers, bearers=[Bearer(TOKEN)])

    @app.websocket("/socket")
    async def socket(socket: WebSocket) -> None:
        await socket.accept()

    return app


@pytest.mark.parametrize(
    "headers",
    [
        *[{}, {"Authorization": "Bearer"}, {"Authorization": "Bearer wrong"}, {"Authorization": f"Basic {TOKEN}"}],
        *[{"Authorization": f"Bearer {TOKEN}!"}, {"Authorization": "Bearer \xff"}, {"Cookie": f"isogi={TOKEN}"}],
        *[{"Cookie": "=;;;[]"}, {"Cookie": 'a="b; isogi-x=c'}],
    ],
)
def test_without_the_token_nothing_is_answered_or_changed(ask: Ask, app: FastAPI, headers: dict[str, str]) -> None:
    raw = {name: value.encode("latin-1") for name, value in headers.items()}
    answer = ask(app, "POST", "/data", headers=raw)
    assert (answer.status_code, app.state.changes) == (401, 0)
    assert answer.headers["www-authenticate"] == "Bearer"
    assert answer.headers["content-type"] == "application/problem+json"
    assert status(handshake(app)) == 401


def test_with_it_all_is(ask: Ask, app: FastAPI) -> None:
    assert ask(app, "POST", "/data", headers=BEARER).status_code == 200
    assert app.state.changes == 1
    assert status(handshake(app, authorization=BEARER["Authorization"])) == 101


def test_shared_caches_keep_nothing_of_it(ask: Ask, app: FastAPI) -> None:
    assert ask(app, "GET", "/data", headers=BEARER).headers["cache-control"] == "private, max-age=5"
    assert ask(app, "GET", "/page", headers=BEARER).headers["cache-control"] == "private, no-cache"


def test_probes_need_none(ask: Ask, app: FastAPI) -> None:
    assert ask(app, "GET", "/livez").status_code == 200


def test_a_browser_shows_it_once_and_then_a_cookie(ask: Ask, app: FastAPI) -> None:
    entry = ask(app, "GET", "/", params={"isovalue": "70", "token": TOKEN})
    assert (entry.status_code, entry.headers["location"]) == (303, "./?isovalue=70")
    cookie = entry.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    assert TOKEN not in str(entry.headers)
    shown = {"Cookie": f"other=1; {cookie.partition(';')[0]}"}
    assert ask(app, "GET", "/page", headers=shown).status_code == 200
    assert ask(app, "GET", "/page", headers={"Cookie": shown["Cookie"][:-1]}).status_code == 401
    assert status(handshake(app, cookie=shown["Cookie"])) == 101


def test_a_cookie_goes_over_tls_alone_where_it_was_set_so(guarded: Callable[..., FastAPI]) -> None:
    scope = {"type": "http", "scheme": "https", "query_string": b""}
    assert "; Secure" in TokenBearers(guarded(), ()).admission(scope, Token(Bearer(TOKEN))).headers["set-cookie"]


LOOK, UPLOAD, ADMIN = "a token to look at it", "a token to send files", "a token for all of it"


@pytest.mark.parametrize("order", [(LOOK, UPLOAD, ADMIN), (ADMIN, UPLOAD, LOOK), (UPLOAD, LOOK, ADMIN)])
def test_of_several_cookies_the_one_that_allows_most_counts(
    ask: Ask, guarded: Callable[..., FastAPI], order: tuple[str, ...]
) -> None:
    scopes = {LOOK: {"look"}, UPLOAD: {"look", "bake", "upload"}, ADMIN: {"admin"}}
    bearers = [Bearer(token, token[8:12], frozenset(scopes[token])) for token in order]
    app = guarded(TokenBearers, bearers=bearers)
    cookies = {bearer.token: f"{Token(bearer).name}={Token(bearer).cookie}" for bearer in bearers}
    for shown, allowed in (((LOOK,), 403), ((LOOK, UPLOAD), 200), ((UPLOAD, LOOK), 200), ((LOOK, ADMIN), 200)):
        headers = {"Cookie": "; ".join(cookies[token] for token in shown)}
        assert ask(app, "POST", "/data", headers=headers).status_code == allowed, shown
    both = {"Cookie": f"{cookies[ADMIN]}; {cookies[LOOK]}", "Authorization": f"Bearer {LOOK}"}
    assert ask(app, "POST", "/data", headers=both).status_code == 403, "a token that is shown itself counts alone"


@pytest.mark.parametrize(("method", "path"), [("GET", "/page"), ("POST", "/data"), ("GET", "/data")])
def test_no_other_address_takes_it(ask: Ask, app: FastAPI, method: str, path: str) -> None:
    assert ask(app, method, path, params={"token": TOKEN}).status_code == 401


def test_a_wrong_token_is_refused_despite_a_cookie(ask: Ask, app: FastAPI) -> None:
    cookie = ask(app, "GET", "/", params={"token": TOKEN}).headers["set-cookie"].partition(";")[0]
    assert ask(app, "GET", "/", params={"token": "wrong"}, headers={"Cookie": cookie}).status_code == 401


def test_a_person_gets_a_page_that_says_what_to_do(ask: Ask, app: FastAPI) -> None:
    answer = ask(app, "GET", "/", headers={"Accept": "text/html,*/*"})
    assert (answer.status_code, answer.headers["cache-control"]) == (401, "no-store")
    assert "?token=" in answer.text
