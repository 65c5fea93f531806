"""Surfaces with colours by data: one colour is one albedo, and all else is what paths that carry colours bring."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from isogi_core.errors import ViewError
from isogi_core.kernels.shading.framebuffer import PROVISIONAL
from isogi_core.plan.scene import Scene
from tests.frame.conftest import CONSTANT, SKY, Workbench, chunks_of, relative_rmse, rmse_of_colours
from tests.loaded import load_scene

ALBEDO = [0.8, 0.5, 0.2]
GRADIENT = {"use": "colour", "of": "gradient", "map": "coolwarm"}
KEPT = {"bounces": 5, "target_error": 0.03}


def painted(light: dict[str, Any], table: dict[str, Any] = GRADIENT, **settings: Any) -> Scene:
    """The orbital with colours by its gradient."""
    return load_scene("demo:orbital", lights=[light], volumes=[table], **{**KEPT, **settings})


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [False, True], ids=["turning", "staying"])
def test_one_colour_is_one_albedo(fixed: bool, tmp_path: Path) -> None:
    """The closed form of all furnaces: the pictures agree to rounding, as the paths are the same."""
    turning = {"rotating": False} if fixed else {}
    table = {"use": "colour", "of": "gradient", "colours": [ALBEDO, ALBEDO], "outside": ALBEDO}
    plain = load_scene("demo:orbital", lights=[SKY], albedo=ALBEDO, **KEPT, **turning)
    one, other = Workbench(painted(SKY, table, **turning), tmp_path / "a"), Workbench(plain, tmp_path / "b")
    assert one.scene.surfaces.albedo == tuple(ALBEDO) and one.scene.plan.bounces == plain.plan.bounces
    frame, expected = (bench.bake(bench.view(size=24)) for bench in (one, other))
    assert rmse_of_colours(frame, expected) < 0.002
    view = one.view(size=12, shading="path_traced", samples=64)
    traced, paths = (bench.renderer.render(view) for bench in (one, other))
    assert rmse_of_colours(traced, paths) < 0.002


@pytest.mark.slow
def test_direct_light_keeps_its_key_and_its_bytes(tmp_path: Path) -> None:
    """Colours change reflected light alone."""
    scene, plain = painted(SKY), load_scene("demo:orbital", lights=[SKY], albedo=0.7, **KEPT)
    direct, reflected = scene.plan.layers
    assert scene.layer_digest(direct) == plain.layer_digest(direct)
    assert scene.layer_digest(reflected) != plain.layer_digest(reflected) and reflected.channels == 3
    one, other = Workbench(scene, tmp_path / "a"), Workbench(plain, tmp_path / "b")
    for bench in (one, other):
        bench.bake(bench.view(size=16), target=0.9)
    found, expected = (chunks_of(bench.folder, scene.layer_digest(direct)) for bench in (one, other))
    assert found and found == expected


@pytest.mark.parametrize("light", [CONSTANT, SKY], ids=["constant", "sky"])
def test_light_of_texels_is_what_paths_bring(light: dict[str, Any], workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(light, target_error=0.02))
    frame = bench.bake(bench.view(size=32))
    traced = bench.renderer.render(bench.view(size=32, shading="path_traced", samples=512))
    assert rmse_of_colours(frame, traced) < 0.04
    hue = traced.radiance[traced.state > 0]
    assert (hue[:, 0] > 1.3 * hue[:, 2]).any() and (hue[:, 2] > 1.3 * hue[:, 0]).any(), "red here and blue there"


@pytest.mark.slow
def test_light_that_stays_is_what_paths_bring(workbench: Callable[..., Workbench]) -> None:
    """Once its picture is checked: colours change within a voxel here, and so do shadows of the sun."""
    scene = painted(SKY, rotating=False)
    bench, view = workbench(scene), workbench(scene).view(size=32)
    bench.bake(view)
    while bench.renderer.refine(view):
        pass
    frame = bench.renderer.render(view)
    traced = bench.renderer.render(bench.view(size=32, shading="path_traced", samples=1024))
    assert frame.final and relative_rmse(frame, traced) == pytest.approx(frame.total.likely, abs=0.015)
    assert scene.plan.representation == "irradiance" and scene.bakes == {"room"}
    assert rmse_of_colours(frame, traced) < 0.05


def test_reflected_light_takes_the_colours_of_what_it_met(workbench: Callable[..., Workbench]) -> None:
    """In pictures divided by the albedo of each point, direct light is grey and reflected light is not."""
    bench = workbench(painted(CONSTANT))
    frame = bench.bake(bench.view(size=24))
    own = frame.gbuffer.albedos(bench.prepared.colours, bench.renderer.tiles)
    arriving = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels] / own
    assert (np.abs(arriving[:, 0] / arriving[:, 2] - 1.0) > 0.02).any()
    vicinity = bench.bake(bench.view(size=24, shading="vicinity"))
    straight = vicinity.radiance.reshape(-1, 3)[vicinity.gbuffer.pixels] / own
    np.testing.assert_allclose(straight[:, 0], straight[:, 2], rtol=1e-4)


def test_unshadowed_light_stands_in_in_the_colours(workbench: Callable[..., Workbench]) -> None:
    """Before anything is baked: all light of the sky, times the albedo of each point, and marked."""
    bench = workbench(painted(CONSTANT))
    frame = bench.renderer.render(bench.view(size=24))
    own = frame.gbuffer.albedos(bench.prepared.colours, bench.renderer.tiles)
    assert (frame.state[frame.state > 0] == PROVISIONAL).all()
    np.testing.assert_allclose(frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels], own, rtol=1e-4)


def test_exported_points_have_the_colours(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(CONSTANT))
    view = bench.view(size=16)
    frame = bench.bake(view)
    lit, _ = bench.renderer.light_points(view, frame.gbuffer.points)
    np.testing.assert_allclose(lit.radiance[0], frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels], rtol=1e-4)


def test_local_shading_shows_the_colours(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(CONSTANT))
    plain = Workbench(load_scene("demo:orbital", lights=[CONSTANT], albedo=0.5, **KEPT), bench.folder)
    view = bench.view(size=24, shading="lambert")
    frame, grey = bench.renderer.render(view), plain.renderer.render(view)
    own = frame.gbuffer.albedos(bench.prepared.colours, bench.renderer.tiles)
    shown, base = (each.radiance.reshape(-1, 3)[frame.gbuffer.pixels] for each in (frame, grey))
    np.testing.assert_allclose(shown, base * own / 0.5, rtol=1e-4)


@pytest.mark.slow
def test_shine_lies_over_the_colours(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(CONSTANT, shine={"kind": "plastic"}))
    frame = bench.bake(bench.view(size=24))
    while bench.renderer.refine(bench.view(size=24)):
        pass
    frame = bench.renderer.render(bench.view(size=24))
    traced = bench.renderer.render(bench.view(size=24, shading="path_traced", samples=256))
    assert rmse_of_colours(frame, traced) < 0.05


def test_a_view_can_ask_for_no_albedo(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(CONSTANT))
    with pytest.raises(ViewError, match="has its albedo from 'gradient'"):
        bench.renderer.render(bench.view(size=8, albedo=(0.5, 0.5, 0.5)))
