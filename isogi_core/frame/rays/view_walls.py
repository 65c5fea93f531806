"""The walls of views: their light is kept for the isovalue and the albedo that are shown, whatever view shows it."""

from collections.abc import Iterable
from typing import Any

from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.wall_light import COARSE, WallLight, WallTexels, WallView
from isogi_core.frame.shading import fog_depths
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import Framebuffer
from isogi_core.lru_cache import LruCache
from isogi_core.model.volume import Volume


class ViewWalls:
    """The walls about a ``volume``, whose light is among what is ``kept`` of views."""

    def __init__(self, kept: LruCache[Any], volume: Volume) -> None:
        """Keep the light of walls where results of views are."""
        self._kept, self._volume = kept, volume

    def put(
        self, gbuffer: GBuffer, light: RotatedLight, target: float, framebuffer: Framebuffer, tiles: Tiles
    ) -> tuple[int, str]:
        """Write the walls into a picture; how many of their pixels are not final, and what names the paths taken.

        Raises Cancelled.
        """
        view, walls = light.view, WallView.of(gbuffer, light)
        if view.shading == "path_traced":
            walls.put_paths(target, framebuffer, tiles)
        elif view.shading != "gi":
            shading = "lambert" if view.shading == "vicinity" else view.shading
            walls.put_locally(shading, fog_depths(view, self._volume), framebuffer, tiles)
        else:
            texels = [self._light(walls, *seen).begun(tiles) for seen in walls.seen]
            return walls.put(texels, target, framebuffer, tiles), "".join(each.version for each in texels)
        return 0, ""

    def put_seen(self, views: Iterable[WallView], target: float, framebuffer: Framebuffer, tiles: Tiles) -> str:
        """Write what several views see of walls into one picture; what names the paths taken. Raises Cancelled."""
        version = ""
        for walls in views:
            texels = [self._light(walls, *seen).begun(tiles) for seen in walls.seen]
            walls.put(texels, target, framebuffer, tiles)
            version += "".join(each.version for each in texels)
        return version

    def grow(self, views: Iterable[WallView], target: float, tiles: Tiles) -> bool:
        """Have the walls in some views, that are not final, take as many paths again. Raises Cancelled."""
        lit = {seen: self._light(walls, *seen) for walls in views for seen in walls.seen}
        taken = [each.step(target, tiles) for each in lit.values()]
        self._kept.settle()
        return any(taken)

    def _light(self, walls: WallView, wall: int, side: int) -> WallLight:
        """The light of a side of a wall, for the isovalue and the albedo that are shown; kept beside views."""
        light = walls.light
        key = (WallLight, light.view.isovalue, light.view.albedo, light.view.glow, wall, side)
        begun = WallTexels.begun(light, wall, side, COARSE)
        return self._kept.get(key, lambda: WallLight(light, walls.gbuffer.surface, begun))
