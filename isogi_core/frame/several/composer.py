"""Pictures of several surfaces: a renderer lights each side, frames and walls are added up, and
edges smoothed.

Samples at edges are peeled as pixels are, and each layer borrows light of the same layer near by.
"""

import hashlib
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from isogi_core.bake.noise import Until
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import NoRoomError
from isogi_core.frame.eye_glow import EyeGlow, rays_through
from isogi_core.frame.film import find_edges, lit, places_in, shown_by
from isogi_core.frame.frame import EdgeSamples, Frame, Layer, Quality
from isogi_core.frame.framing import paint_faces
from isogi_core.frame.gbuffer import TILE_RAYS, surface_key
from isogi_core.frame.rays.control_pixels import TotalError
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.several.peels import (
    Hits,
    Peeler,
    Peels,
    SideLayers,
    first_of,
    side_layers,
    walls_of,
)
from isogi_core.frame.surface_renderer import SurfaceRenderer
from isogi_core.frame.texel_reading import Level, Stage
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_texels import Demand
from isogi_core.kernels.shading.edges import Shown, borrow_light
from isogi_core.kernels.shading.framebuffer import FINAL, Framebuffer
from isogi_core.kernels.tracing.camera import WINDOW_FACE
from isogi_core.kernels.tracing.peels import FIRST_WALL_SIDE
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import View
from isogi_core.plan.isovalue_levels import levels_around
from isogi_core.plan.scene import Scene
from isogi_core.plan.variants import OUTER, WALLS_SIDE, Side, scene_of_side, sides_of, surfaces_of
from isogi_core.prepared.prepared_scene import PreparedScene

MIN_SHOWN_LUMINANCE = 1e-30
"""Luminance below which relative errors are of nothing."""


@dataclass(frozen=True, eq=False)
class Part:
    """What a picture shows of a ``side``, or of WALLS_SIDE: its ``layers``, their tall ``frame``,
    and the ``caches`` of its light.
    """

    side: Side
    layers: SideLayers
    frame: Frame
    caches: Caches

    @property
    def weight(self) -> float:
        """The sum of the squares of what its points count in their pixels."""
        return float((self.layers.weights.astype(np.float64) ** 2).sum())

    def seen(self, values: np.ndarray) -> np.ndarray:
        """The ``values`` of a tall picture at its points."""
        return np.asarray(values.reshape(-1, *values.shape[2:])[self.layers.gbuffer.pixels])

    @property
    def measured(self) -> TotalError | None:
        """The total error by control pixels; walls have no control pixels, and report their
        noise.
        """
        noise = self.frame.noise
        if self.side == WALLS_SIDE:
            return TotalError(noise, noise, noise)
        return self.frame.measured


@dataclass(frozen=True, eq=False)
class SurfacesQuality(Quality):
    """The quality of a frame that is composed of ``parts``, one for each side of a surface that is
    seen.

    Pixels have the least state of what they show, and errors add up by weight. ``aim`` is the
    target of the picture.
    """

    parts: tuple[Part, ...] = ()
    aim: float | None = None

    @property
    def target(self) -> float | None:
        """See ``Quality``."""
        return self.aim

    @property
    def given_up(self) -> bool:
        """See ``Quality``: whether each part is final, or its check ended."""
        return bool(self.parts) and all(
            part.frame.quality.given_up or part.frame.final for part in self.parts
        )

    @property
    def outdated(self) -> bool:
        """See ``Quality``."""
        return any(part.frame.quality.outdated for part in self.parts)

    @property
    def own(self) -> int:
        """See ``Quality``."""
        return sum(part.frame.quality.own for part in self.parts)

    @property
    def demands(self) -> tuple[Demand, ...]:
        """The light that was not final on the outer side of the surface that slides."""
        return next((part.frame.demands for part in self.parts if part.side == OUTER), ())

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All light that is to be baked until the picture is final: first of the side with the
        largest error.
        """
        return tuple(
            replace(stage, caches=None if part.side == OUTER else stage.caches or part.caches)
            for part in sorted(self.parts, key=wrong_of, reverse=True)
            for stage in part.frame.stages
        )

    def layers(self, frame: Frame) -> Iterator[Layer]:
        """See ``Frame.layers``: of each side layer by layer."""
        for part in self.parts:
            for rows, pixels in part.layers.each:
                yield pixels, part.layers.gbuffer.points[rows], part.layers.weights[rows]
        yield frame.gbuffer.faces.pixels, frame.gbuffer.faces.points, 1.0

    def checkable(self, frame: Frame) -> bool:
        """See ``Frame.checkable``."""
        lit = not any(part.frame.provisional for part in self.parts if part.side != WALLS_SIDE)
        return lit and not frame.final and any(part.frame.checkable for part in self.parts)

    def walls_lag(self, frame: Frame) -> bool:
        """See ``Frame.walls_lag``: more wrong than the side with the largest error."""
        walls = [
            part for part in self.parts if part.side == WALLS_SIDE and part.frame.quality.waiting
        ]
        worst = max((wrong_of(part) for part in self.parts if part.side != WALLS_SIDE), default=0.0)
        return any(
            part.frame.quality.walls_coarse(part.frame) or wrong_of(part) > worst for part in walls
        )

    def true_mean(self, frame: Frame) -> float:
        """The mean luminance of the pixels that show something."""
        return float(
            (frame.radiance[frame.state > 0].astype(np.float64) @ LUMINANCE_WEIGHTS).sum()
        ) / max(frame.surface, 1)

    def measured(self, frame: Frame) -> TotalError | None:
        """The total relative RMSE by the control pixels of all sides, whose errors count as
        independent of each other; None before each side has some.
        """
        found = [part.measured for part in self.parts]
        if not found or frame.view.shading != "gi" or frame.view.moving or not all(found):
            return None
        every = [each for each in found if each is not None]
        likely, low, high = (
            self._sum(frame, [getattr(each, of) for each in every])
            for of in ("likely", "low", "high")
        )
        return TotalError(likely, low, high, sum(each.controls for each in every)).at_least(
            frame.noise
        )

    def tail(self, frame: Frame) -> None:
        """None: control pixels of one side tell nothing of how the errors of two in one pixel add
        up.
        """

    def total_error(self, frame: Frame) -> np.ndarray:
        """See ``Frame.total_error``."""
        return summed_errors(
            [(part, part.frame.total_error) for part in self.parts], frame.radiance
        )

    def _sum(self, frame: Frame, errors: Sequence[float]) -> float:
        """The relative RMSE of a ``frame`` by the ``errors`` of its parts."""
        parts = zip(errors, self.parts, strict=True)
        squares = sum((error * part.frame.true_mean) ** 2 * part.weight for error, part in parts)
        return min(
            math.sqrt(squares / max(frame.surface, 1)) / max(frame.true_mean, MIN_SHOWN_LUMINANCE),
            1.0,
        )


def parts_of(frame: Frame) -> tuple[Part, ...]:
    """The parts that a frame is composed of; none of a frame of one surface."""
    if isinstance(frame.quality, SurfacesQuality):
        return frame.quality.parts
    return ()


def wrong_of(part: Part) -> float:
    """The error of a part in the picture, as far as is known."""
    return part.frame.total.likely * part.frame.true_mean * part.weight**0.5


def summed_errors(errors: Sequence[tuple[Part, np.ndarray]], radiance: np.ndarray) -> np.ndarray:
    """Relative errors (h, w) of a picture of this ``radiance``, by those of its parts' tall
    pictures.
    """
    squares = np.zeros(radiance.shape[0] * radiance.shape[1])
    for part, error in errors:
        light = part.seen(part.frame.radiance).astype(np.float64) @ LUMINANCE_WEIGHTS
        own = (part.layers.weights * light * part.seen(error)) ** 2
        for rows, pixels in part.layers.each:
            squares[pixels] += own[rows]
    light = radiance.reshape(-1, 3).astype(np.float64) @ LUMINANCE_WEIGHTS
    return (
        np.minimum(np.sqrt(squares) / np.maximum(light, MIN_SHOWN_LUMINANCE), 1.0)
        .astype(np.float32)
        .reshape(radiance.shape[:2])
    )


def summed(view: View, parts: Sequence[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Linear light (h, w, 3) float32 and states (h, w) uint8 of a view's pixels, of all that they
    show together.
    """
    count = view.width * view.height
    radiance = np.zeros((count, 3))
    state = np.full(count, FINAL + 1, np.uint8)
    for part in parts:
        light = part.layers.weights[:, None] * part.seen(part.frame.radiance)
        own = part.seen(part.frame.state)
        for rows, pixels in part.layers.each:
            radiance[pixels] += light[rows]
            state[pixels] = np.minimum(state[pixels], own[rows])
    state[state > FINAL] = 0
    shape = view.height, view.width
    return radiance.astype(np.float32).reshape(*shape, 3), state.reshape(shape)


def compose(
    view: View, peels: Peels, parts: Sequence[Part], watch: Stopwatch, target: float, scene: Scene
) -> Frame:
    """The frame of a ``view`` of a ``scene`` from the frames of its sides; the faces of its window
    are painted.
    """
    lit, state = summed(view, parts)
    error = summed_errors([(part, part.frame.error) for part in parts], lit)
    if len(peels.first.faces.pixels):
        paint_faces(
            peels.first,
            scene,
            Framebuffer(lit.reshape(-1, 3), state.reshape(-1), error.reshape(-1)),
        )
    checked = view.shading == "gi" and not view.moving
    versions = repr([(part.side, part.frame.version) for part in parts]) + repr(view)
    frames = [part.frame for part in parts]
    chunks = sum(each.chunks_needed for each in frames), sum(each.chunks_final for each in frames)
    quality = SurfacesQuality(
        chunks=chunks,
        waiting=sum(each.quality.waiting for each in frames),
        expected=max((each.quality.expected for each in frames), default=0.0),
        parts=tuple(parts),
        aim=target if checked else None,
    )
    version = hashlib.blake2b(versions.encode(), digest_size=16).hexdigest()
    return Frame(
        view, lit, state, error, peels.first, version, watch.seconds, quality, left=peels.left
    )


SHOWN = 2
HELD = 6
"""Isovalues whose views of pinned surfaces are kept, and those whose light is: two levels of each,
and it itself.
"""


class Composer:
    """Draws views of a scene with several surfaces. Safe to use from many threads."""

    def __init__(
        self, own: SurfaceRenderer, side: Callable[..., SurfaceRenderer], kept: LruCache[Any]
    ) -> None:
        """The scene's ``own`` renderer lights the outer side of the surface that slides, and a
        ``side`` made by caches and levels each of the others. Peels are among what is ``kept`` of
        views.
        """
        self._caches = own.caches
        self._own = own
        self._make = side
        self._kept = kept
        self._scene = self._caches.prepared.scene
        self._inner: PreparedScene | None = None
        self._sides: OrderedDict[tuple[Side, float | None], SurfaceRenderer] = OrderedDict()
        self._held: OrderedDict[tuple[Side, float | None], Caches] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes of memory that the other sides take."""
        with self._lock:
            views = sum(each.nbytes - each.caches.nbytes for each in self._sides.values())
            return views + sum(each.nbytes for each in self._held.values())

    def draw(self, view: View, until: Until, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of a view with the light that is there now. Raises Cancelled, and NoRoomError
        where the light of one view takes more than the budget.
        """
        try:
            return self._drawn(view, until, tiles, watch)
        except (
            NoRoomError
        ):  # light of other isovalues takes the room: what this view reads is read again
            self._let_go()
            return self._drawn(view, until, tiles, watch)

    def _drawn(self, view: View, until: Until, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of a view, where its light has room beside what is held."""
        with watch.stage("primary"):
            peels = self.peels(view, tiles)
        parts = []
        for side, layers in peels.sides.items():
            renderer = self.renderer(side, view.isovalue)
            if side == WALLS_SIDE:
                frame = renderer.draw_walls(peels.walls, view, until.target, tiles, watch)
            else:
                tall = self._view_of(side, view, layers.layers)
                frame = renderer.draw_on(layers.gbuffer, tall, until, tiles, watch)
                self._check_room()
            parts.append(Part(side, layers, frame, renderer.caches))
        with watch.stage("compose"):
            return compose(view, peels, parts, watch, until.target, self._scene)

    def smooth(self, frame: Frame, tiles: Tiles) -> Frame:
        """A ``frame`` that was drawn, with more samples where it has edges. Raises Cancelled."""
        glow = EyeGlow.of(self._caches.prepared, frame.view.glow)
        exposure = self._scene.default_exposure
        return smooth_surfaces(frame, self._peeler(frame.view, tiles), exposure, tiles, glow)

    def _peeler(self, view: View, tiles: Tiles) -> Peeler:
        """What casts rays of a view at all surfaces."""
        every = surfaces_of(self._scene, view.isovalue)
        surfaces = [self._caches.prepared.surface(each.isovalue) for each in every]
        clears = np.array([each.clear for each in every])
        walls = self._caches.prepared.walls_in_view
        return Peeler.of(view, surfaces, clears, tiles, walls)

    def peels(self, view: View, tiles: Tiles) -> Peels:
        """All that a view shows, layer behind layer. Raises Cancelled."""
        return self._kept.get((Peels, surface_key(view)), lambda: self._peels(view, tiles))

    def refine(self, view: View, target: float, tiles: Tiles, prices: Prices) -> bool:
        """Bring the picture of a view whose light is final a step nearer to the ``target``; whether
        there was one.

        The side with the largest known error comes first. Sides have no finer texels, whatever the
        ``prices``.
        """
        frame = self.draw(view, Until(target, FIRST_LEVEL), tiles, Stopwatch())
        if not frame.refinable:
            return False
        waiting = [
            part
            for part in parts_of(frame)
            if part.frame.checkable and (frame.checkable or part.side == WALLS_SIDE)
        ]
        waiting.sort(key=wrong_of, reverse=True)
        own = (self.renderer(part.side, view.isovalue) for part in waiting)
        at = prices.of_present
        return any(
            each.refine_frame(part.frame, target, tiles, at)
            for each, part in zip(own, waiting, strict=True)
        )

    def renderer(self, side: Side, shown: float) -> SurfaceRenderer:
        """The renderer of a ``side``, or of WALLS_SIDE, where the surface that slides shows the
        isovalue ``shown``.
        """
        if side in (OUTER, WALLS_SIDE):
            return self._own
        key = side, shown if side.number else None
        with self._lock:
            if key not in self._sides:
                if side.number:
                    levels = self._levels(shown)
                else:
                    levels = ((shown, 1.0),)
                mix = tuple(Level(self._caches_of(side, level), share) for level, share in levels)
                if len(mix) == 1:
                    own = mix[0].caches
                else:
                    own = self._caches_of(side, shown)
                self._sides[key] = self._make(own, levels=mix)
            return newest(self._sides, key, SHOWN * len(sides_of(self._scene)))

    def _levels(self, shown: float) -> tuple[tuple[float, float], ...]:
        """The levels whose light is mixed where an isovalue is ``shown``, and their shares."""
        return levels_around(
            self._scene.levels, [each.isovalue for each in self._scene.surfaces.pinned], shown
        )

    def _caches_of(self, side: Side, shown: float) -> Caches:
        """Caches of a side's light where the isovalue ``shown`` is: a level, or what is between
        two.
        """
        key = side, shown if side.number else None
        if key not in self._held:
            self._held[key] = self._made(side, shown)
        return newest(self._held, key, HELD * len(sides_of(self._scene)))

    def _made(self, side: Side, shown: float) -> Caches:
        """New caches of a side's light; what was worked out of the volume for other sides serves it
        too.
        """
        scene = scene_of_side(self._scene, side, shown)
        if not side.inner:
            prepared = self._caches.prepared.beside(scene)
        elif self._inner is None:
            prepared = self._inner = PreparedScene(scene, self._caches.prepared.most)
        else:
            prepared = self._inner.beside(scene)
        return Caches(prepared, self._caches.store, self._caches.budget, makes=False)

    def _check_room(self) -> None:
        """Raise NoRoomError where the light of other sides takes more than the budget together."""
        with self._lock:
            taken = sum(each.nbytes for each in self._held.values())
        if taken > self._caches.budget:
            raise NoRoomError(
                f"The light of this view takes {taken >> 20} MB, and may take "
                f"{self._caches.budget >> 20}:"
                " ask for a closer view or fewer pixels, or give light more memory."
            )

    def _let_go(self) -> None:
        """Let go of the light of all other sides, and of what draws them."""
        with self._lock:
            self._sides.clear()
            self._held.clear()

    def _view_of(self, side: Side, view: View, layers: int) -> View:
        """The view of a side's tall picture."""
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
        """All that a view shows."""
        every = surfaces_of(self._scene, view.isovalue)
        (hits, left) = self._peeler(view, tiles).whole(view, tiles)
        first = first_of(view, hits, self._caches.prepared.surface(view.isovalue))
        sides = {}
        for side in sides_of(self._scene):
            if len(hits.rows_of(side)):
                prepared = self.renderer(side, view.isovalue).caches.prepared
                sides[side] = side_layers(
                    hits, side, first, prepared.surface(every[side.number].isovalue)
                )
        walls, seen = walls_of(hits, first)
        return Peels(first, sides | ({} if seen is None else {WALLS_SIDE: seen}), left, walls)


Kept = TypeVar("Kept")


def newest(kept: OrderedDict[Any, Kept], key: Any, most: int) -> Kept:
    """What is ``kept`` by a ``key``, which is now its newest; the oldest beyond the ``most`` are
    let go.
    """
    kept.move_to_end(key)
    while len(kept) > most:
        kept.popitem(last=False)
    return kept[key]


def smooth_surfaces(
    frame: Frame, peeler: Peeler, exposure: float, tiles: Tiles, glow: EyeGlow | None = None
) -> Frame:
    """The ``frame`` with more samples where it has edges at its ``exposure``, and what glows.
    Raises Cancelled.
    """
    pixels, count = find_edges(
        lit(frame.radiance, frame.state, exposure, marked=False), frame.state
    )
    if not len(pixels):
        return frame
    places = places_in(pixels, count, frame.view.width)
    pictures = pictures_of(frame)
    light = np.zeros((len(places), 3), np.float32)
    left = np.empty(len(places), np.float32)
    on = np.zeros(len(places), np.bool_)
    found = dict[int, Hits]()

    def _piece(a: int, b: int) -> None:
        hits, left[a:b] = peeler.through(*places[a:b].T)
        on[a:b][hits.pixels] = True
        for side, picture in pictures.items():
            add_light(hits, side, picture, frame.view.height, places[a:b], light[a:b])
        hits.pixels[:] += np.uint32(a)
        found[a] = hits

    tiles.run(_piece, len(places), TILE_RAYS)
    if glow is not None:
        layers = by_layer(Hits.joined(list(found.values())))
        light += glow.lit(glow.before_layers(*rays_through(frame, places), layers, tiles))
        on |= light.any(axis=1)
    each = len(pixels), count
    edges = EdgeSamples(pixels, light.reshape(*each, 3), on.reshape(each), left=left.reshape(each))
    return replace(frame, edges=edges)


def pictures_of(frame: Frame) -> dict[int, Shown]:
    """The tall picture of each side in a ``frame``, by the side's number as of ``Peeled``; and that
    with its faces.
    """
    whole = shown_by(frame)
    tall = {part.side.peeled: shown_by(part.frame) for part in parts_of(frame)}
    return {int(WINDOW_FACE): whole} | {
        side: picture._replace(fine=whole.fine) for side, picture in tall.items()
    }


def by_layer(hits: Hits) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The ``hits`` of rays, layer behind layer: rays, each of them once, points, and weights."""
    order = np.argsort(hits.pixels, kind="stable")
    rays = hits.pixels[order]
    first = np.searchsorted(rays, rays)
    depth = np.arange(len(rays)) - first
    for layer in range(int(depth.max(initial=-1)) + 1):
        rows = order[depth == layer]
        yield hits.pixels[rows], hits.points[rows], hits.weights[rows]


def add_light(
    hits: Hits, side: int, picture: Shown, height: int, places: np.ndarray, light: np.ndarray
) -> None:
    """Add what rays through ``places`` (n, 2; x, y) meet of a ``side`` to their ``light`` (n, 3).

    It is the light of the pixels around in the same layer of its tall ``picture``, by the weight of
    the hit.
    """
    some = np.flatnonzero(np.minimum(hits.sides, FIRST_WALL_SIDE) == side)
    rays = hits.pixels[some]
    down = np.array([0.0, height], np.float32)
    there = places[rays] + hits.ranks[some][:, None] * down
    found = np.zeros((len(some), 3), np.float32)
    borrow_light(picture, there, np.arange(len(some), dtype=np.uint32), hits.points[some], found)
    np.add.at(light, rays, hits.weights[some][:, None] * found)
