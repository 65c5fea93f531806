import subprocess
import sys

import pytest
from numba import config

RENDER = """\
import sys, tempfile
from isogi_core.bake.recipe import Recipe
from isogi_core.cache.caches import Caches
from isogi_core.frame.film import develop
from isogi_core.frame.kernels import FRAME
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels._jit import Entry
from isogi_core.model.scene import load_scene
from isogi_core.model.view import View

modules = [module for name, module in sys.modules.items() if name.startswith("isogi_core.kernels.")]
entries = {kernel.name: kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Entry)}
assert not any(kernel.loaded for kernel in entries.values())
scene = load_scene("demo:orbital", lattice=0.4, lights=[{"type": "sky"}])
recipe = Recipe(scene)
with tempfile.TemporaryDirectory() as store:
    renderer = Renderer(Caches(recipe, store, 1 << 26), Tiles())
    view = View(scene.isovalue, scene.camera(30, 20, 3, 30), width=20, height=20)
    frame = renderer.render(view)
    assert frame.provisional and frame.demands
    develop(frame, 1.0)
    recipe.bricks(0.5, 0.5)
called = {name for name, kernel in entries.items() if kernel.loaded}
listed = {kernel.name for kernel in FRAME}
sys.exit(f"called but not listed: {called - listed}, listed but not called: {listed - called}")
"""


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="Numba is switched off: nothing is compiled")
def test_the_kernels_of_a_frame_are_those_that_are_called() -> None:
    """In a process of its own, which has loaded no kernel yet."""
    done = subprocess.run([sys.executable, "-c", RENDER], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == "called but not listed: set(), listed but not called: set()", done.stderr
