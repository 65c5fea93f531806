"""Looks: lists of the chunks that a view reads, for cards, which then ask for their light."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Loader
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer, undrawn_frame
from isogi_core.frame.surface_renderer import SurfaceRenderer
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.model.view import View
from isogi_core.prepared.prepared_scene import Index

SEEN_BYTES = 256
"""Bytes of memory that a chunk in a list takes."""


class SeenChunk(NamedTuple):
    """A chunk that a view reads: its index ``at``, its ``version``, and ``final`` if all of it
    that the view reads is final.
    """

    at: Index
    version: bytes
    final: bool


@dataclass(frozen=True, eq=False)
class Look:
    """The chunks that a view reads, those of most pixels first.

    If some are not final, ``frame`` is one that is not drawn, and tells the light that is lacking.
    """

    seen: tuple[SeenChunk, ...]
    frame: Frame | None

    @property
    def nbytes(self) -> int:
        """The bytes that it takes if all light is final."""
        return SEEN_BYTES * len(self.seen)

    def is_current(self, loader: Loader, tiles: Tiles) -> bool:
        """Return True if no chunk was baked on since. Raises the errors of ``Loader.ensure``."""
        chunks = [each.at for each in self.seen]
        loader.ensure(chunks, tiles.check)
        return loader.pool.versions(chunks) == tuple(each.version for each in self.seen)


def seen_chunks(renderer: Renderer, view: View, goal: Goal, tiles: Tiles) -> tuple[SeenChunk, ...]:
    """Return the chunks that a ``view`` reads, those of most pixels first. Raises the errors of
    ``fold_chunks``.
    """
    return look_at(renderer, view, goal, tiles).seen


def look_at(renderer: Renderer, view: View, goal: Goal, tiles: Tiles) -> Look:
    """Return the look of a ``view`` whose picture has a ``goal``; looks at final light are kept for
    all that ask. Raises the errors of ``fold_chunks``.
    """
    goal = goal_of_light(renderer.surface, view, goal)
    loader = renderer.caches.of("gi")
    # A kept look is used until one of its chunks has been baked on.
    known: Look | None = renderer.looks.held((view, goal))
    if known is not None and known.is_current(loader, tiles):
        return known
    renderer.looks.drop((view, goal))
    look = new_look(renderer, view, goal, loader, tiles)
    # Looks at light that is still to be baked change soon, and are not kept.
    if look.frame:
        return look
    return renderer.looks.get((view, goal), lambda: look)


def new_look(renderer: Renderer, view: View, goal: Goal, loader: Loader, tiles: Tiles) -> Look:
    """Find the chunks that a ``view`` reads, by its rays."""
    texels = renderer.surface.texels(view, renderer.gbuffer(view, tiles), tiles)
    reading, versions = read_light(loader, texels, goal, tiles)
    order = np.argsort(-reads_of(texels), kind="stable").tolist()
    seen = tuple(SeenChunk(texels.chunks[i], versions[i], not reading.short[i]) for i in order)
    if not reading.short.any():
        return Look(seen, None)
    return Look(seen, undrawn_frame(renderer, view, texels, reading))


def goal_of_light(renderer: SurfaceRenderer, view: View, goal: Goal) -> Goal:
    """Return the goal by which light that a ``view`` reads is final, if its picture has a ``goal``:
    with the samples that a check of the picture asks for, if there is one.
    """
    check = renderer.checks.held(view, goal)
    return check.known.goal if check else goal


def read_light(
    loader: Loader, texels: ViewTexels, goal: Goal, tiles: Tiles
) -> tuple[Reading, tuple[bytes, ...]]:
    """Return the reading of a view's ``texels``, loaded now, and the version of each of their
    chunks. Raises the errors of ``Loader.ensure``, and Cancelled.
    """
    loader.ensure(texels.chunks, tiles.check)
    with loader.pool.hold(texels.chunks) as held:
        reading = read_texels(texels, held.slots, loader.pool, goal, tiles)
        return reading, tuple(map(loader.pool.version, held.slots.tolist()))


def reads_of(texels: ViewTexels) -> np.ndarray:
    """Return the number of times that a view reads each chunk of its ``texels``, eight for each of
    its points; (chunks,) int64.
    """
    read = texels.places[texels.corners].ravel() >> 3 * texels.lattice.bits
    return np.bincount(read, minlength=len(texels.chunks))
