"""The light of walls: texels of a lattice on each wall, lit for the isovalue that is shown, as fine as time allowed.

They are kept in memory with the views that show them, and are not in the store. The first picture has a few coarse
ones; each step while the view rests then makes them fine, and takes as many paths again. Where what lies between them
then is the greater part of their error, at edges of shadows and in caustics, there are twice as many each way, and
twice as many again.
"""

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from isogi_core.bake.bake_spec import path_weights
from isogi_core.bake.refine import seeds_of
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.glow_light import add_glow
from isogi_core.frame.rays.pixel_rays import NEAR, PATH_POINTS, pooled_variance, replicas_for, variance_of_mean
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL, Framebuffer, PixelPoints
from isogi_core.kernels.shading.lattice import DARKEST
from isogi_core.kernels.shading.local_models import find_shadows, shade_local
from isogi_core.kernels.shading.wall_light import WallTable, light_walls
from isogi_core.kernels.transport.matter.matter_paths import light_through_matter
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from isogi_core.kernels.transport.room_paths import RoomStarts, light_in_room
from isogi_core.model.sky import LUMINANCE
from isogi_core.prepared.surface import Surface

COARSE, FINE, FINEST = 16, 64, 256
"""Texels along the longest edge of any wall: of the first picture, of all others, and at most."""

EDGY = 1.0 / 12.0
"""What interpolation adds to the variance, over the squared second differences of texels' light, at an edge.

That is anywhere between two texels: these are twice its height squared together, and a ramp in its place errs by a
sixth of that. Where light is smooth it is a tenth of this.
"""

FIRST, MOST = 8, 1 << 12
"""Paths of each half of a texel at first, and at most."""

WALL_STREAM = 1 << 19
"""Sets the sequences of walls' texels apart from those of the lattice's, whose first word is smaller."""


def light_starts(
    light: RotatedLight, surface: Surface, starts: RoomStarts, rules: PathRules, samples: SampleRange, tiles: Tiles
) -> np.ndarray:
    """Sums (g, 3) of a ``SampleRange`` of E/π, glow's too, at ``starts`` about a ``surface``; see ``light_in_room``,
    and ``light_through_matter`` where that lets light pass.

    Raises Cancelled.
    """
    traced, sums, prepared = surface.traced(tiles.run), np.zeros((len(starts.seeds), 3)), light.spec.prepared
    room, around = prepared.room(light.seen.albedo), light.surroundings

    def _piece(a: int, b: int) -> None:
        some = RoomStarts(*(np.ascontiguousarray(each[..., a:b]) for each in starts))
        if prepared.scene.material.passable:
            given = some, samples, rules, around, sums[a:b]
            light_through_matter(traced.field, traced.cells, prepared.passable, *given)
            return
        light_in_room(traced.field, traced.cells, room, some, samples, rules, around, sums[a:b])
        add_glow(sums[a:b], light, traced, some, rules, samples)

    tiles.run(_piece, len(sums), PATH_POINTS)
    return sums


@dataclass(frozen=True, eq=False)
class WallTexels:
    """Texels on a side of the wall number ``wall``: ``sums`` (rows, columns, 2, 3) of E/π of ``count`` paths each half.

    Rows are along the wall's second edge, and ``side`` is 1 for its front, -1 for its back. There are so many
    ``across`` the longest edge of any wall. The wall has an ``albedo`` and gives off ``radiance`` (3,). Where coarser
    ones were fine enough, ``settled`` (rows, columns) is what they told to be ``unsharp``, and no paths are sent from
    texels; it is NaN elsewhere, and for all of the first.
    """

    wall: int
    side: int
    albedo: np.ndarray
    radiance: np.ndarray
    sums: np.ndarray
    across: int
    settled: np.ndarray
    count: int = 0

    @classmethod
    def begun(cls, light: RotatedLight, wall: int, side: int, across: int) -> "WallTexels":
        """Texels that no path has been sent from yet, ``across`` of them along the longest edge of any wall."""
        room = light.spec.prepared.room(light.seen.albedo)
        edges = np.linalg.norm(room.edges, axis=2)
        columns, rows = np.maximum(np.ceil(across * edges[wall] / edges.max()), 2).astype(int).tolist()
        sums, settled = np.zeros((rows, columns, 2, 3)), np.full((rows, columns), np.nan)
        return cls(wall, side, room.albedos[wall], room.radiances[wall], sums, across, settled)

    @property
    def fine(self) -> bool:
        """Whether they are fine enough to stay."""
        return self.across >= FINE

    @property
    def nbytes(self) -> int:
        """Bytes that they take, with what is found of them."""
        return 2 * self.sums.nbytes

    @property
    def version(self) -> str:
        """Names the paths that were taken."""
        return f"-{self.count:x}" if self.across == FINE else f"-{self.count:x}a{self.across:x}"

    @property
    def means(self) -> np.ndarray:
        """E/π by each half; (rows, columns, 2, 3)."""
        return np.asarray(self.sums / max(self.count, 1))

    @cached_property
    def variance(self) -> np.ndarray:
        """Variance of the luminance that leaves each texel, a mean with its neighbours', by NEAR; (rows, columns)."""
        halves = self.means @ (LUMINANCE * self.albedo)
        return pooled(((halves[..., 0] - halves[..., 1]) / 2.0) ** 2)

    @cached_property
    def unsharp(self) -> np.ndarray:
        """Variance of the luminance that light between texels adds, as it is interpolated; (rows, columns).

        It is found by how light bends. About an edge that is half as much between next texels as between those two
        apart; where it is less, light is smoother than that.
        """
        near, far = self._bends(1), self._bends(2)
        found = EDGY * near * np.minimum(2.0 * near / np.maximum(far, 1e-30), 1.0)
        return np.where(self.asked, found, self.settled)

    def _bends(self, step: int) -> np.ndarray:
        """Squared second differences of light between texels a ``step`` apart, both ways, less those of noise."""
        light, found = self.luminance, np.zeros(self.sums.shape[:2])
        for axis in (0, 1):
            if light.shape[axis] > 2 * step:
                low, here, high = (
                    light.take(np.arange(k * step, light.shape[axis] - (2 - k) * step), axis) for k in range(3)
                )
                ends = [(step * int(a == axis),) * 2 for a in range(2)]
                found += np.pad((low - 2.0 * here + high) ** 2, ends) - 6.0 * self.variance
        return np.maximum(pooled(found), 0.0)

    @property
    def asked(self) -> np.ndarray:
        """Whether paths are sent from each texel; (rows, columns) bool."""
        return np.isnan(self.settled)

    @property
    def luminance(self) -> np.ndarray:
        """The luminance that the wall reflects at each texel; (rows, columns)."""
        return np.asarray(self.means.mean(axis=2) @ (LUMINANCE * self.albedo))

    def relative(self, variance: np.ndarray) -> float:
        """The error that a ``variance`` (rows, columns) makes of all of them, relative; 0 where no light arrives."""
        mean = float(self.luminance.mean())
        return math.sqrt(float(variance.mean())) / mean if mean > 0.0 else 0.0

    def final(self, target: float) -> bool:
        """Whether their error is within a ``target``, or as small as it may become."""
        return self.fine and self.count > 0 and self.has_enough_paths(target) and not self.too_coarse(target)

    def has_enough_paths(self, target: float) -> bool:
        """Whether their noise is within a ``target``, or they have taken all paths that they may."""
        return self.count >= MOST or self.relative(self.variance) <= target

    def too_coarse(self, target: float) -> bool:
        """Whether what lies between them errs more than they do, and by more than half of a ``target``."""
        if not FINE <= self.across < FINEST or self.unsharp.mean() <= self.variance.mean():
            return False
        return self.relative(self.unsharp) > 0.5 * target

    def nearer(self, light: RotatedLight, surface: Surface, target: float, tiles: Tiles) -> "WallTexels":
        """The same a step nearer to a ``target``: fine ones, more paths, or twice as fine ones. Raises Cancelled."""
        if not self.fine:
            return WallTexels.begun(light, self.wall, self.side, FINE).grown(light, surface, tiles, self.count)
        if not self.has_enough_paths(target):
            return self.grown(light, surface, tiles, self.count)
        return self._finer(light, target).grown(light, surface, tiles, self.count)

    def _finer(self, light: RotatedLight, target: float) -> "WallTexels":
        """Twice as many each way, dark where they are asked; elsewhere, what these tell of the places between them.

        So many are asked that the others are unsharp by less than a quarter of the ``target``.
        """
        finer = WallTexels.begun(light, self.wall, self.side, 2 * self.across)
        least = np.sort(self.unsharp, axis=None)
        allowed = least.size * (0.25 * target * float(self.luminance.mean())) ** 2
        few = least[min(int(np.searchsorted(np.cumsum(least), allowed)), least.size - 1)]
        places = [
            (np.arange(a) + 0.5) * b / a - 0.5 for a, b in zip(finer.settled.shape, self.settled.shape, strict=True)
        ]
        near = np.ix_(*(np.rint(each).astype(int) for each in places))
        settled = np.where(self.unsharp[near] < few, self.unsharp[near], np.nan)
        known = np.where(np.isnan(settled)[..., None, None], 0.0, between(self.means, *places))
        return replace(finer, sums=known, settled=settled)

    def grown(self, light: RotatedLight, surface: Surface, tiles: Tiles, more: int = FIRST) -> "WallTexels":
        """The same after so many ``more`` paths of each half of those that are asked. Raises Cancelled."""
        plan, asked = light.spec.plan, self.asked
        rules = PathRules(path_weights(np.ones(3), plan.bounces, 1.0), plan.survival)
        samples = SampleRange(self.count, more)
        added = light_starts(light, surface, self._starts(light, surface), rules, samples, tiles)
        sums = self.means * (self.count + more) if self.count else self.sums * more
        sums[asked] = self.sums[asked] + added.reshape(-1, 2, 3)
        return replace(self, sums=sums, count=self.count + more)

    def _starts(self, light: RotatedLight, surface: Surface) -> RoomStarts:
        """Where the paths of each asked texel's halves start: in its middle."""
        room, (rows, columns) = light.spec.prepared.room(light.seen.albedo), self.sums.shape[:2]
        row, column, half = np.nonzero(np.repeat(self.asked[..., None], 2, axis=2))
        edges = room.edges[self.wall]
        points = room.corners[self.wall] + np.outer((column + 0.5) / columns, edges[0])
        points += np.outer((row + 0.5) / rows, edges[1])
        points /= surface.field.spacing
        normals = np.tile(self.side * room.normals[self.wall], (len(points), 1))
        words = np.column_stack([np.full(len(row), WALL_STREAM + 2 * self.wall + (self.side < 0)), row, column, half])
        return starts_on(points, normals, np.full(len(row), self.wall), surface, seeds_of(words))

    @cached_property
    def leaving(self) -> np.ndarray:
        """Linear RGB that leaves each texel, and the variance of its luminance; (texels, 4) float32."""
        light = np.minimum(self.radiance + self.albedo * self.means.mean(axis=2), np.finfo(np.float32).max)
        variance = (self.variance + self.unsharp)[..., None]
        return np.concatenate([light, variance], axis=2, dtype=np.float32).reshape(-1, 4)


def between(values: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """``values`` (h, w, …) at places between ``rows`` and ``columns``, linearly; beyond the ends the ends'."""
    for axis, places in enumerate((rows, columns)):
        first = np.clip(np.floor(places).astype(int), 0, values.shape[axis] - 2)
        way = np.clip(places - first, 0.0, 1.0).reshape(-1, *(1,) * (values.ndim - axis - 1))
        values = (1.0 - way) * values.take(first, axis) + way * values.take(first + 1, axis)
    return values


def pooled(variance: np.ndarray) -> np.ndarray:
    """Variances (rows, columns), each a mean with its neighbours', by NEAR."""
    for axis in (0, 1):
        padded = np.pad(variance, [(2 * int(a == axis),) * 2 for a in range(2)], "edge")
        variance = np.lib.stride_tricks.sliding_window_view(padded, len(NEAR), axis) @ (NEAR / NEAR.sum())
    return variance


@dataclass(eq=False)
class WallLight:
    """The light of a side of a wall about the ``surface`` that is shown: its ``texels``, as far as they have come.

    Threads wait for each other.
    """

    light: RotatedLight
    surface: Surface
    texels: WallTexels
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes that it takes once its texels are fine, or finer if they are."""
        return self.texels.nbytes * (1 if self.texels.fine else (FINE // COARSE) ** 2)

    def begun(self, tiles: Tiles) -> WallTexels:
        """Its texels with some light at least. Raises Cancelled."""
        with self.lock:
            if not self.texels.count:
                self.texels = self.texels.grown(self.light, self.surface, tiles)
            return self.texels

    def step(self, target: float, tiles: Tiles) -> bool:
        """Bring them a step nearer to a ``target`` error; whether there was one to take. Raises Cancelled."""
        with self.lock:
            if self.texels.final(target):
                return False
            self.texels = self.texels.nearer(self.light, self.surface, target, tiles)
            return True


def starts_on(
    points: np.ndarray, normals: np.ndarray, walls: np.ndarray, surface: Surface, seeds: np.ndarray
) -> RoomStarts:
    """Starts of paths at ``points`` and ``normals`` (g, 3) on ``walls`` (g,), by number, about a ``surface``."""
    here, around = (np.ascontiguousarray(each.T, np.float64) for each in (points, normals))
    levels = np.full(len(seeds), float(surface.isovalue))
    return RoomStarts(here, around, levels, seeds, walls.astype(np.float64))


@dataclass(frozen=True, eq=False)
class WallView:
    """The walls in a picture: what each of their pixels shows. ``sides`` (m,) int are 1 for fronts, -1 for backs."""

    gbuffer: GBuffer
    light: RotatedLight
    sides: np.ndarray

    @classmethod
    def of(cls, gbuffer: GBuffer, light: RotatedLight) -> "WallView":
        """The walls that a G-buffer shows."""
        room, eye = light.spec.prepared.room(light.seen.albedo), np.multiply(gbuffer.eye, gbuffer.spacing)
        front = ((eye - room.corners) * room.normals).sum(axis=1) > 0.0
        return cls(gbuffer, light, np.where(front, 1, -1)[gbuffer.walls.numbers])

    @property
    def seen(self) -> list[tuple[int, int]]:
        """The walls that are seen, by number, each with the side that is seen."""
        numbers, first = np.unique(self.gbuffer.walls.numbers, return_index=True)
        return list(zip(numbers.tolist(), self.sides[first].tolist(), strict=True))

    def put(self, texels: Sequence[WallTexels], target: float, framebuffer: Framebuffer, tiles: Tiles) -> int:
        """Write the light of ``texels``, those of each wall that is seen, into a picture; pixels that are not final.

        Raises Cancelled.
        """
        walls, prepared = self.gbuffer.walls, self.light.spec.prepared
        finals = {each.wall: each.final(target) for each in texels}
        table, darkest = self._table(texels, finals), np.float32(DARKEST * self.light.spec.unit)
        met = prepared.room(self.light.seen.albedo).walls

        def _piece(a: int, b: int) -> None:
            some = walls.pixels[a:b], walls.points[a:b], walls.numbers[a:b]
            light_walls(met, table, *some, darkest, framebuffer)

        tiles.run(_piece, len(walls.pixels), tiles.even(len(walls.pixels)))
        return int(np.isin(walls.numbers, [wall for wall, final in finals.items() if not final]).sum())

    def _table(self, texels: Sequence[WallTexels], finals: dict[int, bool]) -> WallTable:
        """The texels as kernels take them, and which walls are final."""
        light, count = [each.leaving for each in texels], len(self.light.spec.prepared.scene.room.walls)
        firsts, rows, columns = np.zeros((3, count), np.int64)
        states, ends = np.zeros(count, np.uint8), np.cumsum([0, *map(len, light)])
        for each, first in zip(texels, ends, strict=False):
            k = each.wall
            firsts[k], (rows[k], columns[k]) = first, each.sums.shape[:2]
            states[k] = FINAL if finals[k] else CONVERGING if each.fine else PROVISIONAL
        return WallTable(np.concatenate(light), firsts, rows, columns, states)

    def put_paths(self, target: float, framebuffer: Framebuffer, tiles: Tiles) -> None:
        """Write the walls into a path-traced picture, as many paths from each pixel. Raises Cancelled."""
        walls, plan, samples = self.gbuffer.walls, self.light.spec.prepared.scene.plan, self.light.view.samples
        replicas = replicas_for(samples)
        count, room = max(samples // replicas, 1), self.light.spec.prepared.room(self.light.seen.albedo)
        each, replica = (part.ravel() for part in np.indices((len(walls.pixels), replicas)))
        seeds = seeds_of(np.column_stack([walls.pixels[each], replica]))
        starts = starts_on(walls.points[each], self._normals[each], walls.numbers[each], self.gbuffer.surface, seeds)
        rules = PathRules(path_weights(np.ones(3), plan.bounces, 1.0), plan.survival)
        sums = light_starts(self.light, self.gbuffer.surface, starts, rules, SampleRange(0, count), tiles)
        means = room.albedos[walls.numbers][:, None] * sums.reshape(-1, replicas, 3) / count
        variance = pooled_variance(variance_of_mean(means), self.gbuffer, walls.pixels)
        light = np.minimum(means.mean(axis=1) + room.radiances[walls.numbers], np.finfo(np.float32).max)
        error = np.sqrt(variance) / np.maximum(light @ LUMINANCE, DARKEST * self.light.spec.unit)
        framebuffer.radiance[walls.pixels] = light
        framebuffer.state[walls.pixels] = np.where(error <= target, FINAL, CONVERGING)
        framebuffer.error[walls.pixels] = np.clip(error, 0.0, 1.0)

    @property
    def _normals(self) -> np.ndarray:
        """The normals of the sides that are seen; (m, 3)."""
        room = self.light.spec.prepared.room(self.light.seen.albedo)
        return np.asarray(self.sides[:, None] * room.normals[self.gbuffer.walls.numbers])

    def put_locally(self, shading: str, depths: tuple[float, float], framebuffer: Framebuffer, tiles: Tiles) -> None:
        """Write the walls into a picture by a local model, whose shadows are those of the surface. Raises Cancelled."""
        walls, gbuffer, room = self.gbuffer.walls, self.gbuffer, self.light.spec.prepared.scene.room
        traced, normals = gbuffer.surface.traced(tiles.run), self._normals.astype(np.float32)
        for number, _ in self.seen:
            rows = np.flatnonzero(walls.numbers == number)
            model = self.light.local_model(shading, depths, np.array(room.walls[number].albedo))
            some = PixelPoints(walls.points[rows], normals[rows], walls.pixels[rows])
            reached = np.empty(len(rows), np.bool_)
            if model.shadow:
                find_shadows(traced, some, model.key, reached)
            shade_local(some, reached, gbuffer.eye, gbuffer.spacing, model, framebuffer)
