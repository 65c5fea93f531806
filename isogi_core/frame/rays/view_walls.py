"""The walls of views: their light is kept for what is shown of the surface, whatever view shows it."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from isogi_core.cache.wall_store import WallStore
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.rays.wall_light import RoomLight, WallView
from isogi_core.frame.rays.wall_texels import WallTexels
from isogi_core.frame.shading import fog_depths
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.kernels.shading.framebuffer import Framebuffer
from isogi_core.lru_cache import LruCache
from isogi_core.model.volume import Volume


class ViewWalls:
    """The walls about a ``volume``, whose light is among what is ``kept`` of views."""

    def __init__(self, kept: LruCache[Any], volume: Volume, store: WallStore) -> None:
        """Keep the light of walls where results of views are, and in a ``store``."""
        self._kept, self._volume, self._store = kept, volume, store

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
            texels = self._best(walls, target, tiles)
            return walls.put(texels, target, framebuffer, tiles), "".join(each.version for each in texels)
        return 0, ""

    def add(self, frame: Frame, light: RotatedLight, target: float, tiles: Tiles, watch: Stopwatch) -> Frame:
        """A ``frame`` with the walls that it shows, which are written into its picture. Raises Cancelled."""
        if not len(frame.gbuffer.walls.pixels):
            return frame
        with watch.stage("walls"):
            waiting, version = self.put(frame.gbuffer, light, target, frame.framebuffer, tiles)
        return replace(frame, quality=replace(frame.quality, waiting=waiting), version=f"{frame.version}{version}")

    def put_seen(self, views: Iterable[WallView], target: float, framebuffer: Framebuffer, tiles: Tiles) -> str:
        """Write what several views see of walls into one picture; what names the paths taken. Raises Cancelled."""
        version = ""
        for walls in views:
            texels = self._best(walls, target, tiles)
            walls.put(texels, target, framebuffer, tiles)
            version += "".join(each.version for each in texels)
        return version

    def grow(self, views: Sequence[WallView], target: float, tiles: Tiles) -> bool:
        """Have the walls in some ``views`` of one light, that are not final, take as many paths again.

        The store keeps what they come to, also where this raises Cancelled.
        """
        room, grown = self._room(views[0]), list[WallTexels]()
        try:
            for side in dict.fromkeys(side for walls in views for side in walls.seen):
                lit = room.side(side)
                if lit.step(target, tiles):
                    grown.append(lit.texels)
        finally:
            room.keep(grown)
        self._kept.settle()
        return bool(grown)

    def _best(self, walls: WallView, target: float, tiles: Tiles) -> list[WallTexels]:
        """The texels of the sides that are seen. Raises Cancelled."""
        room = self._room(walls)
        return [room.side(side).best(target, tiles) for side in walls.seen]

    def _room(self, walls: WallView) -> RoomLight:
        """The light of walls for the isovalue, the albedo and the glow that are shown; kept beside views."""
        light, surface = walls.light, walls.gbuffer.surface
        key = (RoomLight, light.view.isovalue, light.view.albedo, light.view.glow)
        return self._kept.get(key, lambda: RoomLight.of(light, surface, self._store))
