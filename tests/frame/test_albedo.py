"""Frames of another albedo than the scene's: the same texels, in the light of that surface."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.bake import refine as refine_module
from isogi_core.errors import ViewError
from isogi_core.files.grid import Vector
from isogi_core.frame import renderer as renderer_module
from isogi_core.frame import surface_renderer, texel_shading
from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.model.view import quaternion_from_angles
from isogi_core.plan.scene import Scene
from tests.frame.conftest import CONSTANT, LOOSE, SKY, Workbench, ball, luminance, relative_rmse, scene_of
from tests.loaded import load_scene

Make = Callable[..., Workbench]
ORANGE = (0.9, 0.5, 0.1)
TURN = quaternion_from_angles(70.0, 20.0, -10.0)
TIGHT = {"target_error": 0.015, "bounces": 4}
SMALL = {"size": 22}


def grey(share: float) -> Vector:
    return (share, share, share)


def live_scene(light: dict[str, Any] = SKY, **settings: Any) -> Scene:
    """The orbital at albedo 0.3, of which views may ask for 0 to 0.9."""
    return load_scene("demo:orbital", **{"lights": [light], "albedo": 0.3, "albedos": [0.0, 0.9], **settings})


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """It under a sky with a sun that is a lobe; `view()` is baked to 1.5 %."""
    bench = Workbench(live_scene(**TIGHT), tmp_path_factory.mktemp("live"))
    assert bench.scene.plan.lobes == 1 and len(bench.scene.plan.nodes) == 2
    bench.bake(bench.view(**SMALL))
    return bench


Fresh = Callable[..., Frame]


@pytest.fixture(scope="module")
def fresh_frame(tmp_path_factory: pytest.TempPathFactory) -> Fresh:
    """Frames of scenes of their own with an albedo, each of them baked once."""

    @cache
    def baked(albedo: Vector, kind: str) -> Workbench:
        light = SKY if kind == "sky" else CONSTANT
        scene = load_scene("demo:orbital", lights=[light], albedo=list(albedo), **TIGHT)
        bench = Workbench(scene, tmp_path_factory.mktemp("fresh"))
        bench.bake(bench.view(**SMALL))
        return bench

    def render(albedo: Vector, kind: str = "sky", **view: Any) -> Frame:
        bench = baked(albedo, kind)
        return bench.renderer.render(bench.view(**SMALL, **view))

    return render


def objects(folder: Path) -> dict[Path, bytes]:
    """Every file of a store."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("albedo", [grey(0.0), grey(0.05), grey(0.9), ORANGE])
@pytest.mark.parametrize("shading", ["gi", "vicinity", "path_traced"])
def test_constant_light_on_a_convex_surface_shows_its_albedo(shading: str, albedo: Vector, workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, albedo=0.3, albedos=[0.0, 0.9], target_error=LOOSE))
    bench.bake(bench.view(size=40, shading=shading, samples=64))
    frame = bench.renderer.render(bench.view(size=40, shading=shading, samples=64, albedo=albedo))
    on = frame.state > 0
    expected = np.broadcast_to(albedo, (on.sum(), 3))
    np.testing.assert_allclose(frame.radiance[on].mean(axis=0), albedo, rtol=0.005)
    np.testing.assert_allclose(frame.radiance[on], expected, rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("albedo", [grey(0.9), ORANGE], ids=["grey", "orange"])
@pytest.mark.parametrize("view", [{}, {"light": TURN}], ids=["as it stands", "turned"])
def test_another_albedo_is_within_1_percent_of_a_fresh_bake(
    view: dict[str, Any], albedo: Vector, live: Workbench, fresh_frame: Fresh
) -> None:
    frame = live.renderer.render(live.view(**SMALL, albedo=albedo, **view))
    assert not frame.provisional and not frame.demands
    assert relative_rmse(frame, fresh_frame(albedo, **view)) < 0.01


@pytest.mark.slow
def test_constant_light_serves_any_albedo(workbench: Make, fresh_frame: Fresh) -> None:
    bench = workbench(live_scene(CONSTANT, **TIGHT))
    assert bench.scene.plan.representation == "constant"
    bench.bake(bench.view(**SMALL))
    for albedo in (grey(0.9), ORANGE):
        frame = bench.renderer.render(bench.view(**SMALL, albedo=albedo))
        assert not frame.provisional
        assert relative_rmse(frame, fresh_frame(albedo, "constant")) < 0.01


def test_another_albedo_casts_no_ray_and_leaves_the_store(live: Workbench, monkeypatch: pytest.MonkeyPatch) -> None:
    own, before = live.renderer.render(live.view(**SMALL)), objects(live.folder)

    def refuse(*_: Any) -> None:
        raise AssertionError("a ray")

    for module, name in (
        *((refine_module, name) for name in ("bake_texels", "bake_irradiance", "locate_texels")),
        *((renderer_module, "trace"), (surface_renderer, "find_lobes")),
        (texel_shading, "find_texels"),
    ):
        monkeypatch.setattr(module, name, refuse)
    bright = live.renderer.render(live.view(**SMALL, albedo=grey(0.9)))
    assert (bright.state[bright.state > 0] == FINAL).all() and objects(live.folder) == before
    assert luminance(bright).mean() > 3.0 * luminance(own).mean(), "more than three times: it is reflected, too"
    assert bright.version != own.version


def test_the_path_tracer_has_the_views_albedo(live: Workbench) -> None:
    traced = live.renderer.render(live.view(**SMALL, albedo=ORANGE, shading="path_traced", samples=256))
    cached = live.renderer.render(live.view(**SMALL, albedo=ORANGE))
    on = traced.state > 0
    colours = [frame.radiance[on].mean(axis=0) for frame in (traced, cached)]
    np.testing.assert_allclose(*colours, rtol=0.02)


def test_local_models_and_provisional_light_have_the_albedo(live: Workbench, workbench: Make) -> None:
    bench = workbench(live_scene())
    for bright, own in (
        [live.renderer.render(live.view(**SMALL, shading="lambert_shadow", albedo=a)) for a in (grey(0.9), None)],
        [bench.renderer.render(bench.view(**SMALL, albedo=a)) for a in (grey(0.9), None)],
    ):
        np.testing.assert_allclose(bright.radiance, 3.0 * own.radiance, rtol=1e-5)


def test_light_without_bounces_serves_any_albedo(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[CONSTANT], albedo=0.5, bounces=0, target_error=LOOSE))
    own = bench.bake(bench.view(**SMALL))
    bright = bench.renderer.render(bench.view(**SMALL, albedo=(1.0, 0.5, 0.25)))
    np.testing.assert_allclose(bright.radiance, own.radiance * [2.0, 1.0, 0.5], rtol=1e-5)
    np.testing.assert_allclose(bright.error, own.error, rtol=1e-4)


def test_the_scenes_albedo_gives_the_same_picture_by_name(live: Workbench) -> None:
    named = live.renderer.render(live.view(**SMALL, albedo=grey(0.3)))
    assert np.array_equal(named.radiance, live.renderer.render(live.view(**SMALL)).radiance)


def test_errors_are_those_of_the_shown_albedo(live: Workbench, workbench: Make) -> None:
    """The estimated error after few paths beside the true one, at each end and at the scene's own."""
    rough = workbench(live.scene)
    rough.bake(rough.view(**SMALL), 0.1)
    for albedo in (0.9, 0.3, 0.05):
        frame, true = (bench.renderer.render(bench.view(**SMALL, albedo=grey(albedo))) for bench in (rough, live))
        assert 0.5 < relative_rmse(frame, true) / frame.noise < 1.5, albedo


def test_an_albedo_outside_the_scenes_range_is_refused(live: Workbench, orbital: Workbench) -> None:
    with pytest.raises(ViewError, match=r"from 0 to 0\.9 in this scene, not 0\.95,0\.5,0\.5"):
        live.renderer.render(live.view(**SMALL, albedo=(0.95, 0.5, 0.5)))
    with pytest.raises(ViewError, match="albedo is fixed in this scene"):
        orbital.renderer.render(orbital.view(albedo=grey(0.5)))
