"""Movies that repeat without end, as GIF or WebP, written one picture after the other.

Pillow makes the pictures; it would write a movie of them only with all of them in memory, each in
an open file.
"""

import io
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from PIL import Image, ImageChops

LONGEST_MILLISECONDS = 60_000
"""Time for which one picture of a movie is shown, at most; GIF could hold ten minutes."""

GIF_TABLE = 0x80
"""Flag of GIF: a table of colours follows."""

GIF_LOOP = b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"
"""Extension of GIF that has players repeat the movie without end."""

GIF_CONTROL = b"\x21\xf9\x04"
"""The beginning of GIF's extension that holds time and transparency of a picture."""

WEBP_QUALITY = 85
WEBP_METHOD = 4

WEBP_PICTURE_CHUNKS = (b"ALPH", b"VP8 ", b"VP8L")
"""Chunks of a WebP file that make the picture: its opacity, and its colours with or without
losses.
"""


@dataclass(frozen=True)
class Change:
    """The part of a picture that differs from the picture before it: its pixels, the ``place``
    (x, y) of its upper left corner, and the time for which it is shown.
    """

    image: Image.Image
    place: tuple[int, int]
    milliseconds: int

    @property
    def is_clear(self) -> bool:
        """Return True if the background shows through the picture."""
        return self.image.mode == "RGBA"


def write_loop(output: Path, pictures: Sequence[Path], milliseconds: int) -> None:
    """Write ``pictures``, of one size, to a movie that shows each for so many ``milliseconds``. The
    suffix of ``output``, .gif or .webp, is the kind. Raises OSError.
    """
    with Image.open(pictures[0]) as first:
        size = first.size
    with output.open("wb") as file:
        WRITERS[output.suffix.lower()](file, size, changes_in(pictures, milliseconds))


def changes_in(pictures: Sequence[Path], milliseconds: int) -> Iterator[Change]:
    """Yield the changes from picture to picture; a picture that equals the one before it makes
    that one last longer.
    """
    former: Image.Image | None = None
    waiting: Change | None = None
    for path in pictures:
        with Image.open(path) as opened:
            picture = opened.convert("RGBA" if opened.has_transparency_data else "RGB")
        box = box_of_change(former, picture)
        former = picture
        if waiting is not None:
            lasting = waiting.milliseconds + milliseconds
            if box is None and lasting <= LONGEST_MILLISECONDS:
                waiting = replace(waiting, milliseconds=lasting)
                continue
            yield waiting
        # A picture that stays for long is shown again by one of its pixels.
        left, top, right, bottom = box or (0, 0, 1, 1)
        # WebP places parts at even columns and rows.
        left -= left % 2
        top -= top % 2
        waiting = Change(picture.crop((left, top, right, bottom)), (left, top), milliseconds)
    if waiting is not None:
        yield waiting


def box_of_change(
    former: Image.Image | None, picture: Image.Image
) -> tuple[int, int, int, int] | None:
    """Return the box (left, top, right, bottom) in which a ``picture`` differs from the
    ``former`` one; None if nowhere. Clear pictures always change as a whole, as the former one
    would show through.
    """
    if former is None or former.mode != picture.mode or picture.mode == "RGBA":
        return (0, 0, *picture.size)
    return ImageChops.difference(former, picture).getbbox()


def write_gif(file: BinaryIO, size: tuple[int, int], changes: Iterator[Change]) -> None:
    """Write ``changes`` as an animated GIF (GIF89a), each with a table of 256 colours."""
    file.write(b"GIF89a" + struct.pack("<HHBBB", *size, 0x70, 0, 0) + GIF_LOOP)
    for change in changes:
        still = io.BytesIO()
        change.image.save(still, "gif", optimize=False, interlace=False)
        colours, clear, pixels = parts_of_gif(still.getvalue())
        # Clear pictures are wiped before the next one, others stay below it.
        flags = (2 if change.is_clear else 1) << 2 | (clear is not None)
        hundredths = round(change.milliseconds / 10)
        file.write(GIF_CONTROL + struct.pack("<BHBB", flags, hundredths, clear or 0, 0))
        table = GIF_TABLE | (len(colours) // 3).bit_length() - 2
        file.write(struct.pack("<BHHHHB", 0x2C, *change.place, *change.image.size, table))
        file.write(colours + pixels)
    file.write(b"\x3b")


def parts_of_gif(still: bytes) -> tuple[bytes, int | None, bytes]:
    """Return the table of colours of a GIF of one picture, the colour that is clear, if one is,
    and its compressed pixels.
    """
    # The header is 13 bytes long, and its flags tell the size of the table behind it.
    colours = still[13 : 13 + (6 << (still[10] & 7))]
    at = 13 + len(colours)
    clear = None
    # Pass over extensions, each of a label and of blocks up to an empty one.
    while still[at] == 0x21:
        if still[at : at + 3] == GIF_CONTROL and still[at + 3] & 1:
            clear = still[at + 6]
        at += 2
        while still[at]:
            at += 1 + still[at]
        at += 1
    # The picture's descriptor is 10 bytes long; the file ends with one byte more.
    return colours, clear, still[at + 10 : -1]


def write_webp(file: BinaryIO, size: tuple[int, int], changes: Iterator[Change]) -> None:
    """Write ``changes`` as an animated WebP: see Google, WebP container specification."""
    file.write(bytes(12))
    # The canvas, with the flags of movies and of opacity, and an endless loop over a clear ground.
    file.write(chunk(b"VP8X", b"\x12\0\0\0" + three_bytes(size[0] - 1) + three_bytes(size[1] - 1)))
    file.write(chunk(b"ANIM", struct.pack("<IH", 0, 0)))
    for change in changes:
        still = io.BytesIO()
        change.image.save(still, "webp", quality=WEBP_QUALITY, method=WEBP_METHOD)
        left, top = change.place
        width, height = change.image.size
        numbers = (left // 2, top // 2, width - 1, height - 1, change.milliseconds)
        # The flag has a part replace what is below it, and not blend with it.
        head = b"".join(map(three_bytes, numbers)) + b"\x02"
        file.write(chunk(b"ANMF", head + picture_in(still.getvalue())))
    # Only now is the length of the file known.
    length = file.tell()
    file.seek(0)
    file.write(b"RIFF" + struct.pack("<I", length - 8) + b"WEBP")


def picture_in(still: bytes) -> bytes:
    """Return the chunks of a WebP file of one picture that make the picture."""
    found = b""
    at = 12
    while at < len(still):
        (length,) = struct.unpack_from("<I", still, at + 4)
        end = at + 8 + length + length % 2
        if still[at : at + 4] in WEBP_PICTURE_CHUNKS:
            found += still[at:end]
        at = end
    return found


def chunk(name: bytes, content: bytes) -> bytes:
    """Return a chunk of RIFF, padded to an even length."""
    return name + struct.pack("<I", len(content)) + content + bytes(len(content) % 2)


def three_bytes(number: int) -> bytes:
    """Return a ``number`` as three bytes, the lowest first."""
    return number.to_bytes(3, "little")


WRITERS: dict[str, Callable[[BinaryIO, tuple[int, int], Iterator[Change]], None]] = {
    ".gif": write_gif,
    ".webp": write_webp,
}
"""Functions that write the changes from picture to picture, by the suffix of the movie."""
