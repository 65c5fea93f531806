"""Binary answers: compressed where the client takes that, and not sent again where it has them."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Sequence
from typing import Any

from fastapi import Request, Response

from isogi_core.frame.known_blocks import Part
from server.api.headers import FOR_EVER, matches, tag_of

MEDIA_TYPE = "application/octet-stream"
BINARY: dict[int | str, dict[str, Any]] = {
    200: {"description": "The bytes, little-endian; docs/card.md has their layout.", "content": {MEDIA_TYPE: {}}},
    304: {"description": "The bytes are those that If-None-Match names."},
}

GZIP = b"\x1f\x8b\x08" + bytes(5) + b"\x04\xff"
"""What data in gzip begin with (RFC 1952): compressed fast, at no time, by nobody in particular."""

END = b"\x03\x00"
"""An empty last block of DEFLATE."""


def binary_answer(request: Request, parts: Sequence[Part], lasting: bool) -> Response:
    """The answer of some ``parts``: at the address of the request it is the same for ever where it is ``lasting``."""
    packs = takes_gzip(request.headers.get("accept-encoding", ""))
    tag = tag_of(hashlib.blake2b(b"".join(each.digest for each in parts)).digest(), packs)
    headers = {"ETag": tag, "Cache-Control": FOR_EVER if lasting else "no-cache", "Vary": "Accept-Encoding"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    if not packs:
        return Response(b"".join(each.data for each in parts), 200, headers, MEDIA_TYPE)
    return Response(gzipped(parts), 200, headers | {"Content-Encoding": "gzip"}, MEDIA_TYPE)


def gzipped(parts: Sequence[Part]) -> bytes:
    """The ``parts`` as one member of gzip; each is compressed once, for all answers that it is in."""
    check, size = 0, sum(len(each.data) for each in parts)
    for each in parts:
        check = zlib.crc32(each.data, check)
    ends = (number.to_bytes(4, "little") for number in (check, size & 0xFFFFFFFF))
    return b"".join((GZIP, *(each.deflated for each in parts), END, *ends))


def takes_gzip(accepted: str) -> bool:
    """Whether an Accept-Encoding header allows gzip (RFC 9110, 12.5.3)."""
    for part in accepted.lower().split(","):
        name, _, weight = part.partition(";")
        if name.strip() in ("gzip", "x-gzip", "*"):
            return weight.replace(" ", "") not in ("q=0", "q=0.0", "q=0.00", "q=0.000")
    return False
