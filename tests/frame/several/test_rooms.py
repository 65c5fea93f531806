"""Several surfaces and sheets in a room: walls light them, are lit through them, and are seen
through them.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.entry_kernels import frame_kernels
from isogi_core.frame.features import SEVERAL_SURFACES
from isogi_core.frame.frame import Frame
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.kernels.shading.framebuffer import FINAL, PROVISIONAL
from isogi_core.kernels.shading.wall_light import light_walls
from isogi_core.kernels.transport.room_paths import light_in_room
from isogi_core.kernels.transport.surface_paths import light_among_surfaces
from isogi_core.model.view import View
from isogi_core.plan.variants import OUTER, WALLS_SIDE, Side
from tests.frame.conftest import LOOSE, Workbench, ball, relative_rmse, scene_of
from tests.frame.several.drawing import bake, check, drawn
from tests.loaded import load_scene

SIZE = 24
ROOMS: dict[str, dict[str, Any]] = {
    "clear": {"albedo": 0.5, "clear": 0.6},
    "sheet": {"albedo": [0.2, 0.1, 0.1], "transmission": [0.7, 0.3, 0.1]},
    "dark": {"albedo": 0.0, "clear": 0.3},
    "pinned": {"clear": 0.7, "surfaces": [{"isovalue": 0.12, "albedo": [0.8, 0.3, 0.2]}]},
}


def bench_of(kind: str, folder: Path) -> Workbench:
    """The orbital as it is in a kind of ROOMS, of the Cornell kind."""
    own = {
        "isovalue": 0.06,
        "room": "cornell",
        "bounces": 2,
        "target_error": LOOSE,
        "projected": False,
    }
    return Workbench(load_scene("demo:orbital", **own, **ROOMS[kind]), folder)


def view_of(bench: Workbench, **changes: Any) -> View:
    """The view from the open side of the room."""
    return bench.view(90.0, 0.0, SIZE, distance=4.0, **changes)


def lit(bench: Workbench, view: View) -> Frame:
    """The frame of a view with all of its light, walls' too."""
    bake(bench, view)
    return check(bench, view)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["clear", "sheet", "pinned"])
def test_it_becomes_final_and_is_what_paths_say(kind: str, tmp_path: Path) -> None:
    bench = bench_of(kind, tmp_path)
    view = view_of(bench)
    first = drawn(bench, view)
    (walls,) = (part for part in parts_of(first) if part.side == WALLS_SIDE)
    assert first.quality.waiting == len(walls.layers.gbuffer.pixels)
    assert not first.checkable, "texels come before walls"
    frame = lit(bench, view)
    assert frame.quality.waiting == 0
    assert (frame.state[first.state > 0] == FINAL).all()
    assert frame.final or frame.given_up
    traced = drawn(bench, replace(view, shading="path_traced", samples=256))
    assert relative_rmse(frame, traced) < 1.5 * LOOSE
    on = frame.state > 0
    np.testing.assert_allclose(
        frame.radiance[on].mean(axis=0), traced.radiance[on].mean(axis=0), rtol=0.05
    )
    again = Workbench(bench.scene, tmp_path)
    assert drawn(again, view).quality.waiting == 0, "the store keeps the light of walls"


def test_walls_are_seen_through_clear_surfaces_by_their_share(tmp_path: Path) -> None:
    """Of all surfaces and walls the shares in a pixel make a whole, where the room has a wall
    behind.
    """
    bench = bench_of("clear", tmp_path)
    frame = drawn(bench, view_of(bench))
    assert {part.side for part in parts_of(frame)} == {OUTER, Side(0, True), WALLS_SIDE}
    total = np.zeros(SIZE * SIZE)
    (walls,) = [part for part in parts_of(frame) if part.side == WALLS_SIDE]
    for part in parts_of(frame):
        for rows, pixels in part.layers.each:
            total[pixels] += part.layers.weights[rows]
    np.testing.assert_allclose(total[walls.layers.gbuffer.pixels], 1.0, atol=1.0 / 512.0)
    assert frame.left is not None and (frame.left.ravel()[walls.layers.gbuffer.pixels] == 0.0).all()
    behind = np.isin(walls.layers.gbuffer.pixels, frame.gbuffer.pixels)
    assert behind.any() and not behind.all()
    assert (walls.layers.weights[~behind] == 1.0).all()
    assert (walls.layers.weights[behind] < 0.61).all()


def test_a_black_sheet_tints_its_shadow(tmp_path: Path) -> None:
    """What gets through is of the colours that it transmits: the floor below has more of these."""
    shadows = []
    for through in ([0.8, 0.0, 0.0], [0.0, 0.8, 0.0]):
        sheet = {
            "albedo": 0.0,
            "transmission": through,
            "room": "cornell",
            "bounces": 2,
            "target_error": LOOSE,
        }
        bench = Workbench(scene_of(ball(24, 11.0), 0.0, **sheet), tmp_path / f"{through}")
        frame = bench.renderer.render(view_of(bench, shading="path_traced", samples=256))
        floor = frame.radiance.reshape(-1, 3)[
            frame.gbuffer.walls.pixels[frame.gbuffer.walls.numbers == 0]
        ]
        shadows.append(np.sort(floor, axis=0)[: len(floor) // 8].mean(axis=0))
    (red, *_), (_, green, _) = np.array(shadows[0]) / shadows[1], np.array(shadows[1]) / shadows[0]
    assert red > 1.05
    assert green > 1.05


def test_edges_are_smooth_and_their_samples_show_walls(tmp_path: Path) -> None:
    bench = bench_of("dark", tmp_path)
    frame = bench.renderer.render(bench.view(90.0, 0.0, 3 * SIZE, distance=2.5, smooth=True))
    assert frame.edges is not None and frame.left is not None
    behind = np.isin(frame.edges.pixels, frame.gbuffer.pixels)
    assert behind.any()
    assert frame.edges.left is not None and (frame.edges.left[behind] == 0.0).all()
    assert frame.edges.on[behind].all()


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("room", [{}, {"room": "cornell"}], ids=["open", "room"])
def test_glow_behind_clear_surfaces_is_what_paths_say(room: dict[str, Any], tmp_path: Path) -> None:
    """A lesion in a shell: it lights the shell from inside, and walls through it, and is seen
    through it.
    """
    shell = {"clear": 0.5, "albedo": [0.6, 0.5, 0.4], "bounces": 2, "target_error": LOOSE, **room}
    lesion = [{"sphere": [11.5, 11.5, 11.5, 4.0], "radiance": [9.0, 3.0, 1.0]}]
    if room:
        dark = {}
    else:
        dark = {"lights": [{"type": "constant", "radiance": 0.05}]}
    bench = Workbench(scene_of(ball(24, 9.0), 0.0, glow=lesion, **shell, **dark), tmp_path)
    view = view_of(bench)
    frame = lit(bench, view)
    traced = drawn(bench, replace(view, shading="path_traced", samples=256))
    assert relative_rmse(frame, traced) < 1.5 * LOOSE
    assert frame.glow is not None and traced.glow is not None
    np.testing.assert_array_equal(frame.glow, traced.glow)
    alone = scene_of(ball(24, 9.0), 0.0, glow=lesion, **(shell | {"clear": 1.0}), **dark)
    bare = Workbench(alone, tmp_path / "bare").renderer.render(view)
    middle = SIZE * (SIZE // 2) + SIZE // 2
    assert bare.glow is not None and bare.glow[middle].any()
    np.testing.assert_allclose(frame.glow[middle], 0.5 * bare.glow[middle], rtol=1e-4)
    brighter = drawn(bench, replace(view, glow=2.0))
    np.testing.assert_allclose(brighter.glow, 2.0 * frame.glow, rtol=1e-6)


@pytest.mark.parametrize("shading", ["lambert", "phong_shadow", "vicinity"])
def test_local_shadings_show_walls_too(shading: str, tmp_path: Path) -> None:
    bench = bench_of("clear", tmp_path)
    frame = drawn(bench, view_of(bench, shading=shading))
    (walls,) = (part for part in parts_of(frame) if part.side == WALLS_SIDE)
    assert (walls.seen(walls.frame.radiance).sum(axis=1) > 0.0).any()
    assert (walls.seen(walls.frame.state) > PROVISIONAL).all()


def test_its_kernels_are_those_of_surfaces_and_walls() -> None:
    own = {"room": "cornell", **ROOMS["clear"]}
    called = {*frame_kernels([load_scene("demo:orbital", **own)])}
    assert {*SEVERAL_SURFACES.kernels, light_walls, light_among_surfaces} <= called
    assert light_in_room not in called
