"""Light of several surfaces for cards: the chunks of all sides of surfaces are numbered as one
lattice, one side behind the other along z.

Light of a pinned surface is mixed of two levels of the isovalue that slides, as in pictures.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Loader
from isogi_core.frame.card.block_format import FOLDED, pack
from isogi_core.frame.card.blocks import fold_light, known_light, packed
from isogi_core.frame.card.chunk_texels import (
    ChunkTexels,
    find_occupied,
    find_there,
    near_texels,
    number_texels,
    with_neighbours,
)
from isogi_core.frame.card.looks import (
    Look,
    SeenChunk,
    goal_of_light,
    look_at,
    read_light,
    reads_of,
    seen_chunks,
)
from isogi_core.frame.known_blocks import Block, Packed
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.several.mixed_reading import Level, mixed
from isogi_core.frame.several.peeling_renderer import SeenSide
from isogi_core.frame.shading import light_sources
from isogi_core.frame.surface_renderer import SurfaceRenderer
from isogi_core.frame.texel_reading import read_texels
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import Side, sides_of
from isogi_core.prepared.prepared_scene import Index


def chunks_of_sides(scene: Scene, chunks: Index) -> Index:
    """Return the number of chunks along z, y, x of all sides of surfaces of a ``scene`` together,
    if each side has ``chunks``; these if the scene has one surface.
    """
    if not scene.surfaces.several:
        return chunks
    return len(sides_of(scene)) * chunks[0], chunks[1], chunks[2]


def look_at_sides(renderer: Renderer, view: View, goal: Goal, tiles: Tiles) -> Look:
    """Return the look of a ``view``: of all sides of surfaces that it shows, if these are several,
    else ``look_at``. Raises the errors of ``Loader.ensure``, and NoRoomError.
    """
    if renderer.peeling is None:
        return look_at(renderer, view, goal, tiles)
    chunks = seen_on_sides(renderer, view, goal, tiles)
    if all(chunk.final for chunk in chunks):
        return Look(chunks, None)
    # The picture knows which side is to have light first. Without a target nobody checks it.
    frame = renderer.peeling.draw(view, goal, tiles, Stopwatch())
    return Look(chunks, replace(frame, aim=None))


def seen_on_sides(
    renderer: Renderer, view: View, goal: Goal, tiles: Tiles
) -> tuple[SeenChunk, ...]:
    """Return the chunks that a ``view`` reads, those of most points first, without drawing it: of
    all sides of surfaces that it shows, if these are several. Raises the errors of
    ``Loader.ensure``, and NoRoomError.
    """
    peeling = renderer.peeling
    if peeling is None:
        return seen_chunks(renderer, view, goal, tiles)

    def find() -> list[tuple[int, SeenChunk]]:
        found: list[tuple[int, SeenChunk]] = []
        for seen in peeling.seen(view, tiles):
            found += chunks_of_side(seen, goal, tiles)
            peeling.check_room()
        return found

    # Each chunk of each side comes with the number of its reads.
    found = peeling.in_room(find)
    return tuple(chunk for _, chunk in sorted(found, key=lambda each: -each[0]))


def chunks_of_side(seen: SeenSide, goal: Goal, tiles: Tiles) -> list[tuple[int, SeenChunk]]:
    """Return the chunks that a view reads of a side that is ``seen``, each with the number of its
    reads. Raises the errors of ``Loader.ensure``.
    """
    light = SideLight(seen.side, seen.renderer)
    goal = goal_of_light(seen.renderer, seen.view, goal)
    texels = seen.renderer.texels(seen.view, seen.layers.gbuffer, tiles)
    # Light is final if it is at all levels that are mixed.
    levels = [read_light(loader, texels, goal, tiles) for loader in light.loaders]
    short = np.logical_or.reduce([reading.short for reading, _ in levels])
    versions = light.mixed_versions([versions for _, versions in levels])
    return [
        (count, SeenChunk((at[0] + light.behind, *at[1:]), version, not lacks))
        for count, at, version, lacks in zip(
            reads_of(texels).tolist(), texels.chunks, versions, short.tolist(), strict=True
        )
    ]


def known_light_of_sides(
    renderer: Renderer, view: View, chunks: Sequence[Index], goal: Goal, tiles: Tiles
) -> Packed:
    """Return the blocks of ``chunks`` in the lattice of all sides, under the light of a ``view``
    and at its isovalue; each is folded once for all that ask for it. Raises the errors of
    ``Loader.ensure``, and NoRoomError.
    """
    peeling = renderer.peeling
    if peeling is None:
        return known_light(renderer, view, chunks, goal, tiles)

    def find() -> dict[Index, Block]:
        blocks = dict[Index, Block]()
        for side, of_side in by_side(renderer, chunks).items():
            light = SideLight(side, peeling.renderer_of(side, view.isovalue))
            found = light.known(renderer, view, of_side, goal, tiles)
            places = ((at[0] + light.behind, *at[1:]) for at in of_side)
            blocks |= zip(places, found.blocks, strict=True)
            peeling.check_room()
        return blocks

    blocks = peeling.in_room(find)
    return Packed(tuple(blocks[at] for at in chunks))


def by_side(renderer: Renderer, chunks: Iterable[Index]) -> Mapping[Side, list[Index]]:
    """Return the ``chunks`` in the lattice of all sides by their side, as indices in the lattice of
    one side.
    """
    deep = renderer.prepared.chunks[0]
    sides = {side.peeled: side for side in sides_of(renderer.prepared.scene)}
    found = dict[Side, list[Index]]()
    for z, y, x in dict.fromkeys(chunks):
        found.setdefault(sides[z // deep], []).append((z % deep, y, x))
    return found


@dataclass(frozen=True, eq=False)
class SideLight:
    """The light of a ``side``, by the ``renderer`` of its pictures."""

    side: Side
    renderer: SurfaceRenderer

    @property
    def behind(self) -> int:
        """The number of chunks along z before those of the side in the lattice of all sides."""
        return self.side.peeled * self.renderer.prepared.chunks[0]

    @property
    def levels(self) -> tuple[Level, ...]:
        """The levels whose light is mixed."""
        return self.renderer.texel_shading.levels

    @property
    def loaders(self) -> tuple[Loader, ...]:
        """The loader of each level."""
        return tuple(level.caches.of("gi") for level in self.levels)

    def load(self, chunks: Sequence[Index], tiles: Tiles) -> None:
        """Load the light of ``chunks`` at all levels. Raises the errors of ``Loader.ensure``."""
        for loader in self.loaders:
            loader.ensure(chunks, tiles.check)

    def versions(self, chunks: Sequence[Index], tiles: Tiles) -> tuple[bytes, ...]:
        """Return the version of each of the ``chunks``, loaded now: it names the light of all
        levels, and their shares. Raises the errors of ``Loader.ensure``.
        """
        self.load(chunks, tiles)
        return self.mixed_versions([loader.pool.versions(chunks) for loader in self.loaders])

    def mixed_versions(self, versions: Iterable[Iterable[bytes]]) -> tuple[bytes, ...]:
        """Return one version of each chunk that names the light of all levels, and their shares,
        from its ``versions`` at each level.
        """
        return tuple(map(self._version, zip(*versions, strict=True)))

    def known(
        self, renderer: Renderer, view: View, chunks: Sequence[Index], goal: Goal, tiles: Tiles
    ) -> Packed:
        """Return ``fold`` of ``chunks`` in the unit of the scene's light, each folded once for all
        that ask the ``renderer``. Raises its errors.
        """
        unit = renderer.caches.spec("gi").unit
        # The light of pinned surfaces depends on the isovalue of the one that slides.
        kind = FOLDED, self.side, view.isovalue if self.side.number else None, goal
        return renderer.blocks.find(
            kind,
            chunks,
            lambda some: self.versions(some, tiles),
            lambda some: self.fold(view, some, goal, unit, tiles),
        )

    def fold(
        self, view: View, chunks: Sequence[Index], goal: Goal, unit: float, tiles: Tiles
    ) -> Packed:
        """Pack ``chunks`` with the light of their texels under the light of a ``view``, in a
        ``unit`` of radiance, as ``fold_chunks`` of ``blocks.py`` does for one surface. Raises
        Cancelled, and the errors of ``Loader.ensure``.
        """
        light = RotatedLight(self.renderer.caches.spec("gi"), replace(view, albedo=None))
        found, lit = self._read(chunks, light, goal, tiles)
        # The filter reads texels of the chunks around, too.
        if found.reading.grainy.any():
            every = with_neighbours(chunks, self.renderer.prepared)
            found, lit = self._read(every, light, goal, tiles, filtered=chunks)
        about, values = fold_light(self.renderer, found, lit, light, tiles)
        scale = np.float32(light.spec.unit / unit)
        # The chunks that are asked for come first, and then those around, which are not sent.
        blocks = pack(found, about, scale * values, FOLDED, self.behind)
        return packed(found, blocks, len(chunks), self.renderer.prepared)

    def _read(
        self,
        chunks: Sequence[Index],
        light: RotatedLight,
        goal: Goal,
        tiles: Tiles,
        filtered: Sequence[Index] = (),
    ) -> tuple[ChunkTexels, np.ndarray]:
        """Return all texels of ``chunks``, and their light, mixed of all levels. If only some are
        ``filtered``, of the others the texels near these alone are taken.
        """
        self.load(chunks, tiles)
        prepared = self.renderer.prepared
        near = near_texels(chunks, filtered, prepared) if filtered else None
        pools = [loader.pool for loader in self.loaders]
        with ExitStack() as stack:
            slots = [stack.enter_context(pool.hold(chunks)).slots for pool in pools]
            held = list(zip(pools, slots, strict=True))
            # A texel is there if it is at any level.
            there = np.logical_or.reduce([find_there(pool, some, near) for pool, some in held])
            texels = number_texels(find_occupied(chunks, slots[0], there), prepared)
            rows = np.flatnonzero(there.any(axis=1))
            found = []
            for pool, some in held:
                reading = read_texels(texels, some[rows], pool, goal, tiles)
                found.append((reading, light_sources(reading.sources(pool), light, tiles)))
            named = self.mixed_versions(map(pool.version, some.tolist()) for pool, some in held)
        reading, lit = mixed(self.levels, found)
        return ChunkTexels(tuple(chunks), named, texels, reading), lit

    def _version(self, versions: Sequence[bytes]) -> bytes:
        """Return the version of light that is mixed of ``versions``, one of each level."""
        if len(versions) == 1 or not any(map(any, versions)):
            return versions[0]
        shares = repr([level.share for level in self.levels]).encode()
        return hashlib.blake2b(b"".join([*versions, shares]), digest_size=8).digest()
