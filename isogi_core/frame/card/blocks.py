"""Make blocks: the light of one chunk as bytes for textures of a visitor's graphics card;
docs/card.md has their layout.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import Goal
from isogi_core.cache.page_pool import PagePool
from isogi_core.frame.card.block_format import FOLDED, RAW, pack
from isogi_core.frame.card.chunk_texels import ChunkTexels, hold_texels, with_neighbours
from isogi_core.frame.card.coded_light import CodedLight, code_light, means_of
from isogi_core.frame.card.coding import Coding
from isogi_core.frame.known_blocks import Block, Packed
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.shading import fill_texel_records, filter_texel_light, light_sources
from isogi_core.frame.surface_renderer import SurfaceRenderer
from isogi_core.frame.texel_normals import normals_at_positions
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.irradiance_ratio import DIRECT_COLUMN, REFLECTED_COLUMN
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index, PreparedScene

CHUNKS = 64
"""Chunks that are packed together at most."""


LEAST_SCATTER = 2.0**-20
"""Least scatter, so that it has a logarithm."""


def known_light(
    renderer: Renderer, view: View, chunks: Sequence[Index], goal: Goal, tiles: Tiles
) -> Packed:
    """Return ``fold_chunks`` of ``chunks``, each folded once for all that ask for it. Raises
    its errors.
    """
    kind = FOLDED, view.light, view.albedo, goal
    return known(
        renderer, kind, chunks, lambda some: fold_chunks(renderer, view, some, goal, tiles), tiles
    )


def known_transfer(renderer: Renderer, chunks: Sequence[Index], goal: Goal, tiles: Tiles) -> Packed:
    """Return ``transfer_chunks`` of ``chunks``, each packed once for all that ask for it.
    Raises its errors.
    """
    return known(
        renderer,
        (RAW, goal),
        chunks,
        lambda some: transfer_chunks(renderer, some, goal, tiles),
        tiles,
    )


def known(
    renderer: Renderer,
    kind: Hashable,
    chunks: Sequence[Index],
    make: Callable[[Sequence[Index]], Packed],
    tiles: Tiles,
) -> Packed:
    """Return blocks of a ``kind`` that the renderer keeps, or that ``make`` makes now."""
    loader = renderer.caches.of("gi")

    def versions(some: Sequence[Index]) -> tuple[bytes, ...]:
        loader.ensure(some, tiles.check)
        return loader.pool.versions(some)

    return renderer.blocks.find(kind, chunks, versions, make)


def fold_chunks(
    renderer: Renderer, view: View, chunks: Sequence[Index], goal: Goal, tiles: Tiles
) -> Packed:
    """Pack ``chunks`` with the light of their texels under the light of a ``view``, filtered if it
    is grainy; light is final by the ``goal``.

    Records are those that ``carry_irradiance_ratios`` interpolates. Raises Cancelled, and the
    errors of ``Loader.ensure``.
    """
    light = RotatedLight(renderer.caches.spec("gi"), view)
    with hold_filtering(renderer, chunks, goal, tiles) as (found, pool):
        lit = light_sources(found.reading.sources(pool), light, tiles)
    about, values = fold_light(renderer.surface, found, lit, light, tiles)
    blocks = pack(found, about, values, FOLDED)
    return packed(found, blocks, len(chunks), renderer.prepared)


def fold_light(
    surface: SurfaceRenderer, found: ChunkTexels, lit: np.ndarray, light: RotatedLight, tiles: Tiles
) -> tuple[np.ndarray, np.ndarray]:
    """Return the normals (m, 3) of the texels that were ``found``, and their direct and reflected
    light, (m, 6): from ``lit`` (m, LIGHT_NUMBERS), filtered about the normals as for a picture of a
    ``surface`` if it is grainy. Raises Cancelled.
    """
    about = normals_of(surface, found.texels, tiles)
    reading = found.reading
    if reading.grainy.any():
        reading, lit = filter_texel_light(found.texels, reading, lit, about, light, tiles)
    records = fill_texel_records(reading.grade, lit, about, light, tiles)
    direct = records[:, DIRECT_COLUMN : DIRECT_COLUMN + 3]
    reflected = records[:, REFLECTED_COLUMN : REFLECTED_COLUMN + 3]
    return about, np.column_stack([direct, reflected])


def transfer_chunks(
    renderer: Renderer, chunks: Sequence[Index], goal: Goal, tiles: Tiles
) -> Packed:
    """Pack ``chunks`` with the ``raw_numbers`` of their texels, from which a card makes light and
    filters it by itself.

    Raises the errors of ``fold_chunks``.
    """
    found, about, numbers = read_raw(renderer, chunks, goal, tiles)
    return Packed(tuple(map(Block, pack(found, about, numbers, RAW), found.versions)))


def packed(
    found: ChunkTexels, blocks: Iterator[bytes], count: int, prepared: PreparedScene
) -> Packed:
    """Return the first ``count`` of some ``blocks`` of light, with the versions of all chunks
    that it comes from.
    """
    versions = dict(zip(found.chunks, found.versions, strict=True))
    filtered = bool(found.reading.grainy.any())
    some = []
    for at, data in zip(found.chunks[:count], blocks, strict=False):
        # Filtered light depends on all chunks around.
        around = {}
        if filtered:
            around = {other: versions[other] for other in with_neighbours([at], prepared)[1:]}
        some.append(Block(data, versions[at], around))
    return Packed(tuple(some))


def coded_chunks(
    renderer: Renderer,
    chunks: Sequence[Index],
    goal: Goal,
    codings: tuple[Coding, Coding],
    tiles: Tiles,
) -> tuple[CodedLight, CodedLight]:
    """Return the light of ``chunks`` in few bits: the ``raw_numbers`` of their texels by the first
    of two ``codings``, and the means of their bricks by the second. Raises the errors of
    ``fold_chunks``.
    """
    found, about, numbers = read_raw(renderer, chunks, goal, tiles)
    fine, coarse = (code_light(found, about, each.codes(numbers)) for each in codings)
    return fine, means_of(coarse)


def read_raw(
    renderer: Renderer, chunks: Sequence[Index], goal: Goal, tiles: Tiles
) -> tuple[ChunkTexels, np.ndarray, np.ndarray]:
    """Return the texels of ``chunks``, the normals (m, 3) that they are lit about, and their
    ``raw_numbers``.
    """
    with hold_texels(renderer.caches.of("gi"), chunks, goal, tiles) as (found, pool):
        numbers = raw_numbers(found.reading, pool)
    return found, normals_of(renderer.surface, found.texels, tiles), numbers


@contextmanager
def hold_filtering(
    renderer: Renderer, chunks: Sequence[Index], goal: Goal, tiles: Tiles
) -> Iterator[tuple[ChunkTexels, PagePool]]:
    """Hold ``chunks`` in the pool while the block runs. If the light of some of their texels is
    grainy, hold the texels of neighbouring chunks that the filter reads, too. Yield the texels, and
    the pool.

    Raises the errors of ``fold_chunks``.
    """
    loader = renderer.caches.of("gi")
    with hold_texels(loader, chunks, goal, tiles) as held:
        if not held[0].reading.grainy.any():
            yield held
            return
    # The filter reads texels of the chunks around, too.
    more = with_neighbours(chunks, renderer.prepared)
    with hold_texels(loader, more, goal, tiles, filtered=chunks) as held:
        yield held


def raw_numbers(reading: Reading, pool: PagePool) -> np.ndarray:
    """Return the coefficients of texels over ``raw_scale``, and their ``noise_numbers``; (m,
    numbers) float32, 0 if they have no light.
    """
    rows = reading.rows
    spec = pool.spec
    numbers = np.where((rows >= 0)[:, None, None], pool.transfer[rows], np.float32(0.0))
    kept = numbers.reshape(len(rows), spec.channels * spec.columns) / np.float32(raw_scale(spec))
    return np.column_stack([kept, noise_numbers(reading, pool)])


def noise_numbers(reading: Reading, pool: PagePool) -> np.ndarray:
    """Return the numbers that a filter needs besides light: log₂ of the scatter, and ±(1 + log₂ of
    the samples); (m, 2) float32.

    The latter is negative if light is not grainy; both are 0 if there is none. Logarithms fit half
    floats, and 1 is added as the sign of log₂ 1 would be lost.
    """
    lit = reading.lit
    scatter = pool.scatter[reading.rows]
    samples = reading.samples
    found = np.log2(np.maximum(np.column_stack([scatter, 2 * samples]), LEAST_SCATTER))
    found[:, 1] *= np.where(reading.grainy, 1.0, -1.0)
    return np.where(lit[:, None], found, 0.0).astype(np.float32)


def raw_scale(spec: BakeSpec) -> float:
    """Return the divisor of transfer that makes it fit half floats: irradiance is in the unit
    of its light, all other transfer is about 1.
    """
    if spec.plan.representation == "irradiance":
        return spec.unit
    return 1.0


def normals_of(surface: SurfaceRenderer, texels: ViewTexels, tiles: Tiles) -> np.ndarray:
    """Return the normals that texels of a ``surface`` are lit about, (m, 3) float32."""
    normals = surface.texel_shading.normals
    return normals_at_positions(texels, texels.places, normals, surface.prepared, tiles)
