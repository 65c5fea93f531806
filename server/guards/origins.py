"""Origins: which pages may ask for anything."""

from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from server.problems import problem

SAFE = ("GET", "HEAD")
"""Methods that change nothing; a client without a browser's headers may use them from wherever it is."""

OWN = ("same-origin", "none")
"""Values of Sec-Fetch-Site for requests of the server's own pages, and of a person who typed an address."""


class KnownOrigins:
    """ASGI middleware: refuses what pages of other origins send, against forged requests and stolen work.

    Browsers say where a request comes from in Sec-Fetch-Site and Origin, and no page can change that. What they
    call foreign is refused, but for a person who follows a link; where they name an origin, changes and sockets
    are refused unless it is the server's own. A frame costs work and bakes light, so that pictures in foreign
    pages are refused too. (A resource isolation policy as in web.dev/articles/fetch-metadata.)
    """

    def __init__(self, app: ASGIApp, origins: tuple[str, ...] = ()) -> None:
        """Let pages of ``origins``, such as ``https://lab.example``, pass besides the server's own."""
        self.app = app
        self.origins = origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on where its origin is known or does not matter; 403 else."""
        if scope["type"] not in ("http", "websocket") or self.lets_pass(scope):
            await self.app(scope, receive, send)
            return
        detail = "Pages of other origins may not ask this server: set ISOGI_ALLOWED_ORIGINS to let one."
        await problem(403, detail, scope["path"])(scope, receive, send)

    def lets_pass(self, scope: Scope) -> bool:
        """Whether the request comes from a page that is known, from no page, or by a link."""
        headers = Headers(scope=scope)
        origin, site = headers.get("origin"), headers.get("sec-fetch-site")
        if origin in self.origins:
            return True
        safe = scope["type"] == "http" and scope["method"] in SAFE
        if not safe and origin is not None and not is_own(origin, headers):
            return False
        return site is None or site in OWN or (safe and is_link(headers))


def is_own(origin: str, headers: Headers) -> bool:
    """Whether an Origin header names the host that the request is sent to."""
    return urlsplit(origin).netloc == headers.get("host", "").lower() != ""


def is_link(headers: Headers) -> bool:
    """Whether a browser opens the address in a tab of its own, as it does when a link is followed."""
    return headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
