"""Picture formats: negotiation of the format, and encoding of frames."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator

import numpy as np
from PIL import Image

from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from isogi_server.errors import NotAcceptableError, ParameterError
from isogi_server.parameters import FORMATS, FrameParams

MEDIA_TYPES = {
    "png": "image/png",
    "jpeg": "image/jpeg",
    "webp": "image/webp",
    "npy": "application/x-npy",
}
FORMAT_OF_SUFFIX = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp", ".npy": "npy"}
DEVELOPING_PARAMETERS = {"exposure", "overlay", "background"}
"""Parameters of developing, which the linear format npy does not read."""

PLANES_PER_PIXEL = 9
"""Numbers of a pixel in an npy file; see ``planes``."""

BAND = 4 << 20
"""Bytes of an npy file that are made at a time."""

SLICE_TYPES = ("|u1", "<u2", "<i2", "<f4")
"""Types in which values of a slice are sent, the narrowest first; values that fit none are sent
as float64.
"""

RLE = 3
"""Zlib's strategy that only searches for runs: filtered rows of smooth shading hold few longer
repeats.
"""

# Fastest that costs no size to speak of. 512 × 512 of the engine under grace, one core,
# milliseconds and KiB: png runs alone 7.3, 190 (any level; level 1 with repeats 8.7, 185; level 6
# 17, 186; stored 4.3, 769), jpeg at 85 0.9, 42 and 38.1 dB (without full chroma 0.6, 35 and 37.5
# dB; at 95 1.0, 74), webp method 0 4.7, 44 (2: 7.2, 27).
ENCODER_OPTIONS: dict[str, dict[str, int]] = {
    "png": {"compress_level": 1, "compress_type": RLE},
    "jpeg": {"quality": 85, "subsampling": 0},
    "webp": {"quality": 85, "method": 0},
}


def format_for(params: FrameParams, accept: str | None) -> str:
    """Return the format: ``f`` first, else the one that the ``accept`` header prefers (png on a tie
    or without a header).

    Raises NotAcceptableError if no format fits, and ParameterError if the format does not read a
    given parameter.
    """
    chosen = params.f or negotiate(accept)
    unread = sorted(params.model_fields_set & DEVELOPING_PARAMETERS)
    if chosen == "npy" and unread:
        names = " and ".join(unread)
        raise ParameterError(
            f"npy holds linear radiance and does not read {names}: leave that out.", unread[0]
        )
    if chosen == "jpeg" and params.background == "transparent":
        raise ParameterError(
            "jpeg knows no transparent background: take png or webp, or another one.", "background"
        )
    return chosen


def smoothed(params: FrameParams, form: str) -> FrameParams:
    """Settle antialiasing if the parameters do not: on in pictures, off in npy, which is used
    for measurements.
    """
    settled = params.antialias or ("off" if form == "npy" else "on")
    return params.model_copy(update={"antialias": settled})


def negotiate(accept: str | None) -> str:
    """Return the first of FORMATS with the highest quality in an Accept header. Raises
    NotAcceptableError.
    """
    if accept and accept.strip():
        ranges = dict(map(media_range, accept.split(",")))
    else:
        ranges = {"*/*": 1.0}
    # ``max`` returns the first of equal ones: png wins a tie.
    best = max(FORMATS, key=lambda name: quality(MEDIA_TYPES[name], ranges))
    if quality(MEDIA_TYPES[best], ranges) <= 0:
        offered = ", ".join(MEDIA_TYPES.values())
        raise NotAcceptableError(
            f"No picture format fits the Accept header; there are {offered}: or name one by f=."
        )
    return best


def media_range(text: str) -> tuple[str, float]:
    """Return one member of an Accept header as (type, quality); quality 0 if it is malformed."""
    kind, *parameters = (part.strip().lower() for part in text.split(";"))
    named = dict(parameter.partition("=")[::2] for parameter in parameters)
    try:
        weight = float(named.get("q", 1))
    except ValueError:
        weight = 0.0
    return kind, weight if 0 <= weight <= 1 else 0.0


def quality(media_type: str, ranges: dict[str, float]) -> float:
    """Return the quality that the most specific matching range gives to a media type (RFC 9110,
    12.5.1).
    """
    for pattern in (media_type, media_type.split("/", maxsplit=1)[0] + "/*", "*/*"):
        if pattern in ranges:
            return ranges[pattern]
    return 0.0


DEFAULT_PARAMETERS = FrameParams.model_validate({})


def encode(
    frame: Frame, form: str, exposure: float, params: FrameParams = DEFAULT_PARAMETERS
) -> bytes:
    """Return the bytes of a frame. Only the 8-bit formats read ``exposure`` and ``params``. In
    jpeg, a transparent background becomes dark.
    """

    if form != "npy":
        # A stream sends drafts as jpeg, whatever the background: jpeg has no transparency.
        if (form, params.background) == ("jpeg", "transparent"):
            behind = "dark"
        else:
            behind = params.background
        return compress(develop(frame, exposure, params.overlay, behind), form)
    buffer = io.BytesIO()
    buffer.writelines(npy_parts(frame))
    return buffer.getvalue()


def compress(picture: np.ndarray, form: str) -> bytes:
    """Return the bytes of a picture, uint8 (h, w, 3), (h, w, 4) or grey (h, w), in one of the
    8-bit formats.
    """
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, form, **ENCODER_OPTIONS[form])
    return buffer.getvalue()


def grey(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return a grey picture, uint8 (h, w), of ``values`` (h, w): black up to ``low``, white
    from ``high`` on, black for NaN; middle grey if low equals high.
    """
    if low == high:
        return np.where(np.isnan(values), np.uint8(0), np.uint8(128))
    # Halve all values first: the difference of two large ones may be infinite.
    middle = low / 2.0 + high / 2.0
    share = np.nan_to_num((values / 2.0 - middle / 2.0) / (high / 2.0 - low / 2.0) + 0.5, nan=0.0)
    return np.asarray(255.0 * np.clip(share, 0.0, 1.0) + 0.5, np.uint8)


def values_npy(values: np.ndarray, near: float) -> bytes:
    """Return an npy file of ``values``, float64 (h, w), in the narrowest of SLICE_TYPES that holds
    them.

    Integers are exact, other values differ by at most ``near``. NaN and infinity need a
    floating-point type.
    """
    # Only float32 may round values; integer types must hold them exactly.
    form = next(
        (form for form in SLICE_TYPES if off(form, values) <= (near if form == "<f4" else 0.0)),
        "<f8",
    )
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(values, form), version=(1, 0))
    return buffer.getvalue()


def off(form: str, values: np.ndarray) -> float:
    """Return the largest difference between ``values`` and their conversion to a ``form`` of
    SLICE_TYPES.
    """
    finite = np.isfinite(values)
    if form != "<f4" and not finite.all():
        return math.inf
    known = values[finite]
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.abs(known.astype(form) - known).max(initial=0.0))


def npy_parts(frame: Frame) -> Iterator[bytes]:
    """Yield the bytes of an npy file of ``planes`` in parts of about BAND bytes: the whole is
    never in memory.
    """
    height, width = frame.state.shape
    yield npy_header(height, width)
    # Round BAND to whole rows of the picture.
    rows = max(BAND // (4 * PLANES_PER_PIXEL * width), 1)
    for first in range(0, height, rows):
        yield planes(frame, first, min(first + rows, height)).tobytes()


def npy_bytes(frame: Frame) -> int:
    """Return the number of bytes that ``npy_parts`` yields."""
    return len(npy_header(*frame.state.shape)) + 4 * PLANES_PER_PIXEL * frame.state.size


def npy_header(height: int, width: int) -> bytes:
    """Return the header of an npy file of this many rows and columns."""
    header = io.BytesIO()
    facts = {"descr": "<f4", "fortran_order": False, "shape": (height, width, PLANES_PER_PIXEL)}
    np.lib.format.write_array_header_1_0(header, facts)
    return header.getvalue()


def planes(frame: Frame, first: int, last: int) -> np.ndarray:
    """Return rows ``first`` to ``last`` of a frame, float32 (rows, w, 9): linear RGB, hit mask,
    state, relative error, hit position x, y, z.

    In pixels at edges that have several samples, RGB is the mean of the samples on the surface, and
    the mask their share.
    """
    rows = slice(first, last)
    state = frame.reported_state[rows, :, None]
    error = frame.total_error[rows, :, None]
    parts = (frame.radiance[rows], state > 0, state, error, frame.positions(first, last))
    whole = np.concatenate(parts, axis=-1, dtype="<f4", casting="unsafe")
    if frame.edges:
        width = whole.shape[1]
        edges = frame.edges
        # Edge pixels are in ascending order: find those in these rows.
        here = slice(*np.searchsorted(edges.pixels, (first * width, last * width)))
        whole.reshape(-1, PLANES_PER_PIXEL)[edges.pixels[here] - first * width, :4] = edges.covered[
            here
        ]
    return whole
