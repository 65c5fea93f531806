"""What a new view lacks before it is drawn, so that its light is baked while its first picture is lit."""

import threading

import numpy as np

from isogi_core.bake.bake_spec import SPECS
from isogi_core.bake.noise import Until
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.frame.frame import Frame
from isogi_core.frame.framing import frame_of
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.tiles import Stopwatch
from isogi_core.frame.view_texels import ViewTexels
from isogi_core.kernels.shading.framebuffer import PROVISIONAL, Framebuffer
from isogi_core.model.view import View


def unlit_frame(renderer: Renderer, view: View, target: float, cancelled: threading.Event) -> Frame | None:
    """The frame of a view at rest that is new, where none of its light is there: white, and provisional all over.

    None of other views, and of scenes whose pictures ask for light in several stages. What it takes is kept, and the
    first picture finds it. Raises what ``Renderer.render`` does, and so Cancelled once ``cancelled`` is set.
    """
    scene = renderer.prepared.scene
    staged = scene.surfaces.several or scene.surfaces.material.refracts
    if staged or view.moving or view.shading not in SPECS or renderer.knows(view):
        return None
    scene.lighting.room.refuse_camera(view.camera, scene.volume.radius)
    tiles, loader = renderer.tiles.cancelled_by(cancelled), renderer.caches.of(view.shading)
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
    """The frame of a view by what its ``texels`` hold, before it is drawn: white, and provisional all over."""
    gbuffer, count = texels.gbuffer, view.width * view.height
    white = Framebuffer(np.ones((count, 3), np.float32), np.zeros(count, np.uint8), np.ones(count, np.float32))
    white.state[gbuffer.pixels] = PROVISIONAL
    light = RotatedLight(renderer.caches.spec(view.shading), view)
    return frame_of(gbuffer, light, white, Stopwatch(), texels, reading)
