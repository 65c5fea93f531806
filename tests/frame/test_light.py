"""The light in a frame: closed forms, vicinity shading, hollows and the path tracer."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake.noise import Goal
from isogi_core.frame.texel_reading import read_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.shading.framebuffer import FINAL
from isogi_core.kernels.shading.lattice import BURIED_GRADE
from isogi_core.model.choices import VIEW_SHADINGS
from isogi_core.model.environment import LUMINANCE_WEIGHTS
from isogi_core.model.view import IDENTITY, Camera, View, quaternion_from_angles
from isogi_core.model.volume import Volume, make_volume
from tests.frame.conftest import (
    CONSTANT,
    LOOSE,
    SKY,
    Workbench,
    ball,
    luminance,
    relative_rmse,
    scene_of,
)
from tests.loaded import load_scene

Make = Callable[..., Workbench]
TURN = quaternion_from_angles(70.0, 20.0, -10.0)
CALM = {"lights": [CONSTANT], "albedo": 0.7, "bounces": 4, "target_error": 0.02}


# --- what the light is
# ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("albedo", [0.3, [0.9, 0.5, 0.1]])
@pytest.mark.parametrize("shading", ["gi", "vicinity", "path_traced"])
def test_a_convex_surface_under_constant_light_shows_its_albedo(
    shading: str, albedo: Any, workbench: Make
) -> None:
    bench = workbench(scene_of(ball(), 0.0, albedo=albedo, bounces=3))
    view = bench.view(size=40, shading=shading, samples=64)
    frame = bench.bake(view)
    on = frame.state > 0
    np.testing.assert_allclose(
        frame.radiance[on].mean(axis=0), np.broadcast_to(albedo, 3), rtol=0.005
    )
    np.testing.assert_allclose(
        frame.radiance[on], np.broadcast_to(albedo, (on.sum(), 3)), rtol=0.05
    )


def test_provisional_light_of_a_convex_surface_is_already_right(workbench: Make) -> None:
    bench = workbench(scene_of(ball(), 0.0, albedo=0.4))
    frame = bench.renderer.render(bench.view(size=40))
    np.testing.assert_allclose(frame.radiance[frame.state > 0], 0.4, rtol=1e-5)


def test_reflected_light_only_adds(evenly_lit: Workbench) -> None:
    """Under constant light of 1: 0 <= vicinity <= gi <= albedo, to a half float; the difference is
    what bounces.
    """
    gi, vicinity = (
        evenly_lit.renderer.render(evenly_lit.view(shading=s)).radiance for s in ("gi", "vicinity")
    )
    assert (
        (vicinity >= 0.0).all()
        and (vicinity <= gi + 1e-6).all()
        and (gi <= 0.9 * (1.0 + 2.0**-11)).all()
    )
    assert gi.sum() > 1.02 * vicinity.sum()


def test_vicinity_does_not_rotate(orbital: Workbench) -> None:
    plain, turned = (
        orbital.renderer.render(orbital.view(shading="vicinity", light=q)) for q in (IDENTITY, TURN)
    )
    np.testing.assert_allclose(plain.radiance, turned.radiance, rtol=1e-5)


@pytest.mark.parametrize(
    "shading", [s for s in VIEW_SHADINGS if s.startswith(("lambert", "phong"))]
)
def test_local_models_need_no_light_from_the_cache(shading: str, workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[SKY]))
    frame = bench.renderer.render(bench.view(shading=shading))
    assert not frame.provisional and frame.chunks_needed == 0 and frame.demands == ()
    assert not list(bench.folder.glob("*/zarr.json")), "no layer is made"
    assert np.isfinite(frame.radiance).all() and frame.radiance[frame.state > 0].max() > 0.05


def test_shadow_and_fog_only_take_light_away(workbench: Make) -> None:
    bench = workbench(load_scene("demo:casting", lights=[SKY]))
    bare, shadow, fog = (
        bench.renderer.render(bench.view(shading=s)).radiance
        for s in ("lambert", "lambert_shadow", "lambert_fog")
    )
    for less in (shadow, fog):
        assert (less <= bare + 1e-6).all() and less.sum() < 0.95 * bare.sum()


def test_solid_below_is_the_picture_of_the_negated_volume(workbench: Make) -> None:
    rng = np.random.default_rng(1)
    voxels = (ball(24, 8.0).voxels * 40.0 + rng.normal(size=(25, 25, 25)) * 0.1).astype(np.float32)
    middle = float(np.median(voxels)) + 4.0
    frames = []
    for volume, isovalue in (
        (make_volume(voxels), middle),
        (make_volume(-voxels, solid="below"), -middle),
    ):
        bench = workbench(scene_of(volume, isovalue, lights=[SKY], target_error=0.3, bounces=1))
        frames.append(bench.bake(bench.view(size=24)))
    assert (frames[0].state > 0).sum() > 50
    assert np.array_equal(frames[0].state, frames[1].state)
    assert np.array_equal(frames[0].radiance, frames[1].radiance)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 3.0), (3.0, 1.5, 1.0)])
def test_a_ball_sampled_unevenly_is_lit_the_same(
    spacing: tuple[float, float, float], workbench: Make
) -> None:
    frames = []
    for steps in ((1.0, 1.0, 1.0), spacing):
        bench = workbench(
            scene_of(ball(42, 15.0, steps), 0.0, lights=[SKY], target_error=0.05, bounces=1)
        )
        frames.append(bench.bake(bench.view(20.0, 30.0, 32)))
    both = (frames[0].state > 0) & (frames[1].state > 0)
    even, uneven = (frame.radiance[both].astype(float) @ LUMINANCE_WEIGHTS for frame in frames)
    assert np.sqrt(((even - uneven) ** 2).mean()) / even.mean() < 0.08
    assert uneven.mean() == pytest.approx(even.mean(), rel=0.02)


# --- vicinity shading
# -----------------------------------------------------------------------------------------------


def test_vicinity_of_a_transfer_scene_reads_its_direct_layer(orbital: Workbench) -> None:
    before = orbital.layers
    assert len(before) == 2
    bench = orbital.again()
    frame = bench.renderer.render(bench.view(shading="vicinity"))
    assert orbital.layers == before
    assert frame.coverage["final"] > 0.99, (
        "but where light is final sooner, as its sun is no part of it"
    )
    direct = bench.caches.of("gi").chunk_store.layers[0]
    assert [layer.path for layer in bench.caches.of("vicinity").chunk_store.layers] == [direct.path]


def test_vicinity_of_a_constant_scene_has_a_layer_of_its_own(workbench: Make) -> None:
    bench = workbench(load_scene("demo:orbital", lights=[CONSTANT], bounces=2, target_error=LOOSE))
    view = bench.view(size=32)
    bench.bake(view)
    (whole,) = bench.layers
    frame = bench.renderer.render(replace(view, shading="vicinity"))
    assert frame.coverage["provisional"] == 1.0
    assert not bench.bake(replace(view, shading="vicinity")).provisional
    assert (
        bench.layers == {whole, bench.caches.of("vicinity").chunk_store.layers[0].digest}
        and len(bench.layers) == 2
    )
    assert not bench.again().renderer.render(view).provisional


@pytest.mark.slow
def test_vicinity_under_a_lamp_alone_is_that_under_its_mean(workbench: Make) -> None:
    """A lamp of irradiance π is as much light as a constant radiance of a quarter."""
    lights = {"type": "directional", "irradiance": math.pi}, {"type": "constant", "radiance": 0.25}
    benches = [
        workbench(load_scene("demo:orbital", **{**CALM, "lights": [light]})) for light in lights
    ]
    lit, even = (bench.bake(bench.view(size=32, shading="vicinity")) for bench in benches)
    assert luminance(lit).mean() > 0.05
    np.testing.assert_allclose(luminance(lit).mean(), luminance(even).mean(), rtol=0.02)


@pytest.mark.parametrize(("name", "most"), [("orbital", 0.012), ("casting", 0.04)])
def test_vicinity_is_direct_constant_light_of_the_path_tracer(
    name: str, most: float, workbench: Make
) -> None:
    """S1, fig. 10. The bake of a scene that has bounces, against a scene that has none.

    The orbital's two differ by their noise, the casting's by what is lost between texels of its
    thin fins.
    """
    bench, bare = (workbench(load_scene(f"demo:{name}", **{**CALM, "bounces": k})) for k in (4, 0))
    view = bench.view(size=64, shading="vicinity")
    frame = bench.bake(view)
    reference = bare.renderer.render(replace(view, shading="path_traced", samples=1024))
    assert frame.noise < 0.02
    assert relative_rmse(frame, reference) < most
    assert luminance(frame).mean() == pytest.approx(luminance(reference).mean(), rel=0.004)
    with_bounces = bench.renderer.render(replace(view, shading="path_traced", samples=64))
    assert relative_rmse(frame, with_bounces) > 0.03, "bounces would be seen"


# --- where no light comes
# -------------------------------------------------------------------------------------------


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
    """Texels of every other voxel: those at z = 8, a quarter of the light at the top, are in the
    hollow.
    """
    settings = {"albedo": 0.5, "bounces": 2, "lattice": 0.5, "projected": False}
    bench = workbench(scene_of(box_with_a_cellar(), 0.0, **settings, **kept))
    view = bench.view(elevation=90.0, distance=1.5, size=24, shading=shading)
    frame = bench.bake(view)
    gbuffer = bench.renderer.gbuffer(view)
    texels = bench.renderer.surface.texels(view, gbuffer)
    pool = bench.caches.of(shading).pool
    with pool.hold(texels.chunks) as held:
        grade = read_texels(
            texels, held.slots, pool, Goal(bench.scene.target_error), Tiles(1)
        ).grade
    roof = np.abs(gbuffer.points[:, :2] - 16.0).max(axis=1) < 7.0
    assert (
        roof.sum() > 50 and ((grade[texels.corners[roof]] == BURIED_GRADE).sum(axis=1) == 4).all()
    )
    np.testing.assert_allclose(frame.radiance.reshape(-1, 3)[gbuffer.pixels[roof]], 0.5, rtol=0.002)
    assert (frame.state.ravel()[gbuffer.pixels] == FINAL).all()


@pytest.mark.parametrize("shading", ["gi", "vicinity", "path_traced"])
def test_a_closed_hollow_is_black_from_inside(shading: str, workbench: Make) -> None:
    z, y, x = np.mgrid[:45, :45, :45] - 22.0
    shell = make_volume((6.0 - np.abs(np.sqrt(x * x + y * y + z * z) - 14.0)).astype(np.float32))
    bench = workbench(scene_of(shell, 0.0, bounces=2))
    camera = Camera((22.0, 22.0, 22.0), (40.0, 23.0, 25.0), fov=70.0)
    frame = bench.bake(View(0.0, camera, width=24, height=24, shading=shading))
    assert (frame.state == FINAL).all() and not frame.radiance.any() and frame.noise == 0.0


# --- against the path tracer
# ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "size", "most"),
    [
        ("orbital", 64, 0.02),
        pytest.param("casting", 64, 0.03, marks=pytest.mark.slow),
        pytest.param("engine", 80, 0.02, marks=[pytest.mark.slow, pytest.mark.data]),
    ],
)
def test_baked_light_is_the_path_tracers(
    name: str, size: int, most: float, workbench: Make, request: pytest.FixtureRequest
) -> None:
    """Of the casting's thin fins and webs, one or two voxels wide, light differs most from texel to
    texel.
    """
    if name == "engine":
        file = request.getfixturevalue("shared_data") / "engine_256x256x128_uint8.nhdr"
        bench = workbench(load_scene(file, isovalue=70, **CALM))
    else:
        bench = workbench(load_scene(f"demo:{name}", **CALM))
    view = bench.view(size=size)
    frame = bench.bake(view)
    assert (
        relative_rmse(
            frame, bench.renderer.render(replace(view, shading="path_traced", samples=256))
        )
        < most
    )
    assert frame.noise < 0.02
