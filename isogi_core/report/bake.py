"""A bake in memory: the light of the texels that one view reads, and frames with it."""

import threading
import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.refine import refine
from isogi_core.cache.chunk import Chunk
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.model.plan import Layer
from isogi_core.model.view import View

NEVER = 1e-9
"""A target error that no texel reaches: all take as many samples as they are told to."""

PIECE = 256
"""Texels that one thread bakes in one go."""


class Bake:
    """The light of the texels that ``view`` reads: layers of its look's plan, or those told.

    ``texels`` (m, 3; z, y, x) are in the order of the view's own numbers; ``seconds`` of the processor were spent.
    """

    def __init__(self, renderer: Renderer, view: View, layers: tuple[Layer, ...] = ()) -> None:
        """Find the texels, all dark."""
        self.renderer, self.view = renderer, view
        self.look = renderer.caches.look(view.shading)
        self.shown = renderer.texels(view, renderer.gbuffer(view))
        self.layers = layers or self.look.plan.layers
        self.light = dark(self.layers, len(self.shown.places))
        self.texels = np.concatenate([chunk.positions(chunk.offsets) for chunk in self._chunks(self.light)])
        self.seconds = 0.0

    def grow(self, until: int, target: float = NEVER, cancelled: threading.Event | None = None) -> None:
        """Bring all texels to ``until`` samples each, or to the relative error ``target``. Raises Cancelled.

        What it calls is compiled before, on a texel of which nothing is kept.
        """
        first = np.arange(min(len(self.texels), 1))
        refine(dark(self.layers, len(first)), self.texels[first], self.look, FIRST_RUNG, NEVER)
        begun = time.process_time()

        def piece(a: int, b: int) -> None:
            light = self.light.rows(np.arange(a, b))
            refine(light, self.texels[a:b], self.look, until, target)
            self.light.put(np.arange(a, b), light)

        self.renderer.tiles.run(piece, len(self.texels), PIECE, cancelled)
        self.seconds += time.process_time() - begun

    def frame(self, light: Light | None = None) -> Frame:
        """The view's frame with the bake's light, or with some ``light`` of the same texels."""
        pool = self.renderer.caches.of(self.view.shading).pool
        for chunk in self._chunks(light or self.light):
            pool.insert(chunk)
        return self.renderer.render(self.view, NEVER)

    @property
    def samples(self) -> float:
        """Mean samples of the texels that can hold light."""
        return float(np.maximum(self.light.samples, 0).sum() / max((~self.light.void).sum(), 1))

    def _chunks(self, light: Light) -> Iterator[Chunk]:
        """The texels and their light, chunk by chunk."""
        bounds = self.shown.bounds.tolist()
        for demand, (a, b) in zip(self.shown.demands, pairwise(bounds), strict=True):
            yield Chunk(demand.index, demand.offsets, light.rows(np.arange(a, b)))


def dark(layers: tuple[Layer, ...], texels: int) -> Light:
    """Light of the ``layers`` that no path was sent for yet."""
    return Light(tuple(Part.dark(layer, texels) for layer in layers))
