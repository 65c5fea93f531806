"""Request ids, counts and the log; limits on bodies; HEAD; and the headers that every response
carries.
"""

import logging
from collections.abc import AsyncIterator

import pytest
from fastapi import FastAPI
from starlette.datastructures import Headers

from isogi_server import problems
from isogi_server.api.requests import HeadAsGet, Requests, SafeHeaders, SmallBodies
from isogi_server.render.metrics import Metrics
from tests.server.api.guards.handshakes import Guarded, handshake
from tests.server.asking import Ask


@pytest.fixture
def metrics() -> Metrics:
    return Metrics()


@pytest.fixture
def app(guarded: Guarded, metrics: Metrics) -> FastAPI:
    app = guarded(Requests, HeadAsGet, metrics=metrics)
    problems.install(app)

    @app.get("/things/{number}")
    def thing(number: int) -> int:
        logging.getLogger("isogi.test").warning("thing %d", number)
        return 1 // number

    return app


def count(metrics: Metrics, **labels: str) -> float | None:
    return metrics.registry.get_sample_value("isogi_requests_total", labels)


@pytest.mark.parametrize("given", ["abc", "A-1_b.c", "x" * 64])
def test_a_well_formed_id_is_kept(ask: Ask, app: FastAPI, given: str) -> None:
    assert (
        ask(app, "GET", "/data", headers={"X-Request-ID": given}).headers["x-request-id"] == given
    )


@pytest.mark.parametrize("given", ["", "a b", "x" * 65, "é", "a\tb", "<script>", None])
def test_any_other_is_replaced(ask: Ask, app: FastAPI, given: str | None) -> None:
    if given is None:
        headers = {}
    else:
        headers = {"X-Request-ID": given.encode("latin-1")}
    numbers = {ask(app, "GET", "/data", headers=headers).headers["x-request-id"] for _ in range(2)}
    assert all(len(number) == 32 for number in numbers) and len(numbers) == 2


@pytest.mark.parametrize(
    ("path", "status"), [("/nothing", 404), ("/things/x", 422), ("/things/0", 500)]
)
def test_a_problem_names_its_request(ask: Ask, app: FastAPI, path: str, status: int) -> None:
    answer = ask(app, "GET", path, headers={"X-Request-ID": "mine"})
    assert (answer.status_code, answer.json()["request_id"]) == (status, "mine")
    assert answer.headers["x-request-id"] == "mine"


def test_requests_are_counted_by_route_and_status(ask: Ask, app: FastAPI, metrics: Metrics) -> None:
    for method, path in [
        ("GET", "/things/1"),
        ("GET", "/things/2"),
        ("HEAD", "/things/1"),
        ("GET", "/things/0"),
    ]:
        ask(app, method, path)
    ask(app, "BREW", "/etc/passwd")
    handshake(app)
    route = "/things/{number}"
    assert count(metrics, method="GET", route=route, status="200") == 2
    assert count(metrics, method="HEAD", route=route, status="200") == 1
    assert count(metrics, method="GET", route=route, status="500") == 1
    assert count(metrics, method="other", route="none", status="404") == 1
    assert count(metrics, method="WEBSOCKET", route="/socket", status="101") == 1
    assert metrics.registry.get_sample_value("isogi_requests_in_progress") == 0


def test_frames_are_counted_with_their_stages(metrics: Metrics) -> None:
    said = {"isogi-provisional": "?1", "server-timing": "primary;dur=12.00, total;dur=30.50"}
    metrics.count("GET", "/frame", 200, 0.04, Headers(said))
    metrics.count("GET", "/frame", 304, 0.04, Headers({"isogi-provisional": "?0"}))
    value = metrics.registry.get_sample_value
    for state in ("provisional", "final"):
        assert value("isogi_frames_total", {"state": state, "way": "request"}) == 1
    assert value("isogi_frame_stage_seconds_sum", {"stage": "primary"}) == pytest.approx(0.012)


def test_what_is_endless_is_counted_without_its_time(metrics: Metrics) -> None:
    metrics.count("WEBSOCKET", "/stream", 101, 3600.0, Headers())
    metrics.count(
        "GET", "/events", 200, 3600.0, Headers({"content-type": "text/event-stream; charset=utf-8"})
    )
    assert count(metrics, method="WEBSOCKET", route="/stream", status="101") == 1
    for route in ("/stream", "/events"):
        assert (
            metrics.registry.get_sample_value("isogi_request_seconds_count", {"route": route})
            is None
        )


def test_the_log_tells_the_path_and_never_the_query(
    ask: Ask, app: FastAPI, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "isogi.requests")
    ask(app, "GET", "/things/1", params={"token": "secret"})
    ask(app, "GET", "/nothing%0Aisogi forged")
    first, second = (record for record in caplog.records if record.name == "isogi.requests")
    assert (vars(first)["status"], vars(first)["path"]) == (200, "/things/1")
    assert "secret" not in caplog.text
    assert "\n" not in second.getMessage()


def test_head_is_get_without_a_body(ask: Ask, app: FastAPI) -> None:
    head, get = (
        ask(app, method, "/page", headers={"X-Request-ID": "mine"}) for method in ("HEAD", "GET")
    )
    assert (head.status_code, head.content) == (200, b"")
    assert dict(head.headers) == dict(get.headers)


LIMIT = 100


async def chunks(length: int) -> AsyncIterator[bytes]:
    for _ in range(length):
        yield b"x"


@pytest.mark.parametrize("told", [True, False])
def test_one_byte_more_is_413(ask: Ask, guarded: Guarded, told: bool) -> None:
    app = guarded(SmallBodies, limit=LIMIT)
    most, more = (b"x" * n if told else chunks(n) for n in (LIMIT, LIMIT + 1))
    assert ask(app, "POST", "/length", content=most).json() == LIMIT
    answer = ask(app, "POST", "/length", content=more)
    assert (answer.status_code, answer.headers["content-type"]) == (413, "application/problem+json")
    assert str(LIMIT) in answer.json()["detail"]


def test_a_body_with_two_lengths_is_refused(ask: Ask, guarded: Guarded) -> None:
    headers = {"Content-Length": "1", "Transfer-Encoding": "chunked"}
    answer = ask(
        guarded(SmallBodies, limit=LIMIT), "POST", "/length", content=b"x", headers=headers
    )
    assert (answer.status_code, answer.headers["connection"]) == (400, "close")


@pytest.mark.parametrize(
    ("path", "loads", "caching"), [("/page", True, "no-cache"), ("/data", False, "max-age=5")]
)
def test_pages_load_their_files_only_and_data_nothing(
    ask: Ask, guarded: Guarded, path: str, loads: bool, caching: str
) -> None:
    headers = ask(guarded(SafeHeaders), "GET", path).headers
    policies = headers["content-security-policy"].split("; ")
    assert policies[0] == "default-src 'none'" and ("script-src 'self'" in policies) == loads
    assert (
        "unsafe" not in headers["content-security-policy"] and headers["cache-control"] == caching
    )
