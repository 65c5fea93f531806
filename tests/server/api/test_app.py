"""The guards together: each setting arms its own, and they stand in the right order."""

from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from isogi_server.api.app import middleware
from isogi_server.api.lifespan import Closing
from isogi_server.render.metrics import Metrics
from tests.server.asking import Ask
from tests.server.sockets import settings_of

LAB = "https://lab.example"
EVIL = "https://evil.example"
TOKEN = "correct horse battery"
PREFLIGHT = {
    "Access-Control-Request-Method": "GET",
    "Access-Control-Request-Headers": "authorization",
}


def app_with(**given: Any) -> FastAPI:
    app = FastAPI(middleware=middleware(settings_of(**given), Metrics(), Closing()))
    app.add_api_route("/data", lambda: {"a": 1})
    app.add_api_route("/data", lambda: {"a": 2}, methods=["POST"])
    return app


@pytest.mark.parametrize(
    ("armed", "disarmed", "request_", "status"),
    [
        ({}, {"allowed_hosts": "evil.example"}, {"headers": {"Host": "evil.example"}}, 421),
        ({}, {"allowed_origins": EVIL}, {"headers": {"Origin": EVIL}}, 403),
        ({"token": TOKEN}, {}, {}, 401),
        ({"body_bytes": 9}, {}, {"content": b"0123456789"}, 413),
    ],
)
def test_each_setting_arms_its_guard(
    ask: Ask, armed: dict[str, Any], disarmed: dict[str, Any], request_: dict[str, Any], status: int
) -> None:
    answer = ask(app_with(**armed), "POST", "/data", **request_)
    assert answer.status_code == status
    assert answer.json()["request_id"] == answer.headers["x-request-id"]
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert ask(app_with(**disarmed), "POST", "/data", **request_).status_code == 200


def test_pages_of_no_other_origin_may_read_unless_one_is_listed(ask: Ask) -> None:
    closed = app_with()
    open_ = app_with(allowed_origins=LAB)
    for origin in (LAB, EVIL, "null"):
        assert not cors(ask(closed, "GET", "/data", headers={"Origin": origin}))
    for origin in (EVIL, "null"):
        assert "access-control-allow-origin" not in cors(
            ask(open_, "GET", "/data", headers={"Origin": origin})
        )
    said = cors(ask(open_, "GET", "/data", headers={"Origin": LAB, "Sec-Fetch-Site": "cross-site"}))
    assert said["access-control-allow-origin"] == LAB
    assert "Isogi-Coverage" in said["access-control-expose-headers"]
    assert "access-control-allow-credentials" not in said


def cors(answer: httpx.Response) -> dict[str, str]:
    return {
        name: value for name, value in answer.headers.items() if name.startswith("access-control")
    }


def test_a_preflight_shows_no_token_and_what_follows_it_does(ask: Ask) -> None:
    app = app_with(token=TOKEN, allowed_origins=LAB)
    allowed = ask(app, "OPTIONS", "/data", headers={"Origin": LAB, **PREFLIGHT})
    assert (allowed.status_code, cors(allowed)["access-control-allow-origin"]) == (200, LAB)
    assert ask(app, "OPTIONS", "/data", headers={"Origin": EVIL, **PREFLIGHT}).status_code == 403
    assert ask(app, "GET", "/data", headers={"Origin": LAB}).status_code == 401
    shown = {"Origin": LAB, "Authorization": f"Bearer {TOKEN}"}
    assert ask(app, "GET", "/data", headers=shown).status_code == 200


def test_a_host_that_is_unknown_learns_nothing_of_the_token(ask: Ask) -> None:
    app = app_with(token=TOKEN)
    shown = {"Host": "evil.example", "Authorization": f"Bearer {TOKEN}"}
    assert ask(app, "GET", "/data", headers=shown).status_code == 421
    assert ask(app, "GET", "/data", headers={"Host": "evil.example"}).status_code == 421
