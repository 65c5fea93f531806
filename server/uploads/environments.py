"""Uploaded environments: light probes, and the one form in which they are kept."""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from urllib.parse import quote, unquote

import numpy as np

from isogi_core.errors import LightError
from isogi_core.files.radiance import encode_rgbe, parse_hdr
from isogi_core.model.environment import resample

VOLUME_KIND, ENVIRONMENT_KIND = "volume", "environment"
"""Kinds of files that may be uploaded."""

MAX_PROBE_SHAPE = (512, 1024)
"""Rows and columns that are kept of a probe: what is finer is averaged by solid angle, without change of energy."""

ROWS_PER_BLOCK = 256
"""Rows of a finer one that are averaged at once."""

MOST_PIXELS = 1 << 25
"""Pixels that a probe may have: 8192 × 4096."""

PROBE_HEADER = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nNAME={name}\n\n-Y {height} +X {width}\n"
PROBE_HEADER_PATTERN = re.compile(
    rb"#\?RADIANCE\nFORMAT=32-bit_rle_rgbe\nNAME=([!-~]*)\n\n-Y (\d+) \+X (\d+)\n", re.ASCII
)
MAX_HEADER_BYTES = 4096
"""Bytes that no header is longer than."""

PIXEL_BYTES = 64
"""Bytes of a pixel in the server's memory: its radiance, and tables to sample it by."""


@dataclass(frozen=True)
class UploadedEnvironment:
    """A probe in its canonical file: its ``id``, its ``name`` for a person, columns and rows, and bytes."""

    id: str
    name: str
    size: tuple[int, int]
    bytes: int

    @property
    def held(self) -> int:
        """Bytes that the quota counts."""
        width, height = self.size
        return self.bytes + PIXEL_BYTES * width * height


def write_environment(file: IO[bytes], data: bytes, name: str) -> str:
    """Write a Radiance picture, as it came, as a canonical file; gives its id, a digest of all but the name.

    Raises LightError where it is no lat-long picture of light: not twice as wide as high, black, or damaged.
    """
    image = parse_hdr(data, name or "the file", MOST_PIXELS)
    height, width, _ = image.shape
    if width != 2 * height:
        raise LightError(f"The picture has {width} × {height} pixels: a probe is twice as wide as high, all around.")
    if not image.any():
        raise LightError("The picture is black: give one with light in it.")
    if height > MAX_PROBE_SHAPE[0]:
        image = made_small(image)
    pixels = encode_rgbe(np.asarray(image, np.float64))
    height, width, _ = image.shape
    number = hashlib.blake2b(f"probe {width} {height}".encode() + pixels, digest_size=16).hexdigest()
    named = quote(name or f"light {number[:6]}", safe="")
    file.write(PROBE_HEADER.format(name=named, height=height, width=width).encode() + pixels)
    return number


def made_small(image: np.ndarray) -> np.ndarray:
    """The image in MAX_PROBE_SHAPE pixels: made narrow some rows at a time, so few 64-bit numbers are in memory."""
    height, width = MAX_PROBE_SHAPE
    blocks = (image[row : row + ROWS_PER_BLOCK] for row in range(0, len(image), ROWS_PER_BLOCK))
    narrow = np.concatenate([resample(block, len(block), width) for block in blocks])
    return resample(narrow, height, width).astype(np.float32)


def read_environment(path: Path) -> UploadedEnvironment | None:
    """What a file whose name is its id says of itself; None where it is not as ``write_environment`` left it."""
    with path.open("rb") as file:
        head = PROBE_HEADER_PATTERN.match(file.read(MAX_HEADER_BYTES))
    if head is None:
        return None
    name, height, width = (part.decode() for part in head.groups())
    kept = UploadedEnvironment(path.stem, unquote(name), (int(width), int(height)), path.stat().st_size)
    return kept if kept.bytes == head.end() + 4 * int(width) * int(height) else None
