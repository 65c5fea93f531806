"""The layout of blocks: the light of one chunk as bytes for textures of a visitor's graphics
card; docs/card.md describes it.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from isogi_core.frame.card.chunk_texels import ChunkTexels
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.kernels.shading.lattice import BURIED_GRADE, PARTIAL_GRADE, VOID_GRADE

BLOCK_MARK = b"ISOB"
"""First bytes of a block."""


HEADER = np.dtype(
    [
        ("mark", "S4"),
        ("bytes", "<u4"),
        ("at", "<u2", 3),
        ("kind", "<u2"),
        ("counts", "<u4", 2),
        ("version", "V8"),
    ]
)
BRICK = np.dtype([("mask", "<u8"), ("first", "<u4"), ("place", "<u4")])


FOLDED = 0
RAW = 1
"""Kinds of blocks: records of light, and transfer, which a page puts under light by itself."""


EDGE = 2
"""Number of texels along each side of a brick, as a power of two."""


CODES = {BURIED_GRADE: 0x80008001, VOID_GRADE: 0x80008002}
"""Words of texels without light in place of a normal, by their grade; no part of a normal is
-32768.
"""


FLAT = 0x80008003
"""Word of a texel with light whose normal is (0, 0, 0)."""


MAX_HALF_FLOAT = float(np.finfo(np.float16).max)


class Order(NamedTuple):
    """The order of records in blocks.

    - ``owners``, ``places`` (bricks,): chunk of each brick, and its place there.
    - ``masks`` (bricks,): a bit for each texel that is there.
    - ``begins`` (bricks,): position of its first texel in the order.
    - ``texels`` (texels,): numbers of the texels, brick by brick.
    """

    owners: np.ndarray
    places: np.ndarray
    masks: np.ndarray
    begins: np.ndarray
    texels: np.ndarray


def order_texels(texels: ViewTexels) -> Order:
    """Sort texels by chunk, then by brick, then by their bit in it."""
    bits = texels.lattice.bits
    z, y, x = (texels.places >> bits * axis & texels.lattice.chunk - 1 for axis in (2, 1, 0))
    bricks = (z >> EDGE) << 16 | (y >> EDGE) << 8 | x >> EDGE
    bit = (z & 3) << 4 | (y & 3) << 2 | x & 3
    # One key of chunk, brick and bit sorts all at once.
    keys = ((texels.places >> 3 * bits).astype(np.int64) << 24 | bricks) << 6 | bit
    order = np.argsort(keys)
    # Texels of one brick have equal keys but for the bit.
    distinct, begins = np.unique(keys[order] >> 6, return_index=True)
    masks = np.bitwise_or.reduceat(np.uint64(1) << bit[order].astype(np.uint64), begins)
    return Order(distinct >> 24, distinct & 0xFFFFFF, masks, begins, order)


def words_of(normals: np.ndarray, grade: np.ndarray) -> np.ndarray:
    """Encode the normals (m, 3) of texels as words, and texels without light by their ``grade``
    (m,); (m,) uint32.

    A normal is projected onto an octahedron, whose lower half is folded over the upper one (Meyer
    and others, "On Floating-Point Normal Vectors", 2010); x is in the lower 16 bits, y in the upper
    ones.
    """
    # Project the normal onto the octahedron |x| + |y| + |z| = 1, and fold the lower half.
    size = np.abs(normals).sum(axis=1)
    x, y, z = (normals / np.maximum(size, 1e-30)[:, None]).T
    u = np.where(z < 0.0, (1.0 - np.abs(y)) * np.where(x >= 0.0, 1.0, -1.0), x)
    v = np.where(z < 0.0, (1.0 - np.abs(x)) * np.where(y >= 0.0, 1.0, -1.0), y)
    # Quantise both coordinates to 16 bits each.
    low, high = (
        np.rint(32767.0 * each).astype(np.int16).view(np.uint16).astype(np.uint32)
        for each in (u, v)
    )
    words = np.where(size > 0.0, low | high << 16, FLAT).astype(np.uint32)
    for unlit, code in CODES.items():
        words[grade == unlit] = code
    return words


def with_means(
    order: Order, grade: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ``grade`` (m,) and ``values`` (m, n) of texels in their order, with a mean of each
    brick behind its texels.

    The mean is of texels with light; if there are none, it has the least of their grades.
    """
    grade = grade[order.texels]
    values = values[order.texels]
    if not len(order.begins):
        return grade, values
    # Average the texels with light over each brick.
    has_light = (grade >= PARTIAL_GRADE) & (grade <= FINAL)
    count = np.add.reduceat(has_light, order.begins, dtype=np.int64)
    sums = np.add.reduceat(np.where(has_light[:, None], values, 0.0), order.begins)
    means = sums / np.maximum(count, 1)[:, None]
    grades = np.where(count > 0, FINAL, np.minimum.reduceat(grade, order.begins))
    # Insert each mean behind the last texel of its brick.
    ends = np.append(order.begins[1:], len(grade))
    return np.insert(grade, ends, grades), np.insert(values, ends, means, axis=0)


def halves(values: np.ndarray) -> np.ndarray:
    """Return numbers as half floats, limited to the largest of these."""
    return np.clip(values, -MAX_HALF_FLOAT, MAX_HALF_FLOAT).astype("<f2")


def folded_body(words: np.ndarray, light: np.ndarray) -> bytes:
    """Return records of ``light`` (r, 6), direct and reflected linear RGB, with their ``words``
    (r,).
    """
    return np.column_stack([halves(light).view("<u4"), words]).astype("<u4").tobytes()


def raw_body(words: np.ndarray, numbers: np.ndarray) -> bytes:
    """Return records of transfer, ``numbers`` (r, n), behind their ``words`` (r,): a layer of a
    texture has four numbers of each record.
    """
    layers = -(-numbers.shape[1] // 4)
    quads = np.pad(halves(numbers), ((0, 0), (0, -numbers.shape[1] % 4))).reshape(
        len(words), layers, 4
    )
    padded = np.pad(words.astype("<u4"), (0, len(words) % 2))
    return padded.tobytes() + np.ascontiguousarray(quads.transpose(1, 0, 2)).tobytes()


BODIES = {FOLDED: folded_body, RAW: raw_body}


class Records(NamedTuple):
    """The records of some chunks, brick by brick: those of its texels, then the mean of these. A
    card takes the mean in place of a texel that is not there.

    - ``order``: of bricks and texels.
    - ``bounds`` (bricks + 1,): number of the first record of each brick, then of all records.
    - ``words`` (records,): normals, or why there is no light.
    - ``numbers`` (records, n): light, transfer or its codes.
    """

    order: Order
    bounds: np.ndarray
    words: np.ndarray
    numbers: np.ndarray


def find_records(chunks: ChunkTexels, normals: np.ndarray, values: np.ndarray) -> Records:
    """Return the records of ``chunks`` from the ``normals`` (m, 3) and the ``values`` (m, n) of
    all their texels.
    """
    # Sort the texels of all chunks at once, by chunk and brick, and put a mean behind each brick.
    order = order_texels(chunks.texels)
    grade, found = with_means(order, chunks.reading.grade, np.column_stack([normals, values]))
    # A brick begins at the position of its first texel, plus one mean for each brick before. The
    # number of all records is the end of the last brick.
    firsts = order.begins + np.arange(len(order.begins))
    bounds = np.append(firsts, len(grade))
    return Records(order, bounds, words_of(found[:, :3], grade), found[:, 3:])


def pack(
    chunks: ChunkTexels, normals: np.ndarray, values: np.ndarray, kind: int, behind: int = 0
) -> Iterator[bytes]:
    """Yield the block of each of the ``chunks``, of a ``kind``, from the ``normals`` (m, 3) and the
    ``values`` (m, n) of all their texels: light or transfer, as the kind has it.

    Blocks name each chunk by its index, moved by ``behind`` chunks along z.
    """
    found = find_records(chunks, normals, values)
    order = found.order
    owners = {index: number for number, index in enumerate(chunks.texels.chunks)}
    # Cut out the bricks a to b - 1 of each chunk, and their records; a chunk without texels has
    # none.
    for index, version in zip(chunks.chunks, chunks.versions, strict=True):
        number = owners.get(index, -1)
        a, b = np.searchsorted(order.owners, [number, number + 1]).tolist()
        first, last = found.bounds[[a, b]].tolist()
        # Bricks name their first records by places in the block.
        bricks = np.zeros(b - a, BRICK)
        bricks["mask"] = order.masks[a:b]
        bricks["place"] = order.places[a:b]
        bricks["first"] = found.bounds[a:b] - first
        body = BODIES[kind](found.words[first:last], found.numbers[first:last])
        place = (index[0] + behind, *index[1:])
        yield block_of(place, version, bricks, last - first, body, kind)


def block_of(
    index: Sequence[int], version: bytes, bricks: np.ndarray, records: int, body: bytes, kind: int
) -> bytes:
    """Return the bytes of a block: its header, its table of ``bricks``, and its records."""
    header = np.zeros(1, HEADER)
    size = HEADER.itemsize + bricks.nbytes + len(body)
    header["mark"] = BLOCK_MARK
    header["bytes"] = size
    header["at"] = index
    header["kind"] = kind
    header["counts"] = (len(bricks), records)
    header["version"] = np.void(version)
    return header.tobytes() + bricks.tobytes() + body
