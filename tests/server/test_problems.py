"""Errors as problem documents."""

import asyncio
import json
from http import HTTPStatus

import pytest
from fastapi import FastAPI
from starlette.requests import Request

from isogi_core import errors as domain
from isogi_server import errors as service
from isogi_server.problems import domain_problem, install, status_of
from isogi_worker import errors as workers
from tests.server.asking import Ask


class NewError(domain.ViewError):
    pass


@pytest.mark.parametrize(
    ("error", "status"),
    [
        *[(error("x"), 422) for error in (domain.ViewError, NewError, domain.VolumeError)],
        (domain.DamagedChunkError("x"), 503),
        (domain.IsogiError("x"), 500),
        (service.UnknownSceneError("x"), 404),
        (service.NotAcceptableError("x"), 406),
        (service.BusyError("x"), 429),
        (service.StartingError("x"), 503),
        (ValueError("x"), 500),
    ],
)
def test_the_table_goes_by_the_nearest_class(error: Exception, status: int) -> None:
    assert status_of(error) == status


OF_COMMANDS = domain.ReportError, service.LibraryError
"""What the command line alone raises."""


def test_every_error_of_the_domain_has_a_status() -> None:
    classes = {
        c
        for module in (domain, workers, service)
        for c in vars(module).values()
        if isinstance(c, type)
    }
    for error in classes - {domain.IsogiError, *OF_COMMANDS}:
        assert status_of(error("x")) != 500, error


def test_a_parameter_is_named() -> None:
    request = Request(
        {"type": "http", "method": "GET", "path": "/v1/x", "headers": [], "query_string": b""}
    )
    answer = asyncio.run(domain_problem(request, service.ParameterError("width is odd.", "width")))
    assert answer.headers["content-type"] == "application/problem+json"
    assert json.loads(bytes(answer.body)) == {
        "type": "about:blank",
        "title": HTTPStatus(422).phrase,
        "status": 422,
        "detail": "width is odd.",
        "instance": "/v1/x",
        "parameter": "width",
    }


@pytest.fixture
def app() -> FastAPI:
    app = FastAPI()
    install(app)

    @app.get("/things/{number}")
    def thing(number: int) -> int:
        return 1 // number

    return app


@pytest.mark.parametrize(
    ("method", "path", "status", "sentence"),
    [
        ("GET", "/{x}", 404, "There is nothing at /{x}: see /docs for what there is."),
        ("POST", "/things/1", 405, "/things/1 does not take POST: see /docs for what it takes."),
        ("GET", "/things/one", 422, "number: Input should be a valid integer"),
        ("GET", "/things/0", 500, "The server failed on this request"),
    ],
)
def test_the_frameworks_own_errors(
    ask: Ask, app: FastAPI, method: str, path: str, status: int, sentence: str
) -> None:
    answer = ask(app, method, path)
    assert answer.status_code == status == answer.json()["status"]
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["detail"].startswith(sentence)
    assert "ZeroDivision" not in answer.text


def test_allow_names_all_methods_of_a_path(ask: Ask, app: FastAPI) -> None:
    @app.delete("/things/{number}")
    def no_thing(number: int) -> None: ...

    @app.get("/hidden", include_in_schema=False)
    def hidden() -> None: ...

    assert ask(app, "POST", "/things/1").headers["allow"] == "DELETE, GET, HEAD"
    assert ask(app, "POST", "/hidden").headers["allow"] == "GET"
