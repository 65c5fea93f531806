"""The line from a view to its frame: surface, G-buffer, texels, reading, light, framebuffer.

Each step makes data from the data before it. One cache keeps what the steps make for the next frames. Its keys name the
step and the surface that a view shows, by isovalue, camera and size (``surface_key``):

| step | kept for |
|---|---|
| ``GBuffer``, ``ViewTexels``, ``Distances``, ``TexelNormals``, ``ShadowStarts``, ``EyeGlow`` | a surface |
| ``Reading`` | a surface, a bake spec, a target error, and the age of the page pool |
| ``FilteredLight`` | a view's texels, what is read of them, the rotation of the light, an albedo and a glow |
| ``LobeLight`` | a surface, the rotation of the light, and whether it moves |
| ``PictureCheck`` | a surface, the rotation of the light, an albedo, a shine, a glow and a target error |
| ``RoomLight`` | an isovalue, an albedo and a glow |
| ``SeenThrough`` | a surface, and the rotation of the light |
| ``ShineLight`` | a surface, its shine and albedo, the rotation of the light, a glow, and whether it moves |

``Reading``, ``FilteredLight``, ``LobeLight`` and ``ShineLight`` have a KIND_SHARE of its bytes each, so that a light
that turns, or a bake that goes on, drives out no surface. ``TexelShading`` keeps what views have in common of texels:
see ``OwnNormals``.
"""

import threading
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import spec_name
from isogi_core.bake.noise import Until
from isogi_core.bake.precision import FIRST_LEVEL
from isogi_core.cache.scene_caches import Caches
from isogi_core.cache.wall_store import WallStore
from isogi_core.frame.antialiasing import smooth_edges
from isogi_core.frame.eye_glow import with_glow
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer, to_index, trace
from isogi_core.frame.known_blocks import KnownBlocks
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.lobe_light import LobeLight, ShadowStarts, find_lobes, find_starts
from isogi_core.frame.rays.picture_plan import PRESENT, Prices
from isogi_core.frame.rays.shine_light import ShineLight, ViewShine
from isogi_core.frame.rays.through_matter import ViewThrough
from isogi_core.frame.rays.view_walls import ViewWalls
from isogi_core.frame.refinement import Refinement
from isogi_core.frame.several.composer import Composer
from isogi_core.frame.several.mixing import Level
from isogi_core.frame.shading import (
    colour_surface,
    empty_framebuffer,
    shade,
)
from isogi_core.frame.stand_in import StandIn
from isogi_core.frame.texel_normals import OwnNormals
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.texel_shading import FilteredLight, TexelShading
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import ViewChecks, texels_until
from isogi_core.frame.view_keys import is_checked, surface_key
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.lobes import add_lobes
from isogi_core.lru_cache import LruCache
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.shine import DULL
from isogi_core.model.view import View

VIEW_BYTES = 256 << 20
"""Bytes that are kept of views, for turning light and for asking again."""

KIND_SHARE, COMMON = 1 / 16, 1 / 3
"""Shares of these bytes: for what changes while a view stays, and for what views have in common of texels."""

PACKED = 1 / 8
"""Share of these bytes for blocks of chunks, which cards that draw the same scene have in common."""


class Renderer:
    """Renders views of one scene. Frames may be asked for from several threads."""

    def __init__(
        self,
        caches: Caches,
        tiles: Tiles,
        most: int = VIEW_BYTES,
        filters: bool = True,
        stand_in: StandIn | None = None,
        levels: tuple[Level, ...] = (),
    ) -> None:
        """Render with the light of ``caches``, on the threads of ``tiles``; keep ``most`` bytes of views.

        Who measures bakes ``filters`` no noisy light. Other light may ``stand_in`` where there is none yet. Of several
        surfaces one is shown alone, as the others light it, where there are ``levels`` to mix its light of.
        """
        self.prepared, self.caches, self.tiles = caches.prepared, caches, tiles
        changing = dict.fromkeys((Reading, FilteredLight, LobeLight, ShineLight), int(KIND_SHARE * most))
        self._kept: LruCache[Any] = LruCache(most - int((COMMON + PACKED) * most), changing)
        self.blocks = KnownBlocks(int(PACKED * most))
        shown = levels or (Level(caches),)
        self._texels = TexelShading(self.prepared, shown, self._kept, int(COMMON * most), filters, stand_in)
        self.checks = ViewChecks(self._kept, self._texels)
        self._walls = ViewWalls(self._kept, self.prepared.scene.volume, WallStore(caches.store, self.prepared))
        self._through = ViewThrough(self._kept, self._walls)
        self._shine = ViewShine(self._kept, self._texels, self._walls, self.checks)
        self._refinements: tuple[Refinement, ...] = (self._through, self._shine, self.checks)
        make, composes = partial(Renderer, tiles=tiles, most=most // 8, filters=filters), self.prepared.scene.several
        self._composer = Composer(caches, self, make, self._kept) if composes and not levels else None

    @property
    def nbytes(self) -> int:
        """Bytes of memory that views, maps and light take."""
        parts = (self._kept, self.blocks, self._texels, self.prepared.maps, self.caches, self._composer)
        return sum(part.nbytes for part in parts if part is not None)

    def render(
        self,
        view: View,
        target: float | None = None,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
        enough: int = FIRST_LEVEL,
    ) -> Frame:
        """The frame of ``view`` with the light that is there now.

        ``target`` is the relative error that it is to reach, the scene's own by default: its texels are final there
        each alone, or with as many samples as its check found ``enough``, or those given; where these are MAX_SAMPLES,
        nothing checks it. ``watch`` goes on with this frame's stages. Raises Cancelled once ``cancelled`` is set, and
        ViewError where the scene's light is not of the albedo that the view asks for, or the camera stands in a wall.
        """
        tiles = self.tiles.cancelled_by(cancelled) if cancelled else self.tiles
        until, watch = Until(target or self.prepared.scene.target_error, enough), watch or Stopwatch()
        frame = self._draw(view, until, tiles, watch)
        if view.moving or not view.smooth:
            return frame
        with watch.stage("edges"):
            return self._composer.smooth(frame, tiles) if self._composer else smooth_edges(frame, self.prepared, tiles)

    def _draw(self, view: View, until: Until, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of a view with what glows before it, drawn on the threads of ``tiles``."""
        lit = self._draw_lit(view, until, tiles, watch)
        return with_glow(lit, self._kept, surface_key(view), self.prepared, tiles, watch)

    def _draw_lit(self, view: View, until: Until, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of what is lit in a view."""
        self.prepared.scene.albedo_for(view.albedo)
        self.prepared.scene.room.refuse_camera(view.camera, self.prepared.scene.volume.radius)
        if self._composer is not None:
            return self._composer.draw(view, until, tiles, watch)
        with watch.stage("primary"):
            gbuffer = self.gbuffer(view, tiles)
        return self.draw_on(gbuffer, view, until, tiles, watch)

    def draw_on(self, gbuffer: GBuffer, view: View, until: Until, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of a view of the surface points in a G-buffer. Raises Cancelled."""
        light, target = self._light(view), until.target
        if view.shading == "gi" and self.prepared.scene.material.refracts:
            return self._through.draw(gbuffer, light, target, tiles, watch)
        if view.shading in ("gi", "vicinity"):
            return self._render_texels(gbuffer, light, until, tiles, watch)
        frame = frame_of(gbuffer, light, shade(gbuffer, light, target, tiles, watch), watch)
        return self._walls.add(frame, light, target, tiles, watch)

    def draw_walls(self, gbuffer: GBuffer, view: View, target: float, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of the walls alone in a G-buffer. Raises Cancelled."""
        light = self._light(view)
        frame = frame_of(gbuffer, light, empty_framebuffer(gbuffer), watch)
        return self._walls.add(frame, light, target, tiles, watch)

    def refine(
        self, view: View, target: float | None = None, tiles: Tiles | None = None, prices: Prices = PRESENT
    ) -> bool:
        """Bring the total error of a view whose light is final a step nearer to the ``target``; whether there was one.

        At some ``prices`` it may ask for finer texels: see ``ViewChecks``. Raises Cancelled once ``tiles`` are
        cancelled, and what ``render`` raises.
        """
        target, tiles = target or self.prepared.scene.target_error, tiles or self.tiles
        if self._composer is not None:
            return self._composer.refine(view, target, tiles, prices)
        frame = self._draw(view, Until(target, FIRST_LEVEL), tiles, Stopwatch())
        return self.refine_frame(frame, target, tiles, prices)

    def refine_frame(self, frame: Frame, target: float, tiles: Tiles, prices: Prices) -> bool:
        """``refine`` of a view with this ``frame``."""
        if not frame.refinable:
            return False
        light, (walls, *others) = self._light(frame.view), self._refinements
        waiting = [walls] if frame.quality.waiting else others  # shine and pixels wait until walls are final
        return any(each.step(frame, light, target, tiles, prices) for each in waiting)

    def _light(self, view: View) -> RotatedLight:
        """The lights of a view, turned: with all their lobes where it is at rest."""
        spec = self.caches.spec(view.shading)
        return RotatedLight(spec.moving if view.moving else spec, view)

    def light_points(self, view: View, points: np.ndarray) -> tuple[Frame, np.ndarray]:
        """The light of surface ``points`` (m, 3) in index space that no ray has found, and their normals (m, 3).

        It is a frame of one row, whose pixel i shows point i. The ``view`` says isovalue, albedo and the light's turn.
        """
        self.forget_views()  # another row of points would have the same key
        row = replace(view, width=len(points), height=1, shading="gi", moving=False)
        row, surface = replace(row, shine=DULL), self.prepared.surface(view.isovalue)  # points in a row are far apart
        gbuffer = GBuffer.of_points(surface, to_index(np.array(view.camera.eye), surface.field.spacing), points)
        light, target = self._light(row), self.prepared.scene.target_error
        until = Until(target)
        return self._render_texels(gbuffer, light, until, self.tiles, Stopwatch()), gbuffer.normals(self.tiles)

    def _render_texels(
        self, gbuffer: GBuffer, light: RotatedLight, until: Until, tiles: Tiles, watch: Stopwatch
    ) -> Frame:
        """The frame out of the illumination cache: global illumination, or vicinity shading (S1, section 4.2)."""
        target = until.target
        checked = is_checked(light.view) and until.enough < MAX_SAMPLES
        known = self.checks.of(light, gbuffer, target).known if checked else None
        with watch.stage("texels"):
            texels = self.texels(light.view, gbuffer, tiles)
        shine, until = b"", texels_until(until, light.view, known)
        reading, framebuffer = self._texels.picture(texels, light, until, tiles, watch)
        if light.spec.lobes:
            with watch.stage("lobes"):
                straight = self.lobes(light, gbuffer, tiles)
                add_lobes(gbuffer.pixels, straight.lit, light.spec.unit, framebuffer)
        colour_surface(gbuffer, light, framebuffer, tiles)
        if light.shine is not None and spec_name(light.view.shading) == "gi":
            with watch.stage("shine"):
                shine = self._shine.put(gbuffer, light, target, framebuffer, tiles)
        if known is not None:
            known.own.put(framebuffer, gbuffer, light, tiles)
        frame = frame_of(gbuffer, light, framebuffer, watch, texels, reading, known, shine)
        return self._walls.add(frame, light, target, tiles, watch)

    def gbuffer(self, view: View, tiles: Tiles | None = None) -> GBuffer:
        """The G-buffer of a view. Raises Cancelled, as every step does, once its ``tiles`` are cancelled."""
        surface, tiles = self.prepared.surface(view.isovalue), tiles or self.tiles
        if self._composer:
            return self._composer.peels(view, tiles).first
        make = partial(trace, view, surface, tiles, self.prepared.walls_in_view)
        return self._kept.get((GBuffer, surface_key(view)), make)

    def texels(self, view: View, gbuffer: GBuffer, tiles: Tiles | None = None) -> ViewTexels:
        """The texels under a view; they hold its G-buffer, so that both are kept, or neither."""
        return self._texels.under(view, gbuffer, tiles or self.tiles)

    @property
    def known_normals(self) -> OwnNormals:
        """The normals of texels at their own points, as far as views or chunks have asked for them."""
        return self._texels.normals

    def knows(self, view: View) -> bool:
        """Whether the texels under a view are kept."""
        return self._kept.held((ViewTexels, surface_key(view), False)) is not None

    def lobes(self, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles | None = None) -> LobeLight:
        """What comes straight from lobes to a view; kept while neither camera nor light moves, for any albedo."""
        tiles, view = tiles or self.tiles, light.view

        def make() -> LobeLight:
            starts = self._kept.get((ShadowStarts, surface_key(view)), partial(find_starts, gbuffer, tiles))
            return find_lobes(light, starts, gbuffer.surface.traced(tiles.run), tiles)

        return self._kept.get((LobeLight, surface_key(view), view.light, view.moving), make).tinted(light.tint)

    def lobe_radiance(self, frame: Frame) -> np.ndarray:
        """What comes straight from lobes to a frame's surface points, linear RGB; (m, 3) float32."""
        light = self._light(frame.view)
        return np.asarray(np.float32(light.spec.unit) * self.lobes(light, frame.gbuffer).lit[:, :3])

    def forget_views(self) -> None:
        """Keep nothing of views, as if every one were new."""
        self._kept.clear()
