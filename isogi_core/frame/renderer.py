"""The renderer of a scene: from a view to its frame, step by step.

The steps are: cast rays at the surface, fill the G-buffer, find texels, read their light, and shade
the framebuffer. Each step makes data from the data before it, and one cache keeps these for the
next frames (``SurfaceRenderer.kept``; each other side of several surfaces has one). Its keys name
the step and the surface that a view shows, by isovalue, camera and size (``surface_key``):

| step | kept for |
|---|---|
| ``GBuffer`` or ``Peels``, ``ViewTexels``, ``Distances`` | a surface |
| ``TexelNormals``, ``ShadowStarts``, ``EyeGlow`` | a surface |
| ``Reading`` | a surface, a bake spec, a goal, and the age of the page pool |
| ``FilteredLight`` | the texels and the reading of a view; rotation of the light, albedo, glow |
| ``LobeLight`` | a surface, the rotation of the light, and whether it moves |
| ``PictureCheck`` | a surface, the light's rotation, albedo, shine, glow and a target error |
| ``TracedLight`` | an isovalue, a window, the light's rotation, albedo and glow |
| ``ViewTransfer`` | a surface |
| ``RoomLight`` | an isovalue, an albedo and a glow |
| ``SurfaceSeen`` | as ``PictureCheck`` |
| ``ShineLight`` | a surface, shine, albedo, the light's rotation, glow, and whether it moves |
| ``DrawnPicture`` | a view, a goal, the state of its check, and the ages of the page pools |

``Reading``, ``FilteredLight``, ``LobeLight``, ``ShineLight`` and ``DrawnPicture`` have a KIND_SHARE
of the bytes each, so that a light that turns, or a bake that goes on, drives out no surface.
Normals of texels are the same in all views: ``LatticeNormals`` keeps them.
"""

import threading
from typing import Any

import numpy as np

from isogi_core.bake.bake_spec import SPECS
from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.features import features_of
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.known_blocks import KnownBlocks
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.picture_plan import PRESENT, Prices
from isogi_core.frame.rays.picture_state import PictureState
from isogi_core.frame.several.peeling_renderer import PeelingRenderer
from isogi_core.frame.shot import Shot
from isogi_core.frame.surface_renderer import BLOCKS_SHARE, VIEW_BYTES, SurfaceRenderer
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.texel_shading import StandIn
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.frame.view_checks import WorkLeft, is_checked
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import PROVISIONAL, Framebuffer
from isogi_core.lru_cache import LruCache
from isogi_core.model.view import View


class Renderer:
    """Renders views of one scene, of one surface or of several. Safe to use from many threads.

    ``surface`` draws the surface and the walls; of several surfaces it draws the outer side of the
    one that slides, and ``peeling`` all of them, which is None for scenes with one.
    """

    def __init__(
        self,
        caches: Caches,
        tiles: Tiles,
        most: int = VIEW_BYTES,
        filters: bool = True,
        stand_in: StandIn | None = None,
    ) -> None:
        """Render with the light of ``caches``: see ``SurfaceRenderer``."""
        self.prepared = caches.prepared
        self.caches = caches
        self.tiles = tiles
        self.surface = SurfaceRenderer(caches, tiles, most, filters, stand_in)
        # A picture of one surface is one shot; of several, a shot of each side, and their sum.
        self.peeling: PeelingRenderer | None = None
        if self.prepared.scene.surfaces.several:
            self.peeling = PeelingRenderer(self.surface)
        self._painter: SurfaceRenderer | PeelingRenderer = self.peeling or self.surface
        self.blocks = KnownBlocks(int(BLOCKS_SHARE * most))
        self.looks: LruCache[Any] = LruCache(most // 64)

    @property
    def nbytes(self) -> int:
        """The bytes of memory that kept views, maps, light and blocks take."""
        return self._painter.nbytes + self.blocks.nbytes + self.looks.nbytes

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
        self._refuse(view)
        frame = self._painter.picture(view, goal, tiles, watch)
        if view.moving or not view.smooth:
            return frame
        # Add samples to pixels at edges.
        with watch.stage("edges"):
            return self._painter.smooth(frame, tiles)

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
        self._refuse(view)
        return self._painter.refine(view, goal, tiles or self.tiles, prices)

    def work_left(self, frame: Frame, goal: Goal) -> tuple[WorkLeft, ...]:
        """Return the work that is left until a ``frame`` that was rendered here reaches its
        ``goal``, part by part, after the samples that its texels lack now.
        """
        return self._painter.work_left(frame, goal)

    def _refuse(self, view: View) -> None:
        """Refuse views that the scene cannot answer: another albedo, or a camera inside a wall.
        Raises ViewError.
        """
        scene = self.prepared.scene
        scene.surfaces.albedo_for(view.albedo)
        scene.lighting.room.refuse_camera(view.camera, scene.volume.radius)

    def gbuffer(self, view: View, tiles: Tiles | None = None) -> GBuffer:
        """Return the G-buffer of all that is in front in a ``view``, kept or traced now. Raises
        Cancelled once ``tiles`` are cancelled.
        """
        return self._painter.gbuffer(view, tiles or self.tiles)

    def sees(self, view: View) -> bool:
        """Return True if the surface points of a ``view`` are kept."""
        return self._painter.sees(view)

    def forget_views(self) -> None:
        """Drop all that is kept of views, as if every view were new."""
        self.surface.kept.clear()


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
    surface = renderer.surface
    # Skip the picture only if all light is missing, and is asked for in one stage.
    staged = any(feature.in_stages for feature in features_of(scene))
    if staged or view.moving or view.shading not in SPECS or surface.knows(view):
        return None
    scene.lighting.room.refuse_camera(view.camera, scene.volume.radius)
    tiles = renderer.tiles.cancelled_by(cancelled)
    loader = renderer.caches.of(view.shading)
    # Find the texels, and look for their light: with any in memory, a real picture is as fast.
    gbuffer = renderer.gbuffer(view, tiles)
    if scene.projection.projects(gbuffer.isovalue):
        return None
    texels = surface.texels(view, gbuffer, tiles)
    loader.ensure(texels.chunks, tiles.check)
    with loader.pool.hold(texels.chunks) as held:
        if not len(held.slots) or (held.slots >= 0).any():
            return None
        reading = read_texels(texels, held.slots, loader.pool, goal, tiles)
    # Its check decides if the light that it lacks is that of texels.
    known = None
    if is_checked(view):
        known = surface.checks.of(surface.shot(view, gbuffer, goal, tiles)).known
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
