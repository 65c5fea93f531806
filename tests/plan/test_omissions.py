"""What plans leave out makes less difference than the target error; where it would make more, planners keep it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake import refine
from isogi_core.bake.recipe import Recipe
from isogi_core.frame import surroundings
from isogi_core.frame.gbuffer import trace
from isogi_core.frame.texels import find_texels
from isogi_core.frame.tiles import Tiles
from isogi_core.kernels.lattice import CHUNK
from isogi_core.model.plan import Layer
from isogi_core.model.scene import Scene
from isogi_core.model.view import quaternion_from_angles
from isogi_core.plan.texels import shown_texels, surface_cells
from tests.plan.conftest import (
    SUN,
    TARGET,
    Frames,
    apart,
    bowl,
    plated_ball,
    scene_of,
    view_of,
    with_layers,
)

Lobe = Callable[[float], dict[str, Any]]
SOFT, WIDE = 0.3, 2.0
"""Sharpness of lobes: light that is nearly the same from all sides, and light from a wide window."""

TURN = quaternion_from_angles(60.0, 0.0, 0.0)
VICINITY = {"representation": "vicinity", "bounces": 0}


def in_bowl(**settings: Any) -> Scene:
    """A scene of the bowl."""
    return scene_of(bowl(), **settings)


def test_harmonics_are_left_out_under_constant_light(frame_of: Frames) -> None:
    scene = in_bowl()
    assert scene.plan.representation == "constant"
    kept = in_bowl(representation="transfer", order=3, indirect_order=3)
    assert apart(frame_of(scene), frame_of(kept)) < TARGET / 10


def test_harmonics_are_kept_under_a_probe(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(1.0)])
    assert scene.plan.representation == "transfer"
    assert apart(frame_of(with_layers(scene, Layer("whole"), representation="constant")), frame_of(scene)) > TARGET


def test_turning_is_left_out_where_the_light_stays(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)], rotating=False)
    assert scene.plan.representation == "irradiance"
    kept = in_bowl(lights=[lobe(WIDE)], order=8, indirect_order=8)
    assert apart(frame_of(scene, 256), frame_of(kept, 256)) < TARGET


def test_turning_is_kept_where_the_light_may_turn(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    assert scene.plan.representation == "transfer"
    turned = frame_of(scene, light=TURN)
    assert apart(turned, frame_of(scene, 256, light=TURN, shading="path_traced")) < 2 * TARGET
    assert apart(frame_of(scene), turned) > 4 * TARGET


def test_bands_of_direct_light_are_left_out_where_the_light_is_soft(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    assert direct.order < 5
    kept = with_layers(scene, replace(direct, order=8), indirect)
    assert apart(frame_of(scene), frame_of(kept)) < TARGET


def test_bands_of_direct_light_are_kept_where_the_light_is_sharp(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[SUN])
    soft = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    cut = with_layers(scene, replace(direct, order=soft.plan.layers[0].order), indirect)
    assert direct.order > cut.plan.layers[0].order
    assert apart(frame_of(cut), frame_of(scene)) > TARGET


def test_bands_of_reflected_light_are_left_out_where_they_are_few(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    assert indirect.order < direct.order
    assert apart(frame_of(scene), frame_of(with_layers(scene, direct, replace(indirect, order=8)))) < TARGET


def test_bands_of_reflected_light_are_kept_where_they_turn_with_the_sun(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[SUN])
    direct, indirect = scene.plan.layers
    assert indirect.order > 1 == in_bowl(lights=[lobe(SOFT)]).plan.indirect_order
    cut = with_layers(scene, direct, replace(indirect, order=1, coarse=None))
    assert apart(frame_of(cut), frame_of(scene)) > TARGET


def test_channels_are_left_out_where_the_albedo_is_grey(frame_of: Frames) -> None:
    scene = in_bowl()
    (whole,) = scene.plan.layers
    assert whole.channels == 1
    one, three = frame_of(scene), frame_of(with_layers(scene, replace(whole, channels=3)))
    assert np.array_equal(one.radiance, three.radiance)


def test_channels_are_kept_where_the_albedo_is_coloured(frame_of: Frames) -> None:
    scene = in_bowl(albedo=[0.9, 0.5, 0.2])
    (whole,) = scene.plan.layers
    assert whole.channels == 3
    assert apart(frame_of(with_layers(scene, replace(whole, channels=1))), frame_of(scene)) > TARGET


def test_bounces_are_left_out_where_they_bring_little(frame_of: Frames) -> None:
    scene = in_bowl(albedo=0.5)
    assert apart(frame_of(scene), frame_of(in_bowl(albedo=0.5, bounces=40))) < TARGET


def test_bounces_are_kept_where_the_albedo_is_high(frame_of: Frames) -> None:
    scene = in_bowl(albedo=0.9)
    few = in_bowl(albedo=0.5).bounces
    assert scene.bounces > few
    assert apart(frame_of(in_bowl(albedo=0.9, bounces=few)), frame_of(scene)) > TARGET


def test_reflected_light_is_left_out_of_black_and_nearly_black_surfaces(frame_of: Frames) -> None:
    black, dark = in_bowl(albedo=0.0), in_bowl(albedo=0.02)
    assert black.plan.representation == dark.plan.representation == "vicinity"
    assert not frame_of(black).radiance.any()
    assert apart(frame_of(dark), frame_of(in_bowl(albedo=0.02, bounces=20))) < TARGET


def test_reflected_light_is_kept_where_it_is_much(frame_of: Frames) -> None:
    scene = in_bowl(albedo=0.7)
    assert scene.plan.layers == (Layer("whole"),)
    assert apart(frame_of(with_layers(scene, Layer("direct"), **VICINITY)), frame_of(scene)) > TARGET


def test_precision_is_left_out_where_the_target_allows(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    assert scene.plan.half and scene.plan.layers[0].coarse == 2
    kept = frame_of(in_bowl(lights=[lobe(WIDE)], precision="single"))
    half = frame_of(in_bowl(lights=[lobe(WIDE)], precision="half"))
    assert 0.0 < apart(frame_of(scene), half) < TARGET / 3
    assert 0.0 < apart(half, kept) < TARGET / 3


def test_single_floats_are_kept_for_a_small_target(frame_of: Frames, lobe: Lobe) -> None:
    small = {"lights": [lobe(WIDE)], "target_error": 1e-4, "bounces": 4}
    scene = in_bowl(**small)
    assert not scene.plan.half
    assert apart(frame_of(in_bowl(**small, precision="half")), frame_of(scene)) > scene.target_error


def aimed(scene: Scene, sharp: bool) -> Scene:
    """The scene with shadow rays towards the bright parts of its environment, or without."""
    around = replace(scene.environment)
    vars(around)["sharp"] = sharp
    return replace(scene, environment=around)


def test_shadow_rays_and_their_table_are_left_out_under_soft_light(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(1.0)], rotating=False)
    assert not scene.environment.table[0].size
    kept = aimed(scene, True)
    assert kept.environment.table[0].size
    assert apart(frame_of(scene, 256), frame_of(kept, 256)) < TARGET / 3


def test_shadow_rays_and_their_table_are_kept_under_the_sun(frame_of: Frames) -> None:
    scene = in_bowl(lights=[SUN], rotating=False)
    assert scene.environment.table[0].size
    best = frame_of(scene, 1024)
    assert apart(frame_of(scene, 256), best) < TARGET < apart(frame_of(aimed(scene, False), 256), best)


def read_by(scene: Scene, isovalue: float, azimuth: float) -> np.ndarray:
    """Which texels of the lattice a view reads; bool."""
    recipe, tiles = Recipe(scene), Tiles()
    gbuffer = trace(view_of(scene, azimuth, isovalue=isovalue), recipe, tiles, None)
    marks = np.zeros(recipe.shape, np.bool_)
    for demand in find_texels(gbuffer, recipe, tiles, None).demands:
        inside = np.unravel_index(demand.offsets, (CHUNK,) * 3)
        marks[tuple(at + CHUNK * chunk for at, chunk in zip(inside, demand.index, strict=True))] = True
    return marks


def test_texels_are_left_out_that_no_allowed_isovalue_shows() -> None:
    scene = scene_of(bowl(), (-0.45, 0.45))
    low, high = map(scene.volume.normalise_isovalue, scene.isovalues)
    shown = shown_texels(surface_cells(scene.volume.voxels, low, high), scene.lattice_shape)
    assert shown.sum() == scene.texels.shown < scene.texels.total / 2
    for isovalue, azimuth in [(-0.45, 0.0), (-0.2, 100.0), (0.0, 200.0), (0.45, 300.0)]:
        assert not (read_by(scene, isovalue, azimuth) & ~shown).any()


def test_texels_are_kept_that_some_allowed_isovalue_shows() -> None:
    one, more = scene_of(bowl(), (0.0, 0.0)), scene_of(bowl(), (0.0, 3.0))
    at_zero = surface_cells(one.volume.voxels, *[one.volume.normalise_isovalue(0.0)] * 2)
    assert (read_by(more, 3.0, 40.0) & ~shown_texels(at_zero, one.lattice_shape)).any()
    assert more.texels.shown > one.texels.shown


def test_texels_without_a_gradient_are_left_out_and_not_missed(frame_of: Frames) -> None:
    """A ball lit from all sides is R everywhere; texels counted as black would show."""
    scene = scene_of(plated_ball(), (-0.4, 0.4), lattice=0.5, bounces=0)
    assert scene.texels.void > scene.texels.shown / 4
    frame = frame_of(scene)
    assert frame.coverage["final"] == 1.0
    assert apart(frame, replace(frame, radiance=np.full_like(frame.radiance, scene.albedo[0]))) < TARGET


def test_texels_with_a_gradient_are_kept() -> None:
    assert scene_of(bowl(), (-0.4, 0.4)).texels.void == 0


def test_vicinity_shading_is_the_path_tracer_without_bounces(frame_of: Frames) -> None:
    """S1, figure 10: by the same paths from texels, and by others from pixels, which do not interpolate."""
    scene = in_bowl(bounces=0, lattice=2.0)
    assert scene.plan.representation == "vicinity"
    frame = frame_of(scene)
    general = with_layers(scene, Layer("irradiance"), representation="irradiance")
    assert apart(frame, frame_of(general)) < TARGET / 50
    assert apart(frame, frame_of(scene, 1024, shading="path_traced")) < TARGET / 2
    assert apart(frame_of(in_bowl(lattice=2.0), shading="vicinity"), frame) == 0.0


KERNELS = {"bake_texels": refine, "bake_irradiance": refine, "rotate": surroundings}
"""Kernels that some scenes do without, and the module that calls them."""


UNTURNED = pytest.mark.xfail(reason="unshadowed light is turned by no angle where it stays")


@pytest.mark.parametrize("light", ["constant", pytest.param("fixed", marks=UNTURNED), "rotating"])
def test_kernels_are_called_but_for_those_left_out(
    light: str, frame_of: Frames, lobe: Lobe, monkeypatch: pytest.MonkeyPatch
) -> None:
    called: set[str] = set()
    for name, module in KERNELS.items():
        monkeypatch.setattr(module, name, recorded(name, getattr(module, name), called))
    scene = in_bowl() if light == "constant" else in_bowl(lights=[lobe(WIDE)], rotating=light == "rotating")
    frame_of(scene)
    (idle,) = [each.what for each in scene.left_out if each.what.startswith("kernels")]
    assert called == {name for name in KERNELS if name not in idle}


def recorded(name: str, kernel: Callable[..., None], called: set[str]) -> Callable[..., None]:
    """The kernel, which notes that it was ``called``."""

    def call(*arguments: Any) -> None:
        called.add(name)
        kernel(*arguments)

    return call
