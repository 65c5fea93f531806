"""ETags, host names, HEAD, and the headers that every response carries."""

import time
from collections.abc import Callable

import httpx
import pytest
from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, JSONResponse, Response

from isogi_core.frame.stopwatch import Stopwatch
from server.headers import (
    STAGES,
    HeadAsGet,
    KnownHosts,
    SafeHeaders,
    coverage_header,
    matches,
    server_timing,
    time_left_header,
)
from server.settings import LOOPBACK
from worker.outlook import TimeLeft


@pytest.fixture
def app() -> FastAPI:
    app = FastAPI()
    app.add_middleware(KnownHosts, hosts=LOOPBACK)
    app.add_middleware(HeadAsGet)
    app.add_middleware(SafeHeaders)
    app.add_api_route("/page", lambda: HTMLResponse("<p>hello"))
    app.add_api_route("/data", lambda: JSONResponse({"a": 1}, headers={"Cache-Control": "max-age=5"}))
    return app


@pytest.mark.parametrize(
    ("header", "matched"),
    [
        (None, False),
        ('"a"', True),
        ('W/"a"', True),
        ('"b", "a"', True),
        ("*", True),
        ('"b"', False),
        ("a", False),
        ("", False),
    ],
)
def test_if_none_match(header: str | None, matched: bool) -> None:
    assert matches(header, '"a"') is matched


@pytest.mark.parametrize(
    ("final", "provisional", "text"),
    [
        (1.0, 0.0, "final=1.000, converging=0.000, provisional=0.000"),
        (0.99999, 0.00001, "final=0.999, converging=0.000, provisional=0.001"),
        (0.25, 0.75, "final=0.250, converging=0.000, provisional=0.750"),
    ],
)
def test_coverage_never_says_all_where_some_is_missing(final: float, provisional: float, text: str) -> None:
    assert coverage_header({"provisional": provisional, "final": final, "converging": 0.0}) == text


def test_server_timing_is_in_milliseconds() -> None:
    watch = Stopwatch(time.perf_counter() - 2.0, {"primary": 0.0125, "encode": 1})
    stages = dict(stage.split(";dur=") for stage in server_timing(watch).split(", "))
    assert float(stages.pop("total")) == pytest.approx(2000.0, abs=100.0)
    assert stages == {"primary": "12.50", "encode": "1000.00"}
    assert stages.keys() < STAGES.keys()


def test_time_left_is_in_seconds() -> None:
    assert time_left_header(TimeLeft(1.26, 20.0, 41.04)) == "low=1.3, likely=20.0, high=41.0"


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.1:80", "localhost:8000", "LOCALHOST", "[::1]", "[::1]:8000"])
def test_loopback_names_are_known(host: str) -> None:
    assert KnownHosts(Response(), LOOPBACK).knows(Headers({"host": host}))


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "127.0.0.1.evil.example",
        "evil.example:80",
        "localhost.",
        "",
        "[::2]",
        "[",
        "a@localhost",
    ],
)
def test_other_names_are_not(ask: Callable[..., httpx.Response], app: FastAPI, host: str) -> None:
    answer = ask(app, "GET", "/data", headers={"Host": host})
    assert answer.status_code == 421
    assert answer.headers["content-type"] == "application/problem+json"


def test_any_name_is_known_where_none_is_listed(ask: Callable[..., httpx.Response]) -> None:
    app = FastAPI()
    app.add_middleware(KnownHosts, hosts=None)
    app.add_api_route("/data", lambda: JSONResponse({}))
    assert ask(app, "GET", "/data", headers={"Host": "evil.example"}).status_code == 200


def test_a_page_may_load_its_own_files_only(ask: Callable[..., httpx.Response], app: FastAPI) -> None:
    headers = ask(app, "GET", "/page").headers
    assert "script-src 'self'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cache-control"] == "no-cache"


def test_data_may_load_nothing_and_keeps_its_own_caching(ask: Callable[..., httpx.Response], app: FastAPI) -> None:
    headers = ask(app, "GET", "/data").headers
    assert headers["content-security-policy"].startswith("default-src 'none';")
    assert headers["cache-control"] == "max-age=5"
    assert "access-control-allow-origin" not in headers


def test_head_is_get_without_a_body(ask: Callable[..., httpx.Response], app: FastAPI) -> None:
    head, get = ask(app, "HEAD", "/page"), ask(app, "GET", "/page")
    assert (head.status_code, head.content) == (200, b"")
    assert dict(head.headers) == dict(get.headers)
