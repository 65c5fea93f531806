"""The light of walls: of the sides that a view sees, about the isovalue that is shown.

The first picture has a few coarse texels on each wall, or light between those isovalues nearby that
were lit before. Each step while the view rests makes texels fine first, and then doubles their
paths. The store keeps them.
"""

import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import path_weights
from isogi_core.bake.refine import seeds_of, starts_at
from isogi_core.cache.wall_store import Planes, Side, WallState, WallStore, planes_of
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.rays.pixel_rays import (
    passes,
    pooled_variance,
    split_into_replicas,
    variance_of_mean,
)
from isogi_core.frame.rays.wall_texels import (
    COARSE_WALL_TEXELS,
    FINE_WALL_TEXELS,
    MAX_WALL_TEXELS,
    WallTexels,
    light_starts,
)
from isogi_core.frame.refinement import PathsLeft, Refinement
from isogi_core.frame.shading import fog_depths, put_noise
from isogi_core.frame.shot import Shot
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL, Framebuffer
from isogi_core.kernels.shading.lattice import MIN_LIGHT
from isogi_core.kernels.shading.local_models import find_shadows, shade_local
from isogi_core.kernels.shading.surface_points import SurfacePoints
from isogi_core.kernels.shading.wall_light import WallTable, light_walls
from isogi_core.kernels.transport.paths import PathRules, PathStarts, SampleRange
from isogi_core.lru_cache import LruCache
from isogi_core.model.volume import Isovalue, Volume
from isogi_core.prepared.prepared_scene import Surface


@dataclass(eq=False)
class WallLight:
    """The light of one side of a wall about the ``surface`` that is shown: its ``texels``, as far
    as they have converged.

    Light ``interpolated`` between the nearest isovalues that were lit before stands in while the
    texels have a larger error; None if there is none. Only the thread that holds the ``lock``
    replaces the texels.
    """

    light: RotatedLight
    surface: Surface
    texels: WallTexels
    interpolated: WallTexels | None = None
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes; texels that are coarse are counted as fine ones."""
        size = self.texels.nbytes
        if not self.texels.fine:
            size *= (FINE_WALL_TEXELS // COARSE_WALL_TEXELS) ** 2
        interpolated = self.interpolated  # another thread may drop it meanwhile
        if interpolated:
            size += interpolated.nbytes
        return size

    def best(self, target: float, tiles: Tiles) -> WallTexels:
        """Return the wall's texels if they are final at the ``target`` error, else the light with
        the least error.

        Pictures do not wait for a step that goes on: they show the texels before it. Raises
        Cancelled.
        """
        # Read both once: a step may replace the texels meanwhile.
        texels = self.texels
        interpolated = self.interpolated
        if interpolated and not texels.final(target):
            better = texels.count and texels.error <= interpolated.error
            if not better:
                return interpolated
        # From now on the texels are better than the light of other isovalues.
        self.interpolated = None
        if texels.count:
            return texels
        with self.lock:
            # Another picture may have begun them meanwhile.
            if not self.texels.count:
                self.texels = self.texels.grown(self.light, self.surface, tiles)
            return self.texels

    def grow(self, target: float, tiles: Tiles) -> int:
        """Take one step of the texels towards a ``target`` error; return the number of paths that
        it traced, 0 if they are final. Raises Cancelled.
        """
        with self.lock:
            before = self.texels
            if before.final(target):
                return 0
            self.texels = before.nearer(self.light, self.surface, target, tiles)
            if self.texels.across == before.across:
                return self.texels.paths - before.paths
            return self.texels.paths


@dataclass(eq=False)
class RoomLight:
    """The light of all walls in one ``state``, about the ``surface`` that is shown: of each of
    their ``sides`` that was seen.

    It begins with the light that the ``store`` kept of this state, and of the nearest isovalues on
    either side. ``pace`` are the seconds that each path of the last step took; None before a step.
    """

    light: RotatedLight
    surface: Surface
    state: WallState
    store: WallStore
    sides: dict[Side, WallLight] = field(default_factory=dict)
    pace: float | None = None
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @classmethod
    def of(cls, light: RotatedLight, surface: Surface, store: WallStore) -> "RoomLight":
        """Return the light of walls about a ``surface`` under a ``light``, as far as the
        ``store`` kept it.
        """
        found = cls(
            light, surface, WallState(float(surface.isovalue), light.seen.albedo, light.glow), store
        )
        kept = found._kept(found.state)
        interpolated = found._interpolated()
        for side in {*kept, *interpolated}:
            texels = kept.get(side) or found._begun(side)
            found.sides[side] = WallLight(light, surface, texels, interpolated.get(side))
        return found

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return sum(each.nbytes for each in list(self.sides.values()))

    def is_shown(self, frame: Frame) -> bool:
        """Return True always: if a ``frame`` is older than this light, a step still traces
        paths for walls that need some.
        """
        return True

    def side(self, side: Side) -> WallLight:
        """Return the light of one side of a wall, or begin it."""
        if side not in self.sides:
            self.sides.setdefault(side, WallLight(self.light, self.surface, self._begun(side)))
        return self.sides[side]

    def keep(self, grown: Sequence[WallTexels]) -> None:
        """Keep the texels that have ``grown`` in the store."""
        # Put the texels of all sides with the same fineness into one lattice, whose planes are
        # halves of sides.
        for across in sorted({each.across for each in grown if each.fine}):
            shape = 4 * len(self.light.spec.prepared.scene.lighting.room.walls), across, across
            means = np.zeros((*shape, 3))
            counts = np.zeros(shape, np.int64)
            for texels in (each for each in grown if each.across == across):
                rows, columns = texels.settled.shape
                there = planes_of((texels.wall, texels.side)), slice(rows), slice(columns)
                means[there] = np.moveaxis(texels.means, 2, 0)
                counts[there] = texels.count * texels.asked
            self.store.keep(self.state, (means, counts))

    def _begun(self, side: Side) -> WallTexels:
        """Return coarse texels of a ``side`` without paths."""
        return WallTexels.begun(self.light, *side, COARSE_WALL_TEXELS)

    def _kept(self, state: WallState, finest: int = MAX_WALL_TEXELS) -> dict[Side, WallTexels]:
        """Return the texels that the store kept in a ``state``, as fine as ``finest`` at most,
        by their sides.
        """
        kept: dict[int, Planes] = {}
        # Finer texels were kept only where coarser ones are, too.
        while (across := FINE_WALL_TEXELS << len(kept)) <= finest and (
            planes := self.store.planes(state, across)
        ) is not None:
            kept[across] = planes
        if not kept:
            return {}
        walls = self.light.spec.prepared.scene.lighting.room.walls
        found = {
            side: WallTexels.restored(self.light, side, kept)
            for side in product(range(len(walls)), (1, -1))
        }
        return {side: texels for side, texels in found.items() if texels is not None}

    def _interpolated(self) -> dict[Side, WallTexels]:
        """Interpolate the light that was kept at the nearest isovalues on either side, by the
        sides of walls.
        """
        around = self.store.around(self.state)
        if around is None:
            return {}
        low, high = (self._kept(each, FINE_WALL_TEXELS) for each in around)
        share = (self.state.isovalue - around[0].isovalue) / (
            around[1].isovalue - around[0].isovalue
        )
        # A side must be known at both isovalues. The numbers of paths at both name its light.
        return {
            side: low[side].mixed(high[side], share, f"-{low[side].count:x}~{high[side].count:x}")
            for side in low.keys() & high.keys()
        }


@dataclass(frozen=True, eq=False)
class WallView:
    """The walls in a picture, each seen from one of its ``sides`` (walls,): 1 for its front, -1
    for its back.
    """

    gbuffer: GBuffer
    light: RotatedLight
    sides: np.ndarray

    @classmethod
    def of(cls, gbuffer: GBuffer, light: RotatedLight) -> "WallView":
        """Return the walls that a G-buffer shows, from the side of its eye."""
        room = light.spec.prepared.room(light.seen.albedo)
        eye = np.multiply(gbuffer.eye, gbuffer.spacing)
        # A wall shows its front if the eye is on the side of its normal.
        front = ((eye - room.corners) * room.normals).sum(axis=1) > 0.0
        return cls(gbuffer, light, np.where(front, 1, -1))

    @classmethod
    def of_sides(cls, gbuffer: GBuffer, light: RotatedLight, sides: np.ndarray) -> list["WallView"]:
        """Return the walls that a G-buffer shows, fronts and backs apart: rays that were mirrored
        or refracted may meet both. ``sides`` (m,) has the side at which each point was met, 1 or
        -1.
        """
        count = len(light.spec.prepared.scene.lighting.room.walls)
        walls = gbuffer.walls
        found = [(side, np.flatnonzero(sides == side)) for side in (1, -1)]
        return [
            cls(replace(gbuffer, walls=walls.part(some)), light, np.full(count, side))
            for side, some in found
            if len(some)
        ]

    @cached_property
    def counts(self) -> np.ndarray:
        """The number of pixels of each wall; (walls,)."""
        return np.bincount(self.gbuffer.walls.numbers, minlength=len(self.sides))

    @property
    def seen(self) -> list[tuple[int, int]]:
        """The walls that are seen, by number, each with the side that is seen."""
        return [(wall, int(self.sides[wall])) for wall in np.flatnonzero(self.counts).tolist()]

    def put(
        self, texels: Sequence[WallTexels], target: float, framebuffer: Framebuffer, tiles: Tiles
    ) -> int:
        """Write the light of ``texels``, of each wall that is seen, into a picture; return the
        number of pixels that are not final.

        Raises Cancelled.
        """
        walls = self.gbuffer.walls
        prepared = self.light.spec.prepared
        # All texels of a side of a wall share one state.
        finals = {each.wall: each.final(target) for each in texels}
        table = self._table(texels, finals)
        darkest = np.float32(MIN_LIGHT * self.light.spec.unit)
        met = prepared.room(self.light.seen.albedo).walls

        def _piece(a: int, b: int) -> None:
            some = walls.pixels[a:b], walls.points[a:b], walls.numbers[a:b]
            light_walls(met, table, *some, darkest, framebuffer)

        tiles.run(_piece, len(walls.pixels), tiles.even(len(walls.pixels)))
        return sum(int(self.counts[wall]) for wall, final in finals.items() if not final)

    def _table(self, texels: Sequence[WallTexels], finals: dict[int, bool]) -> WallTable:
        """Return the table of the ``texels`` of walls that kernels take, with the state of each
        wall: ``finals`` has True for the number of a wall that is at its target.

        Walls without texels keep zeros.
        """
        light = [each.leaving for each in texels]
        count = len(self.light.spec.prepared.scene.lighting.room.walls)
        firsts, rows, columns = np.zeros((3, count), np.int64)
        states = np.zeros(count, np.uint8)
        # The texels of all walls are in one array; the table tells where those of each wall begin.
        # The last number is the length of the array, and belongs to no wall.
        begins = np.cumsum([0, *map(len, light)])
        for each, first in zip(texels, begins, strict=False):
            k = each.wall
            firsts[k] = first
            (rows[k], columns[k]) = each.settled.shape
            if finals[k]:
                states[k] = FINAL
            elif each.fine:
                states[k] = CONVERGING
            else:
                states[k] = PROVISIONAL
        return WallTable(np.concatenate(light), firsts, rows, columns, states)

    def put_paths(self, target: float, framebuffer: Framebuffer, tiles: Tiles) -> None:
        """Path-trace the walls in a picture, with at least as many paths from each pixel as the
        view asks for. Raises Cancelled.
        """
        walls = self.gbuffer.walls
        plan = self.light.spec.prepared.scene.plan
        samples = self.light.view.samples
        replicas, count = split_into_replicas(samples)
        room = self.light.spec.prepared.room(self.light.seen.albedo)
        rules = PathRules(path_weights(np.ones(3), plan.bounces, 1.0), plan.survival)
        variance = np.empty(len(walls.pixels))

        # Trace the paths of some pixels after the other, as those of the surface.
        for some in passes(len(walls.pixels), samples, tiles):
            surface = self.gbuffer.surface
            starts = self._starts(some, replicas, surface.isovalue)
            sums = light_starts(self.light, surface, starts, rules, SampleRange(0, count), tiles)
            numbers = walls.numbers[some]
            means = room.albedos[numbers][:, None] * sums.reshape(-1, replicas, 3) / count
            light = means.mean(axis=1) + room.radiances[numbers]
            framebuffer.radiance[walls.pixels[some]] = np.minimum(light, np.finfo(np.float32).max)
            variance[some] = variance_of_mean(means)

        pooled = pooled_variance(variance, self.gbuffer, walls.pixels)
        darkest = float(MIN_LIGHT) * self.light.spec.unit
        put_noise(framebuffer, walls.pixels, pooled, darkest, target)

    def _starts(self, some: slice, replicas: int, isovalue: Isovalue) -> PathStarts:
        """Return the starts of paths of ``replicas`` replicas from ``some`` of the pixels that
        show walls.
        """
        walls = self.gbuffer.walls
        shown = np.arange(some.start, some.stop)
        each, replica = (part.ravel() for part in np.indices((len(shown), replicas)))
        each = shown[each]
        seeds = seeds_of(np.column_stack([walls.pixels[each], replica]))
        normals = self._normals_of(walls.numbers[each])
        return starts_at(walls.points[each], normals, isovalue, seeds, walls.numbers[each])

    def _normals_of(self, numbers: np.ndarray) -> np.ndarray:
        """Return the normals, on the sides that are seen, of the walls with these ``numbers``
        (m,); (m, 3).
        """
        room = self.light.spec.prepared.room(self.light.seen.albedo)
        return np.asarray((self.sides[:, None] * room.normals)[numbers])

    def put_locally(
        self, shading: str, depths: tuple[float, float], framebuffer: Framebuffer, tiles: Tiles
    ) -> None:
        """Shade the walls in a picture by the local model that ``shading`` names, with the shadows
        that the surface casts on them if the model has any.

        ``depths`` are the world depths at which the model's fog begins and is thick. All pixels of
        walls become final. Raises Cancelled.
        """
        walls = self.gbuffer.walls
        gbuffer = self.gbuffer
        room = self.light.spec.prepared.scene.lighting.room
        traced = gbuffer.surface.traced(tiles.run)
        normals = self._normals_of(walls.numbers).astype(np.float32)
        shown = SurfacePoints(walls.points, normals, walls.pixels)
        # Each wall has its own albedo, and so its own model.
        for number, _ in self.seen:
            rows = np.flatnonzero(walls.numbers == number)
            model = self.light.local_model(shading, depths, np.array(room.walls[number].albedo))
            some = shown.part(rows)
            # ``shade_local`` reads this for models with shadow alone.
            reached = np.empty(len(rows), np.bool_)
            if model.shadow:
                find_shadows(traced, some, model.key, reached)
            shade_local(some, reached, gbuffer.eye, gbuffer.spacing, model, framebuffer)


class ViewWalls(Refinement[RoomLight]):
    """The walls about a ``volume``; renderers keep their light among the results of views."""

    def __init__(self, kept: LruCache[Any], volume: Volume, store: WallStore) -> None:
        """Keep the light of walls in ``kept``, and in a ``store``."""
        self._kept = kept
        self._volume = volume
        self._store = store

    def put(self, shot: Shot, framebuffer: Framebuffer) -> tuple[int, str]:
        """Write the walls into the picture of a ``shot``; return the number of their pixels that
        are not final, and the part of the picture's version that names the light of the walls.

        Only texels converge. Walls of all other shadings are final, and have an empty name. Raises
        Cancelled.
        """
        view = shot.view
        target = shot.goal.error
        tiles = shot.tiles
        walls = WallView.of(shot.gbuffer, shot.light)
        # Walls are shaded as the surface is: by paths, by a local model, or by texels.
        if view.shading == "path_traced":
            walls.put_paths(target, framebuffer, tiles)
        elif view.shading != "gi":
            # There is no vicinity shading of walls: Lambert's model stands in.
            if view.shading == "vicinity":
                shading = "lambert"
            else:
                shading = view.shading
            walls.put_locally(shading, fog_depths(view, self._volume), framebuffer, tiles)
        else:
            texels = self._best(walls, shot)
            return walls.put(texels, target, framebuffer, tiles), "".join(
                each.version for each in texels
            )
        return 0, ""

    def add(self, frame: Frame, shot: Shot) -> Frame:
        """Write the walls into the pixels of the ``frame`` of a ``shot`` that has its surface
        already; return the frame with the number of wall pixels that are not final as
        ``quality.waiting``.

        The framebuffer changes in place. The version grows by the names of the walls' light, so
        that a picture gets another version once its walls have more paths. Raises Cancelled.
        """
        if not len(shot.gbuffer.walls.pixels):
            return frame
        with shot.watch.stage("walls"):
            waiting, version = self.put(shot, frame.framebuffer)
        return replace(
            frame,
            quality=replace(frame.quality, waiting=waiting),
            version=f"{frame.version}{version}",
        )

    def put_seen(self, shot: Shot, views: Iterable[WallView], framebuffer: Framebuffer) -> str:
        """Write the walls of several ``views`` into one picture; return a name of their light, for
        the picture's version. Raises Cancelled.
        """
        version = ""
        for walls in views:
            texels = self._best(walls, shot)
            walls.put(texels, shot.goal.error, framebuffer, shot.tiles)
            version += "".join(each.version for each in texels)
        return version

    def of(self, shot: Shot) -> RoomLight:
        """Return the light of the walls in a ``shot``: see ``Refinement``."""
        return self._room(WallView.of(shot.gbuffer, shot.light))

    def advance(self, found: RoomLight, frame: Frame, shot: Shot, prices: Prices) -> bool:
        """Double the paths of the walls in a ``frame`` that are not final: see ``Refinement``."""
        return self.grow([WallView.of(shot.gbuffer, found.light)], shot)

    def grow(self, views: Sequence[WallView], shot: Shot) -> bool:
        """Take a step of all walls in some ``views`` of one light that are not final; return False
        if all are.

        The store keeps them, also if this raises Cancelled.
        """
        room = self._room(views[0])
        grown = list[WallTexels]()
        begun = time.perf_counter()
        paths = 0
        try:
            # A wall that several views see takes one step.
            for side in dict.fromkeys(side for walls in views for side in walls.seen):
                lit = room.side(side)
                if traced := lit.grow(shot.goal.error, shot.tiles):
                    paths += traced
                    grown.append(lit.texels)
            if paths:
                room.pace = (time.perf_counter() - begun) / paths
        finally:
            room.keep(grown)
        # The texels take more memory than when they were put among the results: count them again.
        self._kept.settle()
        return bool(grown)

    def left(self, shot: Shot) -> PathsLeft:
        """Return the paths that the walls in a ``shot`` are foreseen to take for its goal. All of
        them take a step together.
        """
        walls = WallView.of(shot.gbuffer, shot.light)
        room = self._room(walls)
        steps = [room.side(side).texels.steps_left(shot.goal.error) for side in walls.seen]
        paths = sum(sum(each) for each in steps)
        return PathsLeft(paths, times=max(map(len, steps), default=0), pace=room.pace)

    def _best(self, walls: WallView, shot: Shot) -> list[WallTexels]:
        """Return the best texels of the sides that are seen. Raises Cancelled."""
        room = self._room(walls)
        return [room.side(side).best(shot.goal.error, shot.tiles) for side in walls.seen]

    def _room(self, walls: WallView) -> RoomLight:
        """Return the light of walls for the isovalue, the albedo and the glow of a view, kept
        or begun now. It depends on nothing else of a view: light does not turn in scenes with
        walls.
        """
        light = walls.light
        surface = walls.gbuffer.surface
        key = (RoomLight, light.view.isovalue, light.view.albedo, light.view.glow)
        return self._kept.get(key, lambda: RoomLight.of(light, surface, self._store))
