"""Health over a real socket, and of apps that are not well."""

from collections.abc import Callable
from types import SimpleNamespace

import httpx
import pytest
from fastapi import FastAPI

from server.api.routes import pages as health
from server.api.shutdown import Closing


def test_live(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/livez")
    assert answer.status_code == 200
    assert answer.json()["alive"] is True


def test_ready(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/readyz")
    assert (answer.status_code, answer.json()) == (200, {"ready": True, "reasons": []})
    assert answer.headers["cache-control"] == "no-cache"


@pytest.mark.parametrize(
    ("stopping", "of_service", "of_store", "said"),
    [
        (True, ["No worker is alive."], [], ["isogi is stopping."]),
        (False, ["No worker is alive."], ["The store is full."], ["No worker is alive."]),
        (False, [], ["The store is full."], ["The store is full."]),
    ],
)
def test_why_it_is_not_ready(
    ask: Callable[..., httpx.Response], stopping: bool, of_service: list[str], of_store: list[str], said: list[str]
) -> None:
    app = FastAPI()
    app.include_router(health.health_router)
    app.state.closing = Closing()
    app.state.closing.begun = stopping
    app.state.service = SimpleNamespace(reasons=lambda: of_service, engine=SimpleNamespace(notes=list))
    app.state.probe = SimpleNamespace(reasons=lambda: of_store)
    answer = ask(app, "GET", "/readyz")
    assert (answer.status_code, answer.json()["reasons"]) == (503, said)
    assert answer.headers["retry-after"] == "1"


def test_a_store_that_became_read_only_is_no_reason(ask: Callable[..., httpx.Response]) -> None:
    """The baker waits for it until the probe has found what is the matter."""
    app, read_only = FastAPI(), list[bool]()
    app.include_router(health.health_router)
    app.state.closing = Closing()
    engine = SimpleNamespace(notes=lambda: ["The store can only be read."])
    reasons = lambda: [] if read_only else ["Baking waits for the store."]  # noqa: E731
    app.state.service = SimpleNamespace(reasons=reasons, engine=engine, uploads=SimpleNamespace(notes=list))
    app.state.probe = SimpleNamespace(reasons=lambda: read_only.append(True) or [])
    answer = ask(app, "GET", "/readyz")
    assert (answer.status_code, answer.json()["reasons"]) == (200, ["The store can only be read."])
