"""Response headers: what a frame says about itself, and what every response carries."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.problems import problem

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from isogi_core.frame.stopwatch import Stopwatch
    from worker.outlook import TimeLeft

PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self';"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
STATES = ("final", "converging", "provisional")
STAGES = {
    "queue": "waiting for a thread",
    "demand": "telling the baker what light is lacking, and asking how long it takes",
    "bake": "waiting for light",
    "primary": "casting the camera's rays",
    "texels": "finding the texels that the picture reads",
    "load": "bringing light from the store",
    "read": "looking the texels up",
    "light": "putting the texels under the turned light",
    "shade": "carrying their light to the picture",
    "normals": "finding the surface's normals",
    "paths": "tracing the pixels' paths",
    "encode": "making the picture's bytes",
    "total": "all of these and what is between them",
}
"""The stages of a request, as Server-Timing names them, and what is done in each. None counts what another does."""

OTHER_POLICY = "default-src 'none'; frame-ancestors 'none'"


def frame_headers(frame: Frame, time_left: TimeLeft | None, tag: str) -> dict[str, str]:
    """The headers of a frame's response, a 304 included."""
    left = {"Isogi-Time-Left": time_left_header(time_left)} if time_left is not None and frame.provisional else {}
    return left | {
        "Isogi-Provisional": "?1" if frame.provisional else "?0",
        "Isogi-Coverage": coverage_header(frame.coverage),
        "Isogi-Error": f"{frame.estimated_error:.5f}",
        "Isogi-Chunks": f"needed={frame.chunks_needed}, final={frame.chunks_final}",
        "ETag": tag,
        "Cache-Control": "no-cache",
        "Vary": "Accept",
    }


def coverage_header(shares: Mapping[str, float]) -> str:
    """Shares to three digits; what is final is rounded down and the rest up, so that 1.000 means all."""
    final, *others = (1000 * shares[state] for state in STATES)
    thousandths = (math.floor(final), *map(math.ceil, others))
    return ", ".join(f"{state}={n / 1000:.3f}" for state, n in zip(STATES, thousandths, strict=True))


def time_left_header(left: TimeLeft) -> str:
    """Seconds until the frame is final, and the range that they are likely in."""
    return f"low={left.low:.1f}, likely={left.likely:.1f}, high={left.high:.1f}"


def entity_tag(frame: Frame, *representation: object) -> str:
    """A strong ETag: equal where the frame's content and its representation (format, exposure, …) are."""
    text = repr((frame.version, *representation))
    return f'"{hashlib.blake2b(text.encode(), digest_size=16).hexdigest()}"'


def matches(if_none_match: str | None, tag: str) -> bool:
    """Whether an If-None-Match header names the tag (weak comparison, RFC 9110, 13.1.2)."""
    if if_none_match is None:
        return False
    named = {part.strip().removeprefix("W/") for part in if_none_match.split(",")}
    return tag in named or "*" in named


def server_timing(watch: Stopwatch) -> str:
    """A Server-Timing header: milliseconds of a request's stages so far and of their total; see STAGES."""
    seconds = {**watch.seconds, "total": watch.elapsed}
    return ", ".join(f"{stage};dur={1000 * spent:.2f}" for stage, spent in seconds.items())


class SafeHeaders:
    """ASGI middleware: no sniffing, a content policy, and ``no-cache`` where nothing else was said."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; add headers to the start of its response."""

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                page = headers.get("content-type", "").startswith("text/html")
                headers.setdefault("Content-Security-Policy", PAGE_POLICY if page else OTHER_POLICY)
                headers.setdefault("X-Content-Type-Options", "nosniff")
                headers.setdefault("Referrer-Policy", "no-referrer")
                headers.setdefault("Cache-Control", "no-cache")
            await send(message)

        await self.app(scope, receive, guarded if scope["type"] == "http" else send)


class HeadAsGet:
    """ASGI middleware: HEAD is answered wherever GET is, with the same headers and no body."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a HEAD request on as GET and drop the body."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self.app(scope, receive, send)
            return

        async def bodiless(message: Message) -> None:
            await send({**message, "body": b""} if message["type"] == "http.response.body" else message)

        await self.app({**scope, "method": "GET"}, receive, bodiless)


class KnownHosts:
    """ASGI middleware: refuses requests for other host names, against DNS rebinding."""

    def __init__(self, app: ASGIApp, hosts: tuple[str, ...] | None) -> None:
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
