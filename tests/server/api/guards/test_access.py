"""Who may ask: by the host that a request names, the page that it comes from, and the token that it
shows.
"""

import pytest
from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.responses import Response

from isogi_server.api.access import KnownHosts, KnownOrigins, Token, TokenBearers
from isogi_server.bearers import Bearer
from isogi_server.settings import Settings
from tests.server.api.guards.handshakes import Guarded, handshake, status
from tests.server.asking import Ask

LOOPBACK = Settings(host="127.0.0.1").hosts()
OTHERS = [
    *(
        "evil.example",
        "127.0.0.1.evil.example",
        "evil.example:80",
        "localhost.",
        "",
        "[::2]",
        "[",
        "a@localhost",
    ),
    *("[127.0.0.1]evil", "[127.0.0.1]", "[::1]evil", "[::1]:8000.evil", "localhost:evil"),
]


@pytest.mark.parametrize(
    "host", ["127.0.0.1", "127.0.0.1:80", "localhost:8000", "LOCALHOST", "[::1]", "[::1]:8000"]
)
def test_loopback_names_are_known(host: str) -> None:
    assert KnownHosts(Response(), LOOPBACK).knows(Headers({"host": host}))


@pytest.mark.parametrize("host", OTHERS)
def test_other_names_are_not(ask: Ask, guarded: Guarded, host: str) -> None:
    app = guarded(KnownHosts, hosts=LOOPBACK)
    answer = ask(app, "POST", "/data", headers={"Host": host})
    assert answer.status_code == 421
    assert answer.headers["content-type"] == "application/problem+json"
    assert status(handshake(app, {"Host": host})) == 421
    assert app.state.changes == 0


def test_any_name_is_known_where_none_is_listed(ask: Ask, guarded: Guarded) -> None:
    assert (
        ask(
            guarded(KnownHosts, hosts=None), "GET", "/data", headers={"Host": "evil.example"}
        ).status_code
        == 200
    )


EVIL = (
    "https://evil.example",
    "http://localhost.evil.example",
    "http://evil.example@localhost",
    "null",
    "",
)
FOREIGN = [
    *[{"Origin": origin} for origin in (*EVIL, "http://localhost:8888")],
    {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    {"Sec-Fetch-Site": "same-site"},
    {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"},
]
"""What a browser says of a request that a foreign page makes; the last is a form that the page
sends.
"""

LAB = "https://lab.example"
OWN = [
    *[
        {},
        {"Origin": "http://localhost"},
        {"Origin": "https://localhost", "Sec-Fetch-Site": "same-origin"},
    ],
    *[{"Sec-Fetch-Site": "none"}, {"Origin": LAB, "Sec-Fetch-Site": "cross-site"}],
]
"""What it says of pages of the server or of a listed origin, and of links that people follow;
scripts say nothing.
"""


@pytest.fixture
def listing(guarded: Guarded) -> FastAPI:
    return guarded(KnownOrigins, origins=(LAB,))


@pytest.mark.parametrize("headers", FOREIGN)
@pytest.mark.parametrize("method", ["POST", "DELETE", "OPTIONS"])
def test_a_foreign_page_changes_nothing_and_opens_no_socket(
    ask: Ask, listing: FastAPI, method: str, headers: dict[str, str]
) -> None:
    answer = ask(listing, method, "/data", headers={**headers, "Content-Type": "text/plain"})
    assert answer.status_code == 403
    assert answer.headers["content-type"] == "application/problem+json"
    assert listing.state.changes == 0
    assert status(handshake(listing, headers)) == 403


@pytest.mark.parametrize("headers", OWN)
def test_own_pages_scripts_and_listed_origins_may(
    ask: Ask, listing: FastAPI, headers: dict[str, str]
) -> None:
    assert ask(listing, "POST", "/data", headers=headers).status_code == 200
    assert listing.state.changes == 1
    assert status(handshake(listing, headers)) == 101


@pytest.mark.parametrize(
    ("mode", "destination", "answered"),
    [
        ("navigate", "document", 200),
        ("no-cors", "image", 403),
        ("navigate", "iframe", 403),
        ("cors", "empty", 403),
    ],
)
def test_foreign_links_are_followed_and_foreign_pictures_refused(
    ask: Ask, listing: FastAPI, mode: str, destination: str, answered: int
) -> None:
    headers = {
        "Sec-Fetch-Site": "cross-site",
        "Sec-Fetch-Mode": mode,
        "Sec-Fetch-Dest": destination,
    }
    assert ask(listing, "GET", "/data", headers=headers).status_code == answered


TOKEN = "correct horse battery"
BEARER = {"Authorization": f"Bearer {TOKEN}"}


@pytest.fixture
def locked(guarded: Guarded) -> FastAPI:
    return guarded(TokenBearers, bearers=[Bearer(TOKEN)])


@pytest.mark.parametrize(
    "headers",
    [
        *[
            {},
            {"Authorization": "Bearer"},
            {"Authorization": "Bearer wrong"},
            {"Authorization": f"Basic {TOKEN}"},
        ],
        *[
            {"Authorization": f"Bearer {TOKEN}!"},
            {"Authorization": "Bearer \xff"},
            {"Cookie": f"isogi={TOKEN}"},
        ],
        *[{"Cookie": "=;;;[]"}, {"Cookie": 'a="b; isogi-x=c'}],
    ],
)
def test_without_the_token_nothing_is_answered_or_changed(
    ask: Ask, locked: FastAPI, headers: dict[str, str]
) -> None:
    raw = {name: value.encode("latin-1") for name, value in headers.items()}
    answer = ask(locked, "POST", "/data", headers=raw)
    assert (answer.status_code, locked.state.changes) == (401, 0)
    assert answer.headers["www-authenticate"] == "Bearer"
    assert answer.headers["content-type"] == "application/problem+json"
    assert status(handshake(locked)) == 401


def test_with_it_all_is(ask: Ask, locked: FastAPI) -> None:
    assert ask(locked, "POST", "/data", headers=BEARER).status_code == 200
    assert locked.state.changes == 1
    assert status(handshake(locked, BEARER)) == 101


def test_shared_caches_keep_nothing_of_it(ask: Ask, locked: FastAPI) -> None:
    assert (
        ask(locked, "GET", "/data", headers=BEARER).headers["cache-control"] == "private, max-age=5"
    )
    assert (
        ask(locked, "GET", "/page", headers=BEARER).headers["cache-control"] == "private, no-cache"
    )


def test_probes_need_none(ask: Ask, locked: FastAPI) -> None:
    assert ask(locked, "GET", "/livez").status_code == 200


def test_a_browser_shows_it_once_and_then_a_cookie(ask: Ask, locked: FastAPI) -> None:
    entry = ask(locked, "GET", "/", params={"isovalue": "70", "token": TOKEN})
    assert (entry.status_code, entry.headers["location"]) == (303, "./?isovalue=70")
    cookie = entry.headers["set-cookie"]
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    assert TOKEN not in str(entry.headers)
    shown = {"Cookie": f"other=1; {cookie.partition(';')[0]}"}
    assert ask(locked, "GET", "/page", headers=shown).status_code == 200
    assert ask(locked, "GET", "/page", headers={"Cookie": shown["Cookie"][:-1]}).status_code == 401
    assert status(handshake(locked, shown)) == 101


def test_a_cookie_goes_over_tls_alone_where_it_was_set_so(guarded: Guarded) -> None:
    scope = {"type": "http", "scheme": "https", "query_string": b""}
    assert (
        "; Secure"
        in TokenBearers(guarded(), ()).admission(scope, Token(Bearer(TOKEN))).headers["set-cookie"]
    )


LOOK = "a token to look at it"
UPLOAD = "a token to send files"
ADMIN = "a token for all of it"


@pytest.mark.parametrize(
    "order", [(LOOK, UPLOAD, ADMIN), (ADMIN, UPLOAD, LOOK), (UPLOAD, LOOK, ADMIN)]
)
def test_of_several_cookies_the_one_that_allows_most_counts(
    ask: Ask, guarded: Guarded, order: tuple[str, ...]
) -> None:
    scopes = {LOOK: {"look"}, UPLOAD: {"look", "bake", "upload"}, ADMIN: {"admin"}}
    bearers = [Bearer(token, token[8:12], frozenset(scopes[token])) for token in order]
    app = guarded(TokenBearers, bearers=bearers)
    cookies = {bearer.token: f"{Token(bearer).name}={Token(bearer).cookie}" for bearer in bearers}
    for shown, allowed in (
        ((LOOK,), 403),
        ((LOOK, UPLOAD), 200),
        ((UPLOAD, LOOK), 200),
        ((LOOK, ADMIN), 200),
    ):
        headers = {"Cookie": "; ".join(cookies[token] for token in shown)}
        assert ask(app, "POST", "/data", headers=headers).status_code == allowed, shown
    both = {"Cookie": f"{cookies[ADMIN]}; {cookies[LOOK]}", "Authorization": f"Bearer {LOOK}"}
    assert ask(app, "POST", "/data", headers=both).status_code == 403, (
        "a token that is shown itself counts alone"
    )


@pytest.mark.parametrize(
    ("method", "path"), [("GET", "/page"), ("POST", "/data"), ("GET", "/data")]
)
def test_no_other_address_takes_it(ask: Ask, locked: FastAPI, method: str, path: str) -> None:
    assert ask(locked, method, path, params={"token": TOKEN}).status_code == 401


def test_a_wrong_token_is_refused_despite_a_cookie(ask: Ask, locked: FastAPI) -> None:
    cookie = (
        ask(locked, "GET", "/", params={"token": TOKEN}).headers["set-cookie"].partition(";")[0]
    )
    assert (
        ask(locked, "GET", "/", params={"token": "wrong"}, headers={"Cookie": cookie}).status_code
        == 401
    )


def test_a_person_gets_a_page_that_says_what_to_do(ask: Ask, locked: FastAPI) -> None:
    answer = ask(locked, "GET", "/", headers={"Accept": "text/html,*/*"})
    assert (answer.status_code, answer.headers["cache-control"]) == (401, "no-store")
    assert "?token=" in answer.text
