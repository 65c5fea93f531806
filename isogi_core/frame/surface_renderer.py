"""The light of the surface in a picture, and of walls: by local models, by paths, or by texels, and
refined.
"""

from functools import partial
from typing import Any

from isogi_core.bake.bake_spec import spec_name
from isogi_core.bake.noise import Until
from isogi_core.cache.scene_caches import Caches
from isogi_core.cache.wall_store import WallStore
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer, surface_key
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.lobe_light import LobeLight, ShadowStarts, find_lobes, find_starts
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.rays.shine_light import ShineLight, ViewShine
from isogi_core.frame.rays.through_matter import ViewThrough
from isogi_core.frame.rays.wall_light import ViewWalls
from isogi_core.frame.refinement import Refinement
from isogi_core.frame.shading import (
    colour_surface,
    empty_framebuffer,
    shade,
)
from isogi_core.frame.texel_reading import Level, Reading
from isogi_core.frame.texel_shading import FilteredLight, StandIn, TexelShading
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import ViewChecks, is_checked, texels_until
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.lobes import add_lobes
from isogi_core.lru_cache import LruCache
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.view import View

VIEW_BYTES = 256 << 20
"""Bytes that are kept of views, for turning light and for asking again."""

KIND_SHARE = 1 / 16
COMMON = 1 / 3
"""Shares of these bytes: for what changes while a view stays, and for what views have in common of
texels.
"""

BLOCKS_SHARE = 1 / 8
"""Share of these bytes for blocks of chunks, which cards that draw the same scene have in
common.
"""


class SurfaceRenderer:
    """Lights and refines pictures of the surface of one scene. Any thread may use it."""

    def __init__(
        self,
        caches: Caches,
        tiles: Tiles,
        most: int = VIEW_BYTES,
        filters: bool = True,
        stand_in: StandIn | None = None,
        levels: tuple[Level, ...] = (),
    ) -> None:
        """Light pictures by ``caches``, on the threads of ``tiles``; keep ``most`` bytes of views.

        Who measures bakes ``filters`` no noisy light. Other light may ``stand_in`` where there is
        none yet. Of several surfaces one is lit as the others light it, by the light of ``levels``,
        which is mixed.
        """
        self.prepared = caches.prepared
        self.caches = caches
        self.tiles = tiles
        changing = dict.fromkeys(
            (Reading, FilteredLight, LobeLight, ShineLight), int(KIND_SHARE * most)
        )
        self._kept: LruCache[Any] = LruCache(most - int((COMMON + BLOCKS_SHARE) * most), changing)
        shown = levels or (Level(caches),)
        self._texels = TexelShading(
            self.prepared, shown, self._kept, int(COMMON * most), filters, stand_in
        )
        self.checks = ViewChecks(self._kept, self._texels)
        self._walls = ViewWalls(
            self._kept, self.prepared.scene.volume, WallStore(caches.store, self.prepared)
        )
        self._through = ViewThrough(self._kept, self._walls)
        self._shine = ViewShine(self._kept, self._texels, self._walls, self.checks)
        walls = self._through if self.prepared.scene.surfaces.material.refracts else self._walls
        self._refinements: tuple[Refinement[Any], ...] = (walls, self._shine, self.checks)

    @property
    def nbytes(self) -> int:
        """Bytes of memory that views, maps and light take."""
        return sum(
            part.nbytes for part in (self._kept, self._texels, self.prepared.maps, self.caches)
        )

    def draw_on(
        self, gbuffer: GBuffer, view: View, until: Until, tiles: Tiles, watch: Stopwatch
    ) -> Frame:
        """The frame of a view of the surface points in a G-buffer. Raises Cancelled."""
        light = self._light(view)
        target = until.target
        if view.shading == "gi" and self.prepared.scene.surfaces.material.refracts:
            return self._through.draw(gbuffer, light, target, tiles, watch)
        if view.shading in ("gi", "vicinity"):
            return self._render_texels(gbuffer, light, until, tiles, watch)
        frame = frame_of(gbuffer, light, shade(gbuffer, light, target, tiles, watch), watch)
        return self._walls.add(frame, light, target, tiles, watch)

    def draw_walls(
        self, gbuffer: GBuffer, view: View, target: float, tiles: Tiles, watch: Stopwatch
    ) -> Frame:
        """The frame of the walls alone in a G-buffer. Raises Cancelled."""
        light = self._light(view)
        frame = frame_of(gbuffer, light, empty_framebuffer(gbuffer), watch)
        return self._walls.add(frame, light, target, tiles, watch)

    def refine_frame(self, frame: Frame, target: float, tiles: Tiles, prices: Prices) -> bool:
        """Bring a ``frame`` a step nearer to the ``target``, at these ``prices``; whether there was
        a step to take.

        Raises Cancelled.
        """
        if not frame.refinable:
            return False
        light = self._light(frame.view)
        if frame.unmeasured:
            return self.checks.step(frame, light, target, tiles, prices)
        (walls, *others) = self._refinements
        waiting = (
            [walls] if frame.quality.waiting else others
        )  # shine and pixels wait until walls are final
        return any(each.step(frame, light, target, tiles, prices) for each in waiting)

    def _light(self, view: View) -> RotatedLight:
        """The lights of a view, turned: with all their lobes where it is at rest."""
        spec = self.caches.spec(view.shading)
        return RotatedLight(spec.moving if view.moving else spec, view)

    def _render_texels(
        self, gbuffer: GBuffer, light: RotatedLight, until: Until, tiles: Tiles, watch: Stopwatch
    ) -> Frame:
        """The frame out of the illumination cache: global illumination, or vicinity shading (S1,
        section 4.2).
        """
        target = until.target
        checked = is_checked(light.view) and until.enough < MAX_SAMPLES
        if checked:
            known = self.checks.check(light, target).known
        else:
            known = None
        with watch.stage("texels"):
            texels = self.texels(light.view, gbuffer, tiles)
        shine = b""
        until = texels_until(until, light.view, known)
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

    def texels(self, view: View, gbuffer: GBuffer, tiles: Tiles | None = None) -> ViewTexels:
        """The texels under a view; they hold its G-buffer, so that both are kept, or neither."""
        return self._texels.under(view, gbuffer, tiles or self.tiles)

    def lobes(self, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles | None = None) -> LobeLight:
        """What comes straight from lobes to a view; kept while neither camera nor light moves, for
        any albedo.
        """
        tiles = tiles or self.tiles
        view = light.view

        def make() -> LobeLight:
            starts = self._kept.get(
                (ShadowStarts, surface_key(view)), partial(find_starts, gbuffer, tiles)
            )
            return find_lobes(light, starts, gbuffer.surface.traced(tiles.run), tiles)

        return self._kept.get((LobeLight, surface_key(view), view.light, view.moving), make).tinted(
            light.tint
        )
