"""Scenes of formulas, and light baked in this process: a renderer with a store of its own, and no workers."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.precision import FIRST_RUNG
from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import refine
from isogi_core.cache.loader import Loader
from isogi_core.cache.pages import PagePool
from isogi_core.cache.store import ChunkStore
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.texels import Demand
from isogi_core.frame.tiles import Tiles
from isogi_core.model.environment import pixel_directions
from isogi_core.model.scene import Scene, load_scene
from isogi_core.model.view import View
from isogi_core.model.volume import Volume, make_volume

CONSTANT = {"type": "constant", "radiance": 1.0}
SKY = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}


class Workbench:
    """One scene, the store of its light in a folder, and a renderer that reads it."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        self.scene = scene
        self.folder = folder
        self.recipe = Recipe(scene)
        self.store = ChunkStore(folder, self.recipe)
        self.loader = Loader(self.store, PagePool(self.recipe, 1 << 28))
        self.renderer = Renderer(self.recipe, self.loader, Tiles())

    def again(self) -> "Workbench":
        """Everything built anew over the same store, as after a restart."""
        return Workbench(self.scene, self.folder)

    def view(self, azimuth: float = 40.0, elevation: float = 30.0, size: int = 64, **settings: Any) -> View:
        """A square view round the middle of the volume, at the scene's own isovalue unless told."""
        camera = self.scene.camera(azimuth, elevation, settings.pop("distance", 3.0), 30.0)
        return View(settings.pop("isovalue", self.scene.isovalue), camera, width=size, height=size, **settings)

    def bake(self, view: View, target: float | None = None) -> Frame:
        """Bake rung by rung all that `view` demands, and render its final frame."""
        rung, frame = FIRST_RUNG, self.renderer.render(view, target)
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            while frame.demands:
                list(threads.map(partial(self._refine, rung, target or self.scene.target_error), frame.demands))
                rung, frame = 2 * rung, self.renderer.render(view, target)
        return frame

    def _refine(self, rung: int, target: float, demand: Demand) -> None:
        chunk = self.store.load(demand.index).with_texels(demand.offsets)
        refine(chunk.light, chunk.positions(chunk.offsets), self.recipe, rung, target)
        self.store.save(chunk)
        self.loader.refresh(demand.index)


@pytest.fixture
def workbench(tmp_path: Path) -> Callable[[Scene], Workbench]:
    """Make the workbench of a scene, with nothing baked yet."""
    return lambda scene: Workbench(scene, tmp_path / scene.bake_digest)


def soft_probe(folder: Path) -> dict[str, Any]:
    """A probe of radiance 1 + ω·a, twice as bright as the mean at its pole a and black opposite: no lamp to miss."""
    falling = 1.0 + pixel_directions(32, 64) @ np.array([0.48, 0.6, 0.64])
    write_hdr(folder / "soft.hdr", np.repeat(falling[..., None], 3, axis=-1).astype(np.float32))
    return {"type": "probe", "file": str(folder / "soft.hdr")}


def scene_of(volume: Volume, isovalue: float, **settings: Any) -> Scene:
    """A scene of a volume that is in no file, under constant light of radiance 1 unless told."""
    scene = load_scene("demo:orbital", **{"lights": [CONSTANT], **settings})
    return replace(scene, volume=volume, isovalue=isovalue, isovalues=volume.value_range)


def ball(size: int = 40, radius: float = 12.0, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Volume:
    """Distance from a ball's skin, positive inside: a cube of side `size` in world units, sampled with `spacing`."""
    x, y, z = (np.arange(round(size / step) + 1) * step - size / 2 for step in spacing)
    away = np.sqrt(x[None, None, :] ** 2 + y[None, :, None] ** 2 + z[:, None, None] ** 2)
    return make_volume((radius - away).astype(np.float32), spacing, name="ball")
