"""Middleware for all requests: ids, log and metrics, limits of bodies, headers of every answer,
HEAD as GET.
"""

import logging
import time
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from isogi_server.logs import REQUEST_ID, request_id
from isogi_server.problems import problem
from isogi_server.render.metrics import Metrics

log = logging.getLogger("isogi.requests")
HANDSHAKE = HTTPStatus.SWITCHING_PROTOCOLS


class Requests:
    """ASGI middleware that gives requests an id, logs and counts them. It is outermost, so that
    requests refused by other middleware count too.

    The id is the client's ``X-Request-ID`` if that is well-formed. Answers, problem documents and
    log records carry it. Queries are not logged, as they may hold tokens.
    """

    def __init__(self, app: ASGIApp, metrics: "Metrics") -> None:
        """Count requests in ``metrics``."""
        self.app = app
        self.metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and note its outcome."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        number = request_id(Headers(scope=scope).get("x-request-id"))
        begun = time.perf_counter()
        # Log records and problems of this request find its id in the context.
        REQUEST_ID.set(number)
        status: int = HTTPStatus.INTERNAL_SERVER_ERROR
        headers = Headers()

        async def numbered(message: Message) -> None:
            nonlocal status, headers
            if message["type"].endswith("response.start"):
                answered = MutableHeaders(scope=message)
                answered["X-Request-ID"] = number
                status = message["status"]
                headers = answered
            elif message["type"] == "websocket.accept":
                status = HANDSHAKE
            elif message["type"] == "websocket.close" and status != HANDSHAKE:
                # A socket that is closed before it was accepted gets 403 from the server.
                status = HTTPStatus.FORBIDDEN
            await send(message)

        self.metrics.open.inc()
        try:
            await self.app(scope, receive, numbered)
        finally:
            self.metrics.open.dec()
            self.note(scope, status, time.perf_counter() - begun, headers)

    def note(self, scope: Scope, status: int, seconds: float, headers: Headers) -> None:
        """Count and log a request that has ended."""
        method = scope.get("method", "WEBSOCKET")
        client = (scope.get("client") or ("-",))[0]
        self.metrics.count(method, route_of(scope), status, seconds, headers)
        path = scope.get("raw_path", b"").decode("latin-1") or scope["path"]
        facts = {
            "method": method,
            "path": path,
            "status": status,
            "seconds": round(seconds, 6),
            "client": client,
        }
        log.info("%s %s %d in %.1f ms", method, path, status, 1000 * seconds, extra=facts)


def route_of(scope: Scope) -> str:
    """Return the path of the route that answered, with the names of its parameters; "none" if
    no route did.
    """
    return str(getattr(scope.get("route"), "path", "none"))


UPLOADS = (("POST", "/v1/volumes"), ("POST", "/v1/environments"))
"""Methods and paths of requests whose bodies may be larger and take longer."""


class SmallBodies:
    """ASGI middleware that answers 413 to bodies above a limit, declared or sent in chunks.

    A request that declares its length in two ways is refused with 400, and its connection closed
    (RFC 9112, 6.1).
    """

    def __init__(self, app: ASGIApp, limit: int, upload: int = 0) -> None:
        """Allow ``limit`` bytes, and ``upload`` bytes in UPLOADS."""
        self.app = app
        self.limit = limit
        self.upload = upload

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on. Once its body has too many bytes, the route reads a disconnect, and
        the client gets 413 in place of the answer that the route begins then. An answer that has
        begun before goes on.
        """
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        # With two lengths it is undecided where the next request begins.
        if "content-length" in headers and "transfer-encoding" in headers:
            twofold = problem(
                400, "Content-Length and Transfer-Encoding are given: give one.", scope["path"]
            )
            twofold.headers["Connection"] = "close"
            await twofold(scope, receive, send)
            return
        if (scope["method"], scope["path"]) in UPLOADS:
            limit = self.upload
        else:
            limit = self.limit
        refusal = problem(
            413, f"The body of a request may be {limit} bytes, no more.", scope["path"]
        )
        # The protocol has checked that the header is a number.
        if int(headers.get("content-length", "0")) > limit:
            await refusal(scope, receive, send)
            return
        # Count the bytes of a body of unknown length as the route reads them.
        body = Body(receive, limit)
        refused = False

        async def answer(message: Message) -> None:
            """Send a message of the route's answer, or the refusal in place of the whole answer."""
            nonlocal refused
            if message["type"] == "http.response.start" and body.too_long:
                refused = True
                await refusal(scope, receive, send)
            if not refused:
                await send(message)

        await self.app(scope, body.receive, answer)


class Body:
    """The messages of one request's body, until they are ``too_long``."""

    def __init__(self, receive: Receive, limit: int) -> None:
        self.too_long = False
        self._receive = receive
        self._left = limit

    async def receive(self) -> Message:
        """Return the next message; a disconnect once there were too many bytes."""
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        self.too_long = self.too_long or self._left < 0
        if self.too_long:
            return {"type": "http.disconnect"}
        return message


class HeadAsGet:
    """ASGI middleware that answers HEAD as GET, with the same headers and no body."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a HEAD request on as GET, and drop the body of the answer."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return

        async def bodiless(message: Message) -> None:
            if message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        asked = {**scope, "method": "GET"}
        await self.app(asked, receive, bodiless)
        scope["route"] = asked.get("route")


PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self';"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
OTHER_POLICY = "default-src 'none'; frame-ancestors 'none'"


class SafeHeaders:
    """ASGI middleware that adds security headers to every answer. Pages may load files of this
    server only; other answers may load nothing.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and add headers to the start of its answer."""

        async def guarded(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                headers = MutableHeaders(scope=message)
                # A 304 gets no policy. It has no content type, so it would get the policy of other
                # answers, and a browser would apply this to the page that it has stored.
                if message["status"] != HTTPStatus.NOT_MODIFIED:
                    page = headers.get("content-type", "").startswith("text/html")
                    policy = PAGE_POLICY if page else OTHER_POLICY
                    headers.setdefault("Content-Security-Policy", policy)
                headers.setdefault("X-Content-Type-Options", "nosniff")
                headers.setdefault("Referrer-Policy", "no-referrer")
                headers.setdefault("Cross-Origin-Opener-Policy", "same-origin")
                headers.setdefault("Cache-Control", "no-cache")
            await send(message)

        await self.app(scope, receive, guarded)
