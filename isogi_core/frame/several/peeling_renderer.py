"""Draw scenes with several surfaces by depth peeling: a shot of each side, drawn by a renderer of
its own, and their sum.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import NoRoomError
from isogi_core.frame.eye_glow import EyeGlow
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer, surface_key
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.several.composed_frame import (
    ComposedFrame,
    Part,
    compose,
    step_key,
    to_refine,
)
from isogi_core.frame.several.mixed_reading import Level
from isogi_core.frame.several.peels import (
    Peeler,
    Peels,
    SideLayers,
    first_of,
    side_layers,
    walls_of,
)
from isogi_core.frame.several.smoothing import smooth_surfaces
from isogi_core.frame.surface_renderer import SurfaceRenderer
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import WorkLeft, known_error
from isogi_core.model.view import View
from isogi_core.plan.isovalue_levels import levels_around
from isogi_core.plan.variants import OUTER, WALLS_SIDE, Side, scene_of_side, sides_of, surfaces_of
from isogi_core.prepared.prepared_scene import PreparedScene

Found = TypeVar("Found")

SHOWN = 2
"""Number of isovalues of the sliding surface for which views of pinned surfaces are kept."""

HELD = 3 * SHOWN
"""Number of isovalues for which light is kept: for each that is shown, the two levels around it and
the isovalue itself.
"""


class SeenSide(NamedTuple):
    """A ``side`` of a surface that a view shows: its ``layers``, the ``view`` of these as one tall
    picture, and the ``renderer`` of its light.
    """

    side: Side
    layers: SideLayers
    view: View
    renderer: SurfaceRenderer


class PeelingRenderer:
    """Draws and refines pictures of a scene with several surfaces. Safe to use from many threads.

    Its ``picture`` is a list of shots, one of each side that is seen, and their sum.
    """

    def __init__(self, outer: SurfaceRenderer) -> None:
        """Have ``outer`` draw the outer side of the surface that slides, and the walls; and each
        other side a renderer ``beside`` it. Peels are kept with the results of ``outer``.
        """
        self._outer = outer
        self._caches = outer.caches
        self._scene = outer.prepared.scene
        self._inner: PreparedScene | None = None
        self._sides: OrderedDict[tuple[Side, float | None], SurfaceRenderer] = OrderedDict()
        self._held: OrderedDict[tuple[Side, float | None], Caches] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """The bytes of memory that all sides take."""
        with self._lock:
            views = sum(each.nbytes - each.caches.nbytes for each in self._sides.values())
            light = sum(each.nbytes for each in self._held.values())
        return self._outer.nbytes + views + light

    def picture(self, view: View, goal: Goal, tiles: Tiles, watch: Stopwatch) -> Frame:
        """Draw the picture of a ``view``: its sides, and the glow in front of them.

        Raises Cancelled, ViewError if the view asks for glow and nothing glows, and NoRoomError if
        the light of this view alone takes more than the budget.
        """
        return self._outer.add_glow(self.draw(view, goal, tiles, watch), tiles, watch)

    def draw(self, view: View, goal: Goal, tiles: Tiles, watch: Stopwatch) -> ComposedFrame:
        """Draw all sides that a ``view`` shows, and add them up. Raises Cancelled and
        NoRoomError.
        """
        return self.in_room(lambda: self._draw_sides(view, goal, tiles, watch))

    def in_room(self, work: Callable[[], Found]) -> Found:
        """Run ``work``, which asks for renderers of sides, reads the light of one isovalue, and
        checks the room of each side; if memory is full, drop the light of all sides and run it
        again. Raises its errors, and NoRoomError if its light alone does not fit.
        """
        try:
            return work()
        except NoRoomError:
            # Light of other isovalues may take the room: drop all, and read again the light of this
            # work alone.
            self._let_go()
            return work()

    def _draw_sides(self, view: View, goal: Goal, tiles: Tiles, watch: Stopwatch) -> ComposedFrame:
        """Draw and add up all sides, with the light of other isovalues in memory."""
        with watch.stage("primary"):
            peels = self._peels(view, tiles)
        parts = []
        # Shoot each side as a tall picture of its layers, and have its renderer draw it; walls are
        # one side, without a surface.
        for side, layers in peels.sides.items():
            renderer = self.renderer_of(side, view.isovalue)
            if side == WALLS_SIDE:
                shot = renderer.shot(view, peels.walls, goal, tiles, watch)
                frame = renderer.draw_walls(shot)
            else:
                tall = self._view_of(side, view, layers.layers)
                shot = renderer.shot(tall, layers.gbuffer, goal, tiles, watch)
                frame = renderer.draw(shot)
                self.check_room()
            parts.append(Part(side, layers, frame, renderer.caches))
        # Add up all sides by the weights of their layers.
        with watch.stage("compose"):
            return compose(view, peels, parts, watch, goal.error, self._scene)

    def refine(self, view: View, goal: Goal, tiles: Tiles, prices: Prices) -> bool:
        """Take one step of the picture of a ``view``, whose light is final, towards the ``goal``;
        return False if there is no step to take.

        Sides have no finer texels, whatever the ``prices``. Raises Cancelled and NoRoomError.
        """
        frame = self.draw(view, goal, tiles, Stopwatch())
        if not frame.refinable:
            return False
        # Walls that lag behind may take a step while sides still wait for light.
        waiting = [
            part
            for part in frame.parts
            if part.frame.checkable and (frame.checkable or part.side == WALLS_SIDE)
        ]
        # Walls that are coarse come first. Then measure all sides before any takes other steps:
        # together they may be at the target while one of them is not. After that the side with the
        # largest error takes the step, or else the next that has a step to take.
        for part in sorted(waiting, key=step_key, reverse=True):
            renderer = self.renderer_of(part.side, view.isovalue)
            if renderer.refine_frame(part.frame, goal, tiles, prices.of_present):
                return True
        return False

    def work_left(self, frame: Frame, goal: Goal) -> tuple[WorkLeft, ...]:
        """Return the work that is left until a ``frame`` reaches its ``goal``: of each side, and of
        its walls.
        """
        if not isinstance(frame, ComposedFrame):
            return ()
        # Sides whose texels have no light yet are taken to need as many samples as those that have
        # some.
        readings = [part.frame.quality.lacking for part in frame.parts]
        efforts = [lacking.reading.effort for lacking in readings if lacking is not None]
        effort = float(np.median([each for each in efforts if each] or [0.0]))
        errors = {part.side: known_error(part.frame, effort) for part in frame.parts}
        refined = to_refine(frame, errors, goal.error)
        found = list[WorkLeft]()
        for part in frame.parts:
            renderer = self.renderer_of(part.side, frame.view.isovalue)
            if part.side == WALLS_SIDE:
                found += renderer.walls_left(part.frame, goal) if part in refined else ()
                continue
            # A side whose error is small takes no steps, but is measured.
            if part in refined:
                found.append(renderer.checks.work_left(part.frame, goal, part.light, effort))
            else:
                found.append(renderer.checks.measuring_left(part.frame, goal, part.light))
        return tuple(found)

    def smooth(self, frame: Frame, tiles: Tiles) -> Frame:
        """Return the ``frame`` of a picture with more samples at its edges: where neighbouring
        pixels differ as a screen shows them, at the scene's exposure. Raises Cancelled.
        """
        glow = EyeGlow.of(self._caches.prepared, frame.view.glow)
        exposure = self._scene.default_exposure
        return smooth_surfaces(frame, self._peeler(frame.view, tiles), exposure, tiles, glow)

    def gbuffer(self, view: View, tiles: Tiles) -> GBuffer:
        """Return the G-buffer of the surfaces and walls in front in a ``view``, kept or peeled now.
        Raises Cancelled.
        """
        return self._peels(view, tiles).first

    def sees(self, view: View) -> bool:
        """Return True if the peels of a ``view`` are kept."""
        return self._outer.kept.held((Peels, surface_key(view))) is not None

    def seen(self, view: View, tiles: Tiles) -> tuple[SeenSide, ...]:
        """Return all sides of surfaces that a ``view`` shows, without the walls. Raises
        Cancelled.
        """
        return tuple(
            SeenSide(
                side,
                layers,
                self._view_of(side, view, layers.layers),
                self.renderer_of(side, view.isovalue),
            )
            for side, layers in self._peels(view, tiles).sides.items()
            if side != WALLS_SIDE
        )

    def renderer_of(self, side: Side, shown: float) -> SurfaceRenderer:
        """Return the renderer of a ``side``, or of WALLS_SIDE, while the surface that slides
        shows the isovalue ``shown``.
        """
        if side in (OUTER, WALLS_SIDE):
            return self._outer
        key = side, shown if side.number else None
        with self._lock:
            if key not in self._sides:
                # Light of pinned surfaces depends on the isovalue that slides. It is baked at some
                # levels of that isovalue, and views mix the light of the two levels around it.
                if side.number:
                    pinned = [each.isovalue for each in self._scene.surfaces.pinned]
                    levels = levels_around(self._scene.levels, pinned, shown)
                else:
                    levels = ((shown, 1.0),)
                mix = tuple(Level(self._caches_of(side, level), share) for level, share in levels)
                if len(mix) == 1:
                    caches = mix[0].caches
                else:
                    caches = self._caches_of(side, shown)
                self._sides[key] = self._outer.beside(caches, mix)
            return newest(self._sides, key, SHOWN * len(sides_of(self._scene)))

    def _caches_of(self, side: Side, shown: float) -> Caches:
        """Return the caches of a side's light while the sliding surface shows the isovalue
        ``shown``, kept or made now. The caller holds the lock.
        """
        # Light of the sliding surface (number 0) is kept on each texel's isosurface, and serves
        # every isovalue; that of pinned surfaces depends on where the sliding one is.
        key = side, shown if side.number else None
        if key not in self._held:
            self._held[key] = self._make_caches(side, shown)
        return newest(self._held, key, HELD * len(sides_of(self._scene)))

    def _make_caches(self, side: Side, shown: float) -> Caches:
        """Make caches of a side's light. They share all that other sides have worked out of the
        volume.
        """
        scene = scene_of_side(self._scene, side, shown)
        # Inner sides are lit in the volume turned inside out, which they share.
        if not side.inner:
            prepared = self._caches.prepared.beside(scene)
        elif self._inner is None:
            prepared = self._inner = PreparedScene(scene, self._caches.prepared.most)
        else:
            prepared = self._inner.beside(scene)
        return Caches(prepared, self._caches.store, self._caches.budget, makes=False)

    def check_room(self) -> None:
        """Raise NoRoomError if the light of all other sides takes more than the budget."""
        with self._lock:
            taken = sum(each.nbytes for each in self._held.values())
        if taken > self._caches.budget:
            raise NoRoomError(
                f"The light of this view takes {taken >> 20} MB, and may take "
                f"{self._caches.budget >> 20}:"
                " ask for a closer view or fewer pixels, or give light more memory."
            )

    def _let_go(self) -> None:
        """Drop the light of all other sides, and their renderers."""
        with self._lock:
            self._sides.clear()
            self._held.clear()

    def _view_of(self, side: Side, view: View, layers: int) -> View:
        """Return the view of a side's tall picture of ``layers`` layers: of the isovalue of
        its surface, with the albedo of the scene.
        """
        isovalue = surfaces_of(self._scene, view.isovalue)[side.number].isovalue
        return replace(
            view,
            isovalue=isovalue,
            height=layers * view.height,
            strip=None,
            smooth=False,
            albedo=None,
        )

    def _peels(self, view: View, tiles: Tiles) -> Peels:
        """Return all that a view shows, layer behind layer, kept or peeled now. Raises
        Cancelled.
        """
        return self._outer.kept.get((Peels, surface_key(view)), lambda: self._peel(view, tiles))

    def _peel(self, view: View, tiles: Tiles) -> Peels:
        """Cast the rays of a view through all surfaces and walls, and sort the hits by the sides
        that they are on. Raises Cancelled.
        """
        surfaces = surfaces_of(self._scene, view.isovalue)
        hits, left = self._peeler(view, tiles).whole(view, tiles)
        first = first_of(view, hits, self._caches.prepared.surface(view.isovalue))
        # Stack the layers of each side that is seen into one tall picture. Its surface is made by
        # the side's prepared scene: inside out, with cells that are active there.
        sides = {}
        for side in sides_of(self._scene):
            if len(hits.rows_of(side)):
                prepared = self.renderer_of(side, view.isovalue).prepared
                surface = prepared.surface(surfaces[side.number].isovalue)
                sides[side] = side_layers(hits, side, first, surface)
        walls, seen = walls_of(hits, first)
        if seen is not None:
            sides[WALLS_SIDE] = seen
        return Peels(first, sides, left, walls)

    def _peeler(self, view: View, tiles: Tiles) -> Peeler:
        """Return the peeler that casts rays of a view at all surfaces and walls."""
        prepared = self._caches.prepared
        shown = surfaces_of(self._scene, view.isovalue)
        surfaces = [prepared.surface(each.isovalue) for each in shown]
        clears = np.array([each.clear for each in shown])
        return Peeler.of(view, surfaces, clears, tiles, prepared.walls_in_view)


Kept = TypeVar("Kept")


def newest(kept: OrderedDict[Any, Kept], key: Any, most: int) -> Kept:
    """Return the entry of ``kept`` by ``key``, which must be there, and mark it as used last. Drop
    those used longest ago beyond ``most``, which is at least 1.
    """
    kept.move_to_end(key)
    while len(kept) > most:
        kept.popitem(last=False)
    return kept[key]
