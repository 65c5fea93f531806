"""Frames in which something glows: its light on the surface, on walls and to the eye, and what its
chunks depend on.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.film import develop, linear_table
from isogi_core.frame.lighting import RotatedLight
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.model.glow import Glow, place_glows
from isogi_core.model.volume import make_volume
from isogi_core.plan.scene import Scene
from isogi_report.exact import bake_place, light_of_halves
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench, chunks_of, relative_rmse, scene_of
from tests.loaded import load_scene

SIZE = 32
DARK = {"type": "constant", "radiance": 0.0}


def orbital_of(**settings: Any) -> Scene:
    """The orbital with a ball that glows beside it."""
    low, high = load_scene("demo:orbital", lights=[CONSTANT]).volume.world_bounds
    x, y, z = (np.array(low) + np.array(high)) / 2.0
    radius = 0.12 * (high[0] - low[0])
    glow = {"sphere": [x + 2.0 * radius, y + 2.5 * radius, z, radius], "radiance": [4.0, 2.0, 0.5]}
    return load_scene(
        "demo:orbital", **{"glow": [glow], "target_error": LOOSE, "projected": False, **settings}
    )


def floor_under(glow: Glow, tmp_path: Path) -> Workbench:
    """A white floor at a height of 8 in a box of 48, black but for what glows above it."""
    z, y, x = np.mgrid[:49, :49, :49].astype(np.float32)
    volume = make_volume(8.0 - z + 0.0 * (x + y), (1.0, 1.0, 1.0))
    scene = scene_of(
        volume, 0.0, lights=[DARK], albedo=1.0, bounces=0, projected=False, target_error=0.005
    )
    glowing = place_glows([glow], volume)
    given = load_scene(
        "demo:orbital", glow=[{"sphere": [20, 20, 20, 5]}], lights=[DARK], albedo=1.0, bounces=0
    )
    lighting = replace(scene.lighting, glowing=glowing)
    return Workbench(
        replace(scene, lighting=lighting, plan=given.plan, inputs=given.inputs), tmp_path
    )


@pytest.mark.slow
def test_a_floor_under_a_glowing_ball(tmp_path: Path) -> None:
    """E = π L (r/d)² cosθ in every pixel, through texels, at rays' starts 0.3 voxels above the
    floor.
    """
    middle = np.array([24.0, 24.0, 24.0])
    radius = 6.0
    radiance = np.array([3.0, 2.0, 1.0])
    bench = floor_under(Glow((3.0, 2.0, 1.0), sphere=(24.0, 24.0, 24.0, radius)), tmp_path)
    frame = bench.bake(bench.view(30.0, 70.0, SIZE))
    inner = (np.abs(frame.position[..., :2] - 24.0) < 20.0).all(axis=-1) & (
        frame.position[..., 2] > 7.9
    )
    assert frame.glow is not None and inner.sum() > 200
    lit = (frame.radiance - frame.glow.reshape(frame.radiance.shape))[inner]
    away = middle - frame.position[inner] - [0.0, 0.0, 0.3]
    expected = radius**2 * away[:, 2] / (away**2).sum(axis=1) ** 1.5
    np.testing.assert_allclose(lit.mean(axis=0), expected.mean() * radiance, rtol=0.01)
    assert np.sqrt(np.mean((lit[:, 0] / (3.0 * expected) - 1.0) ** 2)) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("lights", [[SKY], [CONSTANT]])
def test_pictures_with_glow_are_what_paths_say(
    lights: list[dict[str, Any]], tmp_path: Path
) -> None:
    """Beside light that turns and light that is the same from all sides, and what glows is seen by
    the eye.
    """
    bench = Workbench(orbital_of(lights=lights, albedo=[0.8, 0.6, 0.4], bounces=2), tmp_path)
    view = bench.view(size=SIZE)
    frame = bench.bake(view)
    traced = bench.renderer.render(replace(view, shading="path_traced", samples=256))
    assert relative_rmse(frame, traced) < 1.5 * LOOSE
    assert frame.glow is not None and traced.glow is not None
    np.testing.assert_array_equal(frame.glow, traced.glow)
    beside = np.setdiff1d(np.flatnonzero(frame.glow.any(axis=1)), frame.gbuffer.pixels)
    assert len(beside) > 0 and (frame.state.ravel()[beside] == FINAL).all()
    np.testing.assert_array_equal(frame.radiance.reshape(-1, 3)[beside], frame.glow[beside])
    assert bench.settled(view).total.likely < 1.5 * LOOSE


@pytest.mark.slow
def test_walls_are_lit_by_what_glows(tmp_path: Path) -> None:
    """A room whose luminaire is out is lit by the ball alone, as paths say."""
    room = {"room": "cornell", "bounces": 0}
    bench = Workbench(orbital_of(**room, lights=[DARK]), tmp_path)
    dark = tuple(
        replace(wall, radiance=(0.0, 0.0, 0.0)) for wall in bench.scene.lighting.room.walls
    )
    lighting = replace(bench.scene.lighting, lamps=load_scene("demo:orbital").lighting.lamps)
    scene = replace(
        bench.scene, lighting=replace(lighting, room=replace(lighting.room, walls=dark))
    )
    bench = Workbench(scene, tmp_path / "dark")
    view = bench.view(90.0, 0.0, SIZE, distance=4.0)
    bench.bake(view)
    frame = bench.settled(view)
    traced = bench.renderer.render(replace(view, shading="path_traced", samples=256))
    assert relative_rmse(frame, traced) < 1.5 * LOOSE
    walls = frame.gbuffer.walls
    floor = frame.radiance.reshape(-1, 3)[walls.pixels[walls.numbers == 0]]
    assert (floor[:, 0] > 0.0).mean() > 0.5
    np.testing.assert_allclose(floor, floor[:, :1] * [1.0, 0.5, 0.125], rtol=1e-3)


@pytest.mark.slow
def test_colour_and_strength_change_no_chunk(tmp_path: Path) -> None:
    """Two glows of other colours are frames of the same chunks, and the light is theirs: it adds
    up.
    """
    low, high = load_scene("demo:orbital", lights=[CONSTANT]).volume.world_bounds
    one, other = (
        [0.25 * a + 0.75 * b for a, b in zip(*ends, strict=True)]
        for ends in ((low, high), (high, low))
    )
    radius = 0.1 * (high[0] - low[0])
    radiances = ([2.0, 1.0, 0.0], [0.0, 1.0, 3.0])
    frames = []
    benches = []
    for first, second in ((radiances[0], [0, 0, 0]), ([0, 0, 0], radiances[1]), radiances):
        glows = [
            {"sphere": [*one, radius], "radiance": first},
            {"sphere": [*other, radius], "radiance": second},
        ]
        scene = load_scene(
            "demo:orbital", glow=glows, lights=[DARK], albedo=[0.8, 0.5, 0.3], bounces=1
        )
        bench = Workbench(replace(scene, target_error=LOOSE), tmp_path)
        frames.append(
            bench.bake(bench.view(size=SIZE))
            if not frames
            else bench.renderer.render(bench.view(size=SIZE))
        )
        benches.append(bench)
    assert (
        len({bench.scene.bake_digest for bench in benches}) == 1
        and len({b.scene.digest for b in benches}) == 3
    )
    assert benches[0].scene.plan.layers[-1].channels == 6
    brighter = benches[0].renderer.render(benches[0].view(size=SIZE, glow=3.0))
    np.testing.assert_allclose(brighter.radiance, 3.0 * frames[0].radiance, rtol=1e-5, atol=1e-9)
    assert brighter.version != frames[0].version
    found = frames[0].radiance + frames[1].radiance
    np.testing.assert_allclose(frames[2].radiance, found, atol=1e-3 * found.max())
    assert frames[2].radiance[..., 0].any() and frames[2].radiance[..., 2].any()


@pytest.mark.parametrize("glows", [1, 2])
def test_points_of_reports_are_lit_by_what_glows(glows: int, tmp_path: Path) -> None:
    """By paths of the plan's layers, on a coloured surface, as the path tracer's pixels are."""
    (ball,) = orbital_of(lights=[DARK]).source.document["glow"]
    settings = {"albedo": [0.8, 0.5, 0.3], "bounces": 1, "lights": [DARK]}
    bench = Workbench(
        orbital_of(glow=[ball, {**ball, "radiance": [0.5, 1.0, 3.0]}][:glows], **settings), tmp_path
    )
    view = bench.view(60.0, 10.0, SIZE)
    gbuffer = bench.renderer.gbuffer(view)
    tiles = Tiles()
    place = bake_place(gbuffer.pixels, gbuffer.points, gbuffer.normals(tiles), gbuffer.isovalue)
    light = RotatedLight(bench.renderer.caches.spec("gi"), view)
    found = light_of_halves(light, place, 256).mean(axis=(0, 1))
    traced = bench.renderer.render(replace(view, shading="path_traced", samples=256))
    expected = traced.leaving.reshape(-1, 3)[gbuffer.pixels].mean(axis=0)
    np.testing.assert_allclose(found, expected, rtol=0.02)


@pytest.mark.slow
def test_other_light_keeps_its_chunks(tmp_path: Path) -> None:
    """The layers of a scene without glow are those of the same scene with it, byte for byte."""
    alone = Workbench(
        load_scene("demo:orbital", lights=[CONSTANT], target_error=LOOSE), tmp_path / "alone"
    )
    beside = Workbench(orbital_of(lights=[CONSTANT], projected=None), tmp_path / "beside")
    for bench in (alone, beside):
        bench.renderer.render(bench.view(size=16))
        bench.bake(bench.view(size=16), 1.0)
    (layer,) = alone.layers
    assert layer in beside.layers and len(beside.layers) == 2
    assert chunks_of(alone.folder, layer) == chunks_of(beside.folder, layer)


def test_edges_before_what_glows_are_smooth(tmp_path: Path) -> None:
    """No dark rim around the surface where it stands before a glow: samples beside it show that."""
    bench = Workbench(orbital_of(lights=[DARK], bounces=0), tmp_path)
    view = bench.view(51.0, 0.0, 4 * SIZE, smooth=True)
    frame = bench.renderer.render(view)
    assert frame.edges is not None and frame.glow is not None
    before = (frame.glow[frame.edges.pixels] > 0.0).any(axis=1)
    assert before.sum() > 50 and frame.edges.on[before].mean() > 0.9


def test_what_glows_hides_no_background(tmp_path: Path) -> None:
    """A picture on a light ground is nowhere darker than that where it shows what glows alone, at
    edges too.
    """
    bench = Workbench(orbital_of(lights=[DARK], bounces=0), tmp_path)
    frame = bench.renderer.render(bench.view(51.0, 0.0, 4 * SIZE, smooth=True))
    assert frame.airy is not None and frame.airy.sum() > 50 and frame.edges is not None
    rim = np.isin(np.flatnonzero(frame.airy), frame.edges.pixels)
    pictures = [
        develop(each, 1.0, background="light") for each in (frame, replace(frame, edges=None))
    ]
    smooth, stairs = (picture[frame.airy, 0] for picture in pictures)
    assert frame.state[0, 0] == 0, "a corner shows the ground"
    ground = int(pictures[1][0, 0, 0])
    assert rim.any() and not rim.all()
    assert (stairs >= ground - 1).all() and (stairs > ground).mean() > 0.5
    assert (smooth[~rim] >= ground - 1).all() and (smooth[rim] >= ground - 1).mean() > 0.5


@pytest.mark.parametrize("clear", [None, 0.5])
def test_transparent_glow_is_as_bright_over_black(clear: float | None, tmp_path: Path) -> None:
    """Beside one surface and beside several, at edges too: as opaque as its brightest channel."""
    surfaces = [] if clear is None else [{"isovalue": 0.012, "clear": clear}]
    scene = orbital_of(lights=[DARK], bounces=0, **({"surfaces": surfaces} if surfaces else {}))
    bench = Workbench(scene, tmp_path)
    frame = bench.renderer.render(bench.view(51.0, 0.0, 4 * SIZE, shading="lambert", smooth=True))
    assert frame.airy is not None and frame.airy.sum() > 50 and frame.edges is not None
    table = linear_table()
    # At edges, codes of 8 bits are rounded and cut off sample by sample.
    for each, rounded in ((frame, 0.05), (replace(frame, edges=None), 0.01)):
        picture = develop(each, 1.0, background="transparent")[frame.airy]
        black = table[develop(each, 1.0, background="#000000")[frame.airy]]
        colour, opacity = table[picture[:, :3]], picture[:, 3:] / 255.0
        np.testing.assert_allclose(colour * opacity, black, atol=rounded)
    # Of glow alone, without samples at edges, the opacity is no more than that takes.
    np.testing.assert_allclose(opacity[:, 0], black.max(axis=1), atol=0.005)
    assert 0.0 < opacity.min() < 1.0
