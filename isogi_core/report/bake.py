"""Bakes in memory: the light of a few texels, or of all that one view reads, and frames with it."""

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from isogi_core.bake.light import Light, Part
from isogi_core.bake.look import Look, look_name
from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.refine import refine
from isogi_core.cache.chunk import Chunks
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.sharpening import find_ways
from isogi_core.frame.texels import Demand, ViewTexels
from isogi_core.frame.tiles import Tiles
from isogi_core.model.plan import Layer
from isogi_core.model.view import View

NEVER = 1e-9
"""A target error that no texel reaches: all take as many samples as they are told to."""

PIECE = 256
"""Texels that one thread bakes in one go."""


class Bake:
    """The ``light`` of ``texels`` (m, 3; z, y, x) of a look; ``seconds`` of the processor were spent on it.

    Those with a ``level`` (m,) that is not NaN lie on the isosurface of that normalised isovalue.
    """

    def __init__(
        self,
        tiles: Tiles,
        look: Look,
        layers: tuple[Layer, ...],
        texels: np.ndarray,
        levels: np.ndarray | None = None,
    ) -> None:
        """Begin with ``layers`` of darkness, to be baked on the threads of ``tiles``; by default without levels."""
        self.tiles, self.look, self.layers, self.texels = tiles, look, layers, texels
        self.levels = np.full(len(texels), np.nan) if levels is None else levels
        self.light = dark(layers, len(texels))
        self.seconds = 0.0

    def grow(self, until: int, target: float = NEVER, cancelled: threading.Event | None = None) -> None:
        """Bring all texels to ``until`` samples each, or to the relative error ``target``. Raises Cancelled.

        What it calls is compiled before, on a texel of which nothing is kept.
        """
        self.grow_some(np.arange(len(self.texels)), until, target, cancelled)

    def grow_some(self, rows: np.ndarray, until: int, target: float, cancelled: threading.Event | None) -> None:
        """The same of the texels in some ``rows`` (m,)."""
        first = self.texels[:1]
        refine(dark(self.layers, len(first)), first, self.look, FIRST_RUNG, NEVER)
        begun = time.process_time()

        def piece(a: int, b: int) -> None:
            for look, own in self._looks(rows[a:b]):
                light = self.light.rows(own)
                refine(light, self.texels[own], look, until, target)
                self.light.put(own, light)

        self.tiles.run(piece, len(rows), PIECE, cancelled)
        self.seconds += time.process_time() - begun

    def _looks(self, rows: np.ndarray) -> Iterator[tuple[Look, np.ndarray]]:
        """The looks of the texels in some ``rows`` (m,), and the rows of each."""
        levels = self.levels[rows]
        for level in np.unique(levels).tolist():
            shown = None if math.isnan(level) else level
            own = np.isnan(levels) if shown is None else levels == level
            yield replace(self.look, shown=shown), rows[own]

    @property
    def samples(self) -> float:
        """Mean samples of the texels that can hold light, and were baked."""
        taken = self.light.samples
        return float(np.maximum(taken, 0).sum() / max((taken > 0).sum(), 1))

    @property
    def lights(self) -> int:
        """Texels that were baked, or found to be void."""
        return int((self.light.samples != 0).sum())


class ViewBake(Bake):
    """The light of the texels that a ``view`` reads: layers of its look's plan, or those told.

    Where its scene sharpens, those that are far from the view's isosurface are lit there too, after all others.
    """

    def __init__(self, renderer: Renderer, view: View, layers: tuple[Layer, ...] = ()) -> None:
        """Find the texels; they are in the order of the view's own numbers."""
        self.renderer, self.view = renderer, view
        self.shown = renderer.texels(view, renderer.gbuffer(view))
        look, places = renderer.caches.look(view.shading), self.shown.positions
        self.steep = steep_texels(renderer, view, self.shown)
        levels = np.full(len(places) + len(self.steep), np.nan)
        levels[len(places) :] = self.shown.gbuffer.isovalue
        texels = np.concatenate([places, places[self.steep]])
        super().__init__(renderer.tiles, look, layers or look.plan.layers, texels, levels)

    def grow(self, until: int, target: float = NEVER, cancelled: threading.Event | None = None) -> None:
        """As ``Bake.grow``; where the scene is adaptive and there is a ``target``, what its frames ask for alone."""
        if target == NEVER or not self.renderer.recipe.scene.adaptive:
            super().grow(until, target, cancelled)
            return
        rows = self._lacking(self._shown(self.light, target))
        while (self.light.samples[rows] < until).any():
            self.grow_some(rows, until, target, cancelled)
            rows = self._lacking(self._shown(self.light, target))

    def _lacking(self, frame: Frame) -> np.ndarray:
        """The rows of what a frame demands, sharp light last; (m,)."""
        rows = self._rows(frame.demands)
        if len(rows) or frame.sharpness is None:
            return rows
        sharp = np.isin(self.steep, self._rows(frame.sharpness.demands))
        return len(self.shown.places) + np.flatnonzero(sharp)

    def _rows(self, demands: tuple[Demand, ...]) -> np.ndarray:
        """The view's own numbers of what is demanded; (m,)."""
        shown = self.shown
        at = [shown.chunks.index(each.index) for each in demands]
        pairs = zip(at, demands, strict=True)
        found = [shown.bounds[i] + np.searchsorted(shown.offsets[i], each.offsets) for i, each in pairs]
        return np.concatenate([np.empty(0, np.int64), *found])

    def frame(self, light: Light | None = None) -> Frame:
        """The view's frame with the bake's light, or with some ``light`` of the same texels.

        Raises StoreError where the memory for light cannot hold all of it.
        """
        return self._shown(light or self.light, NEVER)

    def _shown(self, light: Light, target: float) -> Frame:
        """The same, final at the relative error ``target``."""
        caches, own = self.renderer.caches, len(self.shown.places)
        caches.of(self.view.shading).pool.insert(self._chunks(light, np.arange(own), 0), self.shown.chunks)
        if len(self.steep):
            sharp = self._chunks(light, self.steep, own)
            caches.sharp(self.shown.gbuffer.isovalue).pool.insert(sharp, self.shown.chunks)
        return self.renderer.render(self.view, target)

    def _chunks(self, light: Light, numbers: np.ndarray, first: int) -> Chunks:
        """The texels with these ``numbers`` in the view, and their light from row ``first`` on."""
        shown, counts = self.shown, np.diff(np.searchsorted(numbers, self.shown.bounds))
        some = np.flatnonzero(counts)
        offsets = np.concatenate([np.empty(0, np.int32), *shown.offsets])[numbers]
        indices = tuple(shown.chunks[i] for i in some.tolist())
        return Chunks(indices, np.cumsum([0, *counts[some]]), offsets, light.rows(first + np.arange(len(numbers))))


def steep_texels(renderer: Renderer, view: View, shown: ViewTexels) -> np.ndarray:
    """Numbers of a view's texels that are to be sharp as well: none where its scene does not sharpen."""
    scene = renderer.recipe.scene
    if not scene.sharpen or look_name(view.shading) != "gi":
        return np.empty(0, np.int64)
    return np.flatnonzero(find_ways(shown, renderer.recipe, renderer.tiles).steep(scene.target_error))


def dark(layers: tuple[Layer, ...], texels: int) -> Light:
    """Light of the ``layers`` that no path was sent for yet."""
    return Light(tuple(Part.dark(layer, texels) for layer in layers))
