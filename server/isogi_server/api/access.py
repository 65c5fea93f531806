"""Access: the hosts, origins and tokens that are let in."""

import hashlib
import hmac
import re
from collections.abc import Sequence
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from isogi_server.bearers import BEARER_SCOPE_KEY, TOKENLESS_BEARER, Bearer
from isogi_server.problems import problem

HOST = re.compile(r"(\[(?P<six>[0-9a-f:.]*:[0-9a-f:.]*)\]|(?P<name>[^\[\]:]*))(:[0-9]*)?", re.ASCII)
"""A Host header: a name or an address, IPv6 in brackets, and perhaps a port (RFC 9110, 7.2)."""


class KnownHosts:
    """ASGI middleware that refuses requests for unknown host names, against DNS rebinding."""

    def __init__(self, app: ASGIApp, hosts: tuple[str, ...] | None) -> None:
        """Allow ``hosts``, in lower case and without ports; None allows all."""
        self.app = app
        self.hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on if its Host header is allowed; else answer 421."""
        if (
            scope["type"] not in ("http", "websocket")
            or self.hosts is None
            or self.knows(Headers(scope=scope))
        ):
            await self.app(scope, receive, send)
            return
        # A page of another site that resolves its name to this address is refused here: it names
        # the host of that site.
        detail = (
            "This host name is not served here: use a loopback name, or set ISOGI_ALLOWED_HOSTS."
        )
        await problem(421, detail, scope["path"])(scope, receive, send)

    def knows(self, headers: Headers) -> bool:
        """Return True if the Host header, without its port, is an allowed name."""
        match = HOST.fullmatch(headers.get("host", "").lower())
        return (
            self.hosts is not None
            and match is not None
            and (match["six"] or match["name"]) in self.hosts
        )


SAFE = ("GET", "HEAD")
"""Methods that change nothing. A client that sends no browser headers may use any method."""

SAME_SITE = ("same-origin", "none")
"""Values of Sec-Fetch-Site for requests of the server's own pages, and for addresses that a
person typed.
"""


class KnownOrigins:
    """ASGI middleware that refuses requests from pages of other origins, against forged requests
    and stolen computing time.

    Browsers state the source of a request in Sec-Fetch-Site and Origin, and pages cannot change
    these. Requests that a browser calls cross-site are refused, except for links that a person
    follows. If an origin is named, changes and sockets are refused unless it is this server's. Even
    a picture costs work and bakes light, so pictures in foreign pages are refused too. Source:
    resource isolation policy, web.dev/articles/fetch-metadata.
    """

    def __init__(self, app: ASGIApp, origins: tuple[str, ...] = ()) -> None:
        """Allow pages of ``origins``, such as ``https://lab.example``, in addition to the
        server's.
        """
        self.app = app
        self.origins = origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on if its origin is allowed or does not matter; else answer 403."""
        if scope["type"] not in ("http", "websocket") or self.lets_pass(scope):
            await self.app(scope, receive, send)
            return
        detail = (
            "Pages of other origins may not ask this server: set ISOGI_ALLOWED_ORIGINS to let one."
        )
        await problem(403, detail, scope["path"])(scope, receive, send)

    def lets_pass(self, scope: Scope) -> bool:
        """Return True if the request comes from an allowed page, from no page, or by a link."""
        headers = Headers(scope=scope)
        origin = headers.get("origin")
        site = headers.get("sec-fetch-site")
        if origin in self.origins:
            return True
        # Changes and sockets need the server's origin, if the browser names one.
        safe = scope["type"] == "http" and scope["method"] in SAFE
        if not safe and origin is not None and not is_own(origin, headers):
            return False
        return site is None or site in SAME_SITE or (safe and is_link(headers))


def is_own(origin: str, headers: Headers) -> bool:
    """Return True if an Origin header names the host that the request was sent to."""
    return urlsplit(origin).netloc == headers.get("host", "").lower() != ""


def is_link(headers: Headers) -> bool:
    """Return True if a browser opens the address as a page, as it does if a link is followed."""
    return (
        headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
    )


OPEN_PATHS = ("/livez", "/readyz", "/bakez")
"""Paths for probes without a token, which get answers without details."""

REFUSAL = (
    "This server wants its token: as 'Authorization: Bearer …', or once in the page's "
    "address as /?token=…"
)
PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>isogi: token</title>
<h1>This server wants its token</h1>
<p>Open this page once as <code>/?token=…</code>; the browser then keeps it.</p>
<p>If it has it already, and you came by a link from elsewhere: <a href="">go on</a>.</p></html>"""


FORBIDDEN = (
    "The token '{name}' does not allow this ({scope}): ask the operator of this server "
    "for one that does."
)


def needed_scope(scope: Scope) -> str:
    """Return the right, one of TOKEN_SCOPES, that a token needs for a request or socket with this
    ASGI ``scope``.
    """
    if scope["path"] == "/metrics":
        return "admin"
    if scope["type"] == "websocket" or scope["method"] in SAFE:
        return "look"
    if scope["path"].startswith(("/v1/volumes", "/v1/environments")):
        return "upload"
    return "bake"


class Token:
    """The token of a ``bearer``, and the cookie that replaces it: its value is a digest of the
    token, and its name a digest of that.
    """

    def __init__(self, bearer: Bearer) -> None:
        self.bearer = bearer
        self.token = bearer.token.encode()
        self.cookie = hmac.new(self.token, b"isogi cookie", hashlib.sha256).hexdigest()
        self.name = f"isogi-{hashlib.sha256(self.cookie.encode()).hexdigest()[:8]}"

    def is_shown(self, given: bytes) -> bool:
        """Return True if ``given`` is the token; compares in constant time."""
        return hmac.compare_digest(given, self.token)

    def is_in(self, cookies: SimpleCookie) -> bool:
        """Return True if the cookie of this token is among those of a request; compares in
        constant time.
        """
        cookie = cookies.get(self.name)
        return cookie is not None and hmac.compare_digest(
            cookie.value.encode(), self.cookie.encode()
        )


class TokenBearers:
    """ASGI middleware that answers 401 to requests without a token, and 403 if the token does not
    allow the request.

    A token is sent in the Authorization header, or by a cookie that a browser gets if the page is
    opened with ``?token=``. The cookie holds a digest, not the token; its name depends on the token
    because servers on different ports share their cookies.
    """

    def __init__(self, app: ASGIApp, bearers: Sequence[Bearer]) -> None:
        """Require the token of one of the ``bearers``."""
        self.app = app
        self.tokens = [Token(bearer) for bearer in bearers]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on if its token allows it, and mark the answer as private; else answer
        401 or 403. A page that is opened with a token in its address gets a redirect that sets the
        cookie.
        """
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        # Probes are answered with or without a token; with one, the answers have details.
        if scope["path"] in OPEN_PATHS:
            token = self.known(Headers(scope=scope))
            if token:
                scope[BEARER_SCOPE_KEY] = token.bearer
            else:
                scope[BEARER_SCOPE_KEY] = TOKENLESS_BEARER
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        # A token in the page's address takes precedence over a cookie, which may be older: if it is
        # wrong, the cookie does not help.
        given = self.given(scope)
        if given is not None and (token := self.shown(given.encode(errors="replace"))):
            await self.admission(scope, token)(scope, receive, send)
        elif given is None and (token := self.known(headers)):
            answering = self.passed(scope, token.bearer)
            await answering(scope, receive, lambda message: send(private(message)))
        else:
            await self.refusal(scope, headers)(scope, receive, send)

    def passed(self, scope: Scope, bearer: Bearer) -> ASGIApp:
        """Return the application that answers a request of this bearer: the app if the bearer
        may ask it, else a 403.
        """
        if bearer.may(needed := needed_scope(scope)):
            scope[BEARER_SCOPE_KEY] = bearer
            return self.app
        return problem(403, FORBIDDEN.format(name=bearer.name, scope=needed), scope["path"])

    def known(self, headers: Headers) -> Token | None:
        """Return the token that the headers carry, directly or by its cookie; of several
        cookies the one that allows most.
        """
        scheme, _, given = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            return self.shown(given.strip().encode("latin-1"))
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return None
        # A browser may hold cookies of several tokens, such as one that was sent by a colleague.
        held = [token for token in self.tokens if token.is_in(cookies)]
        return max(held, key=lambda token: token.bearer.reach, default=None)

    def shown(self, given: bytes) -> Token | None:
        """Return the token that equals ``given``, if any. All tokens are compared, so that the
        time reveals nothing.
        """
        return next(
            (token for token in [each for each in self.tokens if each.is_shown(given)]), None
        )

    def given(self, scope: Scope) -> str | None:
        """Return the token in the address of the page; None if there is none, or if another
        address is requested.
        """
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] != "/":
            return None
        return dict(parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)).get(
            "token"
        )

    def admission(self, scope: Scope, token: Token) -> Response:
        """Return a redirect to the address without the token, with the cookie, so that the
        token leaves the browser's history.
        """
        # The new address is relative, as a proxy may serve this page below another path.
        pairs = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        rest = urlencode([(name, value) for name, value in pairs if name != "token"])
        answer = RedirectResponse(
            f"./?{rest}" if rest else "./", 303, {"Cache-Control": "no-store"}
        )
        secure = scope["scheme"] == "https"
        answer.set_cookie(token.name, token.cookie, httponly=True, samesite="strict", secure=secure)
        return answer

    def refusal(self, scope: Scope, headers: Headers) -> Response:
        """Return a 401, as a page if a page was requested."""
        challenge = {"WWW-Authenticate": "Bearer", "Cache-Control": "no-store"}
        if scope["path"] == "/" and "text/html" in headers.get("accept", ""):
            return HTMLResponse(PAGE, 401, challenge)
        answer = problem(401, REFUSAL, scope["path"])
        answer.headers.update(challenge)
        return answer


def private(message: Message) -> Message:
    """Mark an answer as private, so that shared caches do not keep it; return the message."""
    if message["type"] == "http.response.start":
        headers = MutableHeaders(scope=message)
        headers["Cache-Control"] = f"private, {headers.get('cache-control', 'no-cache')}"
    return message
