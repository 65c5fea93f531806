"""Frames with a fixed number of paths from each texel: what two plans keep is then of the same
paths.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.refine import climb, locate
from isogi_core.bake.texel_light import Light
from isogi_core.cache.scene_caches import Caches, Loader
from isogi_core.files.radiance import write_hdr
from isogi_core.frame.demand import Demand
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.model.environment import LUMINANCE_WEIGHTS, pixel_directions
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import View, quaternion_from_angles
from isogi_core.model.volume import Volume, make_volume
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.loaded import load_scene

Frames = Callable[..., Frame]
Lobe = Callable[[float], dict[str, Any]]
TARGET = 0.05
CONSTANT = {"type": "constant", "radiance": 1.0}
SUN = {"type": "sky", "sun_azimuth": 80.0, "sun_elevation": 50.0}
WIDE = 2.0
"""Projection of a light from a wide window."""

TURN = quaternion_from_angles(60.0, 0.0, 0.0)
SIDE = 40
"""Pixels along each side of a frame."""


@pytest.fixture
def frame_of(tmp_path: Path) -> Frames:
    """Makes frames, each with light of its own."""
    return partial(make_frame, tmp_path)


def make_frame(folder: Path, scene: Scene, samples: int = 64, **settings: Any) -> Frame:
    """A view, with ``samples`` paths from each texel in each layer, or from each pixel; whatever
    the error is.
    """
    view = view_of(scene, samples=samples, **settings)
    renderer = Renderer(
        Caches(PreparedScene(scene), mkdtemp(dir=folder), 1 << 28), Tiles(), filters=False
    )
    demands = renderer.render(view).demands
    if demands:
        loader = renderer.caches.of(view.shading)
        renderer.tiles.run(lambda a, b: bake(loader, demands[a:b], samples), len(demands), 1)
    return renderer.render(view)


@pytest.fixture
def lobe(tmp_path: Path) -> Lobe:
    """Makes probes e^(sharpness (ω·a - 1)): brightest from a, and the softer the less their
    sharpness.
    """

    def make(sharpness: float) -> dict[str, Any]:
        falling = np.exp(sharpness * (pixel_directions(32, 64) @ np.array([0.48, 0.6, 0.64]) - 1.0))
        write_hdr(
            tmp_path / f"lobe{sharpness:g}.hdr",
            np.repeat(falling[..., None], 3, axis=-1).astype(np.float32),
        )
        return {"type": "probe", "file": str(tmp_path / f"lobe{sharpness:g}.hdr")}

    return make


def bake(loader: Loader, demands: Sequence[Demand], samples: int) -> None:
    """Take all that is demanded to ``samples`` paths in each layer."""
    for demand in demands:
        chunk = loader.chunk_store.load(demand.index).with_texels(demand.offsets)
        spec = loader.chunk_store.spec
        climb_to(
            chunk.light, spec.prepared.lattice.positions(demand.index, chunk.offsets), spec, samples
        )
        loader.chunk_store.save(chunk)
        loader.refresh(demand.index)


def climb_to(light: Light, texels: np.ndarray, spec: BakeSpec, samples: int) -> None:
    """Take every part of texels that have no light yet, and are not void, to ``samples``."""
    for part in light.parts:
        while len(rows := np.flatnonzero((part.samples >= 0) & (part.samples < samples))):
            climb([part], rows, locate(texels, spec.prepared, spec.shown), spec)


def view_of(scene: Scene, azimuth: float = 40.0, elevation: float = 55.0, **settings: Any) -> View:
    """A square view round the middle of the volume, at the scene's own isovalue unless told."""
    camera = scene.camera(azimuth, elevation, 2.5, 30.0)
    return View(
        **{"isovalue": scene.isovalue, "camera": camera, "width": SIDE, "height": SIDE, **settings}
    )


def bowl(size: int = 32) -> Volume:
    """A ball in a thick bowl, open to the top: the distance to their skin in voxels, positive
    inside.
    """
    z, y, x = np.mgrid[:size, :size, :size] - (size - 1) / 2
    away = np.sqrt(x**2 + y**2 + z**2)
    shell = np.minimum(np.minimum(13.0 - away, away - 9.0), 5.0 - z)
    ball = 4.0 - np.sqrt(x**2 + y**2 + (z + 4.0) ** 2)
    return make_volume(np.maximum(shell, ball).astype(np.float32), name="bowl")


def plated_ball(size: int = 24, radius: float = 8.0) -> Volume:
    """Distance to a ball's skin, cut to ±½ voxel: plateaus inside and outside."""
    z, y, x = np.mgrid[:size, :size, :size] - (size - 1) / 2
    return make_volume(
        np.clip(radius - np.sqrt(x**2 + y**2 + z**2), -0.5, 0.5).astype(np.float32), name="plated"
    )


def scene_of(
    volume: Volume, isovalues: tuple[float, float] | None = None, **settings: Any
) -> Scene:
    """A scene of a volume that is in no file, at isovalue 0, under constant light unless told."""
    scene = load_scene("demo:orbital", **{"lights": [CONSTANT], "target_error": TARGET, **settings})
    return replace(scene, volume=volume, isovalue=0.0, isovalues=isovalues or volume.value_range)


def in_bowl(**settings: Any) -> Scene:
    """A scene of the bowl."""
    return scene_of(bowl(), **settings)


def with_layers(scene: Scene, *layers: Layer, **plan: Any) -> Scene:
    """The scene with these layers in its plan, needed or not, and other things of its plan."""
    order = max(layer.order for layer in layers)
    return replace(scene, plan=replace(scene.plan, layers=layers, order=order, **plan))


def apart(frame: Frame, other: Frame) -> float:
    """How far two frames of one surface differ: RMSE over its pixels in luminance, over the mean of
    the other.
    """
    on = other.state > 0
    assert np.array_equal(frame.state > 0, on) and on.any()
    wrong = (frame.radiance[on].astype(np.float64) - other.radiance[on]) @ LUMINANCE_WEIGHTS
    return float(np.sqrt((wrong**2).mean()) / (other.radiance[on] @ LUMINANCE_WEIGHTS).mean())
