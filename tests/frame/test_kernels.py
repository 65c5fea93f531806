import json
import subprocess
import sys
from typing import Any

import pytest

from isogi_core.frame.entry_kernels import (
    FRAME,
    LOBES,
    OTHER_KERNELS,
    frame_kernels,
    other_kernels,
)
from isogi_core.frame.features import COLOURS, GLASS, GLOW, SEVERAL_SURFACES, SHINE, WALLS
from isogi_core.kernels._jit import Entry
from isogi_core.kernels.shading.irradiance_ratio import carry_ratios
from isogi_core.kernels.shading.lattice import carry_light
from isogi_core.kernels.tracing.stiffness import count_stiffness
from isogi_core.kernels.transport.glow_paths import glow_in_room
from isogi_core.kernels.transport.harmonics import rotate
from isogi_core.kernels.transport.light_paths import light_in_the_open
from isogi_core.kernels.transport.lights import project_lamps
from isogi_core.kernels.transport.matter.matter_paths import light_through_matter
from isogi_core.kernels.transport.room_paths import fill_seeds, light_in_room
from isogi_core.kernels.transport.surface_paths import light_among_surfaces
from isogi_core.kernels.transport.transfer import measure_distances
from isogi_core.plan.scene import Scene
from tests.loaded import load_scene
from tests.scale import COMPILED

SKY = {"lights": [{"type": "sky"}], "projected": False}
CONSTANT = {"lights": [{"type": "constant"}], "projected": False}
FIXED = {**SKY, "rotating": False, "representation": "transfer"}
TURNING = SKY
SOFT = {**SKY, "lobes": 0}
LAMPS = [{"type": "constant"}, {"type": "directional", "azimuth": 30.0, "elevation": 50.0}]
LAMP = {"lights": LAMPS, "projected": False}
GLOWING = {**CONSTANT, "glow": [{"sphere": [48.0, 48.0, 48.0, 4.0]}]}
PROJECTED = {"lights": LAMPS, "projected": True}
SURVEYED = {"lights": LAMPS}
"""The plan decides: at some isovalues texels are projected."""
RENDER = """\
import json, os, sys, tempfile
from dataclasses import replace
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.cache.scene_caches import Caches
from isogi_core.cache.chunk_record import Chunk, Chunks
from isogi_core.bake.noise import Goal
from isogi_core.frame.film import develop
from isogi_core.frame.entry_kernels import frame_kernels
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels._compilation import with_callees
from isogi_core.kernels._jit import Entry
from isogi_core.kernels.transport.lights import project_lamps
from isogi_core.frame.fitting import fitted
from isogi_core.plan.assembly import load_scene
from isogi_core.model.view import View, quaternion_from_angles

modules = [module for name, module in sys.modules.items() if name.startswith("isogi_core.kernels.")]
entries = {
    kernel.name: kernel
    for module in modules
    for kernel in vars(module).values()
    if isinstance(kernel, Entry)
}
assert not any(kernel.loaded for kernel in entries.values())


def compare(settings):
    scene = load_scene("demo:orbital", lattice=0.4, **settings)
    light = (1.0, 0.0, 0.0, 0.0)
    if scene.lighting.rotating:
        light = quaternion_from_angles(30.0, 0.0, 0.0)
    with tempfile.TemporaryDirectory() as store:
        renderer = Renderer(Caches(PreparedScene(scene), store, 1 << 26), Tiles())
        cache = renderer.caches.of("gi")
        cache.pool.insert(Chunks.of_one(Chunk.empty((0, 0, 0), cache.chunk_store.spec.plan)))
        camera = scene.camera(30, 20, 3, 30)
        view = View(scene.isovalue, camera, width=20, height=20, light=light, smooth=True)
        frame = renderer.render(view)
        assert frame.provisional and frame.demands
        first = frame.demands[0]
        plan = cache.chunk_store.spec.plan
        chunk = Chunk.empty(first.index, plan).with_texels(first.offsets)
        for part in chunk.light.parts:
            part.samples[:] = 16
            part.coefficients[:] = 0.5
            part.noise[:] = 0.1
        cache.pool.insert(Chunks.of_one(chunk))
        renderer.render(view)
        for demand in frame.demands:
            chunk = Chunk.empty(demand.index, plan).with_texels(demand.offsets)
            for part in chunk.light.parts:
                part.samples[:] = 1 << 20
                part.coefficients[:] = 0.5
            cache.pool.insert(Chunks.of_one(chunk))
        for _ in range(3):
            renderer.render(replace(view, moving=True), Goal.checked(1.0))
        develop(frame, 1.0)
        fitted(renderer, view, 30.0, 20.0)
    called = {name for name, kernel in entries.items() if kernel.loaded}
    listed = {kernel.name for kernel in with_callees(frame_kernels([scene]))}
    print(f"called but not listed: {called - listed}", flush=True, end=", ")
    print(f"listed but not called: {listed - called}", flush=True)


for settings in json.loads(sys.argv[1]):
    if os.fork() == 0:
        compare(settings)
        os._exit(0)
    assert os.wait()[1] == 0
"""


def scene_of(settings: dict[str, Any]) -> Scene:
    return load_scene("demo:orbital", **settings)


@pytest.mark.long
@pytest.mark.slow
@COMPILED
def test_a_frame_calls_exactly_its_listed_kernels() -> None:
    """Each scene in a process of its own, which has loaded no kernel yet."""
    scenes = [CONSTANT, FIXED, TURNING, SOFT, LAMP, PROJECTED, GLOWING]
    command = [sys.executable, "-c", RENDER, json.dumps(scenes)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    exact = "called but not listed: set(), listed but not called: set()"
    assert done.stdout.splitlines() == [exact] * len(scenes), done.stdout + done.stderr


FIRST_PICTURE = """\
import sys, tempfile
from isogi_core.prepared.prepared_scene import PreparedScene
from isogi_core.cache.scene_caches import Caches
from isogi_core.frame.film import develop
from isogi_core.frame.fitting import fitted
from isogi_core.frame.entry_kernels import first_kernels
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels._compilation import with_callees
from isogi_core.kernels._jit import Entry
from isogi_core.model.view import View
from isogi_core.plan.assembly import load_scene

modules = [module for name, module in sys.modules.items() if name.startswith("isogi_core.kernels.")]
entries = {
    kernel.name: kernel
    for module in modules
    for kernel in vars(module).values()
    if isinstance(kernel, Entry)
}
scene = load_scene("demo:orbital", lattice=0.4)
with tempfile.TemporaryDirectory() as store:
    renderer = Renderer(Caches(PreparedScene(scene), store, 1 << 26), Tiles())
    scene.projection
    view = View(scene.isovalue, scene.camera(30, 20, 3, 30), width=20, height=20, shading="lambert")
    frame = renderer.render(view)
    assert frame.counts["final"]
    develop(frame, 1.0)
    fitted(renderer, view, 30.0, 20.0)
called = {name for name, kernel in entries.items() if kernel.loaded}
listed = {kernel.name for kernel in with_callees(first_kernels([scene]))}
print(f"called but not listed: {called - listed}, listed but not called: {listed - called}")
"""


@COMPILED
def test_a_first_picture_calls_exactly_its_kernels() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FIRST_PICTURE], capture_output=True, text=True, check=False
    )
    assert done.stdout == "called but not listed: set(), listed but not called: set()\n", (
        done.stdout + done.stderr
    )


def test_kernels_are_left_out_by_what_a_scene_lacks() -> None:
    scenes = (CONSTANT, FIXED, TURNING, SOFT, LAMP, PROJECTED, SURVEYED)
    spared = [set(FRAME) - {*frame_kernels([scene_of(settings)])} for settings in scenes]
    lobes = {*LOBES}
    far = {measure_distances}
    survey = {count_stiffness}
    plain = {carry_light}
    still = {rotate, project_lamps} | lobes | far | survey
    soft = {project_lamps} | lobes | far | survey
    lamp = {rotate} | lobes | far | survey
    turning = {project_lamps} | far | survey | plain
    projected = (lamp | plain) - far
    assert spared[:4] == [still | {carry_ratios}, still | plain, turning, soft | plain]
    assert spared[4:] == [lamp | plain, projected, projected - survey]


def test_colours_need_kernels_of_their_own() -> None:
    plain = load_scene("demo:orbital", **CONSTANT)
    scene = load_scene("demo:orbital", volumes=[{"use": "colour", "of": "gradient"}], **CONSTANT)
    assert {*frame_kernels([scene])} - {*frame_kernels([plain])} == {*COLOURS.kernels}
    assert {*other_kernels([plain])} - {*OTHER_KERNELS} == {light_in_the_open, fill_seeds}
    assert light_in_room in other_kernels([plain, scene])


def test_glow_needs_kernels_of_its_own() -> None:
    plain = scene_of(CONSTANT)
    scene = scene_of(GLOWING)
    assert {*frame_kernels([scene])} - {*frame_kernels([plain])} == {*GLOW.kernels}
    assert {*other_kernels([plain, scene])} - {*OTHER_KERNELS} == {
        glow_in_room,
        light_in_the_open,
        fill_seeds,
    }
    assert glow_in_room in frame_kernels(
        [load_scene("demo:orbital", room="cornell", glow=GLOWING["glow"])]
    )


@pytest.mark.parametrize(
    ("settings", "more", "kernels"),
    [
        ({}, {"room": "cornell"}, {*WALLS.kernels, light_in_room}),
        ({"room": "cornell"}, {"material": "glass"}, {*GLASS.kernels, light_through_matter}),
        (
            {},
            {"surfaces": [{"isovalue": 0.012, "clear": 0.6}]},
            {*SEVERAL_SURFACES.kernels, light_among_surfaces},
        ),
        ({}, {"shine": {"kind": "plastic"}}, {*SHINE.kernels}),
    ],
    ids=["walls", "matter", "surfaces", "shine"],
)
def test_only_scenes_with_a_feature_need_its_kernels(
    settings: dict[str, Any], more: dict[str, Any], kernels: set[Entry]
) -> None:
    assert kernels <= {*frame_kernels([scene_of({**settings, **more})])}
    assert not kernels & {*frame_kernels([scene_of(settings)])}


def test_several_scenes_need_the_kernels_of_each() -> None:
    assert (
        frame_kernels([scene_of(settings) for settings in (SURVEYED, TURNING, CONSTANT)]) == FRAME
    )
    assert rotate not in frame_kernels([scene_of(CONSTANT), scene_of(FIXED)])
    assert frame_kernels([]) == ()
