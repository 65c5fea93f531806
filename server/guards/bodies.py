"""Bodies: how much a request may send."""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.problems import problem

UPLOAD = ("POST", "/v1/volumes")
"""The method and the path of requests whose bodies may be larger, and take longer."""


class SmallBodies:
    """ASGI middleware: 413 for bodies above a limit, whether their length is told or they come in chunks."""

    def __init__(self, app: ASGIApp, limit: int, upload: int = 0) -> None:
        """Let at most ``limit`` bytes pass, in an UPLOAD at most so many."""
        self.app = app
        self.limit = limit
        self.upload = upload

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; once it has sent too much the route hears that its client left, and the client 413."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit = self.upload if (scope["method"], scope["path"]) == UPLOAD else self.limit
        refusal = problem(413, f"The body of a request may be {limit} bytes, no more.", scope["path"])
        length = Headers(scope=scope).get("content-length", "0")
        if int(length) > limit:  # the protocol lets digits pass alone
            await refusal(scope, receive, send)
            return
        body = Body(receive, limit)
        refused = False

        async def answer(message: Message) -> None:
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
        """The next message; that the client left where there was too much."""
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        self.too_long = self.too_long or self._left < 0
        return {"type": "http.disconnect"} if self.too_long else message
