"""The pages for people, and health, over a real socket and of apps that are not well."""

import posixpath
import re
from collections.abc import Callable, Sequence
from types import SimpleNamespace

import httpx
import pytest
from fastapi import FastAPI
from starlette.middleware import Middleware

from isogi_core.kernels._compilation import KernelProgress
from isogi_server.api.access import TokenBearers
from isogi_server.api.lifespan import Closing
from isogi_server.api.routes import pages as health
from isogi_server.bearers import Bearer
from tests.server.asking import Ask


@pytest.mark.smoke
def test_the_viewer_and_its_files(live_server: str) -> None:
    page = httpx.get(f"{live_server}/")
    assert page.headers["content-type"].startswith("text/html")
    assert "script-src 'self'" in page.headers["content-security-policy"]
    files = re.findall(r'(?:src|href)="(web/[^"]+)"', page.text)
    assert files
    for file in files:
        assert httpx.get(f"{live_server}/{file}").status_code == 200, file
    assert httpx.get(f"{live_server}/web/none.js").status_code == 404


def test_the_viewer_takes_three_requests(live_server: str) -> None:
    """A browser would find modules one import after the other, and pay a round trip for each."""
    page = httpx.get(f"{live_server}/")
    named = re.findall(r'<(?:script|link)[^>]* (?:src|href)="(web/[^"]+\.(?:js|css))"', page.text)
    assert [posixpath.splitext(each)[1] for each in named] == [".css", ".js"]
    script = httpx.get(f"{live_server}/{named[1]}")
    assert not re.search(r"^(?:import|export)\b", script.text, re.MULTILINE)
    assert len(re.findall(r"^const _\w+ = \(\(\) => \{$", script.text, re.MULTILINE)) > 20
    for name in named:
        answer = httpx.get(f"{live_server}/{name}")
        assert "immutable" in answer.headers["cache-control"], name
        assert answer.headers["content-encoding"] == "gzip", name
    shaders = httpx.get(f"{live_server}/web/card/shaders.json").json()
    assert shaders["view.frag.glsl"].startswith("//") or "#include" in shaders["view.frag.glsl"]


def test_files_of_the_page_are_sent_in_gzips_form_and_once(live_server: str) -> None:
    address = f"{live_server}/web/main.js"
    packed = httpx.get(address)
    plain = httpx.get(address, headers={"Accept-Encoding": "identity"})
    assert packed.headers["content-encoding"] == "gzip" and packed.text == plain.text
    assert int(packed.headers["content-length"]) < 0.5 * int(plain.headers["content-length"])
    assert packed.headers["etag"] != plain.headers["etag"]
    assert packed.headers["vary"] == plain.headers["vary"] == "Accept-Encoding"
    again = httpx.get(address, headers={"If-None-Match": packed.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert "content-security-policy" not in again.headers, "it would replace that of the page"


def test_the_documentation_needs_nothing_from_elsewhere(live_server: str) -> None:
    page = httpx.get(f"{live_server}/docs")
    assert page.status_code == 200
    assert not [word for word in ("http://", "https://", "<script") if word in page.text]


def test_every_route_and_parameter_is_documented(live_server: str) -> None:
    page = httpx.get(f"{live_server}/docs").text
    api = httpx.get(f"{live_server}/openapi.json").json()
    assert {"/v1/scenes", "/v1/scenes/{scene}/frame", "/readyz"} <= api["paths"].keys()
    for path, methods in api["paths"].items():
        for method, facts in methods.items():
            assert f"{method.upper()} {path}<" in page
            assert facts["description"]
            assert all(
                f"<code>{each['name']}</code>" in page for each in facts.get("parameters", [])
            )


def test_head_is_where_get_is(live_server: str) -> None:
    paths = (
        "/",
        "/docs",
        "/openapi.json",
        "/web/style.css",
        "/v1/scenes",
        "/v1/scenes/small",
        "/livez",
        "/readyz",
    )
    for path in paths:
        head = httpx.head(f"{live_server}{path}")
        get = httpx.get(f"{live_server}{path}")
        assert (head.status_code, head.content) == (200, b""), path
        assert head.headers["content-length"] == get.headers["content-length"], path


TOKEN = "correct horse battery"


def test_a_live_server_is_ready(client: httpx.Client) -> None:
    assert client.get("/livez").raise_for_status().json()["alive"] is True
    for path in ("/readyz", "/bakez"):
        answer = client.get(path)
        well = {"ready": True, "bakes": True, "reasons": []}
        assert (answer.status_code, answer.json()) == (200, well)
        assert answer.headers["cache-control"] == "no-cache"


Told = Callable[[], list[str]]


def app_of(
    reasons: Told = list,
    notes: Told = list,
    progress: KernelProgress | None = None,
    of_store: Told = list,
    guards: Sequence[Middleware] = (),
    starting: Told = list,
) -> FastAPI:
    """An app with these reasons not to bake, those of its store too, not to have started, and
    notes.
    """
    app = FastAPI(middleware=guards)
    app.include_router(health.health_router)
    engine = SimpleNamespace(notes=notes, kernels=SimpleNamespace(progress=progress))
    uploads = SimpleNamespace(notes=list)
    startup = SimpleNamespace(starting=starting, reasons=lambda: starting() or reasons())
    app.state.service = SimpleNamespace(startup=startup, engine=engine, uploads=uploads)
    app.state.closing = Closing()
    app.state.probe = SimpleNamespace(reasons=of_store)
    return app


@pytest.mark.parametrize("progress", [KernelProgress(7, 24, None), KernelProgress(18, 24, 9.5)])
def test_it_says_how_far_kernels_are_compiled(ask: Ask, progress: KernelProgress) -> None:
    if progress.seconds is None:
        reasons = ["Compiling"]
    else:
        reasons = []
    answer = ask(app_of(lambda: reasons, lambda: ["Compiling"], progress), "GET", "/bakez")
    if progress.seconds is None:
        known = {}
    else:
        known = {"seconds": progress.seconds}
    assert answer.json()["compiling"] == {"done": progress.done, "total": progress.total, **known}
    assert (answer.status_code, answer.json()["reasons"]) == (
        503 if reasons else 200,
        ["Compiling"],
    )


AWAY = ["No worker is alive."]
FULL = ["The store is full."]


@pytest.mark.parametrize(
    ("stopping", "of_service", "of_store", "said"),
    [(True, AWAY, [], ["isogi is stopping."]), (False, AWAY, FULL, AWAY), (False, [], FULL, FULL)],
)
def test_why_it_is_not_ready(
    ask: Ask, stopping: bool, of_service: list[str], of_store: list[str], said: list[str]
) -> None:
    app = app_of(lambda: of_service, of_store=lambda: of_store)
    app.state.closing.begun = stopping
    answer = ask(app, "GET", "/bakez")
    assert (answer.status_code, answer.json()["reasons"], answer.headers["retry-after"]) == (
        503,
        said,
        "1",
    )


@pytest.mark.parametrize(("of_service", "of_store"), [(AWAY, []), ([], FULL)])
def test_what_bakes_nothing_still_serves(
    ask: Ask, of_service: list[str], of_store: list[str]
) -> None:
    """A balancer would drop all servers of a store at once."""
    app = app_of(lambda: of_service, lambda: ["A note."], of_store=lambda: of_store)
    answer = ask(app, "GET", "/readyz")
    reasons = [*of_service, *of_store, "A note."]
    assert answer.status_code == 200
    assert answer.json() == {"ready": True, "bakes": False, "reasons": reasons}


@pytest.mark.parametrize("stopping", [True, False])
def test_what_stops_or_starts_does_not_serve(ask: Ask, stopping: bool) -> None:
    app = app_of(starting=lambda: [] if stopping else ["isogi is starting."])
    app.state.closing.begun = stopping
    answers = [ask(app, "GET", path) for path in ("/readyz", "/bakez")]
    assert [answer.status_code for answer in answers] == [503, 503]
    assert answers[0].json()["ready"] is answers[0].json()["bakes"] is False


SECRET = "The store at /home/anna/light can only be read, key c/0/1."


@pytest.mark.parametrize(
    ("reasons", "notes", "status"), [([SECRET], [], 503), ([], [SECRET], 200), ([], [], 200)]
)
def test_reasons_are_for_who_shows_a_token(
    ask: Ask, reasons: list[str], notes: list[str], status: int
) -> None:
    app = app_of(
        lambda: reasons, lambda: notes, guards=[Middleware(TokenBearers, bearers=[Bearer(TOKEN)])]
    )
    shown = ask(app, "GET", "/bakez", headers={"Authorization": f"Bearer {TOKEN}"})
    assert (shown.status_code, shown.json()["reasons"]) == (status, reasons or notes)
    for headers in ({}, {"Authorization": "Bearer wrong"}, {"Cookie": "isogi=1"}):
        hidden = ask(app, "GET", "/bakez", headers=headers)
        assert (hidden.status_code, len(hidden.json()["reasons"])) == (
            status,
            len(reasons or notes),
        )
        assert hidden.json()["ready"] is (status == 200)
        assert "anna" not in hidden.text and "c/0/1" not in hidden.text


def test_a_store_that_became_read_only_is_no_reason(ask: Ask) -> None:
    """The baker waits for it until the probe has found what is the matter."""
    read_only = list[bool]()
    reasons = lambda: [] if read_only else ["Baking waits for the store."]  # noqa: E731
    probed = lambda: read_only.append(True) or []  # type: ignore[func-returns-value]  # noqa: E731
    answer = ask(
        app_of(reasons, lambda: ["The store can only be read."], of_store=probed), "GET", "/bakez"
    )
    assert (answer.status_code, answer.json()["reasons"]) == (200, ["The store can only be read."])
