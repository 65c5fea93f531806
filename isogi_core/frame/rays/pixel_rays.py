"""Rays from the pixels' own points: direct light of lobes, and whole paths, with what is known of their noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from isogi_core.bake.bake_spec import path_weights
from isogi_core.bake.path_light import on_wall
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.glow_light import add_glow
from isogi_core.frame.rays.point_paths import path_starts, sight_lines, trace_among
from isogi_core.frame.rays.shine import add_shine
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import PixelPoints
from isogi_core.kernels.shading.lattice import DARKEST
from isogi_core.kernels.shading.lobes import (
    DARK,
    EVEN,
    HALF,
    LIT,
    RAYS,
    RIM,
    TURNS,
    Aimed,
    Pixels,
    add_halves,
    aim_at_discs,
    aim_at_middles,
    aim_at_rims,
    believe,
    cast_shadow_rays,
    face_lobes,
    find_around,
    light_points,
    mark_edges,
    spread_edges,
)
from isogi_core.kernels.shading.local_models import trace_points
from isogi_core.kernels.tracing.cast import TracedSurface
from isogi_core.kernels.transport.lights import LampArrays
from isogi_core.kernels.transport.paths import PathRules, SampleRange
from isogi_core.model.sky import LUMINANCE
from isogi_core.plan.budget import survival_for

LOBE_POINTS, RIMS, HALVES = 4096, 1024, 256
"""Surface points, pairs of points and lobes at edges of shadows, and such pairs in half-shadow, of a tile."""

RIM_SEEN = np.array([DARK, *[HALF] * (RIM - 1), LIT], np.uint8)
"""What a point sees of a lobe of which so many rays to the rim get away."""


@dataclass(frozen=True, eq=False)
class LobeLight:
    """Light of lobes at a view's surface points: ``lit`` (m, 4) float32, in ``BakeSpec.unit``, see ``light_points``.

    It leaves a surface of the bake spec's own albedo.
    """

    lit: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.lit.nbytes

    def tinted(self, tint: np.ndarray) -> "LobeLight":
        """The same from a surface that reflects ``tint`` (3,) times as much of each colour."""
        if (tint == 1.0).all():
            return self
        if (tint == tint[0]).all():
            return LobeLight(self.lit * np.array([*tint, tint[0] ** 2], np.float32))
        colours = (self.lit[:, :3] * tint).astype(np.float32)
        grown = (colours @ LUMINANCE) / np.maximum(self.lit[:, :3] @ LUMINANCE, DARKEST)
        return LobeLight(np.column_stack([colours, self.lit[:, 3] * grown**2]).astype(np.float32))


def find_lobes(light: RotatedLight, gbuffer: GBuffer, tiles: Tiles) -> LobeLight:
    """Find what comes straight from the lobes of a ``light``; of a view that moves by fewer rays. Raises Cancelled."""
    lamps, moving = light.lobes, light.view.moving
    picture = picture_of(gbuffer, tiles)
    shadows = Shadows(gbuffer.surface.traced(tiles.run), picture, lamps, tiles)
    seen = shadows.middles()
    halves = np.empty(0, np.int64) if moving else shadows.edges(seen)
    lit = np.empty((len(gbuffer.points), 4), np.float32)
    tiles.run(lambda a, b: light_points(picture, lamps, (a, b), moving, seen, lit), len(lit), LOBE_POINTS)
    add_halves(lamps, halves, shadows.halves(halves), lit)
    return LobeLight(lit)


def picture_of(gbuffer: GBuffer, tiles: Tiles) -> Pixels:
    """The points of a G-buffer, and where they are in its picture."""
    return Pixels(PixelPoints(gbuffer.points, gbuffer.normals(tiles), gbuffer.pixels), gbuffer.rows)


@dataclass(frozen=True, eq=False)
class Shadows:
    """What the points of a ``picture`` see of directional ``lamps`` past the ``traced`` surface.

    It is the same however the work is cut into ``tiles``.
    """

    traced: TracedSurface
    picture: Pixels
    lamps: LampArrays
    tiles: Tiles

    @property
    def points(self) -> int:
        """How many points there are."""
        return len(self.picture.points.pixels)

    def middles(self) -> np.ndarray:
        """What all points see of lobes' middles, (lobes, m) uint8."""
        seen = np.empty((len(self.lamps.kinds), self.points), np.uint8)
        around = np.empty((self.points, 4), np.int32)

        def _begin(a: int, b: int) -> None:
            face_lobes(self.picture.points, self.lamps, (a, b), seen)
            find_around(self.picture, (a, b), around)

        self.tiles.run(_begin, self.points, LOBE_POINTS)
        flat = seen.reshape(-1)
        for turn in range(TURNS):

            def _piece(a: int, b: int, turn: int = turn) -> None:
                aimed = room_for(count := believe(self.picture, (a, b), turn, around, seen))
                aim_at_middles(self.picture, self.lamps, (a, b), turn, seen, aimed)
                flat[aimed.pairs] = np.where(self._cast(aimed, count), LIT, DARK)

            self.tiles.run(_piece, self.points, LOBE_POINTS)
        return seen

    def edges(self, seen: np.ndarray) -> np.ndarray:
        """Put into ``seen`` what points at the edges of shadows see of lobes' rims; the pairs in half-shadow, int64."""
        asked = np.empty_like(seen)

        def _piece(a: int, b: int) -> None:
            mark_edges(self.picture, self.lamps, (a, b), seen, asked)

        self.tiles.run(_piece, self.points, LOBE_POINTS)
        pairs, found = np.flatnonzero(asked), [np.empty(0, np.int64)]
        while len(pairs):
            seen.reshape(-1)[pairs] = sees = self._rims(pairs)
            found.append(pairs[sees == HALF])
            more = np.empty(8 * len(pairs), np.int64)
            pairs = more[: spread_edges(self.picture, self.lamps, found[-1], seen, asked, more)]
        return np.sort(np.concatenate(found))

    def _rims(self, pairs: np.ndarray) -> np.ndarray:
        """What the points and lobes in ``pairs`` see of each other by their rims; (pairs,) uint8."""
        found = np.empty(len(pairs), np.uint8)

        def _piece(a: int, b: int) -> None:
            aimed = room_for(RIM * (b - a))
            count = aim_at_rims(self.picture.points, self.lamps, pairs[a:b], aimed)
            rays = np.bincount(aimed.pairs[:count][self._cast(aimed, count)], minlength=b - a)
            found[a:b] = RIM_SEEN[rays]

        self.tiles.run(_piece, len(pairs), RIMS)
        return found

    def halves(self, pairs: np.ndarray) -> np.ndarray:
        """Shares of lobes that points see in part, and their variance; (pairs, 2)."""
        shares = np.empty((len(pairs), 2))

        def _piece(a: int, b: int) -> None:
            count = RAYS * (b - a)
            aimed, brought = room_for(count), np.empty(count)
            aim_at_discs(self.picture.points, self.lamps, pairs[a:b], aimed, brought)
            each = (brought * self._cast(aimed, count)).reshape(-1, RAYS)
            shares[a:b, 0], shares[a:b, 1] = each.mean(axis=1), EVEN * each.var(axis=1) / (RAYS - 1)

        self.tiles.run(_piece, len(pairs), HALVES)
        return shares

    def _cast(self, aimed: Aimed, count: int) -> np.ndarray:
        """Whether the first ``count`` rays get away; (count,) bool."""
        reached = np.empty(count, np.bool_)
        cast_shadow_rays(self.traced, self.picture.points, aimed, count, reached)
        return reached


def room_for(rays: int) -> Aimed:
    """Room for so many rays."""
    return Aimed(np.empty(rays, np.int64), np.empty(rays, np.int64), np.empty((3, rays)))


PATH_POINTS, PATHS = 256, 1 << 16
"""Surface points of a tile when each of them sends paths, and paths of one, at most: some 30 ms until it can end."""

NEAR = np.array([1.0, 4.0, 6.0, 4.0, 1.0])
"""What neighbours count along an axis, where variances are pooled."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths from the surface points of ``gbuffer`` under a ``light``, on the threads of ``tiles``.

    They have the plan's own ``bounces`` by default.
    """

    light: RotatedLight
    gbuffer: GBuffer
    tiles: Tiles
    bounces: int | None = None

    @cached_property
    def survival(self) -> float:
        """The chance with which a path goes on from its second and later hits."""
        plan = self.light.spec.prepared.scene.plan
        return plan.survival if self.bounces is None else survival_for(self.light.reflecting, self.bounces)

    @cached_property
    def weights(self) -> np.ndarray:
        """R^(k + 1) after k = 0 … bounces, over the chance to get there; (bounces + 1, 3) float64.

        Where paths carry the colours that they meet they count 1 at the start, which is all that is read of these. The
        eye's rays that pass a surface reach the first that reflects them by one bounce more.
        """
        scene = self.light.spec.prepared.scene
        bounces = scene.plan.bounces if self.bounces is None else self.bounces
        if scene.material.refracts:
            return path_weights(np.ones(3), bounces + 1, 1.0)
        if self.light.coloured or scene.material.scatters:
            return path_weights(np.ones(3), bounces, 1.0)
        return path_weights(self.light.albedo, bounces, self.survival, leaving=1)

    def of(self, rows: np.ndarray) -> "Paths":
        """The paths of those points alone that are in these ``rows``, ascending."""
        return replace(self, gbuffer=self.gbuffer.part(rows, self.tiles))

    def add(
        self,
        sums: np.ndarray,
        stream: int,
        first: int,
        count: int,
        progress: Callable[[int], object] | None = None,
    ) -> None:
        """Add samples first … first + count of each replica to ``sums`` (points, replicas, 3) float64, in place.

        Replicas are the randomisations from number ``stream`` on; ``progress`` is called with the number of paths
        that each piece traced. Of a surface that shines as many rays of shine are among them. Raises Cancelled.
        """
        buffer, alone = self.gbuffer, self.light.shine is None and not self.light.coloured
        prepared, replicas = self.light.spec.prepared, range(stream, stream + sums.shape[1])
        own = sums if alone else np.zeros_like(sums)
        points, pixels = buffer.points, buffer.pixels
        if prepared.scene.material.refracts:
            points, normals = sight_lines(buffer)
        else:
            normals = buffer.normals(self.tiles)
        traced, around = buffer.surface.traced(self.tiles.run), self.light.surroundings
        met = prepared.met(self.light.seen.albedo, traced.cells, self.tiles.run)
        rules, samples = PathRules(self.weights, self.survival), SampleRange(first, count)

        def _piece(a: int, b: int) -> None:
            some = PixelPoints(points[a:b], normals[a:b], pixels[a:b])
            if met is None:
                trace_points(traced, some, around, rules, stream, samples, own[a:b])
            else:
                own[a:b] += trace_among(traced, met, some, around, rules, replicas, samples)
            if prepared.scene.glowing.any:
                starts = on_wall(path_starts(traced, some, replicas))
                add_glow(own[a:b].reshape(-1, 3), self.light, traced, starts, rules, samples)
            if progress is not None:
                progress((b - a) * sums.shape[1] * count)

        self.tiles.run(_piece, len(sums), max(min(PATH_POINTS, PATHS // (sums.shape[1] * count)), 1))
        if self.light.coloured:
            own *= buffer.albedos(self.light.spec.prepared.colours, self.tiles)[: len(own), None]
        if self.light.shine is not None:
            given = range(first, first + count), len(self.weights) - 1
            add_shine(own, self.light, buffer, stream, *given, self.tiles)
        if not alone:
            sums += own

    def prepare(self) -> None:
        """Do what comes before the first paths, by tracing one: find normals, map the surface, compile."""
        self.add(np.zeros((min(len(self.gbuffer.points), 1), 1, 3)), 0, 0, 1)


def variance_of_mean(means: np.ndarray) -> np.ndarray:
    """Variance of the luminance of the mean over independent replicas ``means`` (m, replicas, 3); (m,) float64."""
    return np.asarray((means @ LUMINANCE).var(axis=1, ddof=1) / means.shape[1])


def replicas_for(samples: int) -> int:
    """How many replicas a frame of ``samples`` paths per pixel is made of.

    More of them estimate the error better, and make it larger, since each is a shorter sequence: at 256 paths eight
    have 1.1 times the error of four (engine under uffizi and grace, CT head under noon_grass).
    """
    return 2 if samples < 8 else 4 if samples < 256 else 8


def pooled_variance(variance: np.ndarray, gbuffer: GBuffer, shown: np.ndarray | None = None) -> np.ndarray:
    """Variances (m,) of the surface pixels, each a mean with its neighbours', by the weights NEAR both ways.

    Or of the pixels ``shown`` (m,), of something else.

    A few replicas say too little of one pixel alone: of four, 1.96 standard deviations would hold 86 % of Gaussian
    errors, and none where all replicas met the same by chance. With these they held 91 to 96 % of the pixels
    of frames of 8 to 256 paths (engine under uffizi and grace, CT head under noon_grass, MNI under constant light).
    """
    pixels, both = gbuffer.pixels if shown is None else shown, np.zeros((2, *gbuffer.shape))
    both.reshape(2, -1)[:, pixels] = variance, np.ones_like(variance)
    for axis in (1, 2):
        padded = np.pad(both, [(2 * int(a == axis),) * 2 for a in range(3)])
        windows = np.lib.stride_tricks.sliding_window_view(padded, len(NEAR), axis)
        both = windows @ NEAR
    total, weight = both.reshape(2, -1)[:, pixels]
    return np.asarray(total / weight)
