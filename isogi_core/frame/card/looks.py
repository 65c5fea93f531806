"""Looks: the chunks that a view reads, for cards that ask for their light."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import Until
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.scene_caches import Loader
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer, undrawn_frame
from isogi_core.frame.texel_reading import read_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index

SEEN_BYTES = 256
"""Bytes that a chunk in a list of those seen takes in memory."""


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
