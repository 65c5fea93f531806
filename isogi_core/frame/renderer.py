"""The renderer of a scene: from a view to its frame, step by step.

The steps are: cast rays at the surface, fill the G-buffer, find texels, read their light, and shade
the framebuffer. Each step makes data from the data before it, and one cache keeps these for the
next frames. Its keys name the step and the surface that a view shows, by isovalue, camera and size
(``surface_key``):

| step | kept for |
|---|---|
| ``GBuffer``, ``ViewTexels``, ``Distances`` | a surface |
| ``TexelNormals``, ``ShadowStarts``, ``EyeGlow`` | a surface |
| ``Reading`` | a surface, a bake spec, a goal, and the age of the page pool |
| ``FilteredLight`` | the texels and the reading of a view; rotation of the light, albedo, glow |
| ``LobeLight`` | a surface, the rotation of the light, and whether it moves |
| ``PictureCheck`` | a surface, the light's rotation, albedo, shine, glow and a target error |
| ``RoomLight`` | an isovalue, an albedo and a glow |
| ``SurfaceSeen`` | as ``PictureCheck`` |
| ``ShineLight`` | a surface, shine, albedo, the light's rotation, glow, and whether it moves |

``Reading``, ``FilteredLight``, ``LobeLight`` and ``ShineLight`` have a KIND_SHARE of the bytes
each, so that a light that turns, or a bake that goes on, drives out no surface. Normals of texels
are the same in all views: ``LatticeNormals`` keeps them.
"""

import threading
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import SPECS
from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.edges import smooth_edges
from isogi_core.frame.eye_glow import with_glow
from isogi_core.frame.features import features_of
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer, surface_key, to_index, trace
from isogi_core.frame.known_blocks import KnownBlocks
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import PRESENT, Prices
from isogi_core.frame.rays.picture_state import PictureState
from isogi_core.frame.several.composer import Composer
from isogi_core.frame.several.peels import Peels
from isogi_core.frame.shot import Shot
from isogi_core.frame.surface_renderer import BLOCKS_SHARE, VIEW_BYTES, SurfaceRenderer
from isogi_core.frame.texel_normals import LatticeNormals
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.texel_shading import StandIn
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import is_checked
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import PROVISIONAL, Framebuffer
from isogi_core.lru_cache import LruCache
from isogi_core.model.material import DULL
from isogi_core.model.view import View


class Renderer(SurfaceRenderer):
    """Renders views of one scene, of one surface or of several. Safe to use from many threads."""

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
        # If the scene has several surfaces, this renderer lights the outer side of the one that
        # slides, and makes a renderer for each other side.
        side = partial(SurfaceRenderer, tiles=tiles, most=most // 8, filters=filters)
        self._composer = (
            Composer(self, side, self._kept) if self.prepared.scene.surfaces.several else None
        )

    @property
    def nbytes(self) -> int:
        """The bytes of memory that kept views, maps, light and blocks take."""
        return (
            super().nbytes
            + self.blocks.nbytes
            + self.looks.nbytes
            + (self._composer.nbytes if self._composer else 0)
        )

    def render(
        self,
        view: View,
        goal: Goal | None = None,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
    ) -> Frame:
        """Render ``view`` with the light that is there now.

        By default the ``goal`` of the picture is the scene's error, to be checked. Texels count as
        final once each reaches the goal alone, or once they have the samples that the picture's
        check asks for; a goal of MAX_SAMPLES asks for no check. ``watch`` goes on with the stages
        of this frame. Raises Cancelled once ``cancelled`` is set, and ViewError if the view asks
        for an albedo that the scene's light is not made for, or if the camera is inside a wall.
        """
        if cancelled:
            tiles = self.tiles.cancelled_by(cancelled)
        else:
            tiles = self.tiles
        goal = goal or Goal.checked(self.prepared.scene.target_error)
        watch = watch or Stopwatch()
        frame = self._draw(view, goal, tiles, watch)
        if view.moving or not view.smooth:
            return frame
        # Add samples to pixels at edges.
        with watch.stage("edges"):
            if self._composer:
                return self._composer.smooth(frame, tiles)
            return smooth_edges(frame, self.prepared, tiles)

    def _draw(self, view: View, goal: Goal, tiles: Tiles, watch: Stopwatch) -> Frame:
        """Render a ``view``, and add the glow in front of its surfaces."""
        lit = self._draw_lit(view, goal, tiles, watch)
        return with_glow(lit, self._kept, surface_key(view), self.prepared, tiles, watch)

    def _draw_lit(self, view: View, goal: Goal, tiles: Tiles, watch: Stopwatch) -> Frame:
        """Render the surfaces and walls of a ``view``."""
        # Refuse views that the scene cannot answer: another albedo, or a camera inside a wall.
        self.prepared.scene.surfaces.albedo_for(view.albedo)
        self.prepared.scene.lighting.room.refuse_camera(
            view.camera, self.prepared.scene.volume.radius
        )
        if self._composer is not None:
            return self._composer.draw(view, goal, tiles, watch)
        with watch.stage("primary"):
            gbuffer = self.gbuffer(view, tiles)
        return self.draw(self.shot(view, gbuffer, goal, tiles, watch))

    def refine(
        self,
        view: View,
        goal: Goal | None = None,
        tiles: Tiles | None = None,
        prices: Prices = PRESENT,
    ) -> bool:
        """Take one step that brings the total error of a view, whose light is final, nearer to the
        ``goal``, by default the scene's error; return False if there is no step to take.

        By the ``prices`` of texels a step may be to ask for finer ones: see ``ViewChecks``. Raises
        Cancelled once ``tiles`` are cancelled, and the errors of ``render``.
        """
        goal = goal or Goal.checked(self.prepared.scene.target_error)
        tiles = tiles or self.tiles
        if self._composer is not None:
            return self._composer.refine(view, goal, tiles, prices)
        frame = self._draw(view, goal, tiles, Stopwatch())
        return self.refine_frame(frame, goal, tiles, prices)

    def light_points(self, view: View, points: np.ndarray) -> tuple[Frame, np.ndarray]:
        """Render surface ``points`` (m, 3) in index space that no ray has found; return a frame and
        their normals (m, 3).

        The frame has one row, whose pixel i shows point i. Isovalue, albedo and rotation of the
        light are those of ``view``.
        """
        self.forget_views()  # another row of points would have the same key
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

    def gbuffer(self, view: View, tiles: Tiles | None = None) -> GBuffer:
        """Return the G-buffer of a ``view``, kept or traced now. Raises Cancelled once
        ``tiles`` are cancelled.
        """
        surface = self.prepared.surface(view.isovalue)
        tiles = tiles or self.tiles
        if self._composer:
            return self._composer.peels(view, tiles).first
        make = partial(trace, view, surface, tiles, self.prepared.walls_in_view)
        return self._kept.get((GBuffer, surface_key(view)), make)

    @property
    def known_normals(self) -> LatticeNormals:
        """The normals of texels at their own positions, as far as views or chunks have asked
        for them.
        """
        return self._texels.normals

    def knows(self, view: View) -> bool:
        """Return True if the texels of a ``view`` are kept."""
        return self._kept.held((ViewTexels, surface_key(view), False)) is not None

    def sees(self, view: View) -> bool:
        """Return True if the surface points of a ``view`` are kept."""
        kind = Peels if self._composer else GBuffer
        return self._kept.held((kind, surface_key(view))) is not None

    def lobe_radiance(self, frame: Frame) -> np.ndarray:
        """Return the radiance at the surface points of a ``frame`` that lobes cause directly;
        (m, 3) float32.
        """
        light = self._light(frame.view)
        return np.asarray(np.float32(light.spec.unit) * self.lobes(light, frame.gbuffer).lit[:, :3])

    def forget_views(self) -> None:
        """Drop all that is kept of views, as if every view were new."""
        self._kept.clear()


def unlit_frame(
    renderer: Renderer, view: View, goal: Goal, cancelled: threading.Event
) -> Frame | None:
    """Render a view at rest that is new and whose chunks hold no light yet: a white frame that is
    provisional everywhere, and lists the light that it lacks.

    Return None if the view is known, moves, or has light, and for scenes whose pictures ask for
    light in several stages. The first picture finds the results of the steps taken here in the
    cache. Raises Cancelled once ``cancelled`` is set, and the errors of ``Renderer.render``.
    """
    scene = renderer.prepared.scene
    # Skip the picture only if all light is missing, and is asked for in one stage.
    staged = any(feature.in_stages for feature in features_of(scene))
    if staged or view.moving or view.shading not in SPECS or renderer.knows(view):
        return None
    scene.lighting.room.refuse_camera(view.camera, scene.volume.radius)
    tiles = renderer.tiles.cancelled_by(cancelled)
    loader = renderer.caches.of(view.shading)
    # Find the texels, and look for their light: with any in memory, a real picture is as fast.
    gbuffer = renderer.gbuffer(view, tiles)
    if scene.projection.projects(gbuffer.isovalue):
        return None
    texels = renderer.texels(view, gbuffer, tiles)
    loader.ensure(texels.chunks, tiles.check)
    with loader.pool.hold(texels.chunks) as held:
        if not len(held.slots) or (held.slots >= 0).any():
            return None
        reading = read_texels(texels, held.slots, loader.pool, goal, tiles)
    # Its check decides if the light that it lacks is that of texels.
    known = None
    if is_checked(view):
        known = renderer.checks.of(renderer.shot(view, gbuffer, goal, tiles)).known
    return undrawn_frame(renderer, view, texels, reading, known)


def undrawn_frame(
    renderer: Renderer,
    view: View,
    texels: ViewTexels,
    reading: Reading,
    known: PictureState | None = None,
) -> Frame:
    """Return the frame of a view before it is drawn: white, and provisional wherever it shows the
    surface. Its ``texels`` and their ``reading`` tell the light that it lacks, so that bakes begin
    before a picture is shaded; ``known`` is the state of its picture's check, if it has one.
    """
    gbuffer = texels.gbuffer
    count = view.width * view.height
    white = Framebuffer(
        np.ones((count, 3), np.float32), np.zeros(count, np.uint8), np.ones(count, np.float32)
    )
    white.state[gbuffer.pixels] = PROVISIONAL
    light = RotatedLight(renderer.caches.spec(view.shading), view)
    shot = Shot(gbuffer, light, reading.goal, renderer.tiles)
    return frame_of(shot, white, texels, reading, known)
