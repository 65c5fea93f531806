"""Draw the surface and the walls of a picture, lit by local models, by paths or by texels, and
refine them.
"""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import spec_name
from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.cache.wall_store import WallStore
from isogi_core.frame.edges import smooth_edges
from isogi_core.frame.eye_glow import with_glow
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer, surface_key, to_index, trace
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.lobe_light import LobeLight, ShadowStarts, find_lobes, find_starts
from isogi_core.frame.rays.picture_check import PictureCheck
from isogi_core.frame.rays.picture_plan import Prices
from isogi_core.frame.rays.picture_state import PictureState
from isogi_core.frame.rays.point_transfer import ViewTransfer
from isogi_core.frame.rays.shine_light import ShineLight, ViewShine
from isogi_core.frame.rays.through_matter import SurfaceSeen, ViewThrough
from isogi_core.frame.rays.wall_light import RoomLight, ViewWalls
from isogi_core.frame.refinement import Refinement
from isogi_core.frame.several.mixed_reading import Level
from isogi_core.frame.shading import colour_surface, empty_framebuffer, shade
from isogi_core.frame.shot import Shot
from isogi_core.frame.texel_reading import Reading
from isogi_core.frame.texel_shading import FilteredLight, StandIn, TexelShading
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import ViewChecks, WorkLeft, goal_of_texels, is_checked
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import Framebuffer
from isogi_core.kernels.shading.lobes import add_lobes
from isogi_core.lru_cache import LruCache
from isogi_core.model.material import DULL
from isogi_core.model.scene_plan import MAX_SAMPLES
from isogi_core.model.view import View

VIEW_BYTES = 256 << 20
"""Default limit of the bytes that are kept of views, for light that turns and for repeated
requests.
"""

KIND_SHARE = 1 / 16
COMMON = 1 / 3
"""Shares of these bytes: for each kind of result that changes while the surface in a view
stays, and for the normals of texels, which all views have in common.
"""

PIXEL_BYTES = 3 * 4 + 1 + 4
"""Bytes of a pixel of a picture: radiance, state and error."""

BLOCKS_SHARE = 1 / 8
"""Share of these bytes for blocks of chunks, which all cards that draw the scene have in common."""

SIDE_SHARE = 1 / 8
"""Bytes that are kept of views of each other side of several surfaces, as a share of these."""


@dataclass(frozen=True, eq=False)
class DrawnPicture:
    """A ``frame`` as it was drawn, for those who ask for it again before its light changes."""

    frame: Frame

    @property
    def nbytes(self) -> int:
        """The size in bytes of its pictures, and of the light of pixels that it holds."""
        own = 0
        if (known := self.frame.quality.known) is not None:
            own = known.own.nbytes + known.base.nbytes
        return own + sum(part.nbytes for part in self.frame.framebuffer)


class SurfaceRenderer:
    """Draws and refines pictures of the surface of one scene, and of its walls. Safe to use from
    many threads.

    ``picture`` draws a view of them alone. If a scene shows several surfaces, each of their sides
    is a shot that a renderer of its own draws. Results of steps are ``kept``: see ``Renderer``.
    """

    def __init__(
        self,
        caches: Caches,
        tiles: Tiles,
        most: int = VIEW_BYTES,
        filters: bool = True,
        stand_in: StandIn | None = None,
        levels: tuple[Level, ...] = (),
    ) -> None:
        """Light pictures by the light of ``caches``, on the threads of ``tiles``.

        - ``most``: limit of the bytes that are kept of views.
        - ``filters``: set it to False to measure unfiltered light.
        - ``stand_in``: other light, for texels that have none yet.
        - ``levels``: caches of light at several levels, whose mixture is shown, if pinned surfaces
          are lit while another one slides. By default the light of ``caches`` alone.
        """
        self.prepared = caches.prepared
        self.caches = caches
        self.tiles = tiles
        self._most = most
        self._filters = filters
        # Results that a turning light or a growing bake replaces have a limit of their own: they
        # must not drive out surfaces. Light that grows step by step must not be lost between two of
        # them, however little memory there is.
        self._most_of_kind = int(KIND_SHARE * most)
        changing = dict.fromkeys(
            (Reading, FilteredLight, LobeLight, ShineLight, DrawnPicture), self._most_of_kind
        )
        growing = PictureCheck, RoomLight, ShineLight, SurfaceSeen, ViewTransfer
        most_of_views = most - int((COMMON + BLOCKS_SHARE) * most)
        self.kept: LruCache[Any] = LruCache(most_of_views, changing, lasting=growing)
        shown = levels or (Level(caches),)
        self.texel_shading = TexelShading(
            self.prepared, shown, self.kept, int(COMMON * most), filters, stand_in
        )
        self.checks = ViewChecks(self.kept, self.texel_shading)
        self._walls = ViewWalls(
            self.kept, self.prepared.scene.volume, WallStore(caches.store, self.prepared)
        )
        self._through = ViewThrough(self.kept, self._walls)
        self._shine = ViewShine(self.kept, self.texel_shading, self._walls, self.checks)
        # Glass shows walls through its surface: its refinement brings these along.
        walls = self._through if self.prepared.scene.surfaces.material.refracts else self._walls
        self._refinements: tuple[Refinement[Any], ...] = (walls, self._shine, self.checks)

    @property
    def nbytes(self) -> int:
        """The bytes of memory that kept views, maps and light take."""
        return sum(
            part.nbytes for part in (self.kept, self.texel_shading, self.prepared.maps, self.caches)
        )

    def beside(self, caches: Caches, levels: tuple[Level, ...]) -> "SurfaceRenderer":
        """Return a renderer of another side of several surfaces, on the same threads: by the light
        of ``caches``, or by that of ``levels``. It keeps a SIDE_SHARE of what this one keeps of
        views.
        """
        most = int(SIDE_SHARE * self._most)
        return SurfaceRenderer(caches, self.tiles, most, self._filters, levels=levels)

    def picture(self, view: View, goal: Goal, tiles: Tiles, watch: Stopwatch) -> Frame:
        """Draw the picture of a ``view`` that shows no other surface: one shot, and the glow in
        front of it. Raises Cancelled, and ViewError if the view asks for glow and nothing glows.
        """
        with watch.stage("primary"):
            gbuffer = self.gbuffer(view, tiles)
        frame = self.draw(self.shot(view, gbuffer, goal, tiles, watch))
        return self.add_glow(frame, tiles, watch)

    def refine(self, view: View, goal: Goal, tiles: Tiles, prices: Prices) -> bool:
        """Take one step of the picture of a ``view``: see ``refine_frame``, and ``picture`` for the
        errors raised.
        """
        frame = self.picture(view, goal, tiles, Stopwatch())
        return self.refine_frame(frame, goal, tiles, prices)

    def smooth(self, frame: Frame, tiles: Tiles) -> Frame:
        """Return the ``frame`` of a picture with more samples at its edges. Raises Cancelled."""
        return smooth_edges(frame, self.prepared, tiles)

    def add_glow(self, frame: Frame, tiles: Tiles, watch: Stopwatch) -> Frame:
        """Return a ``frame`` with the glow in front of all that it shows: see ``with_glow``."""
        return with_glow(frame, self.kept, surface_key(frame.view), self.prepared, tiles, watch)

    def gbuffer(self, view: View, tiles: Tiles) -> GBuffer:
        """Return the G-buffer of the surface and the walls in a ``view``, kept or traced now.
        Raises Cancelled.
        """
        surface = self.prepared.surface(view.isovalue)
        make = partial(trace, view, surface, tiles, self.prepared.walls_in_view)
        return self.kept.get((GBuffer, surface_key(view)), make)

    def sees(self, view: View) -> bool:
        """Return True if the G-buffer of a ``view`` is kept."""
        return self.kept.held((GBuffer, surface_key(view))) is not None

    def shot(
        self, view: View, gbuffer: GBuffer, goal: Goal, tiles: Tiles, watch: Stopwatch | None = None
    ) -> Shot:
        """Return the shot of a ``view`` of the surface points in a ``gbuffer``, under the lights of
        the scene.
        """
        return Shot(gbuffer, self.light(view), goal, tiles, watch or Stopwatch())

    def light(self, view: View) -> RotatedLight:
        """Return the lights of a ``view``, rotated; a view that moves goes without some of the
        lobes.
        """
        spec = self.caches.spec(view.shading)
        if view.moving:
            spec = spec.moving
        return RotatedLight(spec, view)

    def draw(self, shot: Shot) -> Frame:
        """Draw a ``shot`` with the light that is there now. Raises Cancelled."""
        shading = shot.view.shading
        # Glass keeps no texels: rays through its pixels find the walls and the sky that it shows.
        if shading == "gi" and shot.scene.surfaces.material.refracts:
            return self._through.draw(shot)
        # Global illumination and vicinity shading come from texels, all other shadings from local
        # models or from paths.
        if shading in ("gi", "vicinity"):
            return self._draw_texels(shot)
        return self._walls.add(frame_of(shot, shade(shot)), shot)

    def draw_walls(self, shot: Shot) -> Frame:
        """Draw the walls in a ``shot``, without the surface. Raises Cancelled."""
        return self._walls.add(frame_of(shot, empty_framebuffer(shot.gbuffer)), shot)

    def refine_frame(self, frame: Frame, goal: Goal, tiles: Tiles, prices: Prices) -> bool:
        """Take one step that brings a ``frame`` nearer to the ``goal``; return False if there is no
        step to take.

        ``prices`` weigh paths of texels against paths of pixels. Raises Cancelled.
        """
        if not frame.refinable:
            return False
        shot = self.shot(frame.view, frame.gbuffer, goal, tiles)
        # A picture that is still provisional is measured once, before anything refines it.
        if frame.unmeasured:
            return self.checks.step(frame, shot, prices)
        # Walls come first; shine and the check of pixels wait until walls are final, as they see
        # them.
        walls, *others = self._refinements
        if frame.quality.waiting:
            return walls.step(frame, shot, prices)
        return any(each.step(frame, shot, prices) for each in others)

    def work_left(self, frame: Frame, goal: Goal) -> tuple[WorkLeft, ...]:
        """Return the work that is left until a ``frame`` of one surface reaches its ``goal``: of
        its walls, and of its surface. The steps of shine, and of surfaces that light passes, are
        not foreseen.
        """
        if self.prepared.scene.surfaces.material.refracts:
            return ()
        return (*self.walls_left(frame, goal), self.checks.work_left(frame, goal))

    def walls_left(self, frame: Frame, goal: Goal) -> tuple[WorkLeft, ...]:
        """Return the work that is left for the walls in a ``frame``; none if they are final."""
        if not frame.quality.waiting:
            return ()
        shot = self.shot(frame.view, frame.gbuffer, goal, self.tiles)
        return (WorkLeft(self._walls.left(shot)),)

    def _draw_texels(self, shot: Shot) -> Frame:
        """Draw a ``shot`` from the illumination cache: global illumination, or vicinity shading
        (S1, section 4.2). If ``_light_key`` gives a key, the picture is kept until its light
        changes.
        """
        # The check of this picture knows how many samples its texels need. A caller that asks for
        # all samples there can be wants no check.
        known = None
        if is_checked(shot.view) and shot.goal.samples < MAX_SAMPLES:
            known = self.checks.of(shot).known
        light: Hashable | None
        if known is not None and known.covers:
            # All pixels have light from paths of their own: texels are not looked at.
            make = partial(self._show_paths, known, shot)
            light = b""
        elif known is not None and known.lit_by == "transfer":
            make = partial(self._show_transfer, known, shot)
            light = b""
        else:
            # Find the texels around the surface points.
            with shot.watch.stage("texels"):
                texels = self.texels(shot.view, shot.gbuffer, shot.tiles)
            make = partial(self._carry_texels, texels, known, shot)
            light = self._light_key(texels, shot)
        if light is None or PIXEL_BYTES * shot.view.width * shot.view.height > self._most_of_kind:
            return make()
        # Requests that wait for light, and the check, ask for the same picture again and again.
        # Each step of the check replaces ``known``, and may bring light of pixels.
        key = (DrawnPicture, shot.view, shot.goal, known, light)
        return self.kept.get(key, lambda: DrawnPicture(make())).frame

    def _show_paths(self, known: PictureState, shot: Shot) -> Frame:
        """Draw a ``shot`` whose pixels all have light from paths of their own, as its check has
        ``known``, without light of texels.
        """
        framebuffer = empty_framebuffer(shot.gbuffer)
        known.own.show(framebuffer, shot.gbuffer, shot.light)
        return frame_of(shot, framebuffer, checked=known)

    def _show_transfer(self, known: PictureState, shot: Shot) -> Frame:
        """Draw a ``shot`` whose points are lit by their transfer, as its check has ``known``, with
        the light that some of its pixels have of their own.
        """
        gbuffer = shot.gbuffer
        framebuffer = empty_framebuffer(gbuffer)
        known.base.show(framebuffer, gbuffer, shot.light)
        self._add_lobes(shot, framebuffer)
        known.own.put(framebuffer, gbuffer, shot.light, shot.tiles)
        return frame_of(shot, framebuffer, checked=known)

    def _add_lobes(self, shot: Shot, framebuffer: Framebuffer) -> None:
        """Add the light of lobes to a picture: by shadow rays from the pixels, as it is sharper
        than harmonics. Raises Cancelled.
        """
        light = shot.light
        if light.spec.lobes:
            with shot.watch.stage("lobes"):
                straight = self.lobes(light, shot.gbuffer, shot.tiles)
                add_lobes(shot.gbuffer.pixels, straight.lit, light.spec.unit, framebuffer)

    def _light_key(self, texels: ViewTexels, shot: Shot) -> Hashable | None:
        """Return a key that changes whenever light in the picture of a ``shot`` may have changed,
        besides that which its check knows.

        None if the picture is not kept: if the view moves, or if its light may change otherwise
        (walls, glow, shine, several surfaces).
        """
        if shot.view.moving or not shot.plain:
            return None
        return self.texel_shading.ages(texels, shot)

    def _carry_texels(self, texels: ViewTexels, known: PictureState | None, shot: Shot) -> Frame:
        """Draw a ``shot`` by the light of its ``texels``, with the light of pixels that its check
        has ``known``.
        """
        gbuffer = shot.gbuffer
        light = shot.light
        tiles = shot.tiles
        # Read the light of the texels, and carry it to the pixels.
        shine = b""
        goal = goal_of_texels(shot.goal, shot.view, known)
        reading, framebuffer = self.texel_shading.picture(texels, replace(shot, goal=goal))
        self._add_lobes(shot, framebuffer)
        # Texels hold light for a white surface: colours by data are multiplied in at the pixels.
        colour_surface(shot, framebuffer)
        # Shine depends on the direction to the eye, and is added by rays from the pixels.
        if light.shine is not None and spec_name(shot.view.shading) == "gi":
            with shot.watch.stage("shine"):
                shine = self._shine.put(shot, framebuffer)
        # Pixels that got light from paths of their own show it in place of the light of texels.
        if known is not None and known.lit_by == "paths":
            known.own.show(framebuffer, gbuffer, light)
        elif known is not None:
            known.own.put(framebuffer, gbuffer, light, tiles)
        frame = frame_of(shot, framebuffer, texels, reading, known, shine)
        return self._walls.add(frame, shot)

    def texels(self, view: View, gbuffer: GBuffer, tiles: Tiles | None = None) -> ViewTexels:
        """Return the texels of a ``view``, from those kept or found now. They hold its
        G-buffer, so that a cache keeps both or neither.
        """
        return self.texel_shading.under(view, gbuffer, tiles or self.tiles)

    def knows(self, view: View) -> bool:
        """Return True if the texels of a ``view`` are kept."""
        return self.kept.held((ViewTexels, surface_key(view), False)) is not None

    def lobes(self, light: RotatedLight, gbuffer: GBuffer, tiles: Tiles | None = None) -> LobeLight:
        """Return the light that comes straight from lobes to a view. It is kept while camera
        and light rest, for any albedo.
        """
        tiles = tiles or self.tiles
        view = light.view

        # Starts of shadow rays do not depend on the light, and are kept for the surface.
        def make() -> LobeLight:
            starts = self.kept.get(
                (ShadowStarts, surface_key(view)), partial(find_starts, gbuffer, tiles)
            )
            return find_lobes(light, starts, gbuffer.surface.traced(tiles.run), tiles)

        # Light is kept for the albedo of the spec, and tinted for that of the view.
        return self.kept.get((LobeLight, surface_key(view), view.light, view.moving), make).tinted(
            light.tint
        )

    def lobe_radiance(self, frame: Frame) -> np.ndarray:
        """Return the radiance at the surface points of a ``frame`` that lobes cause directly;
        (m, 3) float32.
        """
        light = self.light(frame.view)
        return np.asarray(np.float32(light.spec.unit) * self.lobes(light, frame.gbuffer).lit[:, :3])

    def light_points(self, view: View, points: np.ndarray) -> tuple[Frame, np.ndarray]:
        """Render surface ``points`` (m, 3) in index space that no ray has found; return a frame and
        their normals (m, 3).

        The frame has one row, whose pixel i shows point i. Isovalue, albedo and rotation of the
        light are those of ``view``. All that is kept of views is dropped.
        """
        self.kept.clear()  # another row of points would have the same key
        row = replace(view, width=len(points), height=1, shading="gi", moving=False)
        # Leave shine out: it is light towards an eye, and nobody looks at these points.
        row = replace(row, shine=DULL)
        surface = self.prepared.surface(view.isovalue)  # points in a row are far apart
        gbuffer = GBuffer.of_points(
            surface, to_index(np.array(view.camera.eye), surface.field.spacing), points
        )
        goal = Goal(self.prepared.scene.target_error)
        frame = self._draw_texels(self.shot(row, gbuffer, goal, self.tiles))
        return frame, gbuffer.normals(self.tiles)
