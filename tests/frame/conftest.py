"""Scenes of formulas, and light baked in this process: a renderer with a store of its own, and no
workers.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import FIRST_LEVEL
from isogi_core.cache.scene_caches import Caches, Loader
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.demand import Demand
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.several.mixed_reading import Level
from isogi_core.frame.texel_reading import Reading, read_texels
from isogi_core.frame.texel_shading import TexelShading
from isogi_core.frame.tiles import Tiles
from isogi_core.lru_cache import LruCache
from isogi_core.model.environment import LUMINANCE_WEIGHTS, pixel_directions
from isogi_core.model.view import View
from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.reference import trace_reference
from tests.loaded import load_scene

CONSTANT = {"type": "constant", "radiance": 1.0}
SKY = {"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}
LOOSE = 0.1
"""Target error of scenes that must bake fast."""


MIDDLE = 16.0
"""The middle of the ``shell``, voxels along each axis."""


def shell(hollow: float = 6.0, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Volume:
    """A ball of radius 12 voxels about the MIDDLE, with a hollow: solid where the field is above
    0.
    """
    z, y, x = np.mgrid[:33, :33, :33] - MIDDLE
    r = np.sqrt(x**2 + y**2 + z**2)
    return make_volume(np.minimum(12.0 - r, r - hollow).astype(np.float32), spacing)


class Workbench:
    """One scene, the caches of its light in a folder, and a renderer that reads them."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        self.scene = scene
        self.folder = folder
        self.prepared = PreparedScene(scene)
        self.caches = Caches(self.prepared, folder, 1 << 28)
        self.renderer = Renderer(self.caches, Tiles())

    def again(self) -> "Workbench":
        """Everything built anew over the same store, as after a restart."""
        return Workbench(self.scene, self.folder)

    def view(
        self, azimuth: float = 40.0, elevation: float = 30.0, size: int = 64, **settings: Any
    ) -> View:
        """A square view round the middle of the volume, at the scene's own isovalue unless
        given.
        """
        camera = self.scene.camera(azimuth, elevation, settings.pop("distance", 3.0), 30.0)
        return View(
            settings.pop("isovalue", self.scene.isovalue),
            camera,
            width=size,
            height=size,
            **settings,
        )

    def bake(self, view: View, target: float | None = None) -> Frame:
        """Bake rung by rung all that `view` demands, and render its final frame."""
        rung = FIRST_LEVEL
        goal = Goal(target or self.scene.target_error)
        frame = self.renderer.render(view, goal)
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            while frame.demands:
                loader = self.caches.of(view.shading)
                list(threads.map(partial(refine_chunk, loader, rung, goal.error), frame.demands))
                rung = 2 * rung
                frame = self.renderer.render(view, goal)
        return self.renderer.render(view, Goal.checked(goal.error))

    def project(self, view: View, target: float | None = None) -> Frame:
        """Bake rung by rung all projected texels that a baked view demands, and render it."""
        rung = FIRST_LEVEL
        goal = Goal(target or self.scene.target_error)
        frame = self.renderer.render(view, goal)
        while frame.quality.projection and frame.quality.projection.demands:
            loader = self.caches.projected(frame.gbuffer.isovalue)
            given = partial(refine_chunk, loader, rung, goal.error)
            list(map(given, frame.quality.projection.demands))
            rung = 2 * rung
            frame = self.renderer.render(view, goal)
        return self.renderer.render(view, Goal.checked(goal.error))

    def settled(self, view: View, target: float | None = None) -> Frame:
        """The frame of a view once nothing of its picture can be refined any more."""
        goal = Goal.checked(target or self.scene.target_error)
        while self.renderer.refine(view, goal):
            pass
        return self.renderer.render(view, goal)

    @property
    def layers(self) -> set[str]:
        """Folders of the layers that were baked."""
        return {path.parent.name for path in self.folder.glob("*/c")}


def refine_chunk(loader: Loader, rung: int, target: float, demand: Demand) -> None:
    """Do as a worker does."""
    store = loader.chunk_store
    chunk = store.load(demand.index).with_texels(demand.offsets)
    rows = chunk.rows_of(demand.offsets)
    light = chunk.light.rows(rows)
    texels = store.spec.prepared.lattice.positions(demand.index, demand.offsets)
    refine(light, texels, store.spec, rung, Goal(target))
    chunk.light.put(rows, light)
    store.save(chunk)
    loader.refresh(demand.index)


def true_error(bench: Workbench, frame: Frame) -> float:
    """The error of a picture against long paths, less their noise."""
    reference = trace_reference(bench.renderer, frame.view, 1024)
    on = frame.state > 0
    true = luminance(replace(frame, radiance=reference.mean))
    wrong = np.sqrt(((luminance(frame) - true) ** 2).mean()) / true.mean()
    assert on.any()
    return math.sqrt(max(wrong**2 - reference.noise**2, 0.0))


def reading_of(bench: Workbench, view: View, tiles: Tiles) -> Reading:
    """What the cache has of a view."""
    texels = bench.renderer.surface.texels(view, bench.renderer.gbuffer(view))
    loader = bench.caches.of(view.shading)
    loader.ensure(texels.chunks)
    with loader.pool.hold(texels.chunks) as held:
        return read_texels(texels, held.slots, loader.pool, Goal(bench.scene.target_error), tiles)


def shading_of(caches: Caches, filters: bool = True) -> TexelShading:
    """What carries the light of texels to pictures, before anything else lights these."""
    kept: LruCache[Any] = LruCache(1 << 28)
    return TexelShading(caches.prepared, (Level(caches),), kept, 1 << 26, filters, None)


@pytest.fixture(scope="session")
def orbital(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital under a sky; `view()` is baked to a tenth."""
    bench = Workbench(
        load_scene(
            "demo:orbital", lights=[SKY], albedo=[0.8, 0.6, 0.4], bounces=2, target_error=LOOSE
        ),
        tmp_path_factory.mktemp("orbital"),
    )
    bench.bake(bench.view())
    return bench


@pytest.fixture(scope="session")
def evenly_lit(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital under constant light, white as snow, its direct and indirect light apart;
    `view()` is baked.
    """
    kept = {"representation": "transfer", "order": 1}
    bench = Workbench(
        load_scene(
            "demo:orbital", lights=[CONSTANT], albedo=0.9, bounces=3, target_error=LOOSE, **kept
        ),
        tmp_path_factory.mktemp("evenly_lit"),
    )
    bench.bake(bench.view())
    return bench


@pytest.fixture
def workbench(tmp_path: Path) -> Callable[[Scene], Workbench]:
    """Make the workbench of a scene, with nothing baked yet."""
    return lambda scene: Workbench(scene, tmp_path / scene.bake_digest)


def soft_probe(folder: Path) -> dict[str, Any]:
    """A probe of radiance 1 + ω·a, twice as bright as the mean at its pole a and black opposite: no
    lamp to miss.
    """
    falling = 1.0 + pixel_directions(32, 64) @ np.array([0.48, 0.6, 0.64])
    write_hdr(folder / "soft.hdr", np.repeat(falling[..., None], 3, axis=-1).astype(np.float32))
    return {"type": "probe", "file": str(folder / "soft.hdr")}


def scene_of(volume: Volume, isovalue: float, **settings: Any) -> Scene:
    """A scene of a volume that is in no file, under constant light of radiance 1 unless given."""
    scene = load_scene("demo:orbital", **{"lights": [CONSTANT], **settings})
    return replace(scene, volume=volume, isovalue=isovalue, isovalues=volume.value_range)


def ball(
    size: int = 40, radius: float = 12.0, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> Volume:
    """Distance from a ball's skin, positive inside: a cube of side `size` in world units, sampled
    with `spacing`.
    """
    x, y, z = (np.arange(round(size / step) + 1) * step - size / 2 for step in spacing)
    away = np.sqrt(x[None, None, :] ** 2 + y[None, :, None] ** 2 + z[:, None, None] ** 2)
    return make_volume((radius - away).astype(np.float32), spacing, name="ball")


def luminance(frame: Frame) -> np.ndarray:
    """Luminance of the surface pixels, float64."""
    return frame.radiance[frame.state > 0].astype(np.float64) @ LUMINANCE_WEIGHTS


def relative_rmse(frame: Frame, reference: Frame) -> float:
    """RMSE of the luminance over the surface pixels, over the reference's mean."""
    assert np.array_equal(frame.state > 0, reference.state > 0)
    wrong = luminance(frame) - luminance(reference)
    return float(np.sqrt((wrong**2).mean()) / luminance(reference).mean())


def rmse_of_colours(frame: Frame, other: Frame) -> float:
    """RMSE of the worst channel over the surface, over the other's mean of its brightest
    channel.
    """
    on = (frame.state > 0) & (other.state > 0)
    wrong = (frame.radiance[on] - other.radiance[on]).astype(np.float64)
    return float(np.sqrt((wrong**2).mean(axis=0)).max() / other.radiance[on].mean(axis=0).max())


def chunks_of(folder: Path, digest: str) -> dict[str, bytes]:
    """The chunk objects of a layer."""
    layer = folder / digest
    return {
        str(path.relative_to(layer)): path.read_bytes()
        for path in (layer / "c").rglob("*")
        if path.is_file()
    }
