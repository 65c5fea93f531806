"""Host names: whom a request believes to speak to."""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from server.problems import problem


class KnownHosts:
    """ASGI middleware: refuses requests for other host names, against DNS rebinding."""

    def __init__(self, app: ASGIApp, hosts: tuple[str, ...] | None) -> None:
        """Let requests for ``hosts`` pass, in lower case and without a port; None lets all pass."""
        self.app = app
        self.hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on where its Host header is allowed; 421 else."""
        if scope["type"] not in ("http", "websocket") or self.hosts is None or self.knows(Headers(scope=scope)):
            await self.app(scope, receive, send)
            return
        detail = "This host name is not served here: use a loopback name, or set ISOGI_ALLOWED_HOSTS."
        await problem(421, detail, scope["path"])(scope, receive, send)

    def knows(self, headers: Headers) -> bool:
        """Whether the Host header, its port aside, is one of the allowed names."""
        host = headers.get("host", "").lower()
        name = host[1:].partition("]")[0] if host.startswith("[") else host.partition(":")[0]
        return self.hosts is not None and name in self.hosts
