"""Response headers: what a frame says about itself."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from isogi_core.frame.frame import Frame
    from isogi_core.frame.stopwatch import Stopwatch
    from worker.outlook import TimeLeft

FOR_EVER = "max-age=31536000, immutable"
"""Caching of a picture that is final, at an address that names its version: it can be no other."""

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


def frame_headers(frame: Frame, time_left: TimeLeft | None, tag: str, version: str | None = None) -> dict[str, str]:
    """The headers of a frame's response, a 304 included; ``version`` is what the address asks for, if anything.

    What a client prefers changes the answer until the frame is final, and never the final one.
    """
    left = {"Isogi-Time-Left": time_left_header(time_left)} if time_left is not None and frame.provisional else {}
    sharp = {} if frame.sharpness is None else {"Isogi-Sharp": sharp_header(frame.sharpness.shares)}
    return (
        left
        | sharp
        | {
            "Isogi-Provisional": "?1" if frame.provisional else "?0",
            "Isogi-Coverage": coverage_header(frame.coverage),
            "Isogi-Error": f"{frame.estimated_error:.5f}",
            "Isogi-Chunks": f"needed={frame.chunks_needed}, final={frame.chunks_final}",
            "ETag": tag,
            "Cache-Control": FOR_EVER if not frame.provisional and version == tag.strip('"') else "no-cache",
            "Cache-Status": cache_status(frame.chunks_needed, frame.chunks_final),
            "Vary": "Accept, Prefer" if frame.provisional else "Accept",
        }
    )


def cache_status(needed: int, final: int) -> str:
    """What the store had of a frame's light (RFC 9211): all of it, part of it, or nothing; the rest is baked."""
    if needed == final:
        return "isogi-light; hit"
    return f"isogi-light; fwd={'partial' if final else 'miss'}"


def coverage_header(shares: Mapping[str, float]) -> str:
    """Shares to three digits; what is final is rounded down and the rest up, so that 1.000 means all."""
    final, *others = (1000 * shares[state] for state in STATES)
    thousandths = (math.floor(final), *map(math.ceil, others))
    return ", ".join(f"{state}={n / 1000:.3f}" for state, n in zip(STATES, thousandths, strict=True))


def sharp_header(shares: Mapping[str, float]) -> str:
    """Shares of the texels, to three digits, by how they are read; see ``Sharpness.shares``."""
    return ", ".join(f"{name}={share:.3f}" for name, share in shares.items())


def time_left_header(left: TimeLeft) -> str:
    """Seconds until the frame is final, and the range that they are likely in."""
    return f"low={left.low:.1f}, likely={left.likely:.1f}, high={left.high:.1f}"


def entity_tag(frame: Frame, *representation: object) -> str:
    """A strong ETag: equal where the frame's content and its representation (format, exposure, …) are."""
    return tag_of(frame.version, *representation)


def tag_of(*parts: object) -> str:
    """A strong ETag: equal where the parts are."""
    return f'"{hashlib.blake2b(repr(parts).encode(), digest_size=16).hexdigest()}"'


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
