"""The shine of a view: first one ray for each pixel, and more while the view rests.

The first rays take the light that texels show now. They are filtered over neighbouring pixels with
similar normals; the rays show their noise, and the change by the last pass of the filter shows how
much it blurs. Once the light of texels is final, more rays are cast, in halves that show their
noise, until this is a share of the target error. While they are so few that the filter takes away
more than it blurs, they are filtered, too. They are kept in memory, with the view.
"""

import threading
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from isogi_core.bake.noise import Goal
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer, surface_key
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.control_pixels import bounces_of_truth
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.rays.point_paths import HALVES, Estimate, NoisyLight
from isogi_core.frame.rays.shine import RAYS_TOGETHER, ShineRays, cast_rays, light_below, paths_from
from isogi_core.frame.rays.wall_light import ViewWalls, WallView
from isogi_core.frame.refinement import Refinement
from isogi_core.frame.shading import colour_surface
from isogi_core.frame.shot import Shot
from isogi_core.frame.texel_normals import TexelNormals
from isogi_core.frame.texel_shading import TexelShading
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_checks import ViewChecks, check_key, goal_of_texels
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import FINAL, PROVISIONAL, Framebuffer
from isogi_core.kernels.shading.lattice import MIN_LIGHT
from isogi_core.kernels.shading.shine import filter_shine, light_ends
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.material import DULL

MIN_RAYS = 8
MAX_RAYS = 1 << 12
"""Rays of each half from a point, at least and at most; fewer may miss a highlight."""

STEP_RAYS = 1 << 20
ENDS_TOGETHER = 1 << 18
"""Rays of a step, about, and rays whose ends are looked up together. A step casts at least one ray
of each half from a point, and at most doubles the rays.
"""

SHINE_NOISE_SHARE = 0.5
"""Share of the target error that the noise of shine may have."""

FILTER_STEPS = (1, 2)
ALIKE = 0.2
"""Distances between the pixels that each pass of the filter mixes; and largest difference
between the unit normals of these for a sharp mirror. Rougher lobes see about the same from
normals farther apart.
"""


@dataclass(frozen=True, eq=False)
class SeenLight:
    """Light at the ends of rays: ``light`` (h, 3) linear RGB, its ``states`` (h,), and a
    ``version`` that names it.
    """

    light: np.ndarray
    states: np.ndarray
    version: bytes


@dataclass(eq=False)
class ShineLight:
    """The shine of a view under a ``light``.

    - ``below`` (m, 3): share of diffuse light that stays under the shine.
    - ``rays``: the first rays, one from each point.
    - ``sums``: light of all later rays, which are cast once the light of texels is final.

    Only the thread that holds the ``lock`` replaces the ``sums``.
    """

    light: RotatedLight
    gbuffer: GBuffer
    below: np.ndarray
    rays: ShineRays
    sums: Estimate
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @classmethod
    def begun(cls, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles) -> "ShineLight":
        """Cast the first rays of a view's shine. Raises Cancelled."""
        rays = cast_rays(light, gbuffer, range(1), range(1), tiles, ways=1)
        below = light_below(light, gbuffer, tiles)
        return cls(light, gbuffer, below, rays, Estimate.none(len(gbuffer.points)))

    @property
    def nbytes(self) -> int:
        """The size of its arrays in bytes."""
        return self.below.nbytes + self.rays.nbytes + self.sums.nbytes

    @property
    def count(self) -> int:
        """The largest number of rays of each half from any point; 0 if only the first rays were
        cast.
        """
        return self.sums.most

    @property
    def version(self) -> bytes:
        """A name of the rays that it is made of, without the light at the ends of the first
        ones.
        """
        return self.named(self.sums)

    def named(self, sums: Estimate) -> bytes:
        """Return the ``version`` if the rays are those of ``sums``."""
        return repr(self.light.shine).encode() + sums.version

    def is_shown(self, frame: Frame) -> bool:
        """Return True if a ``frame`` shows all rays that were cast."""
        return frame.quality.rays.startswith(self.version)

    def put(
        self, brought: SeenLight | Estimate, framebuffer: Framebuffer, target: float, tiles: Tiles
    ) -> None:
        """Add the shine to a picture of diffuse light, of which the share ``below`` stays.

        It is ``brought`` by the first rays, with the light at their ends, or in the mean by the
        later ones, with their sums; these are filtered at most until their noise is allowed by a
        ``target`` error. Raises Cancelled.
        """
        if isinstance(brought, Estimate):
            diffuse = framebuffer.radiance[self.gbuffer.pixels] * self.below
            found = self._clearer(
                brought, float((diffuse @ LUMINANCE_WEIGHTS).mean()), target, tiles
            )
        else:
            found = self._filtered(self.rays.gather(brought.light), tiles)
        darkest = MIN_LIGHT * self.light.spec.unit

        # Both errors are independent, so their squares add up.
        def _piece(a: int, b: int) -> None:
            pixels = self.gbuffer.pixels[a:b]
            diffuse = framebuffer.radiance[pixels] * self.below[a:b]
            noise = framebuffer.error[pixels] * (diffuse @ LUMINANCE_WEIGHTS)
            light = diffuse + found.light[a:b]
            error = np.sqrt(noise**2 + found.variance[a:b]) / np.maximum(
                light @ LUMINANCE_WEIGHTS, darkest
            )
            framebuffer.radiance[pixels] = np.minimum(light, np.finfo(np.float32).max)
            unknown = framebuffer.state[pixels] <= PROVISIONAL
            framebuffer.error[pixels] = np.where(unknown, 1.0, np.minimum(error, 1.0))

        tiles.run(_piece, len(self.below), tiles.even(len(self.below)))

    def _clearer(self, sums: Estimate, diffuse: float, target: float, tiles: Tiles) -> NoisyLight:
        """Return the light of ``sums``, filtered over the picture if that has a smaller error and
        their noise is not yet allowed by a ``target`` error; ``diffuse`` is the mean luminance
        below the shine.

        The first sums hold two rays of a point: unfiltered, they would have more noise than the
        picture of the first rays that they replace. Raises Cancelled.
        """
        sharp = self._sharp(sums, tiles)
        shown = diffuse + float((sharp.light @ LUMINANCE_WEIGHTS).mean())
        noise = float(sharp.variance.mean())
        if noise <= (SHINE_NOISE_SHARE * target * shown) ** 2:
            return sharp
        # One half has other rays than the other: what it differs by from the other one filtered,
        # beyond its own noise, is the error by filtering.
        one, other = (sums.means @ LUMINANCE_WEIGHTS).T
        smooth = self._filtered(sums.means[:, :1], tiles).light @ LUMINANCE_WEIGHTS
        error = float(((smooth - other) ** 2).mean() - ((one - other) ** 2).mean() / 2.0)
        if error >= noise:
            return sharp
        # Report at least this error.
        filtered = self._filtered(sums.means, tiles)
        told = float(filtered.variance.mean())
        return NoisyLight(filtered.light, filtered.variance * max(error / max(told, 1e-300), 1.0))

    def _filtered(self, means: np.ndarray, tiles: Tiles) -> NoisyLight:
        """Filter the light of rays, ``means`` (m, 1 or 2, 3), over the picture. Raises
        Cancelled.
        """
        gbuffer = self.gbuffer
        shine = self.light.shine or DULL
        single = NoisyLight.of(means, self.gbuffer, tiles)
        rows = gbuffer.rows
        normals = gbuffer.normals(tiles)
        # The rougher the lobe, the farther normals may differ.
        width = float(np.hypot(ALIKE, 2.0 * shine.alpha))
        steps = [np.column_stack([single.light, single.variance]).astype(np.float32)]
        for step in FILTER_STEPS:
            before = steps[-1]
            after = np.empty_like(steps[-1])

            def _piece(a: int, b: int) -> None:
                filter_shine(rows, gbuffer.pixels, normals, a, before, step, width, after[a:b])  # noqa: B023

            tiles.run(_piece, len(before), tiles.even(len(before)))
            steps.append(after)
        # Count the change by the last pass as an error: the filter may have blurred as much.
        blurred = ((steps[-1] - steps[-2])[:, :3] @ LUMINANCE_WEIGHTS) ** 2
        return NoisyLight(steps[-1][:, :3], steps[-1][:, 3] + blurred)

    def _sharp(self, sums: Estimate, tiles: Tiles) -> NoisyLight:
        """Return the light of ``sums``, those of rays cast since the light of texels is final."""
        return NoisyLight.of(sums.means, self.gbuffer, tiles)

    def noisy(self, allowed: float, tiles: Tiles) -> np.ndarray:
        """Return the rows of the points that are to have more rays: all at first, none once the
        noise of the picture is ``allowed``.
        """
        if self.count < MIN_RAYS:
            return np.arange(len(self.gbuffer.points))
        return self.sums.noisy(self._sharp(self.sums, tiles).variance, allowed)


@dataclass(frozen=True, eq=False)
class ViewShine(Refinement[ShineLight]):
    """The shine of views, among results that are ``kept``; ``texels``, ``walls`` and ``checks``
    give the light at the ends of its rays.
    """

    kept: LruCache[Any]
    texels: TexelShading
    walls: ViewWalls
    checks: ViewChecks

    def put(self, shot: Shot, framebuffer: Framebuffer) -> bytes:
        """Add shine to the diffuse light in the picture of a ``shot``, in place, of which the share
        ``ShineLight.below`` stays; return a name of the shine. Raises Cancelled.

        The name begins with ``ShineLight.version``, which names the rays. If only the first rays
        were cast, it goes on with the version of the light at their ends.
        """
        tiles = shot.tiles
        shine = self._begun(shot)
        # Read the sums once: another thread may replace them meanwhile.
        sums = shine.sums
        # Rays cast after the first ones replace these. Their sums hold final light, so their number
        # names it. The light at the ends of the first rays still changes: look it up now.
        if sums.most:
            shine.put(sums, framebuffer, shot.goal.error, tiles)
            return shine.named(sums)
        ends = self._ends(shine.rays, shot)
        shine.put(ends, framebuffer, shot.goal.error, tiles)
        return shine.named(sums) + ends.version

    def of(self, shot: Shot) -> ShineLight | None:
        """Return the shine in a ``shot``, None if it has none: see ``Refinement``."""
        if shot.light.shine is None or not len(shot.gbuffer.pixels):
            return None
        return self._begun(shot)

    def advance(self, found: ShineLight, frame: Frame, shot: Shot, prices: Prices) -> bool:
        """Cast more rays if the noise is above its share of the goal's: see ``Refinement``."""
        allowed = SHINE_NOISE_SHARE * shot.goal.error * frame.true_mean
        places = found.noisy(allowed, shot.tiles)
        if not len(places) or found.count >= MAX_RAYS:
            return False
        self._cast(found, places, shot)
        return True

    def _cast(self, shine: ShineLight, places: np.ndarray, shot: Shot) -> None:
        """Double the rays from the points in rows ``places``. Paths start from ends whose light
        is not final.
        """
        tiles = shot.tiles
        some = shine.gbuffer.part(places, tiles)
        each = HALVES * len(places)
        numbers = shine.sums.next(STEP_RAYS // each)
        bounces = bounces_of_truth(shine.light)
        added = np.zeros((len(places), HALVES, 3))
        together = max(ENDS_TOGETHER // each, 1)
        # Look up the ends of some rays after the other, as they take memory.
        for first in range(0, len(numbers), together):
            rays = cast_rays(
                shine.light, some, range(HALVES), numbers[first : first + together], tiles
            )
            seen = self._ends(rays, shot)
            # The texels of this picture of ends are of no further use.
            for kind in (ViewTexels, TexelNormals):
                self.kept.drop((kind, surface_key(rays.view(shine.light.view)), False))
            short = np.flatnonzero(seen.states != FINAL)
            seen.light[short] = paths_from(rays, short, shine.light, bounces, tiles)
            added += rays.gather(seen.light).reshape(len(places), HALVES, -1, 3).sum(axis=2)
        shine.sums = shine.sums.joined(places, added, numbers.stop)

    def _begun(self, shot: Shot) -> ShineLight:
        """Return the shine of a ``shot``, kept or begun now with its first rays."""
        make = partial(ShineLight.begun, shot.light, shot.gbuffer, shot.tiles)
        return self.kept.get((ShineLight, *check_key(shot.view, 0.0), shot.view.moving), make)

    def _ends(self, rays: ShineRays, shot: Shot) -> SeenLight:
        """Return the light at the ends of ``rays``, by texels and walls as they are lit now;
        unshadowed light if nothing is lit yet.
        """
        hits = rays.hits
        # The ends are a picture of one row: shade it as any other, from texels, lobes, colours and
        # walls. Its texels are final once those of the view are.
        check = self.checks.held(shot.view, shot.goal)
        first = Goal.checked(shot.goal.error)
        goal = goal_of_texels(first, shot.view, check.known if check else None)
        seen = RotatedLight(shot.light.spec, rays.view(shot.view))
        row = Shot(hits, seen, goal, shot.tiles)
        texels = self.texels.under(seen.view, hits, shot.tiles)
        reading, framebuffer = self.texels.picture(texels, row)
        add_lobes_seen(rays, row, framebuffer)
        colour_surface(row, framebuffer)
        version = self.walls.put_seen(row, walls_seen(rays, seen), framebuffer)
        return SeenLight(
            framebuffer.radiance, framebuffer.state, reading.version + version.encode()
        )


def walls_seen(rays: ShineRays, light: RotatedLight) -> list[WallView]:
    """Return the walls that rays see, fronts and backs apart."""
    walls = rays.hits.walls
    hits = rays.hits
    if not len(walls.pixels):
        return []
    fronts = light.spec.prepared.room(light.seen.albedo).normals[walls.numbers]
    sides = np.where((fronts * rays.ends.points.normals[walls.pixels]).sum(axis=1) > 0.0, 1, -1)
    return WallView.of_sides(hits, light, sides)


def add_lobes_seen(rays: ShineRays, row: Shot, framebuffer: Framebuffer) -> None:
    """Add the direct light of lobes at the ends of ``rays`` to the picture of these, whose shot is
    a ``row``, by one shadow ray to each lobe.

    Raises Cancelled.
    """
    light = row.light
    if not light.spec.lobes:
        return
    hits = rays.hits
    tiles = row.tiles
    # Random points on lobes belong to the sequences of the rays.
    lamps = light.lobes
    shown = hits.shown(tiles)
    seeds = rays.seeds[hits.pixels]
    lit = np.empty((len(hits.pixels), 3), np.float32)
    traced = hits.surface.traced(tiles.run)

    def _piece(a: int, b: int) -> None:
        light_ends(traced, shown.part(slice(a, b)), lamps, seeds[a:b], lit[a:b])

    tiles.run(_piece, len(lit), RAYS_TOGETHER)
    framebuffer.radiance[hits.pixels] += light.spec.unit * light.tint.astype(np.float32) * lit
