"""Binary answers: compressed where the client takes that, and not sent again where it has them."""

from __future__ import annotations

import gzip
import hashlib
from typing import Any

from fastapi import Request, Response

from server.api.headers import FOR_EVER, matches, tag_of

MEDIA_TYPE = "application/octet-stream"
BINARY: dict[int | str, dict[str, Any]] = {
    200: {"description": "The bytes, little-endian; docs/card.md has their layout.", "content": {MEDIA_TYPE: {}}},
    304: {"description": "The bytes are those that If-None-Match names."},
}

LEVEL = 1
"""Compression: of voxels and light higher levels save a tenth of the bytes, and take four times as long."""


def binary_answer(request: Request, body: bytes, lasting: bool) -> Response:
    """The answer with a ``body``: at the address of the request it is the same for ever where it is ``lasting``."""
    packs = takes_gzip(request.headers.get("accept-encoding", ""))
    tag = tag_of(hashlib.blake2b(body).digest(), packs)
    headers = {"ETag": tag, "Cache-Control": FOR_EVER if lasting else "no-cache", "Vary": "Accept-Encoding"}
    if matches(request.headers.get("if-none-match"), tag):
        return Response(status_code=304, headers=headers)
    if not packs:
        return Response(body, 200, headers, MEDIA_TYPE)
    return Response(gzip.compress(body, LEVEL, mtime=0), 200, headers | {"Content-Encoding": "gzip"}, MEDIA_TYPE)


def takes_gzip(accepted: str) -> bool:
    """Whether an Accept-Encoding header allows gzip (RFC 9110, 12.5.3)."""
    for part in accepted.lower().split(","):
        name, _, weight = part.partition(";")
        if name.strip() in ("gzip", "x-gzip", "*"):
            return weight.replace(" ", "") not in ("q=0", "q=0.0", "q=0.00", "q=0.000")
    return False
