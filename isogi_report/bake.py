"""Bakes in memory: the light of a few texels, or of all that one view reads, and frames with it."""

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from isogi_core.bake.bake_spec import BakeSpec, spec_name
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import FIRST_LEVEL, Light, Part
from isogi_core.cache.chunk_record import Chunks
from isogi_core.frame.frame import Frame
from isogi_core.frame.projected_texels import find_distances
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import View

UNREACHED_TARGET = 1e-9
"""A target error that no texel reaches: all take as many samples as they are asked for."""

TEXELS_A_PIECE = 256
"""Texels that one thread bakes in one go."""


class Bake:
    """The ``light`` of ``texels`` (m, 3; z, y, x) of a look; ``seconds`` of the processor were spent on it.

    Those with a ``level`` (m,) that is not NaN lie on the isosurface of that normalised isovalue.
    """

    def __init__(
        self,
        tiles: Tiles,
        spec: BakeSpec,
        layers: tuple[Layer, ...],
        texels: np.ndarray,
        levels: np.ndarray | None = None,
    ) -> None:
        """Begin with ``layers`` of darkness, to be baked on the threads of ``tiles``; by default without levels."""
        self.tiles, self.spec, self.layers, self.texels = tiles, spec, layers, texels
        self.levels = np.full(len(texels), np.nan) if levels is None else levels
        self.light = dark(layers, len(texels))
        self.seconds = 0.0

    def grow(self, until: int, target: float = UNREACHED_TARGET) -> None:
        """Bring all texels to ``until`` samples each, or to what is final for a ``target`` error. Raises Cancelled.

        What it calls is compiled before, on a texel of which nothing is kept.
        """
        first = self.texels[:1]
        refine(dark(self.layers, len(first)), first, self.spec, FIRST_LEVEL, UNREACHED_TARGET)
        begun = time.process_time()

        def piece(a: int, b: int) -> None:
            for spec, rows in self._specs(a, b):
                light = self.light.rows(rows)
                refine(light, self.texels[rows], spec, until, target)
                self.light.put(rows, light)

        self.tiles.run(piece, len(self.texels), TEXELS_A_PIECE)
        self.seconds += time.process_time() - begun

    def _specs(self, a: int, b: int) -> Iterator[tuple[BakeSpec, np.ndarray]]:
        """The bake specs of texels ``a`` … ``b``, and the rows of each."""
        levels = self.levels[a:b]
        for level in np.unique(levels).tolist():
            shown = None if math.isnan(level) else level
            own = np.isnan(levels) if shown is None else levels == level
            yield replace(self.spec, shown=shown), a + np.flatnonzero(own)

    @property
    def samples(self) -> float:
        """Mean samples of the texels that can hold light."""
        return float(np.maximum(self.light.samples, 0).sum() / max((~self.light.void).sum(), 1))


class ViewBake(Bake):
    """The light of the texels that a ``view`` reads: layers of its scene's plan, or those given.

    Where projection pays, those that are far from the view's isosurface are lit there too, after all others.
    """

    def __init__(self, renderer: Renderer, view: View, layers: tuple[Layer, ...] = ()) -> None:
        """Find the texels; they are in the order of the view's own numbers."""
        self.renderer, self.view = renderer, view
        self.shown = renderer.texels(view, renderer.gbuffer(view))
        spec, places = renderer.caches.spec(view.shading), self.shown.positions
        self.distant = distant_texels(renderer, view, self.shown)
        levels = np.full(len(places) + len(self.distant), np.nan)
        levels[len(places) :] = self.shown.gbuffer.isovalue
        texels = np.concatenate([places, places[self.distant]])
        super().__init__(renderer.tiles, spec, layers or spec.plan.layers, texels, levels)

    def frame(self, light: Light | None = None) -> Frame:
        """The view's frame with the bake's light, or with some ``light`` of the same texels.

        Raises StoreError where the memory for light cannot hold all of it.
        """
        caches, light, own = self.renderer.caches, light or self.light, len(self.shown.places)
        self.show(light, np.arange(own))
        if len(self.distant):
            projected = self._chunks(light, self.distant, own)
            caches.projected(self.shown.gbuffer.isovalue).pool.insert(projected, self.shown.chunks)
        return self.renderer.render(self.view, UNREACHED_TARGET)

    def show(self, light: Light, numbers: np.ndarray) -> None:
        """Have frames read this ``light`` of the view's texels with these ``numbers``, and none of others."""
        pool = self.renderer.caches.of(self.view.shading).pool
        pool.insert(self._chunks(light, numbers, 0), self.shown.chunks)

    def _chunks(self, light: Light, numbers: np.ndarray, first: int) -> Chunks:
        """The texels with these ``numbers`` in the view, and their light from row ``first`` on."""
        shown, counts = self.shown, np.diff(np.searchsorted(numbers, self.shown.bounds))
        some = np.flatnonzero(counts)
        offsets = np.concatenate([np.empty(0, np.int32), *shown.offsets])[numbers]
        indices = tuple(shown.chunks[i] for i in some.tolist())
        return Chunks(indices, np.cumsum([0, *counts[some]]), offsets, light.rows(first + np.arange(len(numbers))))


def distant_texels(renderer: Renderer, view: View, shown: ViewTexels) -> np.ndarray:
    """Numbers of a view's texels that are to be projected as well: none where that does not pay."""
    scene = renderer.prepared.scene
    if spec_name(view.shading) != "gi" or not scene.projection.projects(shown.gbuffer.isovalue):
        return np.empty(0, np.int64)
    return np.flatnonzero(find_distances(shown, renderer.prepared, renderer.tiles).beyond(scene.target_error))


def dark(layers: tuple[Layer, ...], texels: int) -> Light:
    """Light of the ``layers`` that no path was sent for yet."""
    return Light(tuple(Part.dark(layer, texels) for layer in layers))
