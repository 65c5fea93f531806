"""The shine of a view: one ray a pixel at once, of what texels show now, and more while the view
rests.

What the first rays bring is filtered: pixels side by side whose normals are alike share it. They
tell its noise, and how much the last step of the filter changed tells what that blurs. Once the
texels' light is final, more are cast, in halves that tell their noise, until it is a share of the
target error. They are kept, in memory, with the view.
"""

import threading
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from isogi_core.bake.noise import Until
from isogi_core.bake.texel_light import FIRST_LEVEL
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
from isogi_core.frame.texel_normals import TexelNormals
from isogi_core.frame.texel_shading import TexelShading
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import ViewChecks, check_key, texels_until
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import FINAL, PROVISIONAL, Framebuffer
from isogi_core.kernels.shading.lattice import MIN_LIGHT
from isogi_core.kernels.shading.shine import filter_shine, light_ends
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.material import DULL

MIN_RAYS = 8
MAX_RAYS = 1 << 12
"""Rays of each half from a point: so many find highlights that a few miss; and at most."""

STEP_RAYS = 1 << 20
ENDS_TOGETHER = 1 << 18
"""Rays of a step, about, of a point at least one of each half, and as many again as there are at
most; and those whose ends are looked up together.
"""

SHINE_NOISE_SHARE = 0.5
"""Share of the target error that the noise of shine may have."""

FILTER_STEPS = (1, 2)
ALIKE = 0.2
"""How far apart the pixels are that the filter of first rays looks at, step after step; and how
much their unit normals differ at most of what mirrors sharply: rougher lobes see as much from
normals farther apart.
"""


@dataclass(frozen=True, eq=False)
class SeenLight:
    """What rays see where they end: ``light`` (h, 3) linear RGB, its ``states`` (h,), and what
    names it.
    """

    light: np.ndarray
    states: np.ndarray
    version: bytes


@dataclass(eq=False)
class ShineLight:
    """The shine of a view in a ``light``: what it leaves of diffuse light, ``below``; its first
    ``rays``; and the ``sums`` of those that were cast since the texels' light is final. Threads
    wait for each other.
    """

    light: RotatedLight
    gbuffer: GBuffer
    below: np.ndarray
    rays: ShineRays
    sums: Estimate
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @classmethod
    def begun(cls, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles) -> "ShineLight":
        """The shine of a surface that shines in a ``light``, with its first rays. Raises
        Cancelled.
        """
        rays = cast_rays(light, gbuffer, range(1), range(1), tiles, ways=1)
        return cls(
            light,
            gbuffer,
            light_below(light, gbuffer, tiles),
            rays,
            Estimate.none(len(gbuffer.points)),
        )

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return self.below.nbytes + self.rays.nbytes + self.sums.nbytes

    @property
    def count(self) -> int:
        """The most rays of each half that any point has; 0 where nothing but the first rays was
        cast.
        """
        return self.sums.most

    @property
    def version(self) -> bytes:
        """Names the rays that it is made of, but for what texels show where the first ones end."""
        return repr(self.light.shine).encode() + self.sums.version

    def is_shown(self, frame: Frame) -> bool:
        """Whether a ``frame`` shows all rays that were cast."""
        return frame.quality.rays.startswith(self.version)

    def put(self, seen: SeenLight | None, framebuffer: Framebuffer, tiles: Tiles) -> None:
        """Write it into a picture of diffuse light, of which the share ``below`` stays; errors are
        of both.

        All rays bring it, or the first ones where these have ``seen`` light. Raises Cancelled.
        """
        if seen is None:
            brought = self._sharp(tiles)
        else:
            brought = self._filtered(self.rays.gather(seen.light), tiles)
        darkest = MIN_LIGHT * self.light.spec.unit

        def _piece(a: int, b: int) -> None:
            pixels = self.gbuffer.pixels[a:b]
            diffuse = framebuffer.radiance[pixels] * self.below[a:b]
            noise = framebuffer.error[pixels] * (diffuse @ LUMINANCE_WEIGHTS)
            light = diffuse + brought.light[a:b]
            error = np.sqrt(noise**2 + brought.variance[a:b]) / np.maximum(
                light @ LUMINANCE_WEIGHTS, darkest
            )
            framebuffer.radiance[pixels] = np.minimum(light, np.finfo(np.float32).max)
            unknown = framebuffer.state[pixels] <= PROVISIONAL
            framebuffer.error[pixels] = np.where(unknown, 1.0, np.minimum(error, 1.0))

        tiles.run(_piece, len(self.below), tiles.even(len(self.below)))

    def _filtered(self, means: np.ndarray, tiles: Tiles) -> NoisyLight:
        """What single rays bring, ``means`` (m, 1, 3), filtered over the picture. Raises
        Cancelled.
        """
        gbuffer = self.gbuffer
        shine = self.light.shine or DULL
        single = NoisyLight.of(means, self.gbuffer, tiles)
        rows = gbuffer.rows
        normals = gbuffer.normals(tiles)
        width = float(np.hypot(ALIKE, 2.0 * shine.alpha))
        steps = [np.column_stack([single.light, single.variance]).astype(np.float32)]
        for step in FILTER_STEPS:
            before = steps[-1]
            after = np.empty_like(steps[-1])

            def _piece(a: int, b: int) -> None:
                filter_shine(rows, gbuffer.pixels, normals, a, before, step, width, after[a:b])  # noqa: B023

            tiles.run(_piece, len(before), tiles.even(len(before)))
            steps.append(after)
        blurred = ((steps[-1] - steps[-2])[:, :3] @ LUMINANCE_WEIGHTS) ** 2
        return NoisyLight(steps[-1][:, :3], steps[-1][:, 3] + blurred)

    def _sharp(self, tiles: Tiles) -> NoisyLight:
        """What all rays bring that were cast since the texels' light is final."""
        return NoisyLight.of(self.sums.means, self.gbuffer, tiles)

    def noisy(self, allowed: float, tiles: Tiles) -> np.ndarray:
        """Rows of the points that are to have more rays: all at first, none where the picture's
        noise is allowed.
        """
        if self.count < MIN_RAYS:
            return np.arange(len(self.gbuffer.points))
        return self.sums.noisy(self._sharp(tiles).variance, allowed)


@dataclass(frozen=True, eq=False)
class ViewShine(Refinement[ShineLight]):
    """The shine of views, among what is ``kept``; ``texels``, ``walls`` and ``checks`` tell what
    its rays see.
    """

    kept: LruCache[Any]
    texels: TexelShading
    walls: ViewWalls
    checks: ViewChecks

    def put(
        self,
        gbuffer: GBuffer,
        light: RotatedLight,
        target: float,
        framebuffer: Framebuffer,
        tiles: Tiles,
    ) -> bytes:
        """Let the surface in a picture shine; what names the rays that were taken, and the light
        that they read.
        """
        shine = self._of(light, gbuffer, tiles)
        if shine.count:
            ends = None
        else:
            ends = self._ends(shine.rays, light, target, tiles)
        shine.put(ends, framebuffer, tiles)
        return shine.version + (ends.version if ends else b"")

    def of(
        self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles
    ) -> ShineLight | None:
        """See ``Refinement``."""
        shines = light.shine is not None and len(frame.gbuffer.pixels) > 0
        if shines:
            return self._of(light, frame.gbuffer, tiles)
        return None

    def advance(
        self, found: ShineLight, frame: Frame, target: float, tiles: Tiles, prices: Prices
    ) -> bool:
        """Cast more rays where the noise is above its share of the ``target``: see
        ``Refinement``.
        """
        places = found.noisy(SHINE_NOISE_SHARE * target * frame.true_mean, tiles)
        if not len(places) or found.count >= MAX_RAYS:
            return False
        self._cast(found, places, target, tiles)
        return True

    def _cast(self, shine: ShineLight, places: np.ndarray, target: float, tiles: Tiles) -> None:
        """Cast as many rays again from the points at ``places``; paths go on from where light is
        not final.
        """
        some = shine.gbuffer.part(places, tiles)
        each = HALVES * len(places)
        numbers = shine.sums.next(STEP_RAYS // each)
        bounces = bounces_of_truth(shine.light)
        added = np.zeros((len(places), HALVES, 3))
        together = max(ENDS_TOGETHER // each, 1)
        for first in range(0, len(numbers), together):
            rays = cast_rays(
                shine.light, some, range(HALVES), numbers[first : first + together], tiles
            )
            seen = self._ends(rays, shine.light, target, tiles)
            for kind in (ViewTexels, TexelNormals):
                self.kept.drop((kind, surface_key(rays.view(shine.light.view)), False))
            short = np.flatnonzero(seen.states != FINAL)
            seen.light[short] = paths_from(rays, short, shine.light, bounces, tiles)
            added += rays.gather(seen.light).reshape(len(places), HALVES, -1, 3).sum(axis=2)
        shine.sums = shine.sums.joined(places, added, numbers.stop)

    def _of(self, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles) -> ShineLight:
        """The shine of a view, with its first rays at least."""
        make = partial(ShineLight.begun, light, gbuffer, tiles)
        return self.kept.get((ShineLight, *check_key(light.view, 0.0), light.view.moving), make)

    def _ends(self, rays: ShineRays, light: RotatedLight, target: float, tiles: Tiles) -> SeenLight:
        """What rays of shine see by texels and walls as they are lit now; unshadowed light where
        nothing is lit yet.
        """
        hits = rays.hits
        seen = RotatedLight(light.spec, rays.view(light.view))
        texels = self.texels.under(seen.view, hits, tiles)
        check = self.checks.held(light.view, target)
        until = texels_until(Until(target, FIRST_LEVEL), light.view, check.known if check else None)
        reading, framebuffer = self.texels.picture(texels, seen, until, tiles, Stopwatch())
        add_lobes_seen(rays, seen, framebuffer, tiles)
        colour_surface(hits, seen, framebuffer, tiles)
        version = self.walls.put_seen(walls_seen(rays, seen), target, framebuffer, tiles)
        return SeenLight(
            framebuffer.radiance, framebuffer.state, reading.version + version.encode()
        )


def walls_seen(rays: ShineRays, light: RotatedLight) -> list[WallView]:
    """The walls that rays see, fronts and backs apart: what was met of each is one side."""
    walls = rays.hits.walls
    hits = rays.hits
    if not len(walls.pixels):
        return []
    fronts = light.spec.prepared.room(light.seen.albedo).normals[walls.numbers]
    sides = np.where((fronts * rays.ends.points.normals[walls.pixels]).sum(axis=1) > 0.0, 1, -1)
    return WallView.of_sides(hits, light, sides)


def add_lobes_seen(
    rays: ShineRays, light: RotatedLight, framebuffer: Framebuffer, tiles: Tiles
) -> None:
    """Add what comes straight from lobes of a ``light`` where rays end, one shadow ray to each, to
    the picture of that.

    Raises Cancelled.
    """
    if not light.spec.lobes:
        return
    hits = rays.hits
    lamps = light.lobes
    shown = hits.shown(tiles)
    seeds = rays.seeds[hits.pixels]
    lit = np.empty((len(hits.pixels), 3), np.float32)
    traced = hits.surface.traced(tiles.run)

    def _piece(a: int, b: int) -> None:
        light_ends(traced, shown.part(slice(a, b)), lamps, seeds[a:b], lit[a:b])

    tiles.run(_piece, len(lit), RAYS_TOGETHER)
    framebuffer.radiance[hits.pixels] += light.spec.unit * light.tint.astype(np.float32) * lit
