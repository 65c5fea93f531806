"""Access: which hosts, origins and tokens are let in."""

import hashlib
import hmac
import re
from collections.abc import Sequence
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qsl, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.bearers import BEARER_SCOPE_KEY, TOKENLESS_BEARER, Bearer
from server.problems import problem

HOST = re.compile(r"(\[(?P<six>[0-9a-f:.]*:[0-9a-f:.]*)\]|(?P<name>[^\[\]:]*))(:[0-9]*)?", re.ASCII)
"""A Host header: a name or an address, that of six in brackets, and perhaps a port (RFC 9110,
7.2).
"""


class KnownHosts:
    """ASGI middleware: refuses requests for other host names, against DNS rebinding."""

    def __init__(self, app: ASGIApp, hosts: tuple[str, ...] | None) -> None:
        """Let requests for ``hosts`` pass, in lower case and without a port; None lets all pass."""
        self.app = app
        self.hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on where its Host header is allowed; 421 else."""
        if (
            scope["type"] not in ("http", "websocket")
            or self.hosts is None
            or self.knows(Headers(scope=scope))
        ):
            await self.app(scope, receive, send)
            return
        detail = (
            "This host name is not served here: use a loopback name, or set ISOGI_ALLOWED_HOSTS."
        )
        await problem(421, detail, scope["path"])(scope, receive, send)

    def knows(self, headers: Headers) -> bool:
        """Whether the Host header, its port aside, is one of the allowed names."""
        match = HOST.fullmatch(headers.get("host", "").lower())
        return (
            self.hosts is not None
            and match is not None
            and (match["six"] or match["name"]) in self.hosts
        )


SAFE = ("GET", "HEAD")
"""Methods that change nothing; a client without a browser's headers may use them from wherever it
is.
"""

SAME_SITE = ("same-origin", "none")
"""Values of Sec-Fetch-Site for requests of the server's own pages, and of a person who typed an
address.
"""


class KnownOrigins:
    """ASGI middleware: refuses what pages of other origins send, against forged requests and stolen
    work.

    Browsers say where a request comes from in Sec-Fetch-Site and Origin, and no page can change
    that. What they call foreign is refused, but for a person who follows a link; where they name an
    origin, changes and sockets are refused unless it is the server's own. A frame costs work and
    bakes light, so that pictures in foreign pages are refused too. (A resource isolation policy as
    in web.dev/articles/fetch-metadata.)
    """

    def __init__(self, app: ASGIApp, origins: tuple[str, ...] = ()) -> None:
        """Let pages of ``origins``, such as ``https://lab.example``, pass besides the server's
        own.
        """
        self.app = app
        self.origins = origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on where its origin is known or does not matter; 403 else."""
        if scope["type"] not in ("http", "websocket") or self.lets_pass(scope):
            await self.app(scope, receive, send)
            return
        detail = (
            "Pages of other origins may not ask this server: set ISOGI_ALLOWED_ORIGINS to let one."
        )
        await problem(403, detail, scope["path"])(scope, receive, send)

    def lets_pass(self, scope: Scope) -> bool:
        """Whether the request comes from a page that is known, from no page, or by a link."""
        headers = Headers(scope=scope)
        origin = headers.get("origin")
        site = headers.get("sec-fetch-site")
        if origin in self.origins:
            return True
        safe = scope["type"] == "http" and scope["method"] in SAFE
        if not safe and origin is not None and not is_own(origin, headers):
            return False
        return site is None or site in SAME_SITE or (safe and is_link(headers))


def is_own(origin: str, headers: Headers) -> bool:
    """Whether an Origin header names the host that the request is sent to."""
    return urlsplit(origin).netloc == headers.get("host", "").lower() != ""


def is_link(headers: Headers) -> bool:
    """Whether a browser opens the address in a tab of its own, as it does when a link is
    followed.
    """
    return (
        headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
    )


OPEN_PATHS = ("/livez", "/readyz", "/bakez")
"""What probes ask, which hold no token: they answer whoever shows none in fewer words."""

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
    """What a request or socket needs its token to allow."""
    if scope["path"] == "/metrics":
        return "admin"
    if scope["type"] == "websocket" or scope["method"] in SAFE:
        return "look"
    if scope["path"].startswith(("/v1/volumes", "/v1/environments")):
        return "upload"
    return "bake"


class Token:
    """The token of a ``bearer``, and the cookie that stands for it: a digest of it, named after
    it.
    """

    def __init__(self, bearer: Bearer) -> None:
        self.bearer = bearer
        self.token = bearer.token.encode()
        self.cookie = hmac.new(self.token, b"isogi cookie", hashlib.sha256).hexdigest()
        self.name = f"isogi-{hashlib.sha256(self.cookie.encode()).hexdigest()[:8]}"

    def is_shown(self, given: bytes) -> bool:
        """Whether this is the token."""
        return hmac.compare_digest(given, self.token)

    def is_in(self, cookies: SimpleCookie) -> bool:
        """Whether its cookie is among those of a request."""
        cookie = cookies.get(self.name)
        return cookie is not None and hmac.compare_digest(
            cookie.value.encode(), self.cookie.encode()
        )


class TokenBearers:
    """ASGI middleware: 401 for requests without a token, 403 for what the token does not allow.

    It is shown in the Authorization header, or by a cookie that a browser is given when the page is
    opened with ``?token=``. The cookie holds a digest and not the token, and is named after it, as
    ports share their cookies.
    """

    def __init__(self, app: ASGIApp, bearers: Sequence[Bearer]) -> None:
        """Ask for the token of one of the ``bearers``."""
        self.app = app
        self.tokens = [Token(bearer) for bearer in bearers]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on where it shows a token that allows it; a page that is opened with one
        gets the cookie.
        """
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        if scope["path"] in OPEN_PATHS:
            token = self.known(Headers(scope=scope))
            if token:
                scope[BEARER_SCOPE_KEY] = token.bearer
            else:
                scope[BEARER_SCOPE_KEY] = TOKENLESS_BEARER
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        given = self.given(scope)
        if given is not None and (token := self.shown(given.encode(errors="replace"))):
            await self.admission(scope, token)(scope, receive, send)
        elif given is None and (token := self.known(headers)):
            await self.passed(scope, token.bearer)(
                scope, receive, lambda message: send(private(message))
            )
        else:
            await self.refusal(scope, headers)(scope, receive, send)

    def passed(self, scope: Scope, bearer: Bearer) -> ASGIApp:
        """What answers the request of a bearer: the app, where it may ask that."""
        if bearer.may(needed := needed_scope(scope)):
            scope[BEARER_SCOPE_KEY] = bearer
            return self.app
        return problem(403, FORBIDDEN.format(name=bearer.name, scope=needed), scope["path"])

    def known(self, headers: Headers) -> Token | None:
        """The token that the headers show, themselves or by its cookie; of several cookies that
        which allows most.
        """
        scheme, _, given = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            return self.shown(given.strip().encode("latin-1"))
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return None
        held = [token for token in self.tokens if token.is_in(cookies)]
        return max(held, key=lambda token: token.bearer.reach, default=None)

    def shown(self, given: bytes) -> Token | None:
        """The token that this is, if any; how long that takes reveals nothing."""
        return next(
            (token for token in [each for each in self.tokens if each.is_shown(given)]), None
        )

    def given(self, scope: Scope) -> str | None:
        """The token in the page's own address; None where there is none, or the address is
        another.
        """
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] != "/":
            return None
        return dict(parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)).get(
            "token"
        )

    def admission(self, scope: Scope, token: Token) -> Response:
        """A redirect to the address without the token, with the cookie; the browser's history
        forgets the token.
        """
        pairs = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        rest = urlencode([(name, value) for name, value in pairs if name != "token"])
        answer = RedirectResponse(
            f"./?{rest}" if rest else "./", 303, {"Cache-Control": "no-store"}
        )
        secure = scope["scheme"] == "https"
        answer.set_cookie(token.name, token.cookie, httponly=True, samesite="strict", secure=secure)
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
