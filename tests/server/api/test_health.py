"""Health over a real socket, and of apps that are not well."""

from collections.abc import Callable, Sequence
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
from tests.server.asking import Ask

TOKEN = "correct horse battery"


def test_a_live_server_is_ready(client: httpx.Client) -> None:
    assert client.get("/livez").raise_for_status().json()["alive"] is True
    answer = client.get("/readyz")
    assert (answer.status_code, answer.json()) == (200, {"ready": True, "reasons": []})
    assert answer.headers["cache-control"] == "no-cache"


Told = Callable[[], list[str]]


def app_of(
    reasons: Told = list,
    notes: Told = list,
    progress: KernelProgress | None = None,
    of_store: Told = list,
    guards: Sequence[Middleware] = (),
) -> FastAPI:
    """An app with these reasons not to be ready, those of its store too, and notes."""
    app = FastAPI(middleware=guards)
    app.include_router(health.health_router)
    engine = SimpleNamespace(notes=notes, kernels=SimpleNamespace(progress=progress))
    uploads = SimpleNamespace(notes=list)
    app.state.service = SimpleNamespace(startup=SimpleNamespace(reasons=reasons), engine=engine, uploads=uploads)
    app.state.closing, app.state.probe = Closing(), SimpleNamespace(reasons=of_store)
    return app


@pytest.mark.parametrize("progress", [KernelProgress(7, 24, None), KernelProgress(18, 24, 9.5)])
def test_it_says_how_far_kernels_are_compiled(ask: Ask, progress: KernelProgress) -> None:
    reasons = ["Compiling"] if progress.seconds is None else []
    answer = ask(app_of(lambda: reasons, lambda: ["Compiling"], progress), "GET", "/readyz")
    known = {} if progress.seconds is None else {"seconds": progress.seconds}
    assert answer.json()["compiling"] == {"done": progress.done, "total": progress.total, **known}
    assert (answer.status_code, answer.json()["reasons"]) == (503 if reasons else 200, ["Compiling"])


AWAY, FULL = ["No worker is alive."], ["The store is full."]


@pytest.mark.parametrize(
    ("stopping", "of_service", "of_store", "said"),
    [(True, AWAY, [], ["isogi is stopping."]), (False, AWAY, FULL, AWAY), (False, [], FULL, FULL)],
)
def test_why_it_is_not_ready(
    ask: Ask, stopping: bool, of_service: list[str], of_store: list[str], said: list[str]
) -> None:
    app = app_of(lambda: of_service, of_store=lambda: of_store)
    app.state.closing.begun = stopping
    answer = ask(app, "GET", "/readyz")
    assert (answer.status_code, answer.json()["reasons"], answer.headers["retry-after"]) == (503, said, "1")


SECRET = "The store at /home/anna/light can only be read, key c/0/1."


@pytest.mark.parametrize(("reasons", "notes", "status"), [([SECRET], [], 503), ([], [SECRET], 200), ([], [], 200)])
def test_reasons_are_for_who_shows_a_token(ask: Ask, reasons: list[str], notes: list[str], status: int) -> None:
    app = app_of(lambda: reasons, lambda: notes, guards=[Middleware(TokenBearers, bearers=[Bearer(TOKEN)])])
    shown = ask(app, "GET", "/readyz", headers={"Authorization": f"Bearer {TOKEN}"})
    assert (shown.status_code, shown.json()["reasons"]) == (status, reasons or notes)
    for headers in ({}, {"Authorization": "Bearer wrong"}, {"Cookie": "isogi=1"}):
        hidden = ask(app, "GET", "/readyz", headers=headers)
        assert (hidden.status_code, len(hidden.json()["reasons"])) == (status, len(reasons or notes))
        assert hidden.json()["ready"] is (status == 200)
        assert "anna" not in hidden.text and "c/0/1" not in hidden.text


def test_a_store_that_became_read_only_is_no_reason(ask: Ask) -> None:
    """The baker waits for it until the probe has found what is the matter."""
    read_only = list[bool]()
    reasons = lambda: [] if read_only else ["Baking waits for the store."]  # noqa: E731
    probed = lambda: read_only.append(True) or []  # type: ignore[func-returns-value]  # noqa: E731
    answer = ask(app_of(reasons, lambda: ["The store can only be read."], of_store=probed), "GET", "/readyz")
    assert (answer.status_code, answer.json()["reasons"]) == (200, ["The store can only be read."])
