"""What is in a published page."""

import gzip
import json
import re
import struct
from base64 import b64decode
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ELEMENT = re.compile(r'<script type="text/plain" data-file="([^"]+)">([^<]*)</script>')


def files_in(page: Path) -> dict[str, bytes]:
    """The files that are in a page, unpacked, by their names."""
    found = ELEMENT.findall(page.read_text(encoding="utf-8"))
    return {name: gzip.decompress(b64decode(letters)) for name, letters in found}


def document_in(page: Path) -> dict[str, Any]:
    """What a page draws by."""
    document: dict[str, Any] = json.loads(files_in(page)["scene.json"])
    return document


class PageChunk(NamedTuple):
    """A chunk of a file of light: its place, the bits of each brick by its place, and the
    numbers and the normal word of each record.
    """

    at: tuple[int, int, int]
    masks: dict[tuple[int, int, int], int]
    numbers: np.ndarray
    words: np.ndarray


def light_in(data: bytes, steps: np.ndarray) -> list[PageChunk]:
    """The chunks of a file of light, read as docs/card.md says."""
    mark, *counts = struct.unpack_from("<4s3I", data)
    assert mark == b"ISOL"
    tables, begin = [], 16
    for count, width in zip(counts, (8, 12, 4 + 2 * len(steps)), strict=True):
        planes = np.frombuffer(data, np.uint8, count * width, begin).reshape(width, count)
        tables.append([row.tobytes() for row in planes.T])
        begin += planes.size
    assert begin == len(data)
    chunks, bricks, records = map(iter, tables)
    found = []
    for z, y, x, count in (struct.unpack("<4H", chunk) for chunk in chunks):
        masks = {}
        for _ in range(count):
            mask, bx, by, bz, none = struct.unpack("<QBBBB", next(bricks))
            assert none == 0
            masks[bz, by, bx] = mask
        rows = [next(records) for _ in range(sum(each.bit_count() + 1 for each in masks.values()))]
        words = np.array([struct.unpack_from("<I", row)[0] for row in rows], np.uint32)
        codes = np.array([np.frombuffer(row, "<u2", offset=4) for row in rows]).astype(np.int64)
        numbers = np.where(codes & 1, -(codes + 1) // 2, codes // 2) * steps
        found.append(PageChunk((z, y, x), masks, numbers, words))
    assert next(bricks, None) is None and next(records, None) is None
    return found


def voxels_in(data: bytes, kind: str, shape: tuple[int, int, int]) -> np.ndarray:
    """The codes of some layers of a volume, (layers, ny, nx) of a NumPy type, read voxel by voxel
    as docs/card.md says.
    """
    size = np.dtype(kind).itemsize
    low, high = np.frombuffer(data, kind, 2)
    depth, ny, nx = shape
    marks = np.frombuffer(data, np.uint8, -(-depth // 8) * ny * nx, 2 * size).reshape(-1, ny, nx)
    planes = np.frombuffer(data, np.uint8, offset=2 * size + marks.size).reshape(size, -1)
    steps = iter(np.ascontiguousarray(planes.T).view(f"<u{size}")[:, 0].tolist())
    values = np.zeros(shape, kind)
    bits = values.view(f"<u{size}")
    stated = np.zeros((ny, nx), bool)

    def bits_at(z: int, y: int, x: int) -> int:
        return int(bits[z, y, x]) if min(x, y, z) >= 0 else 0

    for z, y, x in np.ndindex(shape):
        stated[y, x] ^= bool(marks[z // 8, y, x] >> z % 8 & 1)
        if stated[y, x]:
            a, b, c = bits_at(z, y, x - 1), bits_at(z, y - 1, x), bits_at(z - 1, y, x)
            ab, ac = bits_at(z, y - 1, x - 1), bits_at(z - 1, y, x - 1)
            bc, abc = bits_at(z - 1, y - 1, x), bits_at(z - 1, y - 1, x - 1)
            guesses = (a, b, c, a + b - ab, a + c - ac, b + c - bc, a + b + c - ab - ac - bc + abc)
            step = next(steps)
            signed = -(step + 1) // 2 if step & 1 else step // 2
            bits[z, y, x] = (sorted(guesses)[3] + signed) % (1 << 8 * size)
        else:
            before = [(z, y, x - 1), (z, y - 1, x), (z - 1, y, x)]
            known = next((values[at] for at in before if min(at) >= 0), 0)
            values[z, y, x] = low if known <= low else high
    assert next(steps, None) is None
    return values
