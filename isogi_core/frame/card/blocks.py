"""Blocks: the light of one chunk as bytes for textures of a visitor's graphics card; docs/card.md
has the layout.

Pages without a server get transfer in few bits: whole numbers of steps, as fine as the light asks.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.cache.page_pool import PagePool
from isogi_core.frame.card.block_format import CODED, FOLDED, RAW, pack
from isogi_core.frame.card.chunk_texels import ChunkTexels, hold_texels, with_neighbours
from isogi_core.frame.card.coding import Coding
from isogi_core.frame.known_blocks import Block, Packed
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.shading import (
    fill_texel_records,
    filter_texel_light,
    light_sources,
)
from isogi_core.frame.texel_normals import own_normals
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.irradiance_ratio import DIRECT_COLUMN, REFLECTED_COLUMN
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index, PreparedScene

CHUNKS = 64
"""Chunks that are packed together at most."""


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


def normals_of(renderer: Renderer, texels: ViewTexels, tiles: Tiles) -> np.ndarray:
    """The normals that texels are lit about, (m, 3) float32."""
    return own_normals(texels, texels.places, renderer.known_normals, renderer.prepared, tiles)
