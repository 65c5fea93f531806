"""Frames of several surfaces: against paths among them, and against formulas."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.cache.scene_caches import Caches
from isogi_core.errors import NoRoomError
from isogi_core.frame.film import develop, linear_table
from isogi_core.frame.frame import Frame
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.several.composed_frame import parts_of
from isogi_core.frame.surface_point import point_at
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.model.view import read_window
from isogi_core.plan.variants import OUTER, Side
from tests.frame.conftest import CONSTANT, LOOSE, Workbench, relative_rmse
from tests.frame.several.drawing import bake, check, drawn
from tests.loaded import load_scene

SIZE = 32
SHOWN = 0.06
HALO = {"isovalue": 0.012, "clear": 0.6, "albedo": [0.4, 0.6, 0.9]}


@pytest.fixture(scope="module")
def halo(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital within a clear surface of its own, baked to a tenth."""
    light = {"lights": [{"type": "sky", "sun_azimuth": 30.0, "sun_elevation": 50.0}]}
    scene = load_scene(
        "demo:orbital", isovalue=SHOWN, surfaces=[HALO], bounces=3, target_error=LOOSE, **light
    )
    bench = Workbench(scene, tmp_path_factory.mktemp("halo"))
    bake(bench, bench.view(size=SIZE))
    check(bench, bench.view(size=SIZE))
    return bench


def test_a_picture_becomes_final_and_is_what_paths_say(halo: Workbench) -> None:
    view = halo.view(size=SIZE)
    frame = drawn(halo, view)
    assert {part.side for part in parts_of(frame)} >= {OUTER, Side(1), Side(1, True)}
    assert frame.final and not frame.provisional
    assert frame.measured is not None and frame.measured.high <= LOOSE
    traced = drawn(halo, replace(view, shading="path_traced", samples=512))
    assert relative_rmse(frame, traced) < LOOSE
    assert not traced.stages and not traced.checkable


def test_all_sides_are_measured_before_one_is_refined(halo: Workbench) -> None:
    """Far below the error of each side, which would all take other steps."""
    view = halo.view(size=SIZE)
    renderer = halo.again().renderer
    goal = Goal.checked(0.1 * LOOSE)
    count = len(parts_of(renderer.render(view, goal)))
    measured = []
    for _ in range(count):
        assert renderer.refine(view, goal)
        parts = parts_of(renderer.render(view, goal))
        measured.append(sum(not part.unmeasured for part in parts))
    assert count >= 3 and measured == list(range(1, count + 1))


def test_one_cache_of_what_slides_serves_all_isovalues(halo: Workbench) -> None:
    """Slid beyond its level, the picture asks for texels of its own layer, and of the pinned
    surface at another one.
    """
    before = drawn(halo, halo.view(size=SIZE))
    folders = {*halo.folder.iterdir()}
    slid = drawn(halo, halo.view(size=SIZE, isovalue=0.0601))
    kept, moved = (
        next(part for part in parts_of(each) if part.side == OUTER) for each in (before, slid)
    )
    assert kept.caches is moved.caches
    assert moved.frame.settled > 0.5 * moved.frame.surface
    others = [part for part in parts_of(slid) if part.side.number]
    assert others and not any(part.frame.settled for part in others)
    assert {*halo.folder.iterdir()} == folders  # nothing is made before there is light
    again = drawn(halo, halo.view(size=SIZE))
    assert again.version == before.version
    np.testing.assert_array_equal(again.radiance, before.radiance)


def test_evenly_lit_white_surfaces_are_as_bright_as_the_sky(tmp_path: Path) -> None:
    """The white furnace: whatever passes and whatever is reflected, each pixel shows what covers it
    of radiance 1.
    """
    white = {"albedo": 1.0, "bounces": 60, "lights": [CONSTANT], "projected": False}
    scene = load_scene(
        "demo:orbital", isovalue=SHOWN, surfaces=[{**HALO, "albedo": 1.0}], clear=0.3, **white
    )
    bench = Workbench(scene, tmp_path)
    frame = drawn(bench, bench.view(size=16, shading="path_traced", samples=64))
    assert frame.left is not None
    on = frame.state > 0
    np.testing.assert_allclose(
        frame.radiance[on], 1.0 - frame.left[on][:, None].repeat(3, axis=1), atol=0.02
    )


def test_what_lies_behind_shines_through(halo: Workbench) -> None:
    frame = drawn(halo, halo.view(size=SIZE))
    assert frame.left is not None
    thin = (frame.state > 0) & (frame.left > 0.3)
    black, white = (develop(frame, 0.5, background=ground) for ground in ("#000000", "#ffffff"))
    table = linear_table()
    through = np.minimum(table[black[thin]] + frame.left[thin][:, None], 1.0)
    assert thin.sum() > 20
    np.testing.assert_allclose(table[white[thin]], through, atol=0.01)
    opaque = (frame.state > 0) & (frame.left == 0.0)
    np.testing.assert_array_equal(white[opaque], black[opaque])
    cover = develop(frame, 0.5, background="transparent")[..., 3] / 255.0
    np.testing.assert_allclose(cover, np.where(frame.state > 0, 1.0 - frame.left, 0.0), atol=0.003)


def test_a_point_has_the_value_of_what_is_in_front(halo: Workbench) -> None:
    frame = drawn(halo, halo.view(size=SIZE))
    row, column = divmod(int(frame.gbuffer.pixels[len(frame.gbuffer.pixels) // 2]), SIZE)
    point = point_at(frame, column, row, halo.scene)
    assert point is not None and point.value == HALO["isovalue"]


@pytest.mark.long
@pytest.mark.slow
def test_between_two_levels_nothing_is_baked_anew(halo: Workbench) -> None:
    """Baked at one isovalue, the pinned surface has its light at another between the same levels;
    so paths say.
    """
    level, above = halo.scene.levels[halo.scene.levels.index(SHOWN) :][:2]
    first, other = (level + share * (above - level) for share in (0.25, 0.75))
    bake(halo, halo.view(size=SIZE // 2, isovalue=first))
    folders = {*halo.folder.iterdir()}
    view = halo.view(size=SIZE // 2, isovalue=other)
    slid = drawn(halo, view)
    pinned = [part for part in parts_of(slid) if part.side.number]
    assert pinned and all(part.frame.settled > 0.6 * part.frame.surface for part in pinned)
    frame = bake(halo, view)
    assert {*halo.folder.iterdir()} == folders
    assert not frame.provisional
    traced = drawn(halo, replace(view, shading="path_traced", samples=512))
    assert relative_rmse(frame, traced) < LOOSE


@pytest.mark.long
@pytest.mark.slow
def test_light_of_other_isovalues_makes_room(halo: Workbench, tmp_path: Path) -> None:
    """Views whose light fits the memory one by one are drawn as where all of it fits."""
    first = halo.scene.levels.index(SHOWN)
    views = [halo.view(size=SIZE, isovalue=each) for each in halo.scene.levels[first : first + 4]]
    # A store of its own has the light of these views alone, whichever tests ran before.
    own = Workbench(halo.scene, tmp_path)
    plenty = [bake(own, view, 1) for view in views]
    sides = [
        sum(part.caches.nbytes for part in parts_of(frame) if part.side.number) for frame in plenty
    ]
    caches = Caches(own.prepared, own.folder, sum(sides) - min(sides) // 8)
    small = Renderer(caches, Tiles())
    readers = list[Caches]()
    for view, whole in zip([*views, views[0]], [*plenty, plenty[0]], strict=True):
        frame = small.render(view)
        assert parts_of(frame)
        assert (
            sum(part.caches.nbytes for part in parts_of(frame) if part.side.number) <= caches.budget
        )
        np.testing.assert_array_equal(frame.radiance, whole.radiance)
        readers.append(next(part.caches for part in parts_of(frame) if part.side == Side(1)))
    assert readers[0] is not readers[-1], "the light of the first view was let go, and read anew"


def test_a_view_that_takes_more_than_the_budget_says_so(halo: Workbench) -> None:
    view = halo.view(size=SIZE)
    bake(halo, view, 1)
    with pytest.raises(NoRoomError, match="give light more memory"):
        Renderer(Caches(halo.prepared, halo.folder, 1), Tiles()).render(view)


def test_a_window_takes_shells_away_and_changes_no_light(halo: Workbench) -> None:
    """One looks into what lets rays pass, and what is opaque has a face; what is left has the light
    of the whole.
    """
    middle = halo.scene.volume.world_centre[0]
    whole = drawn(halo, halo.view(size=SIZE))
    view = halo.view(size=SIZE, window=read_window(f"x>{middle:g}"))
    frame = drawn(halo, view)
    left = {part.side for part in parts_of(frame)}
    assert Side(1, True) in left
    faces = frame.gbuffer.faces
    assert len(faces.pixels) > 5
    np.testing.assert_allclose(faces.points[:, 0] * halo.scene.volume.spacing[0], middle, atol=1e-3)
    assert (frame.state.flat[faces.pixels] == FINAL).all() and (
        frame.left.flat[faces.pixels] == 0.0
    ).all()
    grey = frame.radiance.reshape(-1, 3)[faces.pixels]
    assert (grey == grey[:, :1]).all()
    assert (frame.gbuffer.points[:, 0] * halo.scene.volume.spacing[0] <= middle + 1e-3).all()
    same = (frame.gbuffer.position == whole.gbuffer.position).all(axis=-1) & (frame.state > 0)
    assert same.sum() > 10
    np.testing.assert_allclose(frame.radiance[same], whole.radiance[same], rtol=0.2)


def test_edges_are_smoothed_layer_by_layer(halo: Workbench) -> None:
    """Samples show what pixels of a larger picture show there, and let through what those let
    through.
    """
    view = halo.view(size=SIZE, shading="lambert")
    frame = drawn(halo, replace(view, smooth=True))
    fine = drawn(halo, replace(view, width=8 * SIZE, height=8 * SIZE))
    assert frame.edges is not None and frame.edges.left is not None and fine.left is not None
    blocks = [
        each.reshape(SIZE, 8, SIZE, 8, -1).mean(axis=(1, 3)) for each in (fine.radiance, fine.left)
    ]
    light, left = (each.reshape(SIZE * SIZE, -1)[frame.edges.pixels] for each in blocks)
    mine = np.where(frame.edges.on, frame.edges.left, 1.0).mean(axis=1)
    if frame.left is not None:
        coarse = frame.left.flat[frame.edges.pixels]
    else:
        coarse = mine
    assert np.abs(mine - left[:, 0]).mean() < 0.4 * np.abs(coarse - left[:, 0]).mean()
    errors = (
        np.abs(each - light).mean() for each in (frame.edges.light.mean(axis=1), stairs(frame))
    )
    assert next(errors) < 0.75 * next(errors)
    cover = develop(frame, 1.0, background="transparent").reshape(-1, 4)[frame.edges.pixels, 3]
    np.testing.assert_allclose(cover / 255.0, 1.0 - mine, atol=0.003)


def stairs(frame: Frame) -> np.ndarray:
    """The light of the pixels at edges without samples."""
    if frame.edges:
        return np.asarray(frame.radiance.reshape(-1, 3)[frame.edges.pixels])
    return np.zeros(3)


def test_local_shadings_show_all_surfaces(halo: Workbench) -> None:
    for shading in ("lambert", "phong_shadow", "lambert_fog"):
        frame = drawn(halo, halo.view(size=SIZE, shading=shading))
        assert frame.surface == len(frame.gbuffer.pixels) and not frame.provisional
