"""Surfaces of other albedos, of colours by data and of labels: one set of texels, and what coloured
paths bring.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
import pytest

from isogi_core.bake import refine as refine_module
from isogi_core.errors import ViewError
from isogi_core.files.vector import Vector
from isogi_core.frame import surface_renderer, texel_shading
from isogi_core.frame.frame import Frame
from isogi_core.kernels.shading.framebuffer import FINAL, PROVISIONAL
from isogi_core.model.view import quaternion_from_angles, read_window
from isogi_core.plan.scene import Scene
from isogi_core.plan.volumes.labels import smooth
from tests.frame.conftest import (
    CONSTANT,
    LOOSE,
    SKY,
    Workbench,
    ball,
    chunks_of,
    luminance,
    relative_rmse,
    rmse_of_colours,
    scene_of,
)
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
    """The closed form of all furnaces: the pictures agree to rounding, as the paths are the
    same.
    """
    turning = {"rotating": False} if fixed else {}
    table = {"use": "colour", "of": "gradient", "colours": [ALBEDO, ALBEDO], "outside": ALBEDO}
    plain = load_scene("demo:orbital", lights=[SKY], albedo=ALBEDO, **KEPT, **turning)
    one = Workbench(painted(SKY, table, **turning), tmp_path / "a")
    other = Workbench(plain, tmp_path / "b")
    assert (
        one.scene.surfaces.albedo == tuple(ALBEDO) and one.scene.plan.bounces == plain.plan.bounces
    )
    frame, expected = (bench.bake(bench.view(size=24)) for bench in (one, other))
    assert rmse_of_colours(frame, expected) < 0.002
    view = one.view(size=12, shading="path_traced", samples=64)
    traced, paths = (bench.renderer.render(view) for bench in (one, other))
    assert rmse_of_colours(traced, paths) < 0.002


@pytest.mark.slow
def test_direct_light_keeps_its_key_and_its_bytes(tmp_path: Path) -> None:
    """Colours change reflected light alone."""
    scene = painted(SKY)
    plain = load_scene("demo:orbital", lights=[SKY], albedo=0.7, **KEPT)
    direct, reflected = scene.plan.layers
    assert scene.layer_digest(direct) == plain.layer_digest(direct)
    assert (
        scene.layer_digest(reflected) != plain.layer_digest(reflected) and reflected.channels == 3
    )
    one, other = Workbench(scene, tmp_path / "a"), Workbench(plain, tmp_path / "b")
    for bench in (one, other):
        bench.bake(bench.view(size=16), target=0.9)
    found, expected = (
        chunks_of(bench.folder, scene.layer_digest(direct)) for bench in (one, other)
    )
    assert found and found == expected


@pytest.mark.parametrize("light", [CONSTANT, SKY], ids=["constant", "sky"])
def test_light_of_texels_is_what_paths_bring(
    light: dict[str, Any], workbench: Callable[..., Workbench]
) -> None:
    bench = workbench(painted(light, target_error=0.02))
    frame = bench.bake(bench.view(size=32))
    traced = bench.renderer.render(bench.view(size=32, shading="path_traced", samples=512))
    assert rmse_of_colours(frame, traced) < 0.04
    hue = traced.radiance[traced.state > 0]
    assert (hue[:, 0] > 1.3 * hue[:, 2]).any() and (hue[:, 2] > 1.3 * hue[:, 0]).any(), (
        "red here and blue there"
    )


@pytest.mark.slow
def test_light_that_stays_is_what_paths_bring(workbench: Callable[..., Workbench]) -> None:
    """Once its picture is checked: colours change within a voxel here, and so do shadows of the
    sun.
    """
    scene = painted(SKY, rotating=False)
    bench = workbench(scene)
    view = workbench(scene).view(size=32)
    bench.bake(view)
    frame = bench.settled(view)
    traced = bench.renderer.render(bench.view(size=32, shading="path_traced", samples=1024))
    assert frame.final and relative_rmse(frame, traced) == pytest.approx(
        frame.total.likely, abs=0.015
    )
    assert scene.plan.representation == "irradiance" and scene.bakes == {"room"}
    assert rmse_of_colours(frame, traced) < 0.05


def test_reflected_light_takes_the_colours_of_what_it_met(
    workbench: Callable[..., Workbench],
) -> None:
    """In pictures divided by the albedo of each point, direct light is grey and reflected light is
    not.
    """
    bench = workbench(painted(CONSTANT))
    frame = bench.bake(bench.view(size=24))
    own = frame.gbuffer.albedos(bench.prepared.colours, bench.renderer.tiles)
    arriving = frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels] / own
    assert (np.abs(arriving[:, 0] / arriving[:, 2] - 1.0) > 0.02).any()
    vicinity = bench.bake(bench.view(size=24, shading="vicinity"))
    straight = vicinity.radiance.reshape(-1, 3)[vicinity.gbuffer.pixels] / own
    np.testing.assert_allclose(straight[:, 0], straight[:, 2], rtol=1e-4)


def test_unshadowed_light_stands_in_in_the_colours(workbench: Callable[..., Workbench]) -> None:
    """Before anything is baked: all light of the sky, times the albedo of each point, and
    marked.
    """
    bench = workbench(painted(CONSTANT))
    frame = bench.renderer.render(bench.view(size=24))
    own = frame.gbuffer.albedos(bench.prepared.colours, bench.renderer.tiles)
    assert (frame.state[frame.state > 0] == PROVISIONAL).all()
    np.testing.assert_allclose(frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels], own, rtol=1e-4)


def test_exported_points_have_the_colours(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(CONSTANT))
    view = bench.view(size=16)
    frame = bench.bake(view)
    lit, _ = bench.renderer.surface.light_points(view, frame.gbuffer.points)
    np.testing.assert_allclose(
        lit.radiance[0], frame.radiance.reshape(-1, 3)[frame.gbuffer.pixels], rtol=1e-4
    )


def test_local_shading_shows_the_colours(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(CONSTANT))
    plain = Workbench(
        load_scene("demo:orbital", lights=[CONSTANT], albedo=0.5, **KEPT), bench.folder
    )
    view = bench.view(size=24, shading="lambert")
    frame = bench.renderer.render(view)
    grey = plain.renderer.render(view)
    own = frame.gbuffer.albedos(bench.prepared.colours, bench.renderer.tiles)
    shown, base = (each.radiance.reshape(-1, 3)[frame.gbuffer.pixels] for each in (frame, grey))
    np.testing.assert_allclose(shown, base * own / 0.5, rtol=1e-4)


@pytest.mark.slow
def test_shine_lies_over_the_colours(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(CONSTANT, shine={"kind": "plastic"}))
    bench.bake(bench.view(size=24))
    frame = bench.settled(bench.view(size=24))
    traced = bench.renderer.render(bench.view(size=24, shading="path_traced", samples=256))
    assert rmse_of_colours(frame, traced) < 0.05


def test_a_view_can_ask_for_no_albedo(workbench: Callable[..., Workbench]) -> None:
    bench = workbench(painted(CONSTANT))
    with pytest.raises(ViewError, match="has its albedo from 'gradient'"):
        bench.renderer.render(bench.view(size=8, albedo=(0.5, 0.5, 0.5)))


# --- other albedos
# --------------------------------------------------------------------------------------------------


Make = Callable[..., Workbench]
ORANGE = (0.9, 0.5, 0.1)
TURN = quaternion_from_angles(70.0, 20.0, -10.0)
TIGHT = {"target_error": 0.015, "bounces": 4}
SMALL = {"size": 22}


def grey(share: float) -> Vector:
    return (share, share, share)


def live_scene(light: dict[str, Any] = SKY, **settings: Any) -> Scene:
    """The orbital at albedo 0.3, of which views may ask for 0 to 0.9."""
    return load_scene(
        "demo:orbital", **{"lights": [light], "albedo": 0.3, "albedos": [0.0, 0.9], **settings}
    )


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
def test_constant_light_on_a_convex_surface_shows_its_albedo(
    shading: str, albedo: Vector, workbench: Make
) -> None:
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


def test_another_albedo_casts_no_ray_and_leaves_the_store(
    live: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = live.renderer.render(live.view(**SMALL))
    before = objects(live.folder)

    def refuse(*_: Any) -> None:
        raise AssertionError("a ray")

    for module, name in (
        *((refine_module, name) for name in ("bake_texels", "bake_irradiance", "locate_texels")),
        *((surface_renderer, name) for name in ("trace", "find_lobes")),
        (texel_shading, "find_texels"),
    ):
        monkeypatch.setattr(module, name, refuse)
    bright = live.renderer.render(live.view(**SMALL, albedo=grey(0.9)))
    assert (bright.state[bright.state > 0] == FINAL).all() and objects(live.folder) == before
    assert luminance(bright).mean() > 3.0 * luminance(own).mean(), (
        "more than three times: it is reflected, too"
    )
    assert bright.version != own.version


def test_the_path_tracer_has_the_views_albedo(live: Workbench) -> None:
    traced = live.renderer.render(
        live.view(**SMALL, albedo=ORANGE, shading="path_traced", samples=256)
    )
    cached = live.renderer.render(live.view(**SMALL, albedo=ORANGE))
    on = traced.state > 0
    colours = [frame.radiance[on].mean(axis=0) for frame in (traced, cached)]
    np.testing.assert_allclose(*colours, rtol=0.02)


def test_local_models_and_provisional_light_have_the_albedo(
    live: Workbench, workbench: Make
) -> None:
    bench = workbench(live_scene())
    for bright, own in (
        [
            live.renderer.render(live.view(**SMALL, shading="lambert_shadow", albedo=a))
            for a in (grey(0.9), None)
        ],
        [bench.renderer.render(bench.view(**SMALL, albedo=a)) for a in (grey(0.9), None)],
    ):
        np.testing.assert_allclose(bright.radiance, 3.0 * own.radiance, rtol=1e-5)


def test_light_without_bounces_serves_any_albedo(workbench: Make) -> None:
    bench = workbench(
        load_scene("demo:orbital", lights=[CONSTANT], albedo=0.5, bounces=0, target_error=LOOSE)
    )
    own = bench.bake(bench.view(**SMALL))
    bright = bench.renderer.render(bench.view(**SMALL, albedo=(1.0, 0.5, 0.25)))
    np.testing.assert_allclose(bright.radiance, own.radiance * [2.0, 1.0, 0.5], rtol=1e-5)
    np.testing.assert_allclose(bright.error, own.error, rtol=1e-4)


def test_the_scenes_albedo_gives_the_same_picture_by_name(live: Workbench) -> None:
    named = live.renderer.render(live.view(**SMALL, albedo=grey(0.3)))
    assert np.array_equal(named.radiance, live.renderer.render(live.view(**SMALL)).radiance)


def test_errors_are_those_of_the_shown_albedo(live: Workbench, workbench: Make) -> None:
    """The estimated error after few paths beside the true one, at each end and at the scene's
    own.
    """
    rough = workbench(live.scene)
    rough.bake(rough.view(**SMALL), 0.1)
    for albedo in (0.9, 0.3, 0.05):
        frame, true = (
            bench.renderer.render(bench.view(**SMALL, albedo=grey(albedo)))
            for bench in (rough, live)
        )
        assert 0.5 < relative_rmse(frame, true) / frame.noise < 1.5, albedo


def test_an_albedo_outside_the_scenes_range_is_refused(live: Workbench, orbital: Workbench) -> None:
    with pytest.raises(ViewError, match=r"from 0 to 0\.9 in this scene, not 0\.95,0\.5,0\.5"):
        live.renderer.render(live.view(**SMALL, albedo=(0.95, 0.5, 0.5)))
    with pytest.raises(ViewError, match="albedo is fixed in this scene"):
        orbital.renderer.render(orbital.view(albedo=grey(0.5)))


# --- labels
# --------------------------------------------------------------------------------------------------


Z, Y, X = np.indices((18, 18, 18)) - 8.5
BALL = np.sqrt(X**2 + Y**2 + Z**2) < 6.3
CUP = (
    (np.abs(X) < 6)
    & (np.abs(Y) < 6)
    & (np.abs(Z) < 6)
    & ~((np.abs(X) < 3) & (np.abs(Y) < 3) & (Z > -3))
)
RED = [0.8, 0.2, 0.2]
GREEN = [0.2, 0.7, 0.2]
LABELS_KEPT = {"bounces": 3, "target_error": 0.03, "isovalues": [0.4, 0.6]}


def labelled_scene(folder: Path, volume: np.ndarray, **settings: Any) -> Scene:
    """The scene of a volume in a folder."""
    path = folder / "v.nrrd"
    nrrd.write(str(path), np.ascontiguousarray(volume), index_order="C")
    return load_scene(path, **{**LABELS_KEPT, "lights": [CONSTANT], **settings})


def label(value: int, colour: list[float], hidden: bool = False) -> dict[str, Any]:
    """An entry of [[labels]]."""
    return {"value": value, "colour": colour, "hidden": hidden}


def test_one_label_is_a_plain_volume_of_its_albedo(tmp_path: Path) -> None:
    """The closed form: the same voxels, direct light under the same key and of the same bytes, the
    same picture.
    """
    own = labelled_scene(tmp_path, CUP.astype(np.uint8), labels=[label(1, RED)], lights=[SKY])
    plain = labelled_scene(
        tmp_path, np.concatenate(list(smooth(CUP))), isovalue=0.5, albedo=RED, lights=[SKY]
    )
    direct = own.plan.layers[0]
    assert own.surfaces.albedo == plain.surfaces.albedo and own.layer_digest(
        direct
    ) == plain.layer_digest(direct)
    one, other = Workbench(own, tmp_path / "a"), Workbench(plain, tmp_path / "b")
    frame, expected = (bench.bake(bench.view(size=24)) for bench in (one, other))
    assert rmse_of_colours(frame, expected) < 0.002
    found, others = (chunks_of(bench.folder, own.layer_digest(direct)) for bench in (one, other))
    assert found and found == others


def test_two_halves_part_at_their_plane(
    tmp_path: Path, workbench: Callable[..., Workbench]
) -> None:
    """Pixels that hit the surface more than half a voxel away from the plane are of one colour."""
    halves = np.where(BALL, np.where(X < 0, 2, 9), 0).astype(np.uint8)
    bench = workbench(labelled_scene(tmp_path, halves, labels=[label(2, RED), label(9, GREEN)]))
    frame = bench.renderer.render(bench.view(size=48, shading="lambert", azimuth=90.0))
    own = frame.gbuffer.albedos(bench.prepared.colours, bench.renderer.tiles)
    away = frame.gbuffer.points[:, 0] - 8.5
    left = own[away < -0.51]
    right = own[away > 0.51]
    assert len(left) > 100 and len(right) > 100
    np.testing.assert_allclose(left, np.tile(RED, (len(left), 1)), atol=0.01)
    np.testing.assert_allclose(right, np.tile(GREEN, (len(right), 1)), atol=0.01)


def test_faces_of_a_window_are_in_the_colours_of_labels(
    tmp_path: Path, workbench: Callable[..., Workbench]
) -> None:
    halves = np.where(BALL, np.where(X < 0, 2, 9), 0).astype(np.uint8)
    bench = workbench(labelled_scene(tmp_path, halves, labels=[label(2, RED), label(9, GREEN)]))
    view = bench.view(size=48, shading="lambert", elevation=70.0, window=read_window("z>8.5"))
    frame = bench.renderer.render(view)
    faces = frame.gbuffer.faces
    shown = frame.radiance.reshape(-1, 3)[faces.pixels]
    away = faces.points[:, 0] - 8.5
    for side, colour in ((away < -0.51, RED), (away > 0.51, GREEN)):
        assert side.sum() > 100
        np.testing.assert_allclose(
            shown[side] / shown[side].sum(axis=1)[:, None],
            [colour / np.sum(colour)] * side.sum(),
            atol=0.01,
        )


def test_a_hidden_lid_lets_light_into_its_cup(
    tmp_path: Path, workbench: Callable[..., Workbench]
) -> None:
    """By paths of the volume without it: what it hid is lit, under another key."""
    lid = (np.abs(X) < 6) & (np.abs(Y) < 6) & (Z > 5) & (Z < 8)
    both = np.where(CUP, 1, np.where(lid, 2, 0)).astype(np.uint8)
    closed = labelled_scene(tmp_path, both, labels=[label(1, RED), label(2, GREEN)])
    opened = workbench(
        labelled_scene(tmp_path, both, labels=[label(1, RED), label(2, GREEN, hidden=True)])
    )
    alone = workbench(labelled_scene(tmp_path, CUP.astype(np.uint8), labels=[label(1, RED)]))
    assert closed.bake_digest != opened.scene.bake_digest == alone.scene.bake_digest
    frame = opened.bake(opened.view(size=24, elevation=60.0))
    traced = opened.renderer.render(
        opened.view(size=24, elevation=60.0, shading="path_traced", samples=256)
    )
    assert rmse_of_colours(frame, traced) < 0.05
    inner = np.argwhere(
        (frame.position[..., 2] < 8.0) & (np.abs(frame.position[..., :2] - 8.5) < 2.5).all(axis=-1)
    )
    assert len(inner) and all(frame.radiance[row, column, 0] > 0.05 for row, column in inner)
