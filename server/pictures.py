"""Picture formats: which one a request wants, and a frame's bytes in it."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator

import numpy as np
from PIL import Image

from isogi_core.frame.film import develop
from isogi_core.frame.frame import Frame
from server.errors import NotAcceptableError, ParameterError
from server.parameters import FORMATS, FrameParams

MEDIA_TYPES = {
    "png": "image/png",
    "jpeg": "image/jpeg",
    "webp": "image/webp",
    "npy": "application/x-npy",
}
FORMAT_OF_SUFFIX = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".webp": "webp", ".npy": "npy"}
DEVELOPING_PARAMETERS = {"exposure", "overlay", "background"}
"""Parameters of developing, which the linear format does not read."""

PLANES_PER_PIXEL = 9
"""Numbers of a pixel in an npy file; see ``planes``."""

BAND = 4 << 20
"""Bytes of such a file that are made at once."""

SLICE_TYPES = ("|u1", "<u2", "<i2", "<f4")
"""Numbers that values of a slice are sent in, the narrowest first; what none of them holds is
float64.
"""

RLE = 3
"""Zlib's strategy that looks for runs alone: what a PNG filter leaves of smooth shading holds few
longer repeats.
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
    """The format: ``f`` first, else what ``accept`` likes best (png on a tie or without a header).

    NotAcceptableError where no format fits; ParameterError where the format does not read a given
    parameter.
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
    """The parameters with antialiasing settled: on in pictures, off in what is measured, where they
    do not say.
    """
    settled = params.antialias or ("off" if form == "npy" else "on")
    return params.model_copy(update={"antialias": settled})


def negotiate(accept: str | None) -> str:
    """The first of FORMATS with the highest quality in an Accept header."""
    if accept and accept.strip():
        ranges = dict(map(media_range, accept.split(",")))
    else:
        ranges = {"*/*": 1.0}
    best = max(FORMATS, key=lambda name: quality(MEDIA_TYPES[name], ranges))
    if quality(MEDIA_TYPES[best], ranges) <= 0:
        offered = ", ".join(MEDIA_TYPES.values())
        raise NotAcceptableError(
            f"No picture format fits the Accept header; there are {offered}: or name one by f=."
        )
    return best


def media_range(text: str) -> tuple[str, float]:
    """One member of an Accept header as (type, quality); quality 0 where it makes no sense."""
    kind, *parameters = (part.strip().lower() for part in text.split(";"))
    named = dict(parameter.partition("=")[::2] for parameter in parameters)
    try:
        weight = float(named.get("q", 1))
    except ValueError:
        weight = 0.0
    return kind, weight if 0 <= weight <= 1 else 0.0


def quality(media_type: str, ranges: dict[str, float]) -> float:
    """The quality that the most specific matching range gives to a media type (RFC 9110,
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
    """The frame's bytes; ``exposure`` and ``params`` are read by the 8-bit formats alone. No draft
    in jpeg is clear.
    """

    if form != "npy":
        if (form, params.background) == ("jpeg", "transparent"):
            behind = "dark"
        else:
            behind = params.background
        return compress(develop(frame, exposure, params.overlay, behind), form)
    buffer = io.BytesIO()
    buffer.writelines(npy_parts(frame))
    return buffer.getvalue()


def compress(picture: np.ndarray, form: str) -> bytes:
    """The bytes of a picture (h, w, 3), (h, w, 4), or grey (h, w), uint8 in one of the 8-bit
    formats.
    """
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, form, **ENCODER_OPTIONS[form])
    return buffer.getvalue()


def grey(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """A picture (h, w) uint8 of ``values`` (h, w): black at ``low`` and below, white at ``high``
    and above, black for NaN. Where these are one value all of it is middle grey.
    """
    if low == high:
        return np.where(np.isnan(values), np.uint8(0), np.uint8(128))
    middle = low / 2.0 + high / 2.0  # whose difference from either end is finite
    share = np.nan_to_num((values / 2.0 - middle / 2.0) / (high / 2.0 - low / 2.0) + 0.5, nan=0.0)
    return np.asarray(255.0 * np.clip(share, 0.0, 1.0) + 0.5, np.uint8)


def values_npy(values: np.ndarray, near: float) -> bytes:
    """An npy file of ``values`` (h, w), float64, in the narrowest of SLICE_TYPES that holds them.

    Whole numbers are exact in it, others are off by ``near`` at most. What is not finite is in
    floats alone.
    """
    form = next(
        (form for form in SLICE_TYPES if off(form, values) <= (near if form == "<f4" else 0.0)),
        "<f8",
    )
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(values, form), version=(1, 0))
    return buffer.getvalue()


def off(form: str, values: np.ndarray) -> float:
    """How far numbers of a ``form`` of SLICE_TYPES are from ``values``, at most."""
    finite = np.isfinite(values)
    if form != "<f4" and not finite.all():
        return math.inf
    known = values[finite]
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.abs(known.astype(form) - known).max(initial=0.0))


def npy_parts(frame: Frame) -> Iterator[bytes]:
    """The bytes of an npy file of ``planes`` in parts of some BAND bytes: the whole is never in
    memory.
    """
    height, width = frame.state.shape
    yield npy_header(height, width)
    rows = max(BAND // (4 * PLANES_PER_PIXEL * width), 1)
    for first in range(0, height, rows):
        yield planes(frame, first, min(first + rows, height)).tobytes()


def npy_bytes(frame: Frame) -> int:
    """How many these are."""
    return len(npy_header(*frame.state.shape)) + 4 * PLANES_PER_PIXEL * frame.state.size


def npy_header(height: int, width: int) -> bytes:
    """What an npy file of so many rows and columns begins with."""
    header = io.BytesIO()
    facts = {"descr": "<f4", "fortran_order": False, "shape": (height, width, PLANES_PER_PIXEL)}
    np.lib.format.write_array_header_1_0(header, facts)
    return header.getvalue()


def planes(frame: Frame, first: int, last: int) -> np.ndarray:
    """Rows ``first`` to ``last`` of a frame, float32 (rows, w, 9).

    Linear RGB, hit mask, state, relative error, hit position x, y, z. Of pixels at edges that have
    samples, the first is the mean of those on the surface, and the second the share of them.
    """
    rows = slice(first, last)
    state = frame.reported_state[rows, :, None]
    error = frame.total_error[rows, :, None]
    parts = (frame.radiance[rows], state > 0, state, error, frame.positions(first, last))
    whole = np.concatenate(parts, axis=-1, dtype="<f4", casting="unsafe")
    if frame.edges:
        width = whole.shape[1]
        edges = frame.edges
        here = slice(*np.searchsorted(edges.pixels, (first * width, last * width)))
        whole.reshape(-1, PLANES_PER_PIXEL)[edges.pixels[here] - first * width, :4] = edges.covered[
            here
        ]
    return whole
