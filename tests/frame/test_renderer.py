"""Frames: served at once, provisional until their light is baked, and then as good as the path tracer."""

import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.cache.chunk import Chunk
from isogi_core.errors import Cancelled
from isogi_core.frame import gbuffer as gbuffer_module
from isogi_core.frame import renderer as renderer_module
from isogi_core.frame.frame import Frame
from isogi_core.frame.reading import read_texels
from isogi_core.frame.renderer import Renderer
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.lattice import BURIED
from isogi_core.kernels.planes import CONVERGING, FINAL, PROVISIONAL
from isogi_core.model.scene import load_scene
from isogi_core.model.sky import LUMINANCE
from isogi_core.model.view import IDENTITY, SHADINGS, Camera, View, quaternion_from_angles
from isogi_core.model.volume import Volume, make_volume
from tests.frame.conftest import CONSTANT, SKY, Workbench, ball, scene_of, soft_probe

Make = Callable[..., Workbench]
TURN = quaternion_from_angles(70.0, 20.0, -10.0)
LOOSE = 0.1
CALM = {"lights": [CONSTANT], "albedo": 0.7, "bounces": 4, "target_error": 0.02}


def luminance(frame: Frame) -> np.ndarray:
    """Luminance of the surface pixels, float64."""
    return frame.radiance[frame.state > 0].astype(np.float64) @ LUMINANCE


def relative_rmse(frame: Frame, reference: Frame) -> float:
    """RMSE of the luminance over the surface pixels, over the reference's mean."""
    assert np.array_equal(frame.state > 0, reference.state > 0)
    wrong = luminance(frame) - luminance(reference)
    return float(np.sqrt((wrong**2).mean()) / luminance(reference).mean())


@pytest.fixture(scope="module")
def orbital(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital under a sky; `view()` is baked to a tenth."""
    bench = Workbench(
        load_scene("demo:orbital", lights=[SKY], albedo=[0.8, 0.6, 0.4], bounces=2, target_error=LOOSE),
        tmp_path_factory.mktemp("orbital"),
    )
    bench.bake(bench.view())
    return bench


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """The orbital under constant light, white as snow, its direct and indirect light apart; `view()` is baked."""
    kept = {"representation": "transfer", "order": 1}
    bench = Workbench(
        load_scene("demo:orbital", lights=[CONSTANT], albedo=0.9, bounces=3, target_error=LOOSE, **kept),
        tmp_path_factory.mktemp("calm"),
    )
    bench.bake(bench.view())
    return bench


# --- provisional, final -----------------------------------------------------------------------------------------


def test_before_the_bake_a_frame_is_provisional_and_never_black(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2))
    frame = bench.renderer.render(bench.view())
    on = frame.state > 0
    assert on.sum() > 300 and (frame.state[on] == PROVISIONAL).all()
    assert (frame.radiance[on] > 0.0).all() and not frame.radiance[~on].any()
    assert frame.provisional and frame.coverage == {"final": 0.0, "converging": 0.0, "provisional": 1.0}
    assert (frame.error[on] == 1.0).all() and frame.estimated_error == 1.0
    assert frame.chunks_final == 0 < frame.chunks_needed == len(frame.demands)
    assert bench.layers == set(), "a frame bakes nothing"


def test_after_the_bake_a_frame_is_final(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view())
    on = frame.state > 0
    assert (frame.state[on] == FINAL).all() and not frame.provisional
    assert frame.coverage["final"] == 1.0 and frame.demands == ()
    assert frame.chunks_final == frame.chunks_needed > 0
    assert 0.0 < frame.estimated_error < LOOSE
    assert np.isfinite(frame.radiance).all() and (frame.radiance[on] > 0.0).mean() > 0.98


def test_half_baked_light_is_converging(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=2))
    view = bench.view(size=32)
    bench.bake(view, target=1.0)
    frame = bench.renderer.render(view, target=0.001)
    states = set(np.unique(frame.state))
    assert CONVERGING in states and PROVISIONAL not in states
    assert frame.coverage["converging"] > 0.9 and len(frame.demands) > 0
    assert bench.renderer.render(view, target=1.0).coverage["final"] == 1.0


def test_the_estimated_error_is_the_rms_of_the_pixels_errors_over_the_mean(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view())
    wrong = luminance(frame) * frame.error[frame.state > 0]
    assert frame.estimated_error == pytest.approx(np.sqrt((wrong**2).mean()) / luminance(frame).mean(), rel=1e-5)
    assert 0.0 < frame.estimated_error < 0.5
    assert frame.surface == (frame.state > 0).sum() == sum(frame.counts.values())


def test_baking_one_view_leaves_the_others_rest_provisional(orbital: Workbench) -> None:
    frame = orbital.renderer.render(orbital.view(azimuth=110.0))
    assert 0.0 < frame.coverage["provisional"] < 1.0
    assert 0 < len(frame.demands) <= frame.chunks_needed


def test_demands_name_the_texels_that_pixels_read_most_seen_first_known(workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, bounces=0))
    view = bench.view(size=48)
    frame = bench.renderer.render(view)
    places = np.concatenate([Chunk.empty(d.index, bench.scene.plan).positions(d.offsets) for d in frame.demands])
    assert len(np.unique(places, axis=0)) == len(places)
    points = bench.renderer.gbuffer(view).points
    corners = np.floor(points).astype(int)[:, ::-1][:, None] + np.array(list(np.ndindex(2, 2, 2)))
    assert set(map(tuple, places)) == set(map(tuple, corners.reshape(-1, 3)))
    assert all(demand.area > 0.0 for demand in frame.demands)


def test_light_of_one_layer_is_shown_and_provisional(workbench: Make) -> None:
    """The indirect layer is lost: the frame is that of direct light alone, and wants the rest."""
    settings = {"lights": [SKY], "target_error": LOOSE}
    bench = workbench(load_scene("demo:orbital", bounces=2, **settings))
    view = bench.view(size=32)
    whole = bench.bake(view)
    direct, indirect = bench.caches.of("gi").store.layers
    shutil.rmtree(Path(indirect.path, "c"))
    frame = bench.again().renderer.render(view)
    on = frame.state > 0
    assert (frame.state[on] == PROVISIONAL).all() and (frame.error[on] == 1.0).all()
    assert len(frame.demands) == frame.chunks_needed and frame.version != whole.version
    alone = Workbench(load_scene("demo:orbital", bounces=0, **settings), bench.folder)
    assert [layer.path for layer in alone.caches.of("gi").store.layers] == [direct.path]
    direct_light = alone.renderer.render(view).radiance
    assert (frame.radiance <= direct_light).all(), "where no path left, more of them may: not buried yet"
    assert (frame.radiance[on] == direct_light[on]).mean() > 0.9
    assert luminance(frame).sum() < 0.99 * luminance(whole).sum()
    again = bench.again()
    assert not again.bake(view).provisional and again.layers == bench.layers


def test_a_picture_without_surface_is_final_and_empty(workbench: Make) -> None:
    bench = workbench(scene_of(make_volume(np.zeros((9, 9, 9))), 0.0))
    for shading in SHADINGS:
        frame = bench.renderer.render(bench.view(size=8, shading=shading))
        assert not frame.state.any() and not frame.radiance.any()
        assert not frame.provisional and frame.estimated_error == 0.0 and frame.coverage["final"] == 1.0


def test_one_pixel_is_a_picture(orbital: Workbench) -> None:
    frame = orbital.renderer.render(replace(orbital.view(), width=1, height=1))
    assert frame.radiance.shape == (1, 1, 3) and np.isfinite(frame.radiance).all()


# --- turning the light ------------------------------------------------------------------------------------------


def test_turning_the_light_casts_no_primary_ray(orbital: Workbench, monkeypatch: pytest.MonkeyPatch) -> None:
    casts: list[int] = []
    trace_pixels = gbuffer_module.trace_pixels

    def counting(*arguments: Any) -> int:
        casts.append(1)
        return int(trace_pixels(*arguments))

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
    assert not np.array_equal(bench.renderer.render(replace(view, light=TURN)).radiance, first.radiance)
    bench.renderer.render(bench.view(azimuth=41.0))
    assert casts, "another camera does"


def test_turning_the_light_needs_no_more_baking(orbital: Workbench) -> None:
    frame = orbital.renderer.render(replace(orbital.view(), light=TURN))
    assert not frame.provisional


@pytest.mark.parametrize("shading", ["phong", "phong_shadow", "lambert"])
def test_camera_and_light_turned_together_see_the_same(shading: str, workbench: Make) -> None:
    """A ball is alike from all four sides: a quarter turn of camera and light is no turn at all."""
    bench = workbench(scene_of(ball(), 0.0, lights=[SKY]))
    plain = bench.renderer.render(bench.view(azimuth=15.0, size=40, shading=shading))
    quarter = bench.view(azimuth=105.0, size=40, shading=shading, light=quaternion_from_angles(90.0, 0.0, 0.0))
    np.testing.assert_allclose(bench.renderer.render(quarter).radiance, plain.radiance, atol=1e-4)


def test_path_tracer_and_cache_turn_the_light_alike(workbench: Make, tmp_path: Path) -> None:
    bench = workbench(scene_of(ball(), 0.0, lights=[soft_probe(tmp_path)], target_error=0.02, bounces=1))
    view = bench.view(size=40, light=TURN)
    frame = bench.bake(view)
    reference = bench.renderer.render(replace(view, shading="path_traced", samples=256))
    flipped = bench.renderer.render(replace(view, light=quaternion_from_angles(-70.0, 20.0, -10.0)))
    assert relative_rmse(frame, reference) < 0.02
    assert relative_rmse(flipped, reference) > 0.1


def test_the_pool_is_looked_through_once_for_a_view_until_it_changes(
    workbench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = workbench(scene_of(ball(), 0.0, bounces=0, target_error=0.5))
    view = bench.view(size=24)
    bench.bake(view)
    read = renderer_module.read_texels
    readings: list[Any] = []

    def counting(*arguments: Any) -> Any:
        readings.append(read(*arguments))
        return readings[-1]

    monkeypatch.setattr(renderer_module, "read_texels", counting)
    versions = {bench.renderer.render(replace(view, light=turn)).version for turn in (IDENTITY, TURN, IDENTITY)}
    assert len(versions) == 2 and not readings, "the last frame of the bake read it"
    bench.renderer.render(view, 0.001)
    assert len(readings) == 1, "another target is another reading"
    bench.bake(view, 0.002)
    assert len(readings) > 1 and len({reading.version for reading in readings}) > 1


def test_pictures_do_not_depend_on_the_number_of_threads(orbital: Workbench) -> None:
    other = Renderer(orbital.caches, Tiles(5))
    for shading in ("gi", "vicinity", "phong_shadow", "path_traced"):
        view = orbital.view(shading=shading, samples=4)
        frames = [renderer.render(view) for renderer in (orbital.renderer, other)]
        assert frames[0].version == frames[1].version
        for plane in ("radiance", "state", "error", "position"):
            assert np.array_equal(getattr(frames[0], plane), getattr(frames[1], plane))


# --- one store, one picture ---------------------------------------------------------------------------------------


def test_everything_rebuilt_from_the_same_store_is_the_same_frame(orbital: Workbench) -> None:
    one, other = (bench.renderer.render(orbital.view()) for bench in (orbital, orbital.again()))
    assert one.version == other.version
    for plane in ("radiance", "state", "error", "position"):
        assert np.array_equal(getattr(one, plane), getattr(other, plane))


def test_versions_tell_frames_apart(orbital: Workbench) -> None:
    view = orbital.view()
    views = [view, replace(view, light=TURN), replace(view, shading="vicinity"), replace(view, width=65)]
    views += [replace(view, isovalue=0.05), orbital.view(azimuth=41.0)]
    assert len({orbital.renderer.render(v).version for v in views}) == len(views)


def test_versions_change_when_light_is_refined(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY], bounces=0))
    view = bench.view(size=24)
    before = bench.renderer.render(view).version
    after = bench.bake(view, target=1.0).version
    assert len({before, after, bench.bake(view, target=0.1).version}) == 3


def test_two_stores_baked_apart_hold_the_same_light(tmp_path: Path) -> None:
    scene = load_scene("demo:orbital", lights=[SKY], bounces=1, target_error=0.3)
    frames = [(bench := Workbench(scene, tmp_path / name)).bake(bench.view(size=24)) for name in ("a", "b")]
    assert frames[0].version == frames[1].version
    assert np.array_equal(frames[0].radiance, frames[1].radiance)


def test_nobody_waits_for_a_cancelled_frame(orbital: Workbench) -> None:
    cancelled = threading.Event()
    cancelled.set()
    for shading in SHADINGS:
        with pytest.raises(Cancelled):
            orbital.again().renderer.render(orbital.view(shading=shading), cancelled=cancelled)
    assert orbital.renderer.render(orbital.view()).coverage["final"] == 1.0


# --- what the light is ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("albedo", [0.3, [0.9, 0.5, 0.1]])
@pytest.mark.parametrize("shading", ["gi", "vicinity", "path_traced"])
def test_a_convex_surface_under_constant_light_shows_its_albedo(shading: str, albedo: Any, workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, albedo=albedo, bounces=3))
    view = bench.view(size=40, shading=shading, samples=64)
    frame = bench.bake(view)
    on = frame.state > 0
    np.testing.assert_allclose(frame.radiance[on].mean(axis=0), np.broadcast_to(albedo, 3), rtol=0.005)
    np.testing.assert_allclose(frame.radiance[on], np.broadcast_to(albedo, (on.sum(), 3)), rtol=0.05)


def test_provisional_light_of_a_convex_surface_is_already_right(workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, albedo=0.4))
    frame = bench.renderer.render(bench.view(size=40))
    np.testing.assert_allclose(frame.radiance[frame.state > 0], 0.4, rtol=1e-5)


def test_reflected_light_only_adds(calm: Workbench) -> None:
    """Under constant light of 1: 0 <= vicinity <= gi <= albedo, to a half float; the difference is what bounces."""
    gi, vicinity = (calm.renderer.render(calm.view(shading=s)).radiance for s in ("gi", "vicinity"))
    assert (vicinity >= 0.0).all() and (vicinity <= gi + 1e-6).all() and (gi <= 0.9 * (1.0 + 2.0**-11)).all()
    assert gi.sum() > 1.02 * vicinity.sum()


def test_vicinity_does_not_turn(orbital: Workbench) -> None:
    plain, turned = (orbital.renderer.render(orbital.view(shading="vicinity", light=q)) for q in (IDENTITY, TURN))
    np.testing.assert_allclose(plain.radiance, turned.radiance, rtol=1e-5)


@pytest.mark.parametrize("shading", [s for s in SHADINGS if s.startswith(("lambert", "phong"))])
def test_local_models_need_no_light_from_the_cache(shading: str, workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY]))
    frame = bench.renderer.render(bench.view(shading=shading))
    assert not frame.provisional and frame.chunks_needed == 0 and frame.demands == ()
    assert not bench.folder.exists(), "no cache is opened"
    assert np.isfinite(frame.radiance).all() and frame.radiance[frame.state > 0].max() > 0.05


def test_shadow_and_fog_only_take_light_away(workbench: Make) -> None:
    bench = workbench(load_scene("demo:casting", lights=[SKY]))
    bare, shadow, fog = (
        bench.renderer.render(bench.view(shading=s)).radiance for s in ("lambert", "lambert_shadow", "lambert_fog")
    )
    for less in (shadow, fog):
        assert (less <= bare + 1e-6).all() and less.sum() < 0.95 * bare.sum()


def test_solid_below_is_the_picture_of_the_negated_volume(workbench: Make) -> None:
    rng = np.random.default_rng(1)
    voxels = (ball(24, 8.0).voxels * 40.0 + rng.normal(size=(25, 25, 25)) * 0.1).astype(np.float32)
    middle = float(np.median(voxels)) + 4.0
    frames = []
    for volume, isovalue in ((make_volume(voxels), middle), (make_volume(-voxels, solid="below"), -middle)):
        bench = workbench(scene_of(volume, isovalue, lights=[SKY], target_error=0.3, bounces=1))
        frames.append(bench.bake(bench.view(size=24)))
    assert (frames[0].state > 0).sum() > 50
    assert np.array_equal(frames[0].state, frames[1].state)
    assert np.array_equal(frames[0].radiance, frames[1].radiance)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 3.0), (3.0, 1.5, 1.0)])
def test_a_ball_sampled_unevenly_is_lit_the_same(spacing: tuple[float, float, float], workbench: Make) -> None:
    frames = []
    for steps in ((1.0, 1.0, 1.0), spacing):
        bench = workbench(scene_of(ball(42, 15.0, steps), 0.0, lights=[SKY], target_error=0.05, bounces=1))
        frames.append(bench.bake(bench.view(20.0, 30.0, 32)))
    both = (frames[0].state > 0) & (frames[1].state > 0)
    even, uneven = (frame.radiance[both].astype(float) @ LUMINANCE for frame in frames)
    assert np.sqrt(((even - uneven) ** 2).mean()) / even.mean() < 0.08
    assert uneven.mean() == pytest.approx(even.mean(), rel=0.02)


# --- vicinity shading -----------------------------------------------------------------------------------------------


def test_vicinity_of_a_transfer_scene_reads_the_direct_layer_that_is_there(orbital: Workbench) -> None:
    before = orbital.layers
    assert len(before) == 2
    bench = orbital.again()
    frame = bench.renderer.render(bench.view(shading="vicinity"))
    assert frame.coverage["final"] == 1.0 and frame.demands == () and orbital.layers == before
    direct = bench.caches.of("gi").store.layers[0]
    assert [layer.path for layer in bench.caches.of("vicinity").store.layers] == [direct.path]


def test_vicinity_of_a_constant_scene_has_a_layer_of_its_own(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[CONSTANT], bounces=2, target_error=LOOSE))
    view = bench.view(size=32)
    bench.bake(view)
    (whole,) = bench.layers
    frame = bench.renderer.render(replace(view, shading="vicinity"))
    assert frame.coverage["provisional"] == 1.0
    assert not bench.bake(replace(view, shading="vicinity")).provisional
    assert bench.layers == {whole, bench.caches.of("vicinity").store.layers[0].digest} and len(bench.layers) == 2
    assert not bench.again().renderer.render(view).provisional


@pytest.mark.parametrize(("name", "most"), [("orbital", 0.012), ("casting", 0.04)])
def test_vicinity_is_the_path_tracer_without_bounces_under_constant_light(
    name: str, most: float, workbench: Make
) -> None:
    """S1, fig. 10. The bake of a scene that has bounces, against a scene that has none.

    The orbital's two differ by their noise, the casting's by what is lost between texels of its thin fins.
    """
    bench, bare = (workbench(load_scene(f"demo:{name}", **{**CALM, "bounces": k})) for k in (4, 0))
    view = bench.view(size=64, shading="vicinity")
    frame = bench.bake(view)
    reference = bare.renderer.render(replace(view, shading="path_traced", samples=1024))
    assert frame.estimated_error < 0.02
    assert relative_rmse(frame, reference) < most
    assert luminance(frame).mean() == pytest.approx(luminance(reference).mean(), rel=0.004)
    with_bounces = bench.renderer.render(replace(view, shading="path_traced", samples=64))
    assert relative_rmse(frame, with_bounces) > 0.03, "bounces would be seen"


# --- where no light comes -------------------------------------------------------------------------------------------


def box_with_a_cellar() -> Volume:
    """A box whose flat top, at z = 9.5, is the roof of a closed hollow, one voxel thick."""
    z, y, x = np.mgrid[:17, :33, :33]
    aside = np.maximum(np.abs(y - 16), np.abs(x - 16))
    solid = (aside <= 12) & (z >= 2) & (z <= 9)
    hollow = (aside <= 8) & (z >= 4) & (z <= 8)
    return make_volume(np.where(solid & ~hollow, 1.0, -1.0).astype(np.float32), name="cellar")


@pytest.mark.parametrize("kept", [{}, {"representation": "transfer", "order": 2}])
@pytest.mark.parametrize("shading", ["gi", "vicinity"])
def test_buried_texels_under_a_lit_surface_do_not_darken_it(
    kept: dict[str, Any], shading: str, workbench: Make
) -> None:
    """Texels of every other voxel: those at z = 8, a quarter of the light at the top, are in the hollow."""
    bench = workbench(scene_of(box_with_a_cellar(), 0.0, albedo=0.5, bounces=2, lattice=0.5, **kept))
    view = bench.view(elevation=90.0, distance=1.5, size=24, shading=shading)
    frame = bench.bake(view)
    gbuffer = bench.renderer.gbuffer(view)
    texels = bench.renderer.texels(view, gbuffer)
    pool = bench.caches.of(shading).pool
    with pool.hold(texels.chunks) as held:
        grade = read_texels(texels, held.slots, pool, bench.scene.target_error, Tiles(1)).grade
    roof = np.abs(gbuffer.points[:, :2] - 16.0).max(axis=1) < 7.0
    assert roof.sum() > 50 and ((grade[texels.corners[roof]] == BURIED).sum(axis=1) == 4).all()
    np.testing.assert_allclose(frame.radiance.reshape(-1, 3)[gbuffer.pixels[roof]], 0.5, rtol=0.002)
    assert (frame.state.ravel()[gbuffer.pixels] == FINAL).all()


@pytest.mark.parametrize("shading", ["gi", "vicinity", "path_traced"])
def test_a_closed_hollow_is_black_from_inside(shading: str, workbench: Make) -> None:
    z, y, x = np.mgrid[:45, :45, :45] - 22.0
    shell = make_volume((6.0 - np.abs(np.sqrt(x * x + y * y + z * z) - 14.0)).astype(np.float32))
    bench = workbench(scene_of(shell, 0.0, bounces=2))
    camera = Camera((22.0, 22.0, 22.0), (40.0, 23.0, 25.0), fov=70.0)
    frame = bench.bake(View(0.0, camera, width=24, height=24, shading=shading))
    assert (frame.state == FINAL).all() and not frame.radiance.any() and frame.estimated_error == 0.0


# --- against the path tracer ----------------------------------------------------------------------------------------


def against_path_tracer(bench: Workbench, samples: int, size: int = 192) -> tuple[float, Frame]:
    """Relative RMSE of the baked `gi` picture against the path tracer with so many samples, and the `gi` frame."""
    view: View = bench.view(size=size)
    frame = bench.bake(view)
    reference = bench.renderer.render(replace(view, shading="path_traced", samples=samples))
    return relative_rmse(frame, reference), frame


def test_gi_of_the_orbital_is_the_path_tracers(workbench: Make) -> None:
    error, frame = against_path_tracer(workbench(load_scene("demo:orbital", **CALM)), 256, 96)
    assert error < 0.02
    assert frame.estimated_error < 0.02


@pytest.mark.slow
def test_gi_of_the_casting_is_the_path_tracers(workbench: Make) -> None:
    """Thin fins and webs of one or two voxels: light differs most from texel to texel here."""
    error, frame = against_path_tracer(workbench(load_scene("demo:casting", **CALM)), 256, 128)
    assert error < 0.03
    assert frame.estimated_error < 0.02


@pytest.mark.slow
@pytest.mark.data
def test_gi_of_the_engine_is_the_path_tracers(shared_data: Path, workbench: Make) -> None:
    scene = load_scene(shared_data / "engine_256x256x128_uint8.nhdr", isovalue=70, **CALM)
    error, frame = against_path_tracer(workbench(scene), 256)
    assert error < 0.02
    assert frame.estimated_error < 0.02
