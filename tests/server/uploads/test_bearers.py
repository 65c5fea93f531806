"""Tokens with names and scopes: what they allow, whose jobs and volumes are, and files that hold
them.
"""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from pydantic import ValidationError
from starlette.requests import Request

from isogi_server.api.access import needed_scope
from isogi_server.api.service import Service
from isogi_server.bearers import BEARER_SCOPE_KEY, Bearer, read_bearers
from isogi_server.render.viewers import request_viewer, stream_viewer
from isogi_server.settings import Settings
from tests.server.asking import Ask
from tests.server.uploads.files import ball, names
from tests.server.uploads.site import Poster

ANNA, BEN, EVE, ROOT = (
    f"the token of {name}, a long one" for name in ("anna", "ben", "eve", "root")
)
FILE = f"""\
[anna]
token = "{ANNA}"
scopes = ["look", "bake", "upload"]
[ben]
token = "{BEN}"
scopes = ["look", "bake", "upload"]
[eve]
token = "{EVE}"
scopes = ["look"]
[root]
token = "{ROOT}"
scopes = ["admin"]
"""


@pytest.fixture
def tokens(tmp_path: Path) -> Path:
    """The file of four tokens."""
    (tmp_path / "tokens.toml").write_text(FILE)
    return tmp_path / "tokens.toml"


def shown(token: str) -> dict[str, str]:
    """The header that shows a token."""
    return {"Authorization": f"Bearer {token}"}


@pytest.mark.parametrize(
    ("kind", "method", "path", "scope"),
    [
        *[
            ("http", "GET", "/v1/scenes/a/frame", "look"),
            ("websocket", "", "/v1/scenes/a/stream", "look"),
        ],
        *[("http", "GET", "/v1/volumes", "look"), ("http", "POST", "/v1/volumes", "upload")],
        *[
            ("http", "DELETE", "/v1/volumes/a", "upload"),
            ("http", "POST", "/v1/scenes/a/prewarm", "bake"),
        ],
        *[("http", "DELETE", "/v1/jobs/a", "bake"), ("http", "PATCH", "/", "bake")],
        ("http", "GET", "/metrics", "admin"),
    ],
)
def test_what_a_request_needs(kind: str, method: str, path: str, scope: str) -> None:
    assert needed_scope({"type": kind, "method": method, "path": path}) == scope


def test_a_token_allows_what_its_scopes_say(ask: Ask, open_app: Any, tokens: Path) -> None:
    app: FastAPI = open_app(tokens_file=tokens)
    for token, sends in ((ANNA, 201), (EVE, 403), (ROOT, 200)):
        assert ask(app, "GET", "/v1/scenes", headers=shown(token)).status_code == 200
        assert (
            ask(app, "POST", "/v1/volumes", content=ball(), headers=shown(token)).status_code
            == sends
        )
        assert (ask(app, "GET", "/metrics", headers=shown(token)).status_code == 403) == (
            token != ROOT
        )
    refused = ask(app, "POST", "/v1/scenes/a/prewarm", headers=shown(EVE))
    assert (
        refused.status_code == 403
        and "The token 'eve' does not allow this (bake)" in refused.json()["detail"]
    )
    assert (
        ask(app, "GET", "/v1/scenes").status_code
        == ask(app, "GET", "/", headers=shown("!")).status_code
        == 401
    )


async def test_who_may_only_look_has_nothing_baked() -> None:
    scope = {
        "type": "http",
        "client": ("10.0.0.1", 80),
        BEARER_SCOPE_KEY: Bearer(EVE, "eve", frozenset({"look"})),
    }
    viewers = request_viewer(Request(scope)), stream_viewer(Request(scope))
    assert not any(viewer.bakes for viewer in viewers)
    assert request_viewer(Request({"type": "http", "client": None})).bakes
    for viewer in viewers:
        assert await Service.request_light(None, None, None, viewer) == frozenset()  # type: ignore[arg-type]


@pytest.mark.slow
def test_volumes_belong_to_who_sent_them(
    ask: Ask, open_app: Any, tokens: Path, folder: Path
) -> None:
    """Also after a restart; what two have sent goes with the second."""
    app: FastAPI = open_app(tokens_file=tokens)
    hers, both, free = (ball(side) for side in (8, 9, 10))
    sent = [
        ask(app, "POST", "/v1/volumes", content=content, headers=shown(ANNA)).json()
        for content in (hers, both)
    ]
    assert ask(app, "POST", "/v1/volumes", content=both, headers=shown(BEN)).status_code == 200
    app.state.service.uploads.close()
    app = open_app(Poster(), tokens_file=tokens)

    def deleted(which: int, token: str) -> int:
        return ask(app, "DELETE", sent[which]["href"], headers=shown(token)).status_code

    assert deleted(0, BEN) == 403
    assert deleted(0, ANNA) == 204
    assert deleted(1, ANNA) == 204 and f"{sent[1]['id']}.nrrd" in names(folder)
    assert deleted(1, ANNA) == 403
    assert deleted(1, BEN) == 204 and f"{sent[1]['id']}.nrrd" not in names(folder)
    sent.append(ask(app, "POST", "/v1/volumes", content=free, headers=shown(BEN)).json())
    assert deleted(2, ANNA) == 403
    assert deleted(2, ROOT) == 204


def test_jobs_belong_to_who_began_them(ask: Ask, open_app: Any, tokens: Path) -> None:
    app: FastAPI = open_app(tokens_file=tokens)
    app.state.service.resumed.set()

    async def nothing(_: object) -> tuple[()]:
        return ()

    async def begun() -> str:
        job = app.state.service.jobs.begin("frame", "A frame", nothing, client=("anna", ""))
        while app.state.service.jobs.running(job.id):
            await asyncio.sleep(0.0)
        return str(job.id)

    address = f"/v1/jobs/{asyncio.run(begun())}"
    assert ask(app, "GET", address, headers=shown(BEN)).status_code == 200
    refused = ask(app, "DELETE", address, headers=shown(BEN))
    assert refused.status_code == 403 and "belongs to 'anna'" in refused.json()["detail"]
    assert ask(app, "DELETE", address, headers=shown(ANNA)).status_code == 200


def test_one_token_owns_what_nobody_is_named_for() -> None:
    one = Bearer("one token alone")
    anna = Bearer(ANNA, "anna", frozenset({"look"}))
    assert (
        all(map(one.may, ("look", "bake", "upload", "admin"))) and one.owns("") and one.owns("anna")
    )
    assert anna.owns("") and anna.owns("anna") and not anna.owns("ben") and not anna.may("bake")


@pytest.mark.parametrize(
    "text",
    [
        *["", "[anna", "[anna]", 'anna = "look"', '[anna]\ntoken = "short"\nscopes = ["look"]'],
        *[
            FILE.replace('["look"]', "[]"),
            FILE.replace('["look"]', '["looks"]'),
            FILE.replace(EVE, BEN),
        ],
        *[FILE.replace("[eve]", "[eve]\ncolour = 1"), FILE.replace('["look"]', '"look"')],
    ],
)
def test_wrong_files_are_refused_without_a_token_in_words(tmp_path: Path, text: str) -> None:
    path = tmp_path / "tokens.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match="token") as refused:
        read_bearers(path)
    assert ANNA not in str(refused.value)
    with pytest.raises(ValidationError):
        Settings(tokens_file=path)
