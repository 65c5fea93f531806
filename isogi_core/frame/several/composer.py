"""The composer: renders each side of several surfaces by a renderer of its own, and adds the frames up."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import ViewError
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.several.peels import Peels, first_of, layers_of, peel
from isogi_core.frame.several.surfaces_frame import Part, SurfacesFrame, compose, wrong_of
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_keys import surface_key
from isogi_core.lru_cache import LruCache
from isogi_core.model.view import View
from isogi_core.plan.scene import SURVEYED
from isogi_core.plan.sides import OUTER, Side, scene_of_side, sides_of, surfaces_of
from isogi_core.prepared.prepared_scene import PreparedScene

SHOWN = 2
"""Isovalues whose light on pinned surfaces is held in memory: those that were shown last."""


class SideRenderer(Protocol):
    """A renderer of the scene of one side."""

    caches: Caches

    @property
    def nbytes(self) -> int:
        """Bytes of memory that it takes."""

    def draw_on(self, gbuffer: GBuffer, view: View, target: float, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of what a view shows of the side."""

    def refine_frame(self, frame: Frame, target: float, tiles: Tiles, finer: bool) -> bool:
        """Bring a frame a step nearer to the target; whether there was one."""


Make = Callable[[Caches], SideRenderer]


class Composer:
    """Draws views of a scene with several surfaces. Safe to use from many threads."""

    def __init__(self, caches: Caches, own: SideRenderer, make: Make, kept: LruCache[Any]) -> None:
        """The scene's ``own`` renderer, of ``caches``, draws the outer side of the surface that slides; ``make`` makes
        the others'. Peels are among what is ``kept`` of views.
        """
        self._caches, self._own, self._make, self._kept = caches, own, make, kept
        self._scene = caches.prepared.scene
        self._inner: PreparedScene | None = None
        self._sides: OrderedDict[tuple[Side, float | None], SideRenderer] = OrderedDict()
        self._surveyed: dict[Side, dict[str, Any]] = {}
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes of memory that the other sides take."""
        with self._lock:
            return sum(each.nbytes for each in self._sides.values())

    def draw(self, view: View, target: float, tiles: Tiles, watch: Stopwatch) -> SurfacesFrame:
        """The frame of a view with the light that is there now. Raises Cancelled, and ViewError through a window."""
        if view.window is not None:
            raise ViewError("A window looks into one surface, and this scene has several: leave window out, or cut.")
        with watch.stage("primary"):
            peels = self.peels(view, tiles)
        parts = []
        for side, layers in peels.sides.items():
            renderer = self.renderer(side, view.isovalue)
            frame = renderer.draw_on(layers.gbuffer, self._view_of(side, view, layers.layers), target, tiles, watch)
            parts.append(Part(side, layers, frame, renderer.caches))
        with watch.stage("compose"):
            return compose(view, peels, parts, watch, target)

    def peels(self, view: View, tiles: Tiles) -> Peels:
        """All that a view shows, layer behind layer. Raises Cancelled."""
        return self._kept.get((Peels, surface_key(view)), lambda: self._peels(view, tiles))

    def refine(self, view: View, target: float, tiles: Tiles) -> bool:
        """Bring the picture of a view whose light is final a step nearer to the ``target``; whether there was one.

        The side that errs most, as far as is known, comes first.
        """
        frame = self.draw(view, target, tiles, Stopwatch())
        waiting = sorted((part for part in frame.parts if part.frame.checkable), key=wrong_of, reverse=True)
        if not frame.checkable:
            return False
        return any(
            self.renderer(part.side, view.isovalue).refine_frame(part.frame, target, tiles, False) for part in waiting
        )

    def renderer(self, side: Side, shown: float) -> SideRenderer:
        """The renderer of a ``side``, where the surface that slides shows the isovalue ``shown``."""
        if side == OUTER:
            return self._own
        key = side, shown if side.number else None
        with self._lock:
            if key not in self._sides:
                self._sides[key] = self._make(self._caches_of(side, shown))
            self._sides.move_to_end(key)
            while len(self._sides) > SHOWN * len(sides_of(self._scene)):
                self._sides.popitem(last=False)
            return self._sides[key]

    def _caches_of(self, side: Side, shown: float) -> Caches:
        """Caches of a side's light; what was worked out of the volume for other sides serves it too."""
        scene = scene_of_side(self._scene, side, shown)
        vars(scene).update(self._surveyed.get(side, {}))
        if not side.inner:
            prepared = self._caches.prepared.beside(scene)
        elif self._inner is None:
            prepared = self._inner = PreparedScene(scene, self._caches.prepared.most)
        else:
            prepared = self._inner.beside(scene)
        scene.projection  # noqa: B018 - surveyed once for all isovalues that are shown
        self._surveyed[side] = {name: found for name, found in vars(scene).items() if name in SURVEYED}
        budget = self._caches.budget // (SHOWN * len(sides_of(self._scene)))
        return Caches(prepared, self._caches.store, budget, makes=False)

    def _view_of(self, side: Side, view: View, layers: int) -> View:
        """The view of a side's tall picture."""
        isovalue = surfaces_of(self._scene, view.isovalue)[side.number].isovalue
        return replace(view, isovalue=isovalue, height=layers * view.height, strip=None, smooth=False, albedo=None)

    def _peels(self, view: View, tiles: Tiles) -> Peels:
        """All that a view shows."""
        every = surfaces_of(self._scene, view.isovalue)
        surfaces = [self._caches.prepared.surface(each.isovalue) for each in every]
        hits, left = peel(view, surfaces, np.array([each.clear for each in every]), tiles)
        first, sides = first_of(view, hits, surfaces[0]), {}
        for side in sides_of(self._scene):
            some = (hits.numbers == side.number) & (hits.inner == side.inner)
            if some.any():
                prepared = self.renderer(side, view.isovalue).caches.prepared
                sides[side] = layers_of(hits, some, first, prepared.surface(every[side.number].isovalue))
        return Peels(first, sides, left)
