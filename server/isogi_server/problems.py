"""Errors as RFC 9457 problem documents, and the one table from classes of errors to HTTP status."""

import logging
from collections.abc import Mapping
from http import HTTPMethod, HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse
from starlette.routing import compile_path

from isogi_core.errors import (
    Cancelled,
    IsogiError,
    LightError,
    SceneError,
    SharedMemoryError,
    StoreError,
    UnwritableError,
    ViewError,
    VolumeError,
)
from isogi_server.errors import (
    BusyError,
    ForbiddenError,
    FullError,
    LateError,
    NotAcceptableError,
    ParameterError,
    SlowUploadError,
    StalledError,
    StartingError,
    StreamError,
    UnknownJobError,
    UnknownPartError,
    UnknownResultError,
    UnknownSceneError,
    UnknownVolumeError,
    UploadFolderError,
    UploadsOffError,
)
from isogi_server.logs import REQUEST_ID
from isogi_worker.errors import WorkersError

log = logging.getLogger("isogi.requests")

STATUS: Mapping[type[Exception], int] = {
    ViewError: 422,
    VolumeError: 422,
    LightError: 422,
    SceneError: 422,
    StreamError: 400,
    UploadsOffError: 403,
    ForbiddenError: 403,
    UnknownSceneError: 404,
    UnknownJobError: 404,
    UnknownPartError: 404,
    UnknownResultError: 404,
    UnknownVolumeError: 404,
    NotAcceptableError: 406,
    SlowUploadError: 408,
    StalledError: 408,
    BusyError: 429,
    StartingError: 503,
    StoreError: 503,
    WorkersError: 503,
    SharedMemoryError: 503,
    UploadFolderError: 503,
    LateError: 503,
    Cancelled: 503,
    FullError: 507,
    UnwritableError: 507,
    IsogiError: 500,
}
REFUSALS: Mapping[type[Exception], str] = {
    ForbiddenError: "forbidden",
    UploadsOffError: "forbidden",
    FullError: "quota",
    StartingError: "starting",
    StoreError: "store",
    WorkersError: "workers",
}
"""Reasons of refusals for metrics, by class of error; a BusyError states its reason itself."""

RETRY_AFTER_SECONDS = {429: "1", 503: "1"}
HTTP_METHODS = frozenset(map(str, HTTPMethod))
SENTENCES = {
    404: "There is nothing at {path}: see /docs for what there is.",
    405: "{path} does not take {method}: see /docs for what it takes.",
    500: "The server failed on this request; its log says why.",
}


class Problem(BaseModel):
    """An RFC 9457 problem; ``detail`` is a sentence that a person can act on."""

    type: str
    title: str
    status: int
    detail: str
    instance: str


def documented_problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI responses of an operation that answers these ``statuses``."""
    content = {"application/problem+json": {"schema": Problem.model_json_schema()}}
    return {
        status: {"description": HTTPStatus(status).phrase, "content": content}
        for status in statuses
    }


def status_of(error: Exception) -> int:
    """Return the status of the nearest base class in the table; 500 if there is none."""
    return next((STATUS[kind] for kind in type(error).__mro__ if kind in STATUS), 500)


def refusal(error: Exception) -> str:
    """Return the reason, in a word, of an error that another time or another client would not
    get; empty for other errors.
    """
    if isinstance(error, BusyError):
        return error.why
    return next((REFUSALS[kind] for kind in type(error).__mro__ if kind in REFUSALS), "")


def problem_document(status: int, detail: str, instance: str, **more: Any) -> dict[str, Any]:
    """Return a problem document; ``more`` are its extension members."""
    title = HTTPStatus(status).phrase
    return (
        Problem(
            type="about:blank", title=title, status=status, detail=detail, instance=instance
        ).model_dump()
        | more
    )


def parameter_named(error: Exception) -> dict[str, str]:
    """Return the extension member that names the parameter of an error; empty if it is about no
    single one.
    """
    if isinstance(error, ParameterError) and error.parameter:
        return {"parameter": error.parameter}
    return {}


def problem(status: int, detail: str, instance: str, **more: Any) -> JSONResponse:
    """Return a response with a ``problem_document``, which carries the id of the present
    request.
    """
    number = REQUEST_ID.get()
    if number:
        more = {"request_id": number, **more}
    body = problem_document(status, detail, instance, **more)
    headers = {"X-Content-Type-Options": "nosniff"}
    if status in RETRY_AFTER_SECONDS:
        headers["Retry-After"] = RETRY_AFTER_SECONDS[status]
    if number:
        headers["X-Request-ID"] = number
    return JSONResponse(body, status, headers, "application/problem+json")


async def domain_problem(request: Request, error: Exception) -> JSONResponse:
    """Answer a domain error with a problem document; log it if it is not the client's, and
    count refusals.
    """
    if (
        isinstance(error, StoreError | WorkersError)
        or status_of(error) == HTTPStatus.INTERNAL_SERVER_ERROR
    ):
        log.error("%s", error)
    if (why := refusal(error)) and (metrics := getattr(request.app.state, "metrics", None)):
        metrics.refused.labels(why).inc()
    return problem(status_of(error), str(error), request.url.path, **parameter_named(error))


async def http_problem(request: Request, error: Exception) -> JSONResponse:
    """Answer an error of the framework, such as 404 or 405, with a problem document; headers
    such as Allow are kept.
    """
    assert isinstance(error, HTTPException)
    status = error.status_code
    path = request.url.path
    if status in SENTENCES:
        sentence = SENTENCES[status].format(path=path, method=request.method)
    else:
        sentence = error.detail
    answer = problem(status, sentence, path)
    answer.headers.update(error.headers or {})
    # If several routes share a path, the framework names the methods of one only.
    if status == HTTPStatus.METHOD_NOT_ALLOWED and (methods := methods_at(request.app, path)):
        answer.headers["Allow"] = ", ".join(methods)
    return answer


def methods_at(app: FastAPI, path: str) -> list[str]:
    """Return the methods of all routes at a path, by the OpenAPI document."""
    operations = (
        each
        for template, each in app.openapi()["paths"].items()
        if compile_path(template)[0].match(path)
    )
    found = {method.upper() for each in operations for method in each}
    return sorted(found & HTTP_METHODS | ({"HEAD"} if "GET" in found else set()))


async def validation_problem(request: Request, error: Exception) -> JSONResponse:
    """Answer the framework's validation error with one sentence about the first finding."""
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    name = str(first["loc"][-1])
    return problem(422, f"{name}: {first['msg']}.", request.url.path, parameter=name)


async def left(request: Request, error: Exception) -> JSONResponse:
    """Answer a client that left before its request was complete; nobody reads the answer."""
    return problem(400, "The client left before its request was whole.", request.url.path)


async def failure(request: Request, error: Exception) -> JSONResponse:
    """Answer any other error; its traceback goes to the log, never to the client."""
    return problem(500, SENTENCES[500], request.url.path)


def install(app: FastAPI) -> None:
    """Make the app answer every error with a problem document."""
    app.add_exception_handler(IsogiError, domain_problem)
    app.add_exception_handler(HTTPException, http_problem)
    app.add_exception_handler(ClientDisconnect, left)
    app.add_exception_handler(RequestValidationError, validation_problem)
    app.add_exception_handler(Exception, failure)
