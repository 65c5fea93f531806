"""Radiance RGBE pictures (.hdr): light probes in, high-dynamic-range frames out.

Format: Greg Ward, "Real Pixels", Graphics Gems II (1991), and the file formats manual of Radiance.
A pixel is three mantissas and one exponent: value = mantissa · 2^(exponent - 136).
"""

import re
from pathlib import Path

import numpy as np

from isogi_core.errors import LightError
from isogi_core.files.packed_files import open_regular, reason_of
from isogi_core.storage.atomic_file import write_whole

MAX_PIXELS = 2**28
"""Most pixels: more mean a damaged header."""

_HEADER_BYTES = 1 << 16
_RESOLUTION = re.compile(rb"-Y\s+(\d{1,9})\s+\+X\s+(\d{1,9})\s*")
_UNITS = np.concatenate([[0.0], np.ldexp(1.0, np.arange(1, 256) - 136)]).astype(np.float32)


def read_hdr(path: Path) -> np.ndarray:
    """Read a probe as linear RGB radiance (h, w, 3) float32, row 0 at the top. The header's
    EXPOSURE and COLORCORR are divided out.

    Pixels may be flat, or in old or new run-length coding. Raises LightError if the file is
    missing, not RGBE, not stored from the top left (``-Y h +X w``), or damaged.
    """
    try:
        with open_regular(Path(path)) as file:
            data = file.read(_HEADER_BYTES)
            # Read the rest only if the file begins as one of RGBE; if not, its beginning is enough
            # to say so.
            if data.startswith(b"#?"):
                data += file.read()
    except OSError as error:
        raise LightError(
            f"The light '{path}' cannot be read ({reason_of(error)}): check its path."
        ) from error
    return parse_hdr(data, str(path))


def parse_hdr(data: bytes, path: str, most: int = MAX_PIXELS) -> np.ndarray:
    """Return the picture in the bytes of a file called ``path``, of ``most`` pixels at most; see
    ``read_hdr``.
    """
    height, width, gain, start = _read_header(path, data, most)
    try:
        coded = data[start : start + 2] == b"\2\2" and data[start + 2] < 128 and 8 <= width < 32768
        if coded:
            pixels = _decode_lines(data, start, height, width)
        else:
            pixels = _decode_quads(data, start, height * width)
    except (ValueError, IndexError) as error:
        raise LightError(
            f"The pixels of '{path}' are damaged or cut short: copy it again."
        ) from error
    radiance = np.empty((height, width, 3), np.float32)
    with np.errstate(over="ignore"):
        for row, quads in zip(radiance, pixels.reshape(height, width, 4), strict=True):
            row[:] = quads[:, :3] * (_UNITS[quads[:, 3:]] / gain)
    return radiance


def write_hdr(path: Path, rgb: np.ndarray) -> None:
    """Write linear RGB (h, w, 3) as flat RGBE: 8 bits relative to each pixel's largest channel.
    Raises LightError if a value is negative, not finite or beyond 2^127, which RGBE cannot hold.
    """
    values = np.asarray(rgb, np.float64)
    if not (np.isfinite(values).all() and values.min() >= 0.0 and values.max() < 2.0**126.99):
        raise LightError(
            f"'{path}' was not written: RGBE holds no value below 0, above 1e38 or not finite."
        )
    height, width, _ = values.shape
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + b"-Y %d +X %d\n" % (height, width)
    write_whole(Path(path), header + encode_rgbe(values))


def encode_rgbe(values: np.ndarray) -> bytes:
    """Return RGBE quads of values (h, w, 3) float64 that the format can hold; the largest mantissa
    is 128 to 255 or 0.
    """
    fraction, exponent = np.frexp(values.max(axis=-1))
    exponent += np.rint(fraction * 256.0) == 256.0
    exponent = np.where(exponent > -128, exponent, -128)
    quads = np.zeros((*values.shape[:2], 4), np.uint8)
    lit = exponent > -128
    quads[lit, :3] = np.rint(np.ldexp(values[lit], 8 - exponent[lit, None]))
    quads[..., 3] = np.where(quads[..., :3].any(axis=-1), exponent + 128, 0)
    return quads.tobytes()


def _read_header(path: str, data: bytes, most: int) -> tuple[int, int, np.ndarray, int]:
    """Read height, width, the factor of each channel (3,) float32, and the offset of the pixels."""
    text, _, rest = data[:_HEADER_BYTES].partition(b"\n\n")
    if not text.startswith(b"#?") or not rest:
        raise LightError(f"'{path}' is not a Radiance picture: give a lat-long probe as RGBE .hdr.")
    line = rest.partition(b"\n")[0]
    match = _RESOLUTION.fullmatch(line)
    if match is None:
        name = line[:40].decode("ascii", "replace")
        raise LightError(
            f"'{path}' is stored as '{name}': save it from the top left, '-Y height +X width'."
        )
    height, width = int(match[1]), int(match[2])
    if MAX_PIXELS >= height * width > most:
        raise LightError(
            f"'{path}' has {width} × {height} pixels, and {most} are the most that may be: "
            "make it smaller."
        )
    if not 1 <= height * width <= MAX_PIXELS:
        raise LightError(
            f"'{path}' claims {width} × {height} pixels, which cannot be: copy it again."
        )
    return height, width, _gain(path, text), len(text) + 2 + len(line) + 1


def _gain(path: str, header: bytes) -> np.ndarray:
    """Return the product of all EXPOSURE and COLORCORR lines, (3,) float32. Raises LightError for
    formats other than RGBE.
    """
    gain = np.ones(3)
    for line in header.decode("latin-1").splitlines():
        key, _, value = line.partition("=")
        if key == "FORMAT" and value.strip() != "32-bit_rle_rgbe":
            raise LightError(f"'{path}' holds {value.strip()} colours: save it as 32-bit_rle_rgbe.")
        if key in ("EXPOSURE", "COLORCORR"):
            gain *= _positive_numbers(path, line, 1 if key == "EXPOSURE" else 3)
    return gain.astype(np.float32)


def _positive_numbers(path: str, line: str, count: int) -> list[float]:
    """Return ``count`` positive finite numbers after the equals sign of a header line."""
    try:
        numbers = [float(word) for word in line.partition("=")[2].split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(1e-30 < number < 1e30 for number in numbers):
        raise LightError(
            f"'{path}' has the header line '{line[:60]}', which has no meaning: mend it."
        )
    return numbers


def _decode_lines(body: bytes, at: int, height: int, width: int) -> np.ndarray:
    """Decode, from a byte on, new run-length coding, per line a mark and four components in runs;
    (h, w, 4) uint8.
    """
    mark = bytes([2, 2, width >> 8, width & 255])
    planes = np.empty((height, 4, width), np.uint8)
    for row in planes:
        if body[at : at + 4] != mark:
            raise ValueError("a line without its mark")
        line, at = _decode_runs(body, at + 4, 4 * width)
        row[:] = np.frombuffer(line, np.uint8).reshape(4, width)
    return planes.transpose(0, 2, 1)


def _decode_runs(body: bytes, at: int, size: int) -> tuple[bytearray, int]:
    """Decode ``size`` bytes from runs (count > 128: one byte repeated) and dumps; returns the next
    line's offset.
    """
    line = bytearray()
    while len(line) < size:
        count = body[at]
        if count > 128:
            line += body[at + 1 : at + 2] * (count - 128)
            at += 2
        else:
            line += body[at + 1 : at + 1 + count]
            at += 1 + count
    if len(line) != size or at > len(body):
        raise ValueError("runs that pass the end of their line")
    return line, at


def _decode_quads(body: bytes, at: int, count: int) -> np.ndarray:
    """Decode, from a byte on, flat pixels and old run-length coding; (count, 4) uint8.

    A quad (1, 1, 1, n) repeats the pixel before it n times. If several follow each other, each next
    n counts 256 times as much as the one before.
    """
    quads = np.frombuffer(body, np.uint8, (len(body) - at) // 4 * 4, at).reshape(-1, 4)
    runs = (quads[:, :3] == 1).all(axis=1)
    if len(quads) >= count and not runs.any():
        return quads[:count]
    index = np.arange(len(quads))
    pixel = np.maximum.accumulate(np.where(runs, -1, index))
    power = np.clip(index - pixel - 1, 0, 3)
    times = np.where(runs, quads[:, 3].astype(np.int64) << 8 * power, 1)
    ends = np.cumsum(times)
    used = int(np.searchsorted(ends, count)) + 1
    if used > len(quads) or ends[used - 1] != count or pixel[0] < 0:
        raise ValueError("fewer or more pixels than the resolution says")
    return np.repeat(quads[pixel[:used]], times[:used], axis=0)
