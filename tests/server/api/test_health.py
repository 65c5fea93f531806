"""Health over a real socket, and of apps that are not well."""

from collections.abc import Callable
from types import SimpleNamespace

import httpx
import pytest
from fastapi import FastAPI
from starlette.middleware import Middleware

from isogi_core.kernels._compilation import KernelProgress
from server.api.access import TokenBearers
from server.api.lifespan import Closing
from server.api.routes import pages as health
from server.bearers import Bearer

TOKEN = "correct horse battery"


def test_live(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/livez")
    assert answer.status_code == 200
    assert answer.json()["alive"] is True


def test_ready(live_server: str) -> None:
    answer = httpx.get(f"{live_server}/readyz")
    assert (answer.status_code, answer.json()) == (200, {"ready": True, "reasons": []})
    assert answer.headers["cache-control"] == "no-cache"


def service_of(
    reasons: Callable[[], list[str]], notes: Callable[[], list[str]], progress: KernelProgress | None = None
) -> SimpleNamespace:
    """A service with these reasons not to be ready, and notes."""
    engine = SimpleNamespace(notes=notes, kernels=SimpleNamespace(progress=progress))
    return SimpleNamespace(startup=SimpleNamespace(reasons=reasons), engine=engine, uploads=SimpleNamespace(notes=list))


@pytest.mark.parametrize("progress", [KernelProgress(7, 24, None), KernelProgress(18, 24, 9.5)])
def test_it_says_how_far_kernels_are_compiled(ask: Callable[..., httpx.Response], progress: KernelProgress) -> None:
    app = FastAPI()
    app.include_router(health.health_router)
    app.state.closing = Closing()
    reasons = ["Compiling"] if progress.seconds is None else []
    app.state.service = service_of(lambda: reasons, lambda: ["Compiling"], progress)
    app.state.probe = SimpleNamespace(reasons=list)
    answer = ask(app, "GET", "/readyz")
    known = {} if progress.seconds is None else {"seconds": progress.seconds}
    assert answer.json()["compiling"] == {"done": progress.done, "total": progress.total, **known}
    assert (answer.status_code, answer.json()["reasons"]) == (503 if reasons else 200, ["Compiling"])


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
    app.state.service = service_of(lambda: of_service, list)
    app.state.probe = SimpleNamespace(reasons=lambda: of_store)
    answer = ask(app, "GET", "/readyz")
    assert (answer.status_code, answer.json()["reasons"]) == (503, said)
    assert answer.headers["retry-after"] == "1"


SECRET = "The store at /home/anna/light can only be read, key c/0/1."


@pytest.fixture
def guarded_app() -> FastAPI:
    """An app that wants a token, with reasons and notes that name a path."""
    app = FastAPI(middleware=[Middleware(TokenBearers, bearers=[Bearer(TOKEN)])])
    app.include_router(health.health_router)
    app.state.closing, app.state.probe = Closing(), SimpleNamespace(reasons=list)
    return app


@pytest.mark.parametrize(("reasons", "notes", "status"), [([SECRET], [], 503), ([], [SECRET], 200), ([], [], 200)])
def test_reasons_are_for_who_shows_a_token(
    ask: Callable[..., httpx.Response], guarded_app: FastAPI, reasons: list[str], notes: list[str], status: int
) -> None:
    guarded_app.state.service = service_of(lambda: reasons, lambda: notes)
    shown = ask(guarded_app, "GET", "/readyz", headers={"Authorization": f"Bearer {TOKEN}"})
    assert (shown.status_code, shown.json()["reasons"]) == (status, reasons or notes)
    for headers in ({}, {"Authorization": "Bearer wrong"}, {"Cookie": "isogi=1"}):
        hidden = ask(guarded_app, "GET", "/readyz", headers=headers)
        assert (hidden.status_code, len(hidden.json()["reasons"])) == (status, len(reasons or notes))
        assert hidden.json()["ready"] is (status == 200)
        assert "anna" not in hidden.text and "c/0/1" not in hidden.text


def test_a_store_that_became_read_only_is_no_reason(ask: Callable[..., httpx.Response]) -> None:
    """The baker waits for it until the probe has found what is the matter."""
    app, read_only = FastAPI(), list[bool]()
    app.include_router(health.health_router)
    app.state.closing = Closing()
    reasons = lambda: [] if read_only else ["Baking waits for the store."]  # noqa: E731
    app.state.service = service_of(reasons, lambda: ["The store can only be read."])
    app.state.probe = SimpleNamespace(reasons=lambda: read_only.append(True) or [])
    answer = ask(app, "GET", "/readyz")
    assert (answer.status_code, answer.json()["reasons"]) == (200, ["The store can only be read."])
