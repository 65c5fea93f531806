"""The token: who may ask a server that others can reach."""

import hashlib
import hmac
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.problems import problem

OPEN = ("/livez", "/readyz")
"""What probes ask, which hold no token."""

REFUSAL = "This server wants its token: as 'Authorization: Bearer …', or once in the page's address as /?token=…"
PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>isogi: token</title>
<h1>This server wants its token</h1><p>Open this page once as <code>/?token=…</code>; the browser then keeps it.</p>
<p>If it has it already, and you came by a link from elsewhere: <a href="">go on</a>.</p></html>"""


class TokenBearers:
    """ASGI middleware: 401 for who does not show the token.

    It is shown in the Authorization header, or by a cookie that a browser is given when the page is opened with
    ``?token=``. The cookie holds a digest and not the token, and is named after it, as ports share their cookies.
    """

    def __init__(self, app: ASGIApp, token: str) -> None:
        """Ask for ``token``."""
        self.app = app
        self.token = token.encode()
        self.cookie = hmac.new(self.token, b"isogi cookie", hashlib.sha256).hexdigest()
        self.name = f"isogi-{hashlib.sha256(self.cookie.encode()).hexdigest()[:8]}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on where it shows the token; a page that is opened with it gets the cookie."""
        if scope["type"] not in ("http", "websocket") or scope["path"] in OPEN:
            await self.app(scope, receive, send)
            return
        headers, told = Headers(scope=scope), self.told(scope)
        if told is not None and hmac.compare_digest(told.encode(errors="replace"), self.token):
            await self.admission(scope)(scope, receive, send)
        elif told is None and self.knows(headers):
            await self.app(scope, receive, lambda message: send(private(message)))
        else:
            await self.refusal(scope, headers)(scope, receive, send)

    def knows(self, headers: Headers) -> bool:
        """Whether the headers show the token or its cookie."""
        scheme, _, given = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            return hmac.compare_digest(given.strip().encode("latin-1"), self.token)
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self.name)
        except CookieError:
            return False
        return cookie is not None and hmac.compare_digest(cookie.value.encode(), self.cookie.encode())

    def told(self, scope: Scope) -> str | None:
        """The token in the page's own address; None where there is none, or the address is another."""
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] != "/":
            return None
        return dict(parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)).get("token")

    def admission(self, scope: Scope) -> Response:
        """The same address without the token, and the cookie; the browser's history forgets the token."""
        pairs = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        rest = urlencode([(name, value) for name, value in pairs if name != "token"])
        answer = RedirectResponse(f"./?{rest}" if rest else "./", 303, {"Cache-Control": "no-store"})
        secure = scope["scheme"] == "https"
        answer.set_cookie(self.name, self.cookie, httponly=True, samesite="strict", secure=secure)
        return answer

    def refusal(self, scope: Scope, headers: Headers) -> Response:
        """401, as a page where a page was asked for."""
        challenge = {"WWW-Authenticate": "Bearer", "Cache-Control": "no-store"}
        if scope["path"] == "/" and "text/html" in headers.get("accept", ""):
            return HTMLResponse(PAGE, 401, challenge)
        answer = problem(401, REFUSAL, scope["path"])
        answer.headers.update(challenge)
        return answer


def private(message: Message) -> Message:
    """The message; an answer says that caches which others share may not keep it."""
    if message["type"] == "http.response.start":
        headers = MutableHeaders(scope=message)
        headers["Cache-Control"] = f"private, {headers.get('cache-control', 'no-cache')}"
    return message
