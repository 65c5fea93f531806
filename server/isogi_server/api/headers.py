"""Response headers of frames, and the preferences that a request states."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, TypeVar

from fastapi import Depends, Header

from isogi_core.frame.frame import Frame
from isogi_core.frame.tiles import Stopwatch
from isogi_core.plan.variants import FINER_FACTOR
from isogi_server.knobs import LONGEST_WAIT
from isogi_server.parameters import FrameParams, ViewParams
from isogi_server.pictures import media_range
from isogi_worker.progress import TimeLeft

FOR_EVER = "max-age=31536000, immutable"
"""Caching of a final picture at an address that names its version: it never changes."""

STATE_NAMES = ("final", "converging", "provisional")
STAGES = {
    "queue": "waiting for a thread",
    "demand": "requesting the light that is lacking, and estimating how long it takes",
    "bake": "waiting for light",
    "primary": "casting the camera's rays",
    "texels": "finding the texels that the picture reads",
    "load": "bringing light from the store",
    "read": "looking the texels up",
    "filter": "taking noise out of light that converges",
    "light": "putting the texels under the turned light",
    "shade": "carrying their light to the picture",
    "normals": "finding the surface's normals",
    "lobes": "casting shadow rays at the bright parts of the light",
    "shine": "casting rays of shine, and lighting their ends",
    "walls": "lighting what is seen of walls",
    "through": "following rays through glass, and lighting their ends",
    "compose": "adding up the sides of several surfaces",
    "glow": "gathering what glows before the surface",
    "edges": "taking more samples at edges",
    "check": "measuring the total error, or bringing it nearer to the target",
    "paths": "tracing the pixels' paths",
    "encode": "making the picture's bytes",
    "total": "all of these and what is between them",
}
"""Stages of a request as Server-Timing names them, with descriptions. Their times do not
overlap.
"""


def frame_headers(
    frame: Frame, time_left: TimeLeft | None, tag: str, version: str | None = None
) -> dict[str, str]:
    """Return the headers of a frame's response, also of a 304. ``version`` is the version in the
    address, if any.

    The preferences of a client change the answer until the frame is final, so that caches must vary
    by them until then.
    """
    # Some headers depend on the frame: time left if it is not final, projected or finer texels if
    # it has some.
    if time_left is not None and not frame.final:
        left = {"Isogi-Time-Left": time_left_header(time_left)}
        if time_left.overdue:
            left["Isogi-Overdue"] = "?1"
    else:
        left = {}
    projection = frame.quality.projection
    if projection is None:
        projected = {}
    else:
        projected = {"Isogi-Projected": projection_header(projection.shares)}
    if frame.quality.fineness or frame.traced_pixels:
        refined = {"Isogi-Refined": refined_header(frame)}
    else:
        refined = {}
    return (
        left
        | projected
        | refined
        | {
            "Isogi-Provisional": "?0" if frame.final else "?1",
            "Isogi-Coverage": coverage_header(frame.coverage),
            "Isogi-Surface": str(frame.surface),
            "Isogi-Error": error_header(frame),
            "Isogi-Chunks": f"needed={frame.chunks_needed}, final={frame.chunks_final}",
            "ETag": tag,
            "Cache-Control": FOR_EVER if frame.final and version == tag.strip('"') else "no-cache",
            "Cache-Status": cache_status(
                frame.chunks_needed, frame.chunks_final, frame.goes_without_texels
            ),
            "Vary": "Accept" if frame.final else "Accept, Prefer",
        }
    )


def cache_status(needed: int, final: int, by_paths: bool) -> str:
    """Return the share of a frame's light that the store had (RFC 9211): hit, partial or miss;
    bypass if paths of its pixels light it.
    """
    if by_paths:
        return "isogi-light; fwd=bypass"
    if needed == final:
        return "isogi-light; hit"
    return f"isogi-light; fwd={'partial' if final else 'miss'}"


def coverage_header(shares: Mapping[str, float]) -> str:
    """Return the shares of states to three digits, the final share rounded down and the others
    up, so that 1.000 means all.
    """
    final, *others = (1000 * shares[state] for state in STATE_NAMES)
    thousandths = (math.floor(final), *map(math.ceil, others))
    return ", ".join(
        f"{state}={n / 1000:.3f}" for state, n in zip(STATE_NAMES, thousandths, strict=True)
    )


def projection_header(shares: Mapping[str, float]) -> str:
    """Return the shares of texels by the way that they are read, to three digits; see
    ``Projection.shares``.
    """
    return ", ".join(f"{name}={share:.3f}" for name, share in shares.items())


def refined_header(frame: Frame) -> str:
    """Return the refinements of a picture beyond its plan: texels along each axis, as a
    multiple, and the share of pixels with light of their own.
    """
    return (
        f"texels={FINER_FACTOR**frame.quality.fineness:g}, "
        f"pixels={frame.traced_pixels / max(frame.surface, 1):.3f}"
    )


def error_header(frame: Frame) -> str:
    """Return the picture's total relative error as a value with parameters (RFC 8941): its part by
    noise, 95 % interval and number of control pixels; or a prediction before there are any.

    If the error below which 99 % of the pixels stay is measured, it follows with its 95 % interval.
    """
    total = frame.total
    stated = f"{total.likely:.5f}; noise={frame.noise:.5f}"
    if total.predicted:
        return f"{stated}; predicted"
    measured = f"{stated}; low={total.low:.5f}; high={total.high:.5f}; controls={total.controls}"
    if (tail := frame.tail) is None:
        return measured
    return f"{measured}; p99={tail.likely:.5f}; p99-low={tail.low:.5f}; p99-high={tail.high:.5f}"


def time_left_header(left: TimeLeft) -> str:
    """Return the seconds until the frame is final, with the likely range. The upper end is at
    least 0.1 while work is left.
    """
    return f"low={left.low:.1f}, likely={left.likely:.1f}, high={max(left.high, 0.1):.1f}"


def entity_tag(frame: Frame, form: str, exposure: float, params: FrameParams) -> str:
    """Return a strong ETag of a frame that is developed with an ``exposure`` and ``params``, and
    encoded in the format ``form``: it is another one whenever the bytes may differ.

    The progress of the frame's check counts only if the bytes show it, as errors and states do.
    """
    overlay = params.overlay
    # The target decides which pixels are final, as npy files and overlays show.
    target = params.max_error
    background = params.background
    controls = len(frame.controlled)
    if form == "npy" or overlay == "error":
        check = (controls, frame.improving)
    else:
        check = None
    return tag_of(frame.version, form, exposure, overlay, target, check, background)


def tag_of(*parts: object) -> str:
    """Return a strong ETag that is equal if the ``parts`` are."""
    return f'"{hashlib.blake2b(repr(parts).encode(), digest_size=16).hexdigest()}"'


def matches(if_none_match: str | None, tag: str) -> bool:
    """Return True if an If-None-Match header names the tag (weak comparison, RFC 9110, 13.1.2)."""
    if if_none_match is None:
        return False
    named = {part.strip().removeprefix("W/") for part in if_none_match.split(",")}
    return tag in named or "*" in named


def takes_gzip(accepted: str) -> bool:
    """Return True if an Accept-Encoding header allows gzip (RFC 9110, 12.5.3)."""
    weights = dict(map(media_range, accepted.split(",")))
    return weights.get("gzip", weights.get("*", 0.0)) > 0.0


def server_timing(watch: Stopwatch) -> str:
    """Return a Server-Timing header: milliseconds of each stage so far, and their total; see
    STAGES.
    """
    seconds = {**watch.seconds, "total": watch.elapsed}
    return ", ".join(f"{stage};dur={1000 * spent:.2f}" for stage, spent in seconds.items())


MEMBER = re.compile(r'(?:[^,"]|"(?:[^"\\]|\\.)*"?)+')
"""One member of a list header; commas in quoted parts are text."""

PREFER_DESCRIPTION = (
    "Preferences (RFC 7240). wait=5: wait up to 5 seconds for baking, if wait_ms is left out; "
    f"{LONGEST_WAIT // 1000} at most. respond-async: if the frame is not final by then, answer "
    "with a job that bakes it. Others are ignored."
)

Params = TypeVar("Params", bound=ViewParams)


@dataclass(frozen=True)
class Preferences:
    """The preferences of a request: to ``wait`` this many seconds, if any, and to get a job
    rather than wait longer.
    """

    wait: int | None = None
    respond_async: bool = False

    def fill(self, params: Params) -> tuple[Params, dict[str, str]]:
        """Return the parameters with the preferred wait, and the header that confirms it. A
        ``wait_ms`` in the query takes precedence.
        """
        if self.wait is None or "wait_ms" in params.model_fields_set:
            return params, {}
        filled = params.model_copy(update={"wait_ms": 1000 * self.wait})
        return filled, {"Preference-Applied": f"wait={self.wait}"}


def preferences(headers: Iterable[str]) -> Preferences:
    """Read Prefer headers. If a preference is given twice, the first counts; invalid ones are
    ignored (RFC 7240).

    A wait longer than is allowed is reduced to the longest.
    """
    # A member is a name, perhaps with a value and parameters: name=value;parameter.
    found: dict[str, str] = {}
    for member in (member for header in headers for member in MEMBER.findall(header)):
        name, _, value = member.partition(";")[0].partition("=")
        found.setdefault(name.strip().lower(), value.strip().strip('"'))
    return Preferences(seconds(found.get("wait", "")), "respond-async" in found)


def seconds(text: str) -> int | None:
    """Return the whole seconds that a text spells, at most LONGEST_WAIT; None if it spells none."""
    if not re.fullmatch(r"\d+", text, re.ASCII):
        return None
    # Avoid the conversion of absurdly long numbers.
    if len(text) < 10:
        return min(int(text), LONGEST_WAIT // 1000)
    return LONGEST_WAIT // 1000


async def preferred(
    prefer: Annotated[list[str] | None, Header(description=PREFER_DESCRIPTION)] = None,
) -> Preferences:
    """Return the preferences of a request."""
    return preferences(prefer or ())


PreferencesDep = Annotated[Preferences, Depends(preferred)]
