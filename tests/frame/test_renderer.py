"""Frames: served at once, provisional until their light is baked, and then one picture for one
store.
"""

import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import WeakSet

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.errors import Cancelled
from isogi_core.frame import gbuffer as gbuffer_module
from isogi_core.frame import surface_renderer, texel_shading
from isogi_core.frame.demand import first_texels
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import GBuffer
from isogi_core.frame.rays.control_pixels import TotalError
from isogi_core.frame.renderer import Renderer, unlit_frame
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import CONVERGING, FINAL, PROVISIONAL
from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.model.view import IDENTITY, View, quaternion_from_angles
from isogi_core.model.volume import make_volume
from tests.frame.conftest import (
    LOOSE,
    SKY,
    Workbench,
    ball,
    luminance,
    refine_chunk,
    relative_rmse,
    scene_of,
    soft_probe,
)
from tests.loaded import load_scene

Make = Callable[..., Workbench]
TURN = quaternion_from_angles(70.0, 20.0, -10.0)


# --- provisional, final
# -----------------------------------------------------------------------------------------


def test_before_the_bake_a_frame_is_provisional_and_never_black(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2))
    frame = bench.renderer.render(bench.view())
    on = frame.state > 0
    assert on.sum() > 300 and (frame.state[on] == PROVISIONAL).all()
    assert (frame.radiance[on] > 0.0).all() and not frame.radiance[~on].any()
    assert frame.provisional and frame.coverage == {
        "final": 0.0,
        "converging": 0.0,
        "provisional": 1.0,
    }
    assert (frame.error[on] == 1.0).all() and frame.noise == 1.0
    assert frame.chunks_final == 0 < frame.chunks_needed == len(frame.demands)
    assert bench.layers == set(), "a frame bakes nothing"


def test_after_the_bake_a_frame_is_final(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view(), Goal(orbital.scene.target_error))
    on = frame.state > 0
    assert (frame.state[on] == FINAL).all() and not frame.provisional
    assert frame.coverage["final"] == 1.0 and frame.demands == ()
    assert frame.chunks_final == frame.chunks_needed > 0
    assert 0.0 < frame.noise < LOOSE
    assert np.isfinite(frame.radiance).all() and (frame.radiance[on] > 0.0).mean() > 0.98


def test_half_baked_light_is_converging(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2))
    view = bench.view(size=32)
    bench.bake(view, target=1.0)
    frame = bench.renderer.render(view, Goal(0.001))
    states = set(np.unique(frame.state))
    assert CONVERGING in states and PROVISIONAL not in states
    assert frame.coverage["converging"] > 0.9 and len(frame.demands) > 0
    assert bench.renderer.render(view, Goal(1.0)).coverage["final"] == 1.0


@pytest.mark.slow
def test_a_quarter_of_the_texels_lights_all_of_a_picture(workbench: Make) -> None:
    """Those that have light first give theirs to their neighbours, at an error that is told."""
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2))
    view = bench.view(size=48)
    demands = bench.renderer.render(view).demands
    first = [
        replace(each, offsets=each.offsets[first_texels(each.offsets, each.bits)])
        for each in demands
    ]
    assert (
        0.2
        < sum(len(each.offsets) for each in first) / sum(len(each.offsets) for each in demands)
        < 0.3
    )
    for each in first:
        refine_chunk(bench.caches.of("gi"), 256, 0.01, each)
    frame = bench.renderer.render(view, Goal.checked(0.001))
    truth = bench.bake(view, 0.01)
    assert frame.coverage["provisional"] < 0.02
    wrong = relative_rmse(frame, truth)
    assert wrong < 0.08 and 0.5 < frame.noise / wrong < 3.0


def test_the_estimated_error_is_the_rms_of_pixels_over_the_mean(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view())
    wrong = luminance(frame) * frame.error[frame.state > 0]
    assert frame.noise == pytest.approx(
        np.sqrt((wrong**2).mean()) / luminance(frame).mean(), rel=1e-5
    )
    assert 0.0 < frame.noise < 0.5
    assert frame.surface == (frame.state > 0).sum() == sum(frame.counts.values())


def test_baking_one_view_leaves_the_others_rest_provisional(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view(azimuth=110.0))
    assert 0.0 < frame.coverage["provisional"] < 1.0
    assert 0 < len(frame.demands) <= frame.chunks_needed


def test_demands_name_the_texels_that_pixels_read(workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, bounces=0))
    view = bench.view(size=48)
    frame = bench.renderer.render(view)
    lattice = bench.renderer.prepared.lattice
    places = np.concatenate([lattice.positions(d.index, d.offsets) for d in frame.demands])
    assert len(np.unique(places, axis=0)) == len(places)
    points = bench.renderer.gbuffer(view).points
    corners = np.floor(points).astype(int)[:, ::-1][:, None] + np.array(list(np.ndindex(2, 2, 2)))
    assert set(map(tuple, places)) == set(map(tuple, corners.reshape(-1, 3)))
    assert all(demand.weight > 0.0 for demand in frame.demands)


@pytest.mark.slow
@pytest.mark.usefixtures("unfiltered")
def test_light_of_one_layer_is_shown_and_provisional(workbench: Make) -> None:
    """The indirect layer is lost: the frame is that of direct light alone, and wants the rest."""
    settings = {"lights": [SKY], "target_error": LOOSE}
    bench = workbench(load_scene("demo:orbital", bounces=2, **settings))
    view = bench.view(size=32)
    whole = bench.bake(view)
    direct, indirect = bench.caches.of("gi").chunk_store.layers
    shutil.rmtree(Path(indirect.path, "c"))
    frame = bench.again().renderer.render(view)
    on = frame.state > 0
    assert (frame.state[on] == PROVISIONAL).all() and (frame.error[on] == 1.0).all()
    assert len(frame.demands) == frame.chunks_needed and frame.version != whole.version
    alone = Workbench(load_scene("demo:orbital", bounces=0, **settings), bench.folder)
    assert [layer.path for layer in alone.caches.of("gi").chunk_store.layers] == [direct.path]
    direct_light = alone.renderer.render(view).radiance
    assert (frame.radiance <= direct_light).all(), (
        "where no path left, more of them may: not buried yet"
    )
    assert (frame.radiance[on] == direct_light[on]).mean() > 0.9
    assert luminance(frame).sum() < 0.99 * luminance(whole).sum()
    again = bench.again()
    assert not again.bake(view).provisional and again.layers == bench.layers


def test_a_picture_without_surface_is_final_and_empty(workbench: Make) -> None:
    bench = workbench(scene_of(make_volume(np.zeros((9, 9, 9))), 0.0))
    for shading in VIEW_SHADINGS:
        frame = bench.renderer.render(bench.view(size=8, shading=shading))
        assert not frame.state.any() and not frame.radiance.any()
        assert not frame.provisional and frame.noise == 0.0 and frame.coverage["final"] == 1.0
        assert frame.total == TotalError(0.0, 0.0, 0.0), "an error of nothing"


def test_an_isovalue_beyond_all_values_has_no_error(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2))
    seen = bench.view(size=16)
    gone = replace(seen, isovalue=float(bench.scene.volume.value_range[1]))
    assert bench.renderer.render(seen).total.likely > 0.0
    frame = bench.renderer.render(gone)
    assert frame.final and frame.total == TotalError(0.0, 0.0, 0.0)


def test_one_pixel_is_a_picture(orbital: Workbench) -> None:
    frame = orbital.renderer.render(replace(orbital.view(), width=1, height=1))
    assert frame.radiance.shape == (1, 1, 3) and np.isfinite(frame.radiance).all()


# --- turning the light
# ------------------------------------------------------------------------------------------


def test_rotating_the_light_casts_no_primary_ray(
    orbital: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    casts: list[int] = []
    trace_pixels = gbuffer_module.trace_pixels

    def counting(*arguments: Any) -> Any:
        casts.append(1)
        return trace_pixels(*arguments)

    monkeypatch.setattr(gbuffer_module, "trace_pixels", counting)
    bench = orbital.again()
    view = bench.view()
    first = bench.renderer.render(view)
    assert casts
    casts.clear()
    for shading in ("gi", "vicinity", "phong_shadow"):
        turned = replace(view, light=TURN, shading=shading)
        frame = bench.renderer.render(turned)
        assert bench.renderer.gbuffer(turned) is bench.renderer.gbuffer(view)
        assert np.array_equal(frame.position, first.position)
    assert casts == []
    assert not np.array_equal(
        bench.renderer.render(replace(view, light=TURN)).radiance, first.radiance
    )
    bench.renderer.render(bench.view(azimuth=41.0))
    assert casts, "another camera does"


def test_rotating_the_light_needs_no_more_baking(orbital: Workbench) -> None:
    frame = orbital.renderer.render(replace(orbital.view(), light=TURN))
    assert not frame.provisional


@pytest.mark.parametrize("shading", ["phong", "phong_shadow", "lambert"])
def test_camera_and_light_turned_together_see_the_same(shading: str, workbench: Make) -> None:
    """A ball is alike from all four sides: a quarter turn of camera and light is no turn at all."""
    bench = workbench(scene_of(ball(), 0.0, lights=[SKY]))
    plain = bench.renderer.render(bench.view(azimuth=15.0, size=40, shading=shading))
    quarter = bench.view(
        azimuth=105.0, size=40, shading=shading, light=quaternion_from_angles(90.0, 0.0, 0.0)
    )
    np.testing.assert_allclose(bench.renderer.render(quarter).radiance, plain.radiance, atol=1e-4)


def test_path_tracer_and_cache_rotate_the_light_alike(workbench: Make, tmp_path: Path) -> None:
    bench = workbench(
        scene_of(ball(), 0.0, lights=[soft_probe(tmp_path)], target_error=0.02, bounces=1)
    )
    view = bench.view(size=40, light=TURN)
    frame = bench.bake(view)
    reference = bench.renderer.render(replace(view, shading="path_traced", samples=256))
    flipped = bench.renderer.render(replace(view, light=quaternion_from_angles(-70.0, 20.0, -10.0)))
    assert relative_rmse(frame, reference) < 0.02
    assert relative_rmse(flipped, reference) > 0.1


def test_the_pool_is_read_once_for_a_view_until_it_changes(
    workbench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = workbench(scene_of(ball(), 0.0, bounces=0, target_error=0.5))
    view = bench.view(size=24)
    bench.bake(view)
    read = texel_shading.read_texels
    readings: list[Any] = []

    def counting(*arguments: Any) -> Any:
        readings.append(read(*arguments))
        return readings[-1]

    monkeypatch.setattr(texel_shading, "read_texels", counting)
    versions = {
        bench.renderer.render(replace(view, light=turn)).version
        for turn in (IDENTITY, TURN, IDENTITY)
    }
    assert len(versions) == 2 and not readings, "the last frame of the bake read it"
    bench.renderer.render(view, Goal.checked(0.001))
    assert len(readings) == 1, "another target is another reading"
    bench.bake(view, 0.002)
    assert len(readings) > 1 and len({reading.version for reading in readings}) > 1


def test_a_forgotten_view_takes_its_texels_along(workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, bounces=0))
    most = 1 << 20
    renderer = Renderer(bench.caches, Tiles(), most)
    surfaces = WeakSet[GBuffer]()
    for azimuth in range(40):
        surfaces.add(
            renderer.render(bench.view(azimuth, shading="gi" if azimuth % 2 else "lambert")).gbuffer
        )
        assert sum(surface.nbytes for surface in surfaces) < most
    assert 4 < len(surfaces) < 40


def test_pictures_do_not_depend_on_the_number_of_threads(orbital: Workbench) -> None:
    other = Renderer(orbital.caches, Tiles(5))
    for shading in ("gi", "vicinity", "phong_shadow", "path_traced"):
        view = orbital.view(shading=shading, samples=4)
        frames = [renderer.render(view) for renderer in (orbital.renderer, other)]
        assert frames[0].version == frames[1].version
        for plane in ("radiance", "state", "error", "position"):
            assert np.array_equal(getattr(frames[0], plane), getattr(frames[1], plane))


# --- one store, one picture
# ---------------------------------------------------------------------------------------


def test_a_restart_on_the_same_store_gives_the_same_frame(orbital: Workbench) -> None:
    one, other = (bench.renderer.render(orbital.view()) for bench in (orbital, orbital.again()))
    assert one.version == other.version
    for plane in ("radiance", "state", "error", "position"):
        assert np.array_equal(getattr(one, plane), getattr(other, plane))


def test_versions_tell_frames_apart(orbital: Workbench) -> None:
    view = orbital.view()
    views = [
        view,
        replace(view, light=TURN),
        replace(view, shading="vicinity"),
        replace(view, width=65),
    ]
    views += [replace(view, isovalue=0.05), orbital.view(azimuth=41.0)]
    assert len({orbital.renderer.render(v).version for v in views}) == len(views)


def test_versions_change_when_light_is_refined(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=0, lobes=0))
    view = bench.view(size=24)
    before = bench.renderer.render(view).version
    after = bench.bake(view, target=1.0).version
    assert len({before, after, bench.bake(view, target=0.1).version}) == 3


@pytest.mark.slow
def test_two_stores_baked_apart_hold_the_same_light(tmp_path: Path) -> None:
    scene = load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=0.3)
    frames = [
        (bench := Workbench(scene, tmp_path / name)).bake(bench.view(size=24))
        for name in ("a", "b")
    ]
    assert frames[0].version == frames[1].version
    assert np.array_equal(frames[0].radiance, frames[1].radiance)


def test_a_cancelled_frame_stops(orbital: Workbench) -> None:
    cancelled = threading.Event()
    cancelled.set()
    for shading in VIEW_SHADINGS:
        with pytest.raises(Cancelled):
            orbital.again().renderer.render(orbital.view(shading=shading), cancelled=cancelled)
    assert (
        orbital.renderer.render(orbital.view(), Goal(orbital.scene.target_error)).coverage["final"]
        == 1.0
    )


@pytest.mark.slow
def test_errors_do_not_depend_on_how_bright_the_light_is(tmp_path: Path) -> None:
    """Squares of these lights are nothing, or more, in single floats."""
    frames = []
    for scale in (2.0**-99, 1.0, 2.0**99):
        lights = [{**SKY, "scale": scale}]
        bench = Workbench(
            load_scene("demo:orbital", lights=lights, bounces=1), tmp_path / f"{scale:g}"
        )
        frames.append(bench.bake(bench.view(size=24), LOOSE))
    for frame in frames:
        assert np.isfinite(frame.radiance).all() and frame.radiance.any()
        np.testing.assert_allclose(frame.error, frames[1].error, rtol=1e-4)
        assert 0.0 < frame.noise == pytest.approx(frames[1].noise, rel=1e-4)


# --- points
# --------------------------------------------------------------------------------------------------


def test_points_of_a_picture_have_its_light(orbital: Workbench) -> None:
    view = orbital.view()
    renderer = Renderer(orbital.renderer.caches, orbital.renderer.tiles)
    frame = renderer.render(
        view
    )  # by a renderer of its own, in which no pixel has paths of its own
    shown = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels]
    for moving in (False, True):
        lit, normals = renderer.surface.light_points(
            replace(view, moving=moving), frame.gbuffer.points
        )
        assert (lit.radiance[0] != shown).any(
            axis=1
        ).mean() < 0.01  # half-shadows are of random rays
    np.testing.assert_array_equal(normals, frame.gbuffer.normals(orbital.renderer.tiles))


# --- views without light
# ----------------------------------------------------------------------------------------------


ORBITAL = {"lights": [SKY], "bounces": 1, "target_error": 0.5}


def unlit(bench: Workbench, view: View) -> Frame | None:
    """The frame of a view that is new, and has no light."""
    return unlit_frame(
        bench.renderer, view, Goal.checked(bench.scene.target_error), threading.Event()
    )


def test_it_demands_what_the_first_picture_does(
    workbench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And that picture traces no ray and finds no texel again."""
    bench = workbench(load_scene("demo:orbital", **ORBITAL))
    view = bench.view()
    frame = unlit(bench, view)
    assert frame is not None and not frame.checkable
    for module, name in ((surface_renderer, "trace"), (texel_shading, "find_texels")):
        monkeypatch.setattr(module, name, lambda *_: pytest.fail("it is done twice"))
    first = bench.renderer.render(view)
    assert (
        np.array_equal(frame.state, first.state)
        and (first.state[first.state > 0] == PROVISIONAL).all()
    )
    pairs = list(zip(frame.demands, first.demands, strict=True))
    assert len(pairs) > 3 and all(
        ours.index == theirs.index and ours.weight > 0.0 for ours, theirs in pairs
    )
    assert all(np.array_equal(ours.offsets, theirs.offsets) for ours, theirs in pairs)
    assert all(ours.effort == theirs.effort for ours, theirs in pairs)


def test_there_is_none_of_a_view_that_is_known_or_lit(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", **ORBITAL))
    view = bench.view()
    assert unlit(bench, view) is not None
    assert unlit(bench, view) is None, "it is known"
    refine_chunk(bench.caches.of("gi"), 16, 0.5, bench.renderer.render(view).demands[0])
    assert unlit(bench, replace(view, width=40)) is None, "some of it has light"
    assert unlit(bench.again(), view) is None, "also after a restart"


@pytest.mark.parametrize(
    "other", [{"moving": True}, {"shading": "lambert"}, {"shading": "vicinity"}]
)
def test_views_without_light_of_their_own_are_passed_over(
    workbench: Make, other: dict[str, object]
) -> None:
    bench = workbench(load_scene("demo:orbital", **ORBITAL))
    found = unlit(bench, bench.view(**other))
    assert (found is not None) == (other == {"shading": "vicinity"})


def test_it_ends_once_nobody_waits(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", **ORBITAL))
    cancelled = threading.Event()
    cancelled.set()
    with pytest.raises(Cancelled):
        unlit_frame(bench.renderer, bench.view(), Goal.checked(0.5), cancelled)


@pytest.mark.parametrize("settings", [{}, {"isovalue": 0.02}])
def test_the_first_picture_is_the_same_about_any_normals(
    workbench: Make, settings: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is lit about those of surface points, as texels' own would take as long as all else."""
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2))
    view = bench.view(**settings)
    monkeypatch.setattr(
        texel_shading, "find_texel_normals", lambda *_: pytest.fail("it takes long")
    )
    near = bench.renderer.render(view)
    monkeypatch.undo()
    monkeypatch.setattr("isogi_core.frame.texel_reading.Reading.unbaked", False)
    own = bench.again().renderer.render(view)
    np.testing.assert_allclose(near.radiance, own.radiance, rtol=1e-5, atol=1e-7)
    assert near.version == own.version and (near.radiance[near.state > 0] > 0.0).all()


def test_a_picture_is_drawn_again_when_its_light_changed(workbench: Make) -> None:
    """Clients that wait for light ask for the same picture many times a second."""
    bench = workbench(load_scene("demo:casting", lights=[SKY], target_error=LOOSE))
    view = bench.view(size=32)
    dark = bench.renderer.render(view)
    assert bench.renderer.render(view) is dark
    lit = bench.bake(view)
    assert lit is not dark and bench.renderer.render(view) is lit
    # A step of the check may change the picture, or what is known of its error.
    assert bench.renderer.refine(view)
    checked = bench.renderer.render(view)
    assert checked is not lit and checked.measured is not None
    # Other views, and other goals, have pictures of their own.
    assert bench.renderer.render(replace(view, width=33)) is not checked
    assert bench.renderer.render(view, Goal.checked(LOOSE / 2.0)) is not checked
    assert bench.renderer.render(view) is checked


@pytest.mark.parametrize(
    "settings",
    [{"room": "cornell"}, {"shine": {"kind": "plastic"}, "lights": [SKY]}],
)
def test_a_picture_with_walls_or_shine_is_drawn_each_time(
    settings: dict[str, Any], workbench: Make
) -> None:
    """Walls and shine get light of their own, which no page pool counts."""
    bench = workbench(load_scene("demo:casting", target_error=LOOSE, **settings))
    view = bench.view(size=32)
    assert bench.renderer.render(view) is not bench.renderer.render(view)
