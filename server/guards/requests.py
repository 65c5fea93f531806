"""Requests: each gets an id, is counted, and is told in the log."""

import logging
import time
from http import HTTPStatus
from typing import TYPE_CHECKING

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.logs import REQUEST_ID, request_id

if TYPE_CHECKING:
    from server.metrics import Metrics

log = logging.getLogger("isogi.requests")
HANDSHAKE = HTTPStatus.SWITCHING_PROTOCOLS


class Requests:
    """ASGI middleware: the outermost one, so that what the others refuse is counted and told too.

    The id is the client's ``X-Request-ID`` where it is well-formed; the answer carries it, and so do problems and
    all that is logged meanwhile. Queries are not logged.
    """

    def __init__(self, app: ASGIApp, metrics: "Metrics") -> None:
        """Count into ``metrics``."""
        self.app = app
        self.metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and note what became of it."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        number, begun = request_id(Headers(scope=scope).get("x-request-id")), time.perf_counter()
        REQUEST_ID.set(number)
        status: int = HTTPStatus.INTERNAL_SERVER_ERROR
        headers = Headers()

        async def numbered(message: Message) -> None:
            nonlocal status, headers
            if message["type"].endswith("response.start"):
                own = MutableHeaders(scope=message)
                own["X-Request-ID"] = number
                status, headers = message["status"], own
            elif message["type"] == "websocket.accept":
                status = HANDSHAKE
            elif message["type"] == "websocket.close" and status != HANDSHAKE:
                status = HTTPStatus.FORBIDDEN
            await send(message)

        self.metrics.open.inc()
        try:
            await self.app(scope, receive, numbered)
        finally:
            self.metrics.open.dec()
            self.note(scope, status, time.perf_counter() - begun, headers)

    def note(self, scope: Scope, status: int, seconds: float, headers: Headers) -> None:
        """Count a request that has ended, and tell it."""
        method, client = scope.get("method", "WEBSOCKET"), (scope.get("client") or ("-",))[0]
        self.metrics.count(method, route_of(scope), status, seconds, headers)
        path = scope.get("raw_path", b"").decode("latin-1") or scope["path"]
        facts = {"method": method, "path": path, "status": status, "seconds": round(seconds, 6), "client": client}
        log.info("%s %s %d in %.1f ms", method, path, status, 1000 * seconds, extra=facts)


def route_of(scope: Scope) -> str:
    """The path of the route that answered, with its parameters' names; ``none`` where no route did."""
    return str(getattr(scope.get("route"), "path", "none"))
