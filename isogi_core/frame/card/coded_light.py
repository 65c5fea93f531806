"""Light of published pages: texels and means of bricks, with transfer in few bits; docs/card.md
has the layout of its files.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from isogi_core.frame.card.block_format import CODES, FLAT, find_records
from isogi_core.frame.card.chunk_texels import ChunkTexels
from isogi_core.frame.card.coding import byte_planes, fold_signs

LIGHT_MARK = b"ISOL"
"""First bytes of a file."""

HEADER = np.dtype([("mark", "S4"), ("counts", "<u4", 3)])
CHUNK = np.dtype([("at", "<u2", 3), ("bricks", "<u2")])
BRICK = np.dtype([("mask", "<u8"), ("place", "<u4")])

NORMAL_STEPS = 64
"""Step of normals in few bits: a tenth of a degree."""


class CodedLight(NamedTuple):
    """Light of some chunks in few bits.

    - ``chunks`` (chunks,): place and number of bricks of each, as CHUNK.
    - ``bricks`` (bricks,): texels and place of each, as BRICK, chunk by chunk.
    - ``records`` (records,): normal word and codes of each texel, and of the mean of each brick
      behind its texels.
    """

    chunks: np.ndarray
    bricks: np.ndarray
    records: np.ndarray


def code_light(chunks: ChunkTexels, normals: np.ndarray, codes: np.ndarray) -> CodedLight:
    """Return the light of ``chunks`` from the ``normals`` (m, 3) and the ``codes`` (m, n) of their
    texels. Chunks without texels are left out.
    """
    found = find_records(chunks, normals, codes)
    order = found.order
    table = np.zeros(len(chunks.texels.chunks), CHUNK)
    table["at"] = np.array(chunks.texels.chunks).reshape(-1, 3)
    table["bricks"] = np.bincount(order.owners, minlength=len(table))
    bricks = np.zeros(len(order.places), BRICK)
    bricks["mask"] = order.masks
    bricks["place"] = order.places
    records = np.zeros(len(found.words), record_type(codes.shape[1]))
    records["word"] = coarse_words(found.words)
    records["codes"] = fold_signs(np.rint(found.numbers).astype(np.int16))
    return CodedLight(table, bricks, records)


def record_type(numbers: int) -> np.dtype:
    """Return the type of a record with a normal word and codes of some ``numbers``."""
    return np.dtype([("word", "<u4"), ("codes", "<u2", (numbers,))])


NO_LIGHT = CodedLight(np.empty(0, CHUNK), np.empty(0, BRICK), np.empty(0, record_type(0)))
"""The light of no chunk."""


def coarse_words(words: np.ndarray) -> np.ndarray:
    """Round both parts of normals' ``words`` (m,) to multiples of NORMAL_STEPS; words without a
    normal stay.
    """
    most = 0x7FFF // NORMAL_STEPS
    parts = np.ascontiguousarray(words, "<u4").view("<i2").reshape(-1, 2)
    steps = np.clip(np.rint(parts / NORMAL_STEPS), -most, most)
    rounded = (NORMAL_STEPS * steps).astype("<i2").view("<u4")[:, 0]
    return np.where(np.isin(words, (*CODES.values(), FLAT)), words, rounded)


def means_of(light: CodedLight) -> CodedLight:
    """Return the same bricks without their texels: the mean alone stands for all of them."""
    bricks = light.bricks.copy()
    bricks["mask"] = 0
    # The mean of a brick is its last record.
    ends = np.cumsum(np.bitwise_count(light.bricks["mask"]).astype(np.int64) + 1)
    return CodedLight(light.chunks, bricks, light.records[ends - 1])


def join_light(parts: Sequence[CodedLight]) -> CodedLight:
    """Return the light of several ``parts`` as one; NO_LIGHT if there are none."""
    if not parts:
        return NO_LIGHT
    return CodedLight(*map(np.concatenate, zip(*parts, strict=True)))


def light_file(light: CodedLight) -> bytes:
    """Return the bytes of a file of ``light``: a header with the number of chunks, bricks and
    records, and these three tables, byte by byte.
    """
    header = np.zeros(1, HEADER)
    header["mark"] = LIGHT_MARK
    header["counts"] = [len(table) for table in light]
    return header.tobytes() + b"".join(map(byte_planes, light))
