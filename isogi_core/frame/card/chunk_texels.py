"""All texels of whole chunks that hold light, numbered as the texels of a view."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.cache.page_pool import PagePool
from isogi_core.cache.scene_caches import Loader
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.shading import FILTER_DISTANCES
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.filtering import Numbering
from isogi_core.kernels.shading.lattice import UNLIT_ROW
from isogi_core.prepared.prepared_scene import Index, PreparedScene


@dataclass(frozen=True, eq=False)
class ChunkTexels:
    """All texels of ``chunks`` that hold light, or are known to have none, and their ``reading``.

    ``texels`` are those of the chunks that have any, in the same order; ``versions`` are of all
    chunks, 8 bytes each, and tell how far each is baked.
    """

    chunks: tuple[Index, ...]
    versions: tuple[bytes, ...]
    texels: ViewTexels
    reading: Reading


class Occupied(NamedTuple):
    """Chunks that have any texels, their ``slots`` in a pool, and a mark for each texel that is
    ``there``, (chunks, texels) bool.
    """

    chunks: tuple[Index, ...]
    slots: np.ndarray
    there: np.ndarray


@contextmanager
def hold_texels(
    loader: Loader,
    chunks: Sequence[Index],
    goal: Goal,
    tiles: Tiles,
    filtered: Sequence[Index] = (),
) -> Iterator[tuple[ChunkTexels, PagePool]]:
    """Hold ``chunks`` in the pool while the block runs; yield their texels, final by the ``goal``,
    and the pool.

    If only some chunks are ``filtered``, the others are neighbours whose texels the filter reads:
    of these, only the texels within its reach are taken. Raises the errors of ``Loader.ensure``.
    """
    loader.ensure(chunks, tiles.check)
    pool = loader.pool
    prepared = loader.chunk_store.spec.prepared
    with pool.hold(chunks) as held:
        versions = tuple(map(pool.version, held.slots.tolist()))
        # Of chunks that are held for the filter alone, leave out the texels beyond its reach.
        if filtered:
            near = near_texels(chunks, filtered, prepared)
        else:
            near = None
        occupied = find_occupied(chunks, held.slots, find_there(pool, held.slots, near))
        texels = number_texels(occupied, prepared)
        # Look up the light of the texels while their chunks are held.
        yield (
            ChunkTexels(
                tuple(chunks),
                versions,
                texels,
                read_texels(texels, occupied.slots, pool, goal, tiles),
            ),
            pool,
        )


def find_there(pool: PagePool, slots: np.ndarray, near: np.ndarray | None) -> np.ndarray:
    """Mark the texels that chunks in ``slots`` of a pool hold, or those ``near`` alone; (chunks,
    texels) bool. Slots are -1 if a chunk is absent.
    """
    there = np.where(slots[:, None] >= 0, pool.table[slots] != UNLIT_ROW, False)
    if near is not None:
        there &= near
    return np.asarray(there)


def find_occupied(chunks: Sequence[Index], slots: np.ndarray, there: np.ndarray) -> Occupied:
    """Find the ``chunks``, in ``slots`` of a pool, with any texels ``there``."""
    some = np.flatnonzero(there.any(axis=1))
    return Occupied(tuple(chunks[i] for i in some.tolist()), slots[some], there[some])


def near_texels(
    chunks: Sequence[Index], filtered: Sequence[Index], prepared: PreparedScene
) -> np.ndarray:
    """Mark the texels of ``chunks`` that the filter reads to smooth the ``filtered`` chunks: all of
    these, and margins of their neighbours; (chunks, texels) bool.
    """
    side = prepared.lattice.chunk
    # Each pass of the filter reads farther by its distance.
    reach = min(sum(FILTER_DISTANCES), side)
    # Along each axis, the filter reads the end of the chunk before, all of the chunk, and the
    # beginning of the next.
    parts = {-1: slice(side - reach, side), 0: slice(0, side), 1: slice(0, reach)}
    near = np.zeros((len(chunks), side, side, side), np.bool_)
    numbers = {at: number for number, at in enumerate(chunks)}
    for z, y, x in filtered:
        for k, j, i in product(parts, repeat=3):
            if (number := numbers.get((z + k, y + j, x + i))) is not None:
                near[number, parts[k], parts[j], parts[i]] = True
    return near.reshape(len(chunks), -1)


def number_texels(occupied: Occupied, prepared: PreparedScene) -> ViewTexels:
    """Number the texels of ``occupied`` chunks, as those of a view that shows no point of the
    surface.
    """
    lattice = prepared.lattice
    (chunks, _, there) = occupied
    # Number texels as ``find_texels`` does: a bit for each, and a running sum of the bits.
    read = texel_words(there.reshape(-1, lattice.chunk))
    first = np.zeros(len(read) + 1, np.uint32)
    np.cumsum(np.bitwise_count(read), out=first[1:])
    slots = np.full(prepared.chunks, -1, np.int32)
    slots[tuple(np.array(chunks, np.int64).reshape(-1, 3).T)] = np.arange(len(chunks))
    places = np.flatnonzero(there).astype(np.uint32)
    bounds = first[:: lattice.rows].copy()
    # No points are shown, so no texel is a corner of any; the G-buffer only gives an isovalue.
    corners = np.empty((0, 8), np.uint32)
    nowhere = np.empty((0, 3), np.float32)
    points = GBuffer.of_points(prepared.surface(prepared.scene.isovalue), (0.0, 0.0, 0.0), nowhere)
    return ViewTexels(
        points, lattice, chunks, places, bounds, corners, Numbering(slots, read, first)
    )


def texel_words(rows: np.ndarray) -> np.ndarray:
    """Pack rows (m, n) bool of at most 32 into words, the first in the lowest bit; (m,) uint32."""
    bits = np.packbits(rows, axis=1, bitorder="little")
    return np.pad(bits, ((0, 0), (0, 4 - bits.shape[1]))).view("<u4")[:, 0].astype(np.uint32)


def with_neighbours(chunks: Sequence[Index], prepared: PreparedScene) -> tuple[Index, ...]:
    """Return the ``chunks``, in their order, and after them all others that touch one of them."""
    found = dict.fromkeys(chunks)
    for z, y, x in chunks:
        around = ((z + k, y + j, x + i) for k, j, i in product((-1, 0, 1), repeat=3))
        found.update(dict.fromkeys(each for each in around if is_inside(each, prepared.chunks)))
    return tuple(found)


def is_inside(index: Index, shape: tuple[int, int, int]) -> bool:
    """Return True if a lattice of ``shape`` chunks has one with this ``index``."""
    return all(0 <= i < n for i, n in zip(index, shape, strict=True))
