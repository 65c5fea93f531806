"""Health over a real socket, and of apps that are not well."""

from collections.abc import Callable
from types import SimpleNamespace

import httpx
import pytest
from fastapi import FastAPI

from isogi_core.kernels._compilation import KernelProgress
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
