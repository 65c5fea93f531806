"""The line from a view to its frame: surface, G-buffer, texels, reading, light, framebuffer.

Each step makes data from the data before it. One cache keeps what the steps make for the next
frames. Its keys name the step and the surface that a view shows, by isovalue, camera and size
(``surface_key``):

| step | kept for |
|---|---|
| ``GBuffer``, ``ViewTexels``, ``Distances`` | a surface |
| ``TexelNormals``, ``ShadowStarts``, ``EyeGlow`` | a surface |
| ``Reading`` | a surface, a bake spec, a target error, and the age of the page pool |
| ``FilteredLight`` | a view's texels, what is read of them, the light's rotation, albedo, glow |
| ``LobeLight`` | a surface, the rotation of the light, and whether it moves |
| ``PictureCheck`` | a surface, the light's rotation, albedo, shine, glow and a target error |
| ``RoomLight`` | an isovalue, an albedo and a glow |
| ``SeenThrough`` | a surface, and the rotation of the light |
| ``ShineLight`` | a surface, shine, albedo, the light's rotation, glow, and whether it moves |

``Reading``, ``FilteredLight``, ``LobeLight`` and ``ShineLight`` have a KIND_SHARE of its bytes
each, so that a light that turns, or a bake that goes on, drives out no surface. ``TexelShading``
keeps what views have in common of texels: see ``OwnNormals``.
"""

import threading
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import SPECS
from isogi_core.bake.noise import Until
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.edges import smooth_edges
from isogi_core.frame.eye_glow import with_glow
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer, surface_key, to_index, trace
from isogi_core.frame.known_blocks import KnownBlocks
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import PRESENT, Prices
from isogi_core.frame.several.composer import Composer
from isogi_core.frame.several.peels import Peels
from isogi_core.frame.surface_renderer import BLOCKS_SHARE, VIEW_BYTES, SurfaceRenderer
from isogi_core.frame.texel_normals import OwnNormals
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.texel_shading import StandIn
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import PROVISIONAL, Framebuffer
from isogi_core.lru_cache import LruCache
from isogi_core.model.material import DULL
from isogi_core.model.view import View


class Renderer(SurfaceRenderer):
    """Renders views of one scene. Frames may be asked for from several threads."""

    def __init__(
        self,
        caches: Caches,
        tiles: Tiles,
        most: int = VIEW_BYTES,
        filters: bool = True,
        stand_in: StandIn | None = None,
    ) -> None:
        """Render with the light of ``caches``: see ``SurfaceRenderer``."""
        super().__init__(caches, tiles, most, filters, stand_in)
        self.blocks = KnownBlocks(int(BLOCKS_SHARE * most))
        self.looks: LruCache[Any] = LruCache(most // 64)
        side = partial(SurfaceRenderer, tiles=tiles, most=most // 8, filters=filters)
        self._composer = (
            Composer(self, side, self._kept) if self.prepared.scene.surfaces.several else None
        )

    @property
    def nbytes(self) -> int:
        """Bytes of memory that views, maps and light take."""
        return (
            super().nbytes
            + self.blocks.nbytes
            + self.looks.nbytes
            + (self._composer.nbytes if self._composer else 0)
        )

    def render(
        self,
        view: View,
        target: float | None = None,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
        enough: int = FIRST_LEVEL,
    ) -> Frame:
        """The frame of ``view`` with the light that is there now.

        ``target`` is the relative error that it is to reach, the scene's own by default: its texels
        are final there each alone, or with as many samples as its check found ``enough``, or those
        given; where these are MAX_SAMPLES, nothing checks it. ``watch`` goes on with this frame's
        stages. Raises Cancelled once ``cancelled`` is set, and ViewError where the scene's light is
        not of the albedo that the view asks for, or the camera stands in a wall.
        """
        if cancelled:
            tiles = self.tiles.cancelled_by(cancelled)
        else:
            tiles = self.tiles
        until = Until(target or self.prepared.scene.target_error, enough)
        watch = watch or Stopwatch()
        frame = self._draw(view, until, tiles, watch)
        if view.moving or not view.smooth:
            return frame
        with watch.stage("edges"):
            if self._composer:
                return self._composer.smooth(frame, tiles)
            return smooth_edges(frame, self.prepared, tiles)

    def _draw(self, view: View, until: Until, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of a view with what glows before it, drawn on the threads of ``tiles``."""
        lit = self._draw_lit(view, until, tiles, watch)
        return with_glow(lit, self._kept, surface_key(view), self.prepared, tiles, watch)

    def _draw_lit(self, view: View, until: Until, tiles: Tiles, watch: Stopwatch) -> Frame:
        """The frame of what is lit in a view."""
        self.prepared.scene.surfaces.albedo_for(view.albedo)
        self.prepared.scene.lighting.room.refuse_camera(
            view.camera, self.prepared.scene.volume.radius
        )
        if self._composer is not None:
            return self._composer.draw(view, until, tiles, watch)
        with watch.stage("primary"):
            gbuffer = self.gbuffer(view, tiles)
        return self.draw_on(gbuffer, view, until, tiles, watch)

    def refine(
        self,
        view: View,
        target: float | None = None,
        tiles: Tiles | None = None,
        prices: Prices = PRESENT,
    ) -> bool:
        """Bring the total error of a view whose light is final a step nearer to the ``target``;
        whether there was one.

        At some ``prices`` it may ask for finer texels: see ``ViewChecks``. Raises Cancelled once
        ``tiles`` are cancelled, and what ``render`` raises.
        """
        target = target or self.prepared.scene.target_error
        tiles = tiles or self.tiles
        if self._composer is not None:
            return self._composer.refine(view, target, tiles, prices)
        frame = self._draw(view, Until(target, FIRST_LEVEL), tiles, Stopwatch())
        return self.refine_frame(frame, target, tiles, prices)

    def light_points(self, view: View, points: np.ndarray) -> tuple[Frame, np.ndarray]:
        """The light of surface ``points`` (m, 3) in index space that no ray has found, and their
        normals (m, 3).

        It is a frame of one row, whose pixel i shows point i. The ``view`` says isovalue, albedo
        and the light's turn.
        """
        self.forget_views()  # another row of points would have the same key
        row = replace(view, width=len(points), height=1, shading="gi", moving=False)
        row = replace(row, shine=DULL)
        surface = self.prepared.surface(view.isovalue)  # points in a row are far apart
        gbuffer = GBuffer.of_points(
            surface, to_index(np.array(view.camera.eye), surface.field.spacing), points
        )
        light = self._light(row)
        target = self.prepared.scene.target_error
        until = Until(target)
        return self._render_texels(gbuffer, light, until, self.tiles, Stopwatch()), gbuffer.normals(
            self.tiles
        )

    def gbuffer(self, view: View, tiles: Tiles | None = None) -> GBuffer:
        """The G-buffer of a view. Raises Cancelled, as every step does, once its ``tiles`` are
        cancelled.
        """
        surface = self.prepared.surface(view.isovalue)
        tiles = tiles or self.tiles
        if self._composer:
            return self._composer.peels(view, tiles).first
        make = partial(trace, view, surface, tiles, self.prepared.walls_in_view)
        return self._kept.get((GBuffer, surface_key(view)), make)

    @property
    def known_normals(self) -> OwnNormals:
        """The normals of texels at their own points, as far as views or chunks have asked for
        them.
        """
        return self._texels.normals

    def knows(self, view: View) -> bool:
        """Whether the texels under a view are kept."""
        return self._kept.held((ViewTexels, surface_key(view), False)) is not None

    def sees(self, view: View) -> bool:
        """Whether what the rays of a view met is kept."""
        kind = Peels if self._composer else GBuffer
        return self._kept.held((kind, surface_key(view))) is not None

    def lobe_radiance(self, frame: Frame) -> np.ndarray:
        """What comes straight from lobes to a frame's surface points, linear RGB; (m, 3)
        float32.
        """
        light = self._light(frame.view)
        return np.asarray(np.float32(light.spec.unit) * self.lobes(light, frame.gbuffer).lit[:, :3])

    def forget_views(self) -> None:
        """Keep nothing of views, as if every one were new."""
        self._kept.clear()


def unlit_frame(
    renderer: Renderer, view: View, target: float, cancelled: threading.Event
) -> Frame | None:
    """The frame of a view at rest that is new, where none of its light is there: white, and
    provisional all over.

    None of other views, and of scenes whose pictures ask for light in several stages. What it takes
    is kept, and the first picture finds it. Raises what ``Renderer.render`` does, and so Cancelled
    once ``cancelled`` is set.
    """
    scene = renderer.prepared.scene
    staged = scene.surfaces.several or scene.surfaces.material.refracts
    if staged or view.moving or view.shading not in SPECS or renderer.knows(view):
        return None
    scene.lighting.room.refuse_camera(view.camera, scene.volume.radius)
    tiles = renderer.tiles.cancelled_by(cancelled)
    loader = renderer.caches.of(view.shading)
    gbuffer = renderer.gbuffer(view, tiles)
    if scene.projection.projects(gbuffer.isovalue):
        return None
    texels = renderer.texels(view, gbuffer, tiles)
    loader.ensure(texels.chunks, tiles.check)
    with loader.pool.hold(texels.chunks) as held:
        if not len(held.slots) or (held.slots >= 0).any():
            return None
        reading = read_texels(texels, held.slots, loader.pool, Until(target, FIRST_LEVEL), tiles)
    return undrawn_frame(renderer, view, texels, reading)


def undrawn_frame(renderer: Renderer, view: View, texels: ViewTexels, reading: Reading) -> Frame:
    """The frame of a view by what its ``texels`` hold, before it is drawn: white, and provisional
    all over.
    """
    gbuffer = texels.gbuffer
    count = view.width * view.height
    white = Framebuffer(
        np.ones((count, 3), np.float32), np.zeros(count, np.uint8), np.ones(count, np.float32)
    )
    white.state[gbuffer.pixels] = PROVISIONAL
    light = RotatedLight(renderer.caches.spec(view.shading), view)
    return frame_of(gbuffer, light, white, Stopwatch(), texels, reading)
