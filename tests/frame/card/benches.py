"""Scenes of the orbital with light for whole chunks, and what the frame has of them before lobes."""

from collections.abc import Callable
from typing import Any

import numpy as np

from isogi_core.bake.noise import Until
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Stopwatch, Tiles
from isogi_core.model.view import View
from isogi_core.plan.scene import Scene
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench
from tests.loaded import load_scene

Make = Callable[[Scene], Workbench]
TILES = Tiles()
SCENES: dict[str, dict[str, Any]] = {
    "colours": {"lights": [SKY], "albedo": [0.8, 0.6, 0.4]},
    "albedos": {"lights": [SKY], "albedo": 0.6, "albedos": [0.2, 0.8]},
    "irradiance": {"lights": [{**SKY, "scale": 3e4}], "rotating": False},
    "constant": {"lights": [CONSTANT]},
    "fine": {"lights": [SKY], "lattice": 1.5, "chunk": 8},
}


def bench_of(workbench: Make, name: str) -> Workbench:
    """A scene of the orbital whose `view()` is baked."""
    bench = workbench(load_scene("demo:orbital", bounces=2, target_error=LOOSE, projected=False, **SCENES[name]))
    bench.bake(bench.view(size=40))
    return bench


def drawn(
    bench: Workbench, view: View, target: float = LOOSE, filters: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and radiance before lobes of a view's surface."""
    renderer = bench.renderer if filters else Renderer(bench.caches, TILES, filters=False)
    gbuffer, light = renderer.gbuffer(view), RotatedLight(bench.caches.spec("gi"), view)
    texels = renderer.texels(view, gbuffer)
    _, framebuffer = renderer._texels.picture(texels, light, Until(target), TILES, Stopwatch())
    return gbuffer.points, gbuffer.normals(TILES), framebuffer.radiance[gbuffer.pixels]
