"""A small app behind guards of a test's choice, asked without a socket."""

from typing import Any

import pytest
from fastapi import FastAPI, Request, WebSocket
from starlette.middleware import Middleware
from starlette.responses import HTMLResponse, JSONResponse, Response

from tests.server.api.guards.handshakes import Guarded


@pytest.fixture(scope="session")
def guarded() -> Guarded:
    """``guarded(Guard, **options)``: a page, data, what changes it, what tells a body's length, and
    a socket.
    """

    def app_behind(*guards: Any, **options: Any) -> FastAPI:
        app = FastAPI(
            middleware=[
                Middleware(guard, **(options if n == 0 else {})) for n, guard in enumerate(guards)
            ]
        )
        app.state.changes = 0

        def change() -> None:
            app.state.changes += 1

        async def length(request: Request) -> Response:
            try:
                return JSONResponse(len(await request.body()))
            except Exception:
                return JSONResponse("the client left", 503)

        async def socket(socket: WebSocket) -> None:
            await socket.accept()

        app.add_api_route("/page", lambda: HTMLResponse("<p>hello"))
        app.add_api_route("/", lambda: HTMLResponse("<p>index"))
        app.add_api_route("/livez", lambda: {"alive": True})
        app.add_api_route(
            "/data", lambda: JSONResponse({"a": 1}, headers={"Cache-Control": "max-age=5"})
        )
        app.add_api_route("/data", change, methods=["POST", "DELETE"])
        app.add_api_route("/length", length, methods=["POST"])
        app.add_api_websocket_route("/socket", socket)
        return app

    return app_behind
