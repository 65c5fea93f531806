"""Pages for people, and the endpoints that say if the process lives and can render."""

import base64
import hashlib
from html import escape
from typing import Any

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import HTMLResponse
from prometheus_client import CONTENT_TYPE_LATEST
from pydantic import BaseModel

from isogi_server.api.headers import FOR_EVER, matches, tag_of, takes_gzip
from isogi_server.api.service import Service, ServiceDep
from isogi_server.bearers import bearer_of
from isogi_server.exports.page_files import viewer_files
from isogi_server.problems import documented_problems, problem

STYLE = """
:root { color-scheme: light dark; font: 16px/1.5 system-ui, sans-serif }
body { max-width: 58rem; margin: 2rem auto; padding: 0 1rem }
h2 { margin: 2.5rem 0 .25rem; font-size: 1.05rem }
code, h2 { font-family: ui-monospace, monospace }
table { border-collapse: collapse; width: 100%; font-size: .9rem }
td { border-top: 1px solid #8884; padding: .2rem .8rem .2rem 0; vertical-align: top }
td:first-child { white-space: nowrap; width: 10rem }
p { margin: .25rem 0 .75rem }
"""
STYLE_DIGEST = base64.b64encode(hashlib.sha256(STYLE.encode()).digest()).decode()
PAGE_POLICY = (
    f"default-src 'none'; style-src 'sha256-{STYLE_DIGEST}'; base-uri 'none'; "
    "frame-ancestors 'none'"
)

router = APIRouter(include_in_schema=False)


@router.get("/")
def index(request: Request) -> Response:
    """Return the viewer."""
    return file_answer(request, "index.html")


@router.get("/web/{name:path}")
def page_file(request: Request, name: str) -> Response:
    """Return a file of the viewer."""
    return file_answer(request, f"web/{name}")


def file_answer(request: Request, name: str) -> Response:
    """Answer with a file of the viewer, compressed for browsers that accept it. Raises
    HTTPException if there is no such file.
    """
    file = viewer_files().get(name)
    if file is None:
        raise HTTPException(404, "The page has no such file.")
    packs = takes_gzip(request.headers.get("accept-encoding", ""))
    tag = tag_of(file.digest, packs)
    headers = {
        "ETag": tag,
        "Cache-Control": FOR_EVER if file.lasting else "no-cache",
        "Vary": "Accept-Encoding",
    }
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    if not packs:
        return Response(file.content, 200, headers, file.media_type)
    return Response(file.packed, 200, headers | {"Content-Encoding": "gzip"}, file.media_type)


@router.get("/docs")
def docs(request: Request) -> HTMLResponse:
    """Return the OpenAPI document as a page that loads no other files."""
    return HTMLResponse(
        documentation(request.app.openapi()), headers={"Content-Security-Policy": PAGE_POLICY}
    )


def documentation(api: dict[str, Any]) -> str:
    """Return the documentation page of an OpenAPI document, as HTML."""
    title = f"{escape(api['info']['title'])} {escape(api['info']['version'])}"
    sections = "".join(
        operation(method, path, facts)
        for path, methods in api["paths"].items()
        for method, facts in methods.items()
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style>'
        f"<h1>{title}</h1><p>{escape(api['info']['description'])}"
        f' For programs: <a href="openapi.json">openapi.json</a>.</p>{sections}</html>'
    )


def operation(method: str, path: str, facts: dict[str, Any]) -> str:
    """Return the HTML of one operation: its description, parameters and answers."""
    parameters = "".join(
        table_row(
            each["name"],
            f"{parameter_in_words(each['schema'])} {escape(each.get('description', ''))}",
        )
        for each in facts.get("parameters", [])
    )
    answers = "".join(
        table_row(code, escape(each["description"])) for code, each in facts["responses"].items()
    )
    return (
        f"<section><h2>{method.upper()} "
        f"{escape(path)}</h2><p>{escape(facts.get('description', ''))}</p>"
        f"<table>{parameters}</table><table>{answers}</table></section>"
    )


def table_row(name: str, html: str) -> str:
    """Return one row of an HTML table: a name, and the HTML of its description."""
    return f"<tr><td><code>{escape(name)}</code></td><td>{html}</td></tr>"


def parameter_in_words(schema: dict[str, Any]) -> str:
    """Return the type, range and default of a parameter in a few words, as HTML."""
    kind = next((s for s in schema.get("anyOf", [schema]) if s.get("type") != "null"), schema)
    if "enum" in kind:
        words = " | ".join(kind["enum"])
    else:
        words = kind.get("type", "")
    if "minimum" in kind:
        words += f" {kind['minimum']:g} … {kind['maximum']:g}"
    if schema.get("default") is not None:
        words += f", default {schema['default']}"
    return f"<code>{escape(words)}</code>"


health_router = APIRouter(tags=["health"])


class Live(BaseModel):
    """The process answers."""

    alive: bool = True
    version: str


class Compiling(BaseModel):
    """Kernels that are being compiled, once on this machine: ``done`` of ``total``, with about
    ``seconds`` left if that is known.
    """

    done: int
    total: int
    seconds: float | None


class Ready(BaseModel):
    """The state of the service: ``ready`` if frames can be served, ``bakes`` if the light that they
    lack is baked; with reasons if not, and with notes for the operator if so.

    While kernels of light are ``compiling``, frames are served without light.
    """

    ready: bool = True
    bakes: bool = True
    reasons: list[str] = []
    compiling: Compiling | None = None


NOT_READY = "isogi is not ready: ask with a token for the reasons."
NOTED = "isogi is ready, and there is something to know: ask with a token."


@health_router.get("/livez")
async def livez(request: Request) -> Live:
    """Answer if the event loop runs. Touches neither store nor workers."""
    return Live(version=request.app.version)


@health_router.get(
    "/readyz",
    response_model=Ready,
    response_model_exclude_none=True,
    responses=documented_problems(503),
)
def readyz(request: Request, service: ServiceDep) -> Response | Ready:
    """Answer 200 if pictures can be drawn and the server is not about to stop; else 503 with
    reasons.

    If light is not baked, pictures show the light that is there: `bakes` is false then, and the
    reasons say why. If the server requires a token, a client without one gets no reasons, as these
    name paths and keys.
    """
    serves, bakes = shortcomings(request, service)
    return health(request, service, serves, bakes)


@health_router.get(
    "/bakez",
    response_model=Ready,
    response_model_exclude_none=True,
    responses=documented_problems(503),
)
def bakez(request: Request, service: ServiceDep) -> Response | Ready:
    """Answer 200 if pictures can be drawn and the light that they lack is baked: workers are
    alive, and the store can be written; else 503 with reasons, as `/readyz` gives them.
    """
    _, bakes = shortcomings(request, service)
    return health(request, service, bakes, bakes)


def shortcomings(request: Request, service: Service) -> tuple[list[str], list[str]]:
    """Return the reasons why no pictures are served, and the reasons why no light is baked."""
    if request.app.state.closing.begun:
        stopping = ["isogi is stopping."]
        return stopping, stopping
    # Probe the store first: the probe finds out if the store is only read, and the reasons of the
    # start leave out all that follows from this.
    of_store = request.app.state.probe.reasons()
    return service.startup.starting(), service.startup.reasons() or of_store


def health(
    request: Request, service: Service, lacks: list[str], bakes: list[str]
) -> Response | Ready:
    """Answer a probe: 200 if ``lacks`` is empty, else 503. ``bakes`` are the reasons why no light
    is baked.

    A client that may not look gets a general sentence instead of the reasons.
    """
    progress = service.engine.kernels.progress
    if progress is None:
        compiling = None
    else:
        compiling = Compiling(**progress._asdict())
    notes = [*bakes, *service.engine.notes(), *service.uploads.notes()]
    # Reasons name paths and keys: without a token, only say that there are some.
    if not bearer_of(request.scope).may("look"):
        lacks = [NOT_READY][: len(lacks)]
        notes = [NOTED][: len(notes)]
    if not lacks:
        return Ready(bakes=not bakes, reasons=notes, compiling=compiling)
    if compiling:
        more = {"compiling": compiling.model_dump(exclude_none=True)}
    else:
        more = {}
    facts = {"ready": False, "bakes": not bakes, "reasons": lacks, **more}
    return problem(503, " ".join(lacks), request.url.path, **facts)


@health_router.get(
    "/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}}
)
def metrics(request: Request) -> Response:
    """Return all metrics since the start of the server, in the text format of Prometheus."""
    return Response(request.app.state.metrics.text(), media_type=CONTENT_TYPE_LATEST)
