import json
import subprocess
import sys
from typing import Any

import pytest

from isogi_core.frame.kernels import ADAPTIVE, FRAME, PLAIN, SHARING, frame_kernels
from isogi_core.kernels.chunks import touch_chunks
from isogi_core.kernels.harmonics import rotate
from isogi_core.kernels.lamps import project_lamps
from isogi_core.kernels.lobes import add_lobes, light_lobes
from isogi_core.kernels.moves import judge_texels
from isogi_core.kernels.wide import spread_light, spread_shares
from isogi_core.model.scene import Scene, load_scene
from tests.scale import COMPILED

CONSTANT = {"lights": [{"type": "constant"}]}
FIXED = {"lights": [{"type": "sky"}], "rotating": False, "representation": "transfer"}
TURNING = {"lights": [{"type": "sky"}]}
SOFT = {"lights": [{"type": "sky"}], "lobes": 0}
LAMP = {"lights": [{"type": "constant"}, {"type": "directional", "azimuth": 30.0, "elevation": 50.0}]}
SHARP = {**LAMP, "sharpen": True}
EVEN = {**CONSTANT, "adaptive": True}
ADAPTING = {**SHARP, "adaptive": True}
RENDER = """\
import json, sys, tempfile
from isogi_core.bake.recipe import Recipe
from isogi_core.cache.caches import Caches
from isogi_core.cache.chunk import Chunk, Chunks
from isogi_core.frame.film import develop
from isogi_core.frame.kernels import frame_kernels
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels._jit import Entry
from isogi_core.kernels.lamps import project_lamps
from isogi_core.model.scene import load_scene
from isogi_core.model.view import View, quaternion_from_angles

modules = [module for name, module in sys.modules.items() if name.startswith("isogi_core.kernels.")]
entries = {kernel.name: kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Entry)}
assert not any(kernel.loaded for kernel in entries.values())
scene = load_scene("demo:orbital", lattice=0.4, **json.loads(sys.argv[1]))
light = quaternion_from_angles(30.0, 0.0, 0.0) if scene.rotating else (1.0, 0.0, 0.0, 0.0)
with tempfile.TemporaryDirectory() as store:
    renderer = Renderer(Caches(Recipe(scene), store, 1 << 26), Tiles())
    cache = renderer.caches.of("gi")
    cache.pool.insert(Chunks.of_one(Chunk.empty((0, 0, 0), cache.store.look.plan)))
    view = View(scene.isovalue, scene.camera(30, 20, 3, 30), width=20, height=20, light=light)
    frame = renderer.render(view)
    assert frame.provisional and frame.demands
    develop(frame, 1.0)
called = {name for name, kernel in entries.items() if kernel.loaded}
listed = {kernel.name for kernel in frame_kernels([scene])}
sys.exit(f"called but not listed: {called - listed}, listed but not called: {listed - called}")
"""


ALL = (CONSTANT, FIXED, TURNING, SOFT, LAMP, SHARP, EVEN, ADAPTING)
NAMES = ("constant", "fixed", "turning", "soft", "lamp", "sharp", "even", "adapting")


def scene_of(settings: dict[str, Any]) -> Scene:
    return load_scene("demo:orbital", **settings)


@COMPILED
@pytest.mark.parametrize("settings", ALL, ids=NAMES)
def test_the_kernels_of_a_frame_are_those_that_are_called(settings: dict[str, Any]) -> None:
    """In a process of its own, which has loaded no kernel yet."""
    command = [sys.executable, "-c", RENDER, json.dumps(settings)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == "called but not listed: set(), listed but not called: set()", done.stderr


def test_harmonics_are_for_lights_that_have_some_and_turn_and_for_lamps_lobes_and_what_scenes_ask_for() -> None:
    spared = [set(FRAME) - {*frame_kernels([scene_of(settings)])} for settings in ALL]
    lobes, judge, plain = {light_lobes, add_lobes}, {judge_texels} | ADAPTIVE, PLAIN
    still = {rotate, project_lamps} | lobes | judge
    soft, lamp = {project_lamps} | lobes | judge, {rotate} | lobes | judge
    turning = {project_lamps} | judge | plain
    expected = [still | SHARING, still | plain, turning, soft | plain, lamp | plain, (lamp | plain) - {judge_texels}]
    expected += [(still | SHARING | {touch_chunks}) - (ADAPTIVE - {spread_shares})]
    expected += [(lamp | plain | {touch_chunks}) - {judge_texels} - (ADAPTIVE - {spread_light})]
    assert spared == expected


def test_scenes_together_need_what_any_of_them_needs() -> None:
    assert frame_kernels([scene_of(settings) for settings in (SHARP, TURNING, CONSTANT, EVEN, ADAPTING)]) == FRAME
    assert rotate not in frame_kernels([scene_of(CONSTANT), scene_of(FIXED)])
    assert frame_kernels([]) == ()
