"""The renderer: answers views at once with the light that is there, and says what is missing."""

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from isogi_core.bake.look import look_name
from isogi_core.cache.caches import Caches
from isogi_core.cache.pages import Held, PagePool
from isogi_core.frame.facings import Facings, find_facings
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer, trace
from isogi_core.frame.lobes import LobeLight, find_lobes
from isogi_core.frame.reading import Reading, read_texels
from isogi_core.frame.shader import Shaded, Shader
from isogi_core.frame.sharpening import Ways, brought, find_ways, joined
from isogi_core.frame.stopwatch import Stopwatch
from isogi_core.frame.surroundings import Turned
from isogi_core.frame.texels import ViewTexels, find_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.kept import Kept
from isogi_core.kernels.lanes import REGISTER
from isogi_core.model.view import View

FORMAT = 2
"""Counts up when pictures of the same light change: those that browsers keep are then asked for anew."""

KEPT = 256 << 20
"""Bytes that are kept of views, for turning light and for asking again."""

READINGS = 1 / 16
"""The share of these for what was read of the pool and of lobes, the rest is for G-buffers and their texels."""


class Renderer:
    """Renders views of one scene. Frames may be asked for from several threads."""

    def __init__(self, caches: Caches, tiles: Tiles, most: int = KEPT) -> None:
        """Render with the light that ``caches`` bring, on the threads of ``tiles``; keep ``most`` bytes of views."""
        self.recipe = caches.recipe
        self.caches = caches
        self.tiles = tiles
        readings = int(READINGS * most)
        self._views: Kept[Any] = Kept(most - readings)  # texels hold their G-buffer, so that both go together
        self._readings: Kept[Any] = Kept(readings)

    def render(
        self,
        view: View,
        target: float | None = None,
        cancelled: threading.Event | None = None,
        watch: Stopwatch | None = None,
    ) -> Frame:
        """The frame of ``view`` with the light that is there now.

        ``target`` is the relative error at which light counts as final, the scene's own by default; ``watch`` goes
        on with this frame's stages. Raises Cancelled when ``cancelled`` is set on the way, and ViewError where the
        scene's light is not of the albedo that the view asks for.
        """
        watch = watch or Stopwatch()
        self.recipe.scene.albedo_for(view.albedo)
        with watch.stage("primary"):
            gbuffer = self.gbuffer(view, cancelled)
        shader = Shader(
            look=self.caches.look(view.shading),
            loader=lambda: self.caches.of(view.shading),
            tiles=self.tiles,
            view=view,
            gbuffer=gbuffer,
            find_texels=lambda: self.texels(view, gbuffer, cancelled),
            read=lambda texels, pool, held, target: self._read(view, texels, pool, held, target),
            find_lobes=lambda turned: self.lobes(turned, gbuffer, cancelled),
            sharpen=lambda texels, reading: self._sharpen(view, texels, reading),
            find_facing=lambda texels, reading: self._facing(view, texels, reading),
            watch=watch,
            cancelled=cancelled,
        )
        shaded = shader.shade(target or self.recipe.scene.target_error)
        return self._compose(view, gbuffer, shaded, watch)

    def gbuffer(self, view: View, cancelled: threading.Event | None = None) -> GBuffer:
        """The G-buffer of a view, kept for the next frames that share camera, isovalue and size."""
        key = (GBuffer, surface_key(view))
        return self._views.get(key, lambda: trace(view, self.recipe, self.tiles, cancelled))

    def texels(self, view: View, gbuffer: GBuffer, cancelled: threading.Event | None = None) -> ViewTexels:
        """The texels under a view, kept as its G-buffer is."""
        key = (ViewTexels, surface_key(view))
        return self._views.get(key, lambda: find_texels(gbuffer, self.recipe, self.tiles, cancelled))

    def lobes(self, turned: Turned, gbuffer: GBuffer, cancelled: threading.Event | None = None) -> LobeLight:
        """What comes straight from lobes to a view, kept while neither camera nor light moves, for any albedo."""
        key = (LobeLight, surface_key(turned.view), turned.view.light)
        kept = self._readings.get(key, lambda: find_lobes(turned, gbuffer, self.tiles, cancelled))
        return kept.tinted(turned.tint)

    def forget_views(self) -> None:
        """Drop the kept G-buffers and their texels, as if every view were new."""
        self._views.clear()
        self._readings.clear()

    def _read(self, view: View, texels: ViewTexels, pool: PagePool, held: Held, target: float) -> Reading:
        """What the ``pool`` has of a view's texels, looked up anew when it has changed."""
        key = (surface_key(view), look_name(view.shading), held.age, target)
        return self._readings.get(key, lambda: read_texels(texels, held.slots, pool, target, self.tiles))

    @contextmanager
    def _sharpen(self, view: View, texels: ViewTexels, base: Reading) -> Iterator[Reading]:
        """What a view reads besides the ``base``, which stays while the block runs: sharp light where its scene has it.

        Vicinity shading has none.
        """
        if not self.recipe.scene.sharpen or look_name(view.shading) != "gi":
            yield base
            return
        ways = self._views.get((Ways, surface_key(view)), lambda: find_ways(texels, self.recipe, self.tiles))
        loader = self.caches.sharp(texels.gbuffer.isovalue)
        with brought(loader, texels.chunks) as held:
            if held is None:
                yield base
            else:
                sharp = read_texels(texels, held.slots, loader.pool, base.target, self.tiles)
                yield joined(base, sharp, ways, loader.pool)

    def _facing(self, view: View, texels: ViewTexels, reading: Reading) -> np.ndarray:
        """The normals that a view's texels are lit about, as they are read; kept as its texels are."""
        key = (Facings, surface_key(view))
        facings = self._views.get(key, lambda: find_facings(texels, self.recipe, self.tiles))
        return facings.where(reading.moved, texels, self.recipe, self.tiles)

    def _compose(self, view: View, gbuffer: GBuffer, shaded: Shaded, watch: Stopwatch) -> Frame:
        return Frame(
            view=view,
            radiance=shaded.planes.radiance.reshape(*gbuffer.shape, 3),
            state=shaded.planes.state.reshape(gbuffer.shape),
            error=shaded.planes.error.reshape(gbuffer.shape),
            gbuffer=gbuffer,
            chunks_needed=shaded.chunks_needed,
            chunks_final=shaded.chunks_final,
            lacks=shaded.lacks,
            version=version_of(self.recipe.scene.digest, self.caches.look(view.shading).digest, view, shaded.version),
            seconds=watch.seconds,
            sharpness=shaded.sharpness,
        )


def surface_key(view: View) -> tuple[Any, ...]:
    """What the surface in a picture depends on."""
    return view.isovalue, view.camera, view.width, view.height


def version_of(scene: str, look: str, view: View, light: bytes) -> str:
    """Hex digest of all that a picture was made of: scene, look, view, how far the light it read is baked, and by what.

    Light is summed in the order that fills the processor's registers, whose width is part of it.
    """
    return hashlib.blake2b(repr((FORMAT, scene, look, view, light, REGISTER)).encode(), digest_size=12).hexdigest()
