"""Bakes in memory: the light of a few texels, or of all that one view reads, and frames with it."""

import threading
import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.look import Look
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.refine import refine
from isogi_core.cache.chunk import Chunk
from isogi_core.cache.record import TEXELS
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texels import ViewTexels
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.plan import Layer
from isogi_core.model.view import View

NEVER = 1e-9
"""A target error that no texel reaches: all take as many samples as they are told to."""

PIECE = 256
"""Texels that one thread bakes in one go."""


class Bake:
    """The ``light`` of ``texels`` (m, 3; z, y, x) of a look; ``seconds`` of the processor were spent on it."""

    def __init__(self, tiles: Tiles, look: Look, layers: tuple[Layer, ...], texels: np.ndarray) -> None:
        """Begin with ``layers`` of darkness, to be baked on the threads of ``tiles``."""
        self.tiles, self.look, self.layers, self.texels = tiles, look, layers, texels
        self.light = dark(layers, len(texels))
        self.seconds = 0.0

    def grow(self, until: int, target: float = NEVER, cancelled: threading.Event | None = None) -> None:
        """Bring all texels to ``until`` samples each, or to the relative error ``target``. Raises Cancelled.

        What it calls is compiled before, on a texel of which nothing is kept.
        """
        first = self.texels[:1]
        refine(dark(self.layers, len(first)), first, self.look, FIRST_RUNG, NEVER)
        begun = time.process_time()

        def piece(a: int, b: int) -> None:
            light = self.light.rows(np.arange(a, b))
            refine(light, self.texels[a:b], self.look, until, target)
            self.light.put(np.arange(a, b), light)

        self.tiles.run(piece, len(self.texels), PIECE, cancelled)
        self.seconds += time.process_time() - begun

    @property
    def samples(self) -> float:
        """Mean samples of the texels that can hold light."""
        return float(np.maximum(self.light.samples, 0).sum() / max((~self.light.void).sum(), 1))


class ViewBake(Bake):
    """The light of the texels that a ``view`` reads: layers of its look's plan, or those told."""

    def __init__(self, renderer: Renderer, view: View, layers: tuple[Layer, ...] = ()) -> None:
        """Find the texels; they are in the order of the view's own numbers."""
        self.renderer, self.view = renderer, view
        self.shown = renderer.texels(view, renderer.gbuffer(view))
        look = renderer.caches.look(view.shading)
        super().__init__(renderer.tiles, look, layers or look.plan.layers, texels_of(self.shown))

    def frame(self, light: Light | None = None) -> Frame:
        """The view's frame with the bake's light, or with some ``light`` of the same texels.

        Raises StoreError where the memory for light cannot hold all of it.
        """
        pool, keep = self.renderer.caches.of(self.view.shading).pool, frozenset(self.shown.chunks)
        for chunk in self._chunks(light or self.light):
            pool.insert(chunk, keep)
        return self.renderer.render(self.view, NEVER)

    def _chunks(self, light: Light) -> Iterator[Chunk]:
        """The texels and their light, chunk by chunk."""
        shown = self.shown
        for index, offsets, (a, b) in zip(shown.chunks, shown.offsets, pairwise(shown.bounds.tolist()), strict=True):
            yield Chunk(index, offsets, light.rows(np.arange(a, b)))


def texels_of(shown: ViewTexels) -> np.ndarray:
    """Lattice indices (m, 3; z, y, x) int32 of a view's texels, in the order of its own numbers."""
    slots, offsets = np.divmod(shown.places.astype(np.int64), TEXELS)
    inside = np.stack(np.unravel_index(offsets, (CHUNK, CHUNK, CHUNK)), axis=-1)
    return (np.array(shown.chunks, np.int64).reshape(-1, 3)[slots] * CHUNK + inside).astype(np.int32)


def dark(layers: tuple[Layer, ...], texels: int) -> Light:
    """Light of the ``layers`` that no path was sent for yet."""
    return Light(tuple(Part.dark(layer, texels) for layer in layers))
