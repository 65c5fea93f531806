"""Blocks: the light of one chunk as bytes for textures of a visitor's graphics card; docs/card.md
has the layout.

Pages without a server get transfer in few bits: whole numbers of steps, as fine as the light asks.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, band_of
from isogi_core.bake.noise import Until
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.page_pool import PagePool
from isogi_core.cache.scene_caches import Loader
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.known_blocks import Block, Packed
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer, undrawn_frame
from isogi_core.frame.shading import (
    FILTER_DISTANCES,
    fill_texel_records,
    filter_texel_light,
    light_sources,
)
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels, own_normals
from isogi_core.kernels.shading.filtering import Numbering
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.kernels.shading.irradiance_ratio import DIRECT_COLUMN, REFLECTED_COLUMN
from isogi_core.kernels.shading.lattice import BURIED_GRADE, PARTIAL_GRADE, UNLIT_ROW, VOID_GRADE
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index, PreparedScene


@dataclass(frozen=True, eq=False)
class ChunkTexels:
    """All texels of ``chunks`` that hold light, or are known to have none, and what is read of
    them.

    ``texels`` are of those chunks alone that have any, in the same order; ``versions`` of all, 8
    bytes each: they say how far each chunk is baked.
    """

    chunks: tuple[Index, ...]
    versions: tuple[bytes, ...]
    texels: ViewTexels
    reading: Reading


class Occupied(NamedTuple):
    """Chunks that have any texels, their ``slots`` in a pool, and which texels are ``there``,
    (chunks, texels) bool.
    """

    chunks: tuple[Index, ...]
    slots: np.ndarray
    there: np.ndarray


@contextmanager
def hold_texels(
    loader: Loader,
    chunks: Sequence[Index],
    target: float,
    tiles: Tiles,
    around: Sequence[Index] = (),
) -> Iterator[tuple[ChunkTexels, PagePool]]:
    """The texels of ``chunks``, in the pool that holds them while the block runs; final at the
    ``target`` error.

    Of those ``around`` which chunks are filtered, where any are named, only the texels that the
    filter reads. Raises what ``Loader.ensure`` does.
    """
    loader.ensure(chunks, tiles.check)
    pool = loader.pool
    prepared = loader.chunk_store.spec.prepared
    with pool.hold(chunks) as held:
        versions = tuple(map(pool.version, held.slots.tolist()))
        if around:
            near = near_texels(chunks, around, prepared)
        else:
            near = None
        occupied = find_occupied(pool, tuple(chunks), held.slots, near)
        texels = number_texels(occupied, prepared)
        yield (
            ChunkTexels(
                tuple(chunks),
                versions,
                texels,
                read_texels(texels, occupied.slots, pool, Until(target, FIRST_LEVEL), tiles),
            ),
            pool,
        )


def find_occupied(
    pool: PagePool, chunks: tuple[Index, ...], slots: np.ndarray, near: np.ndarray | None
) -> Occupied:
    """Which ``chunks`` in ``slots`` of a pool, -1 where absent, hold any texels, and which; of
    those ``near`` alone.
    """
    there = np.where(slots[:, None] >= 0, pool.table[slots] != UNLIT_ROW, False)
    if near is not None:
        there &= near
    some = np.flatnonzero(there.any(axis=1))
    return Occupied(tuple(chunks[i] for i in some.tolist()), slots[some], there[some])


def near_texels(
    chunks: Sequence[Index], around: Sequence[Index], prepared: PreparedScene
) -> np.ndarray:
    """Which texels of ``chunks`` the filter reads for the chunks ``around`` which they lie;
    (chunks, texels) bool.
    """
    side = prepared.lattice.chunk
    reach = min(sum(FILTER_DISTANCES), prepared.lattice.chunk)
    parts = {-1: slice(side - reach, side), 0: slice(0, side), 1: slice(0, reach)}
    near = np.zeros((len(chunks), side, side, side), np.bool_)
    numbers = {at: number for number, at in enumerate(chunks)}
    for z, y, x in around:
        for k, j, i in product(parts, repeat=3):
            if (number := numbers.get((z + k, y + j, x + i))) is not None:
                near[number, parts[k], parts[j], parts[i]] = True
    return near.reshape(len(chunks), -1)


def number_texels(occupied: Occupied, prepared: PreparedScene) -> ViewTexels:
    """The texels that are there, numbered as a view that shows no point of the surface would number
    them.
    """
    lattice = prepared.lattice
    (chunks, _, there) = occupied
    read = texel_words(there.reshape(-1, lattice.chunk))
    first = np.zeros(len(read) + 1, np.uint32)
    np.cumsum(np.bitwise_count(read), out=first[1:])
    slots = np.full(prepared.chunks, -1, np.int32)
    slots[tuple(np.array(chunks, np.int64).reshape(-1, 3).T)] = np.arange(len(chunks))
    places = np.flatnonzero(there).astype(np.uint32)
    bounds = first[:: lattice.rows].copy()
    corners = np.empty((0, 8), np.uint32)
    nowhere = np.empty((0, 3), np.float32)
    points = GBuffer.of_points(prepared.surface(prepared.scene.isovalue), (0.0, 0.0, 0.0), nowhere)
    return ViewTexels(
        points, lattice, chunks, places, bounds, corners, Numbering(slots, read, first)
    )


def texel_words(rows: np.ndarray) -> np.ndarray:
    """Rows (m, n) bool of at most 32 as the bits of words, the first one lowest; (m,) uint32."""
    bits = np.packbits(rows, axis=1, bitorder="little")
    return np.pad(bits, ((0, 0), (0, 4 - bits.shape[1]))).view("<u4")[:, 0].astype(np.uint32)


def with_neighbours(chunks: Sequence[Index], prepared: PreparedScene) -> tuple[Index, ...]:
    """The ``chunks``, in their order, and after them all others that touch one of them."""
    found = dict.fromkeys(chunks)
    for z, y, x in chunks:
        around = ((z + k, y + j, x + i) for k, j, i in product((-1, 0, 1), repeat=3))
        found.update(dict.fromkeys(each for each in around if is_inside(each, prepared.chunks)))
    return tuple(found)


def is_inside(index: Index, shape: tuple[int, int, int]) -> bool:
    """Whether there is a chunk of this ``index`` in a lattice of so many chunks."""
    return all(0 <= i < n for i, n in zip(index, shape, strict=True))


BLOCK_MARK = b"ISOB"
"""What a block begins with."""

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
CODED = 2
"""Kinds of blocks: records of light, transfer that a page puts under the light by itself, and such
in few bits.
"""

EDGE = 2
"""Texels along each side of a brick, as a power of two."""

CODES = {BURIED_GRADE: 0x80008001, VOID_GRADE: 0x80008002}
"""Words of texels without light in place of a normal, by their grade; no part of a normal is
-32768.
"""

FLAT = 0x80008003
"""The word of a texel with light whose normal is (0, 0, 0)."""

MAX_HALF_FLOAT = float(np.finfo(np.float16).max)


class Order(NamedTuple):
    """The order of records in blocks: the chunk ``owners`` and ``places`` of bricks, their
    ``masks`` and where in the order each ``begins``, (bricks,); ``texels`` (texels,) lists the
    numbers of texels, brick by brick.
    """

    owners: np.ndarray
    places: np.ndarray
    masks: np.ndarray
    begins: np.ndarray
    texels: np.ndarray


def order_texels(texels: ViewTexels) -> Order:
    """Order texels by chunk, then by brick, then by their place in it."""
    bits = texels.lattice.bits
    z, y, x = (texels.places >> bits * axis & texels.lattice.chunk - 1 for axis in (2, 1, 0))
    bricks = (z >> EDGE) << 16 | (y >> EDGE) << 8 | x >> EDGE
    bit = (z & 3) << 4 | (y & 3) << 2 | x & 3
    keys = ((texels.places >> 3 * bits).astype(np.int64) << 24 | bricks) << 6 | bit
    order = np.argsort(keys)
    own, begins = np.unique(keys[order] >> 6, return_index=True)
    masks = np.bitwise_or.reduceat(np.uint64(1) << bit[order].astype(np.uint64), begins)
    return Order(own >> 24, own & 0xFFFFFF, masks, begins, order)


def words_of(normals: np.ndarray, grade: np.ndarray) -> np.ndarray:
    """Normals (m, 3) of texels with this ``grade`` (m,) as words, or the codes of those without;
    (m,) uint32.

    A normal is projected onto an octahedron, whose lower half is folded over the upper one (Meyer
    and others, "On Floating-Point Normal Vectors", 2010); x is in the lower 16 bits, y in the upper
    ones.
    """
    size = np.abs(normals).sum(axis=1)
    x, y, z = (normals / np.maximum(size, 1e-30)[:, None]).T
    u = np.where(z < 0.0, (1.0 - np.abs(y)) * np.where(x >= 0.0, 1.0, -1.0), x)
    v = np.where(z < 0.0, (1.0 - np.abs(x)) * np.where(y >= 0.0, 1.0, -1.0), y)
    low, high = (
        np.rint(32767.0 * each).astype(np.int16).view(np.uint16).astype(np.uint32)
        for each in (u, v)
    )
    words = np.where(size > 0.0, low | high << 16, FLAT).astype(np.uint32)
    for each, code in CODES.items():
        words[grade == each] = code
    return words


def with_means(
    order: Order, grade: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The ``grade`` (m,) and ``values`` (m, n) of texels in their order, with the mean of each
    brick behind its texels.

    A mean is of the texels with light, or buried or void where there are none.
    """
    grade = grade[order.texels]
    values = values[order.texels]
    bricks = np.arange(len(order.begins))
    ends = np.append(order.begins[1:], len(grade))
    fit = (grade >= PARTIAL_GRADE) & (grade <= FINAL)
    if not len(bricks):
        return grade, values
    count = np.add.reduceat(fit, order.begins, dtype=np.int64)
    means = (
        np.add.reduceat(np.where(fit[:, None], values, 0.0), order.begins)
        / np.maximum(count, 1)[:, None]
    )
    kinds = np.where(count > 0, FINAL, np.minimum.reduceat(grade, order.begins))
    return np.insert(grade, ends, kinds), np.insert(values, ends, means, axis=0)


def halves(values: np.ndarray) -> np.ndarray:
    """Numbers as half floats, those beyond these at their ends."""
    return np.clip(values, -MAX_HALF_FLOAT, MAX_HALF_FLOAT).astype("<f2")


def folded_body(words: np.ndarray, light: np.ndarray) -> bytes:
    """Records of light (r, 6), direct and reflected linear RGB, with their ``words`` (r,)."""
    return np.column_stack([halves(light).view("<u4"), words]).astype("<u4").tobytes()


def raw_body(words: np.ndarray, numbers: np.ndarray) -> bytes:
    """Records of transfer, ``numbers`` (r, n), after their ``words`` (r,): four numbers of each in
    every layer.
    """
    layers = -(-numbers.shape[1] // 4)
    quads = np.pad(halves(numbers), ((0, 0), (0, -numbers.shape[1] % 4))).reshape(
        len(words), layers, 4
    )
    padded = np.pad(words.astype("<u4"), (0, len(words) % 2))
    return padded.tobytes() + np.ascontiguousarray(quads.transpose(1, 0, 2)).tobytes()


NORMAL_STEPS = 64
"""Steps of normals in few bits: a tenth of a degree."""


def coded_body(words: np.ndarray, codes: np.ndarray) -> bytes:
    """Records of transfer in few bits, ``codes`` (r, n), with their ``words`` (r,): byte by byte,
    for compression.

    First come all low bytes of words' x, all high ones, and those of y. Codes follow, with their
    signs in bit 0: low bytes of number 0, of number 1, and so on, then all high ones.
    """
    x = (words & 0xFFFF).astype(np.uint16)
    y = (words >> 16).astype(np.uint16)
    signed = np.rint(codes.T).astype(np.int32)
    folded = (signed << 1 ^ signed >> 31).astype(np.uint16)
    planes = [
        each >> shift & 0xFF for each in (coarse(x, words), coarse(y, words)) for shift in (0, 8)
    ]
    body = np.vstack([*planes, folded & 0xFF, folded >> 8]).astype(np.uint8).tobytes()
    return body + bytes(-len(body) % 8)


def coarse(parts: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Parts of normals' ``words`` (m,) as multiples of NORMAL_STEPS, those of words without a
    normal as they are.
    """
    most = 0x7FFF // NORMAL_STEPS
    rounded = NORMAL_STEPS * np.clip(
        np.rint(parts.view(np.int16) / NORMAL_STEPS), -most, most
    ).astype(np.int16)
    return np.where(np.isin(words, (*CODES.values(), FLAT)), parts, rounded.view(np.uint16))


BODIES = {FOLDED: folded_body, RAW: raw_body, CODED: coded_body}


def pack(
    chunks: ChunkTexels, normals: np.ndarray, values: np.ndarray, kind: int
) -> Iterator[bytes]:
    """The block of each chunk, of a ``kind``, from the ``normals`` (m, 3) and ``values`` (m, n) of
    its texels.
    """
    order = order_texels(chunks.texels)
    grade, found = with_means(order, chunks.reading.grade, np.column_stack([normals, values]))
    words = words_of(found[:, :3], grade)
    numbers = found[:, 3:]
    firsts = order.begins + np.arange(len(order.begins))
    owners = {index: number for number, index in enumerate(chunks.texels.chunks)}
    for index, version in zip(chunks.chunks, chunks.versions, strict=True):
        a, b = np.searchsorted(order.owners, [number := owners.get(index, -1), number + 1]).tolist()
        ends = [int(firsts[i]) if i < len(firsts) else len(words) for i in (a, b)]
        bricks = np.zeros(b - a, BRICK)
        bricks["mask"], bricks["place"] = order.masks[a:b], order.places[a:b]
        bricks["first"] = firsts[a:b] - ends[0]
        some = slice(*ends)
        yield block_of(
            index,
            version,
            bricks,
            ends[1] - ends[0],
            BODIES[kind](words[some], numbers[some]),
            kind,
        )


def block_of(
    index: Sequence[int], version: bytes, bricks: np.ndarray, records: int, body: bytes, kind: int
) -> bytes:
    """A block: its header, its table of ``bricks``, and its records."""
    header = np.zeros(1, HEADER)
    size = HEADER.itemsize + bricks.nbytes + len(body)
    header["mark"] = BLOCK_MARK
    header["bytes"] = size
    header["at"] = index
    header["kind"] = kind
    header["counts"] = (len(bricks), records)
    header["version"] = np.void(version)
    return header.tobytes() + bricks.tobytes() + body


TYPICAL = 0.5
"""The light that leaves a surface in the mean, over what leaves one that sees all of the light."""

MOST_CODE = (1 << 15) - 1
"""The greatest code; the least is its opposite."""

NOISE_STEP = 1.0
"""The step of ``noise_numbers``: filters know noise within a factor of √2, which moves pictures by
0.04 % (RMSE).
"""


@dataclass(frozen=True, eq=False)
class Coding:
    """Codes of transfer: number k of a texel is a whole number of ``steps[k]``, (numbers,) float32.

    A step of 0 is that of numbers which meet no light: all of them are 0.
    """

    steps: np.ndarray

    def codes(self, numbers: np.ndarray) -> np.ndarray:
        """The codes of ``numbers`` (m, numbers); of the same shape, float32 without fractions."""
        codes = np.rint(numbers / np.where(self.steps > 0.0, self.steps, np.float32(np.inf)))
        return np.asarray(np.clip(codes, -MOST_CODE, MOST_CODE), np.float32)

    def numbers(self, codes: np.ndarray) -> np.ndarray:
        """What ``codes`` (m, numbers) stand for; float32."""
        return np.asarray(codes * self.steps, np.float32)


def coding_for(spec: BakeSpec, scale: float, error: float) -> Coding:
    """The coding of ``raw_numbers`` over a ``scale`` at which texels have about an ``error``,
    relative to light.

    The squared error of rounding is a twelfth of the squared step. Errors are the least for their
    bits where each number brings as much: steps are inverse to the light that it meets, in the mean
    over a band, as the light may turn.
    """
    meets = (
        np.concatenate([band_means(term.luminance) for term in spec.terms], axis=1).ravel()
        * scale
        / spec.unit
    )
    lit = meets > 0.0
    allowed = error * TYPICAL * spec.unoccluded / spec.unit
    steps = allowed * np.sqrt(12.0 / max(int(lit.sum()), 1)) / np.where(lit, meets, np.inf)
    return Coding(np.append(steps, [NOISE_STEP, NOISE_STEP]).astype(np.float32))


def band_means(light: np.ndarray) -> np.ndarray:
    """Root mean squares of each band of harmonics (channels, n²), for each of its coefficients; of
    the same shape.
    """
    bands = band_of(round(light.shape[1] ** 0.5))
    sums = np.stack([np.bincount(bands, each**2) for each in light]) / np.bincount(bands)
    return np.asarray(np.sqrt(sums)[:, bands])


CHUNKS = 64
"""Chunks that are packed together at most."""

SEEN_BYTES = 256
"""Bytes that a chunk in a list of those seen takes in memory."""

LEAST_SCATTER = 2.0**-20
"""What scatter counts as at least, so that its logarithm is a number."""


def known_light(
    renderer: Renderer, view: View, chunks: Sequence[Index], target: float, tiles: Tiles
) -> Packed:
    """``fold_chunks``, of which each is folded once for all that ask for it. Raises as that
    does.
    """
    kind = FOLDED, view.light, view.albedo, target
    return known(
        renderer, kind, chunks, lambda some: fold_chunks(renderer, view, some, target, tiles), tiles
    )


def known_transfer(
    renderer: Renderer, chunks: Sequence[Index], target: float, tiles: Tiles
) -> Packed:
    """``transfer_chunks``, of which each is packed once for all that ask for it. Raises as that
    does.
    """
    return known(
        renderer,
        (RAW, target),
        chunks,
        lambda some: transfer_chunks(renderer, some, target, tiles),
        tiles,
    )


def known(
    renderer: Renderer,
    kind: Hashable,
    chunks: Sequence[Index],
    make: Callable[[Sequence[Index]], Packed],
    tiles: Tiles,
) -> Packed:
    """Blocks of a ``kind`` that the renderer knows, or that ``make`` makes."""
    return renderer.blocks.find(kind, chunks, renderer.caches.of("gi"), make, tiles.check)


def fold_chunks(
    renderer: Renderer, view: View, chunks: Sequence[Index], target: float, tiles: Tiles
) -> Packed:
    """``chunks`` under the light of a ``view``, filtered where it is grainy; final at the
    ``target`` error.

    Records are those that ``carry_irradiance_ratios`` is given. Raises Cancelled, and what
    ``Loader.ensure`` does.
    """
    light = RotatedLight(renderer.caches.spec("gi"), view)
    with hold_filtering(renderer, chunks, target, tiles) as (found, pool):
        lit = light_sources(found.reading.sources(pool), light, tiles)
    about = normals_of(renderer, found.texels, tiles)
    reading = found.reading
    if reading.grainy.any():
        reading, lit = filter_texel_light(found.texels, reading, lit, about, light, tiles)
    records = fill_texel_records(reading.grade, lit, about, light, tiles)
    values = np.column_stack(
        [
            records[:, DIRECT_COLUMN : DIRECT_COLUMN + 3],
            records[:, REFLECTED_COLUMN : REFLECTED_COLUMN + 3],
        ]
    )
    return packed(found, pack(found, about, values, FOLDED), len(chunks), renderer.prepared)


def transfer_chunks(
    renderer: Renderer, chunks: Sequence[Index], target: float, tiles: Tiles
) -> Packed:
    """``chunks`` with the ``raw_numbers`` of their texels, which fold to light and filter it
    wherever they are drawn.

    Raises as ``fold_chunks``.
    """
    found, about, numbers = read_raw(renderer, chunks, target, tiles)
    return Packed(tuple(map(Block, pack(found, about, numbers, RAW), found.versions)))


def packed(
    found: ChunkTexels, blocks: Iterator[bytes], count: int, prepared: PreparedScene
) -> Packed:
    """The first ``count`` of some ``blocks`` of light, with the versions of all that it comes
    from.
    """
    versions = dict(zip(found.chunks, found.versions, strict=True))
    filtered = bool(found.reading.grainy.any())
    return Packed(
        tuple(
            Block(
                data,
                versions[at],
                {n: versions[n] for n in with_neighbours([at], prepared)[1:]} if filtered else {},
            )
            for at, data in zip(found.chunks[:count], blocks, strict=False)
        )
    )


def coded_chunks(
    renderer: Renderer, chunks: Sequence[Index], target: float, coding: Coding, tiles: Tiles
) -> tuple[bytes, ...]:
    """The blocks of ``chunks`` with the ``raw_numbers`` of their texels in few bits. Raises as
    ``fold_chunks``.
    """
    found, about, numbers = read_raw(renderer, chunks, target, tiles)
    return tuple(pack(found, about, coding.codes(numbers), CODED))


def read_raw(
    renderer: Renderer, chunks: Sequence[Index], target: float, tiles: Tiles
) -> tuple[ChunkTexels, np.ndarray, np.ndarray]:
    """The texels of ``chunks``, the normals (m, 3) that they are lit about, and their
    ``raw_numbers``.
    """
    with hold_texels(renderer.caches.of("gi"), chunks, target, tiles) as (found, pool):
        numbers = raw_numbers(found.reading, pool)
    return found, normals_of(renderer, found.texels, tiles), numbers


@contextmanager
def hold_filtering(
    renderer: Renderer, chunks: Sequence[Index], target: float, tiles: Tiles
) -> Iterator[tuple[ChunkTexels, PagePool]]:
    """The texels of ``chunks``, and behind them those near by of all chunks that touch one, where
    some are grainy.

    They are held in the pool while the block runs. Raises as ``fold_chunks``.
    """
    loader = renderer.caches.of("gi")
    more = with_neighbours(chunks, renderer.prepared)
    with hold_texels(loader, chunks, target, tiles) as held:
        if not held[0].reading.grainy.any():
            yield held
            return
    with hold_texels(loader, more, target, tiles, around=chunks) as held:
        yield held


def raw_numbers(reading: Reading, pool: PagePool) -> np.ndarray:
    """What texels keep, over ``raw_scale``, and their ``noise_numbers``; (m, numbers) float32, 0
    where unlit.
    """
    rows = reading.rows
    spec = pool.spec
    numbers = np.where((rows >= 0)[:, None, None], pool.transfer[rows], np.float32(0.0))
    kept = numbers.reshape(len(rows), spec.channels * spec.columns) / np.float32(raw_scale(spec))
    return np.column_stack([kept, noise_numbers(reading, pool)])


def noise_numbers(reading: Reading, pool: PagePool) -> np.ndarray:
    """What the filter reads besides light: log₂ of the scatter, and ±(1 + log₂ of the samples); (m,
    2) float32.

    The latter is negative where light is not grainy; both are 0 where there is none.
    """
    lit = reading.lit
    scatter = pool.scatter[reading.rows]
    samples = reading.samples
    found = np.log2(np.maximum(np.column_stack([scatter, 2 * samples]), LEAST_SCATTER))
    found[:, 1] *= np.where(reading.grainy, 1.0, -1.0)
    return np.where(lit[:, None], found, 0.0).astype(np.float32)


def raw_scale(spec: BakeSpec) -> float:
    """What transfer is divided by so that half floats hold it: irradiance has met its light, and is
    as bright.
    """
    if spec.plan.representation == "irradiance":
        return spec.unit
    return 1.0


class SeenChunk(NamedTuple):
    """A chunk that a view reads: its place ``at``, its ``version``, and whether all that is read of
    it is ``final``.
    """

    at: Index
    version: bytes
    final: bool


@dataclass(frozen=True, eq=False)
class Look:
    """The chunks that a view reads, those first that most of its pixels do.

    Where some of them are not final, a ``frame`` that is not drawn says what light it lacks.
    """

    seen: tuple[SeenChunk, ...]
    frame: Frame | None

    @property
    def nbytes(self) -> int:
        """Bytes that it takes where all is final."""
        return SEEN_BYTES * len(self.seen)

    def is_current(self, loader: Loader, tiles: Tiles) -> bool:
        """Whether nothing was baked on since. Raises what ``Loader.ensure`` does."""
        chunks = [each.at for each in self.seen]
        loader.ensure(chunks, tiles.check)
        return loader.pool.versions(chunks) == tuple(each.version for each in self.seen)


def seen_chunks(
    renderer: Renderer, view: View, target: float, tiles: Tiles
) -> tuple[SeenChunk, ...]:
    """The chunks that a ``view`` reads, those first that most of its pixels do. Raises as
    ``fold_chunks``.
    """
    return look_at(renderer, view, target, tiles).seen


def look_at(renderer: Renderer, view: View, target: float, tiles: Tiles) -> Look:
    """What a ``view`` reads; looks at final light are kept for all that ask. Raises as
    ``fold_chunks``.
    """
    check = renderer.checks.held(view, target)
    loader = renderer.caches.of("gi")
    until = Until(target, check.known.enough if check else FIRST_LEVEL)
    known: Look | None = renderer.looks.held((view, until))
    if known is not None and known.is_current(loader, tiles):
        return known
    renderer.looks.drop((view, until))
    look = new_look(renderer, view, until, loader, tiles)
    if look.frame:
        return look
    return renderer.looks.get((view, until), lambda: look)


def new_look(renderer: Renderer, view: View, until: Until, loader: Loader, tiles: Tiles) -> Look:
    """What a ``view`` reads, by its rays."""
    texels = renderer.texels(view, renderer.gbuffer(view, tiles), tiles)
    loader.ensure(texels.chunks, tiles.check)
    with loader.pool.hold(texels.chunks) as held:
        reading = read_texels(texels, held.slots, loader.pool, until, tiles)
        versions = list(map(loader.pool.version, held.slots.tolist()))
    read = texels.places[texels.corners].ravel() >> 3 * texels.lattice.bits
    order = np.argsort(-np.bincount(read, minlength=len(versions)), kind="stable").tolist()
    seen = tuple(SeenChunk(texels.chunks[i], versions[i], not reading.short[i]) for i in order)
    return Look(
        seen, undrawn_frame(renderer, view, texels, reading) if reading.short.any() else None
    )


def normals_of(renderer: Renderer, texels: ViewTexels, tiles: Tiles) -> np.ndarray:
    """The normals that texels are lit about, (m, 3) float32."""
    return own_normals(texels, texels.places, renderer.known_normals, renderer.prepared, tiles)
