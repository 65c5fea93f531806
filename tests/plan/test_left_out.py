"""What plans leave out makes less difference than the target error; where it made more, it is
kept.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.bake import refine
from isogi_core.frame import lighting as surroundings
from isogi_core.frame.frame import Frame
from isogi_core.frame.gbuffer import trace
from isogi_core.frame.tiles import Tiles
from isogi_core.frame.view_texels import find_texels
from isogi_core.kernels.shading.lattice import DEFAULT_CHUNK_SIDE
from isogi_core.model import environment as lamps
from isogi_core.model.scene_plan import Layer
from isogi_core.model.view import IDENTITY
from isogi_core.plan.reachable_texels import surface_cells
from isogi_core.plan.scene import Scene
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.plan.conftest import (
    SUN,
    TARGET,
    TURN,
    WIDE,
    Frames,
    Lobe,
    apart,
    bowl,
    in_bowl,
    make_frame,
    plated_ball,
    scene_of,
    view_of,
    with_layers,
)
from tests.plan.shown import shown_texels

SOFT = 0.3
"""Projection of a light that is nearly the same from all sides."""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Frames:
    """Makes frames, one for each scene, plan and view: the frame of what a plan keeps serves
    several tests.
    """
    made: dict[Any, Frame] = {}

    def make(scene: Scene, samples: int = 64, **settings: Any) -> Frame:
        key = scene.digest, scene.bounces, repr(scene.plan), samples, repr(settings)
        if key not in made:
            made[key] = make_frame(tmp_path_factory.mktemp("light"), scene, samples, **settings)
        return made[key]

    return make


VICINITY = {"representation": "vicinity", "bounces": 0}


def test_harmonics_are_left_out_under_constant_light(drawn: Frames) -> None:
    scene = in_bowl()
    assert scene.plan.representation == "constant"
    kept = in_bowl(representation="transfer", order=3, indirect_order=3)
    assert apart(drawn(scene), drawn(kept)) < TARGET / 10


def test_harmonics_are_kept_under_a_probe(drawn: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(1.0)])
    assert scene.plan.representation == "transfer"
    assert (
        apart(drawn(with_layers(scene, Layer("whole"), representation="constant")), drawn(scene))
        > TARGET
    )


@pytest.mark.slow
def test_turning_is_left_out_where_the_light_stays(drawn: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)], rotating=False)
    assert scene.plan.representation == "irradiance"
    kept = in_bowl(lights=[lobe(WIDE)], order=8, indirect_order=8)
    assert apart(drawn(scene, 256), drawn(kept, 256)) < TARGET


def test_soft_light_leaves_out_bands_of_direct_light(drawn: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    assert direct.order < 5
    kept = with_layers(scene, replace(direct, order=8), indirect)
    assert apart(drawn(scene), drawn(kept)) < TARGET


def test_bands_of_direct_light_are_kept_where_the_light_is_sharp(drawn: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[SUN], lobes=0)
    soft = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    cut = with_layers(scene, replace(direct, order=soft.plan.layers[0].order), indirect)
    assert direct.order > cut.plan.layers[0].order
    assert apart(drawn(cut), drawn(scene)) > TARGET


def test_reflected_light_keeps_few_bands(drawn: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    assert indirect.order < direct.order
    assert (
        apart(drawn(scene), drawn(with_layers(scene, direct, replace(indirect, order=8)))) < TARGET
    )


def test_bands_of_reflected_light_turn_with_the_sun(drawn: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[SUN])
    direct, indirect = scene.plan.layers
    assert indirect.order > 1 == in_bowl(lights=[lobe(SOFT)]).plan.indirect_order
    cut = with_layers(scene, direct, replace(indirect, order=1, coarse=None))
    assert apart(drawn(cut), drawn(scene)) > TARGET


def test_lobes_are_left_out_where_the_light_is_soft(drawn: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    assert scene.plan.lobes == 0 and not scene.inputs.lobes
    assert apart(drawn(scene, 256), drawn(scene, 256, shading="path_traced")) < 2 * TARGET


def test_channels_are_left_out_where_the_albedo_is_grey(drawn: Frames) -> None:
    scene = in_bowl()
    (whole,) = scene.plan.layers
    assert whole.channels == 1
    one = drawn(scene)
    three = drawn(with_layers(scene, replace(whole, channels=3)))
    assert np.array_equal(one.radiance, three.radiance)


def test_channels_are_kept_where_the_albedo_is_coloured(drawn: Frames) -> None:
    scene = in_bowl(albedo=[0.9, 0.5, 0.2])
    (whole,) = scene.plan.layers
    assert whole.channels == 3
    assert apart(drawn(with_layers(scene, replace(whole, channels=1))), drawn(scene)) > TARGET


def test_bounces_are_left_out_where_they_bring_little(drawn: Frames) -> None:
    scene = in_bowl(albedo=0.5)
    assert apart(drawn(scene), drawn(in_bowl(albedo=0.5, bounces=40))) < TARGET


def test_bounces_are_kept_where_the_albedo_is_high(drawn: Frames) -> None:
    scene = in_bowl(albedo=0.9)
    few = in_bowl(albedo=0.5).bounces
    assert scene.bounces > few
    assert apart(drawn(in_bowl(albedo=0.9, bounces=few)), drawn(scene)) > TARGET


def test_paths_end_by_chance_where_that_adds_little_noise(drawn: Frames) -> None:
    scene = in_bowl(albedo=0.9)
    assert scene.plan.survival < 1.0
    kept = replace(scene, plan=replace(scene.plan, survival=1.0))
    assert apart(drawn(scene), drawn(kept)) < TARGET


def test_paths_are_kept_as_often_as_the_albedo_asks(drawn: Frames) -> None:
    scene = in_bowl(albedo=0.9)
    hasty = replace(scene, plan=replace(scene.plan, survival=in_bowl(albedo=0.5).plan.survival))
    assert hasty.plan.survival < scene.plan.survival
    assert apart(drawn(hasty), drawn(scene, 256)) > TARGET


def test_black_surfaces_leave_out_reflected_light(drawn: Frames) -> None:
    black = in_bowl(albedo=0.0)
    dark = in_bowl(albedo=0.02)
    assert black.plan.representation == dark.plan.representation == "vicinity"
    assert not drawn(black).radiance.any()
    assert apart(drawn(dark), drawn(in_bowl(albedo=0.02, bounces=20))) < TARGET


def test_reflected_light_is_kept_where_it_is_much(drawn: Frames) -> None:
    scene = in_bowl(albedo=0.7)
    assert scene.plan.layers == (Layer("whole"),)
    assert apart(drawn(with_layers(scene, Layer("direct"), **VICINITY)), drawn(scene)) > TARGET


def test_precision_is_left_out_where_the_target_allows(drawn: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    assert scene.plan.half and scene.plan.layers[0].coarse == 2
    kept = drawn(in_bowl(lights=[lobe(WIDE)], precision="single"))
    half = drawn(in_bowl(lights=[lobe(WIDE)], precision="half"))
    assert 0.0 < apart(drawn(scene), half) < TARGET / 3
    assert 0.0 < apart(half, kept) < TARGET / 3


def test_single_floats_are_kept_for_a_small_target(drawn: Frames, lobe: Lobe) -> None:
    small = {"lights": [lobe(WIDE)], "target_error": 1e-4, "bounces": 4}
    scene = in_bowl(**small)
    assert not scene.plan.half
    assert apart(drawn(in_bowl(**small, precision="half")), drawn(scene)) > scene.target_error


# --- rays, kernels and texels
# -----------------------------------------------------------------------------------------


KERNELS = {
    "bake_texels": refine,
    "bake_irradiance": refine,
    "rotate": surroundings,
    "project_lamps": lamps,
}
"""Kernels that some scenes do without, and the module that calls them."""


@pytest.mark.parametrize("light", ["constant", "fixed", "rotating", "lamp"])
def test_kernels_are_called_but_for_those_left_out(
    light: str, frame_of: Frames, lobe: Lobe, monkeypatch: pytest.MonkeyPatch
) -> None:
    called: set[str] = set()
    for name, module in KERNELS.items():
        monkeypatch.setattr(module, name, recorded(name, getattr(module, name), called))
    lights = {"constant": [{"type": "constant"}], "lamp": [{"type": "directional"}]}.get(
        light, [lobe(WIDE)]
    )
    scene = in_bowl(lights=lights, rotating=light in ("constant", "rotating"))
    frame_of(scene, light=TURN if light == "rotating" else IDENTITY)
    (idle,) = [each.what for each in scene.left_out if each.what.startswith("kernels")]
    assert called == {name for name in KERNELS if name not in idle}


def recorded(name: str, kernel: Callable[..., None], called: set[str]) -> Callable[..., None]:
    """The kernel, which notes that it was ``called``."""

    def call(*arguments: Any) -> None:
        called.add(name)
        kernel(*arguments)

    return call


def aimed(scene: Scene, sharp: bool) -> Scene:
    """The scene with shadow rays towards the bright parts of its environment, or without."""
    around = replace(scene.lighting.environment)
    vars(around)["sharp"] = sharp
    return replace(scene, lighting=replace(scene.lighting, environment=around))


@pytest.mark.slow
def test_soft_light_leaves_out_shadow_rays_and_their_table(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(1.0)], rotating=False)
    assert not scene.lighting.environment.table.rows.size
    kept = aimed(scene, True)
    assert kept.lighting.environment.table.rows.size
    assert apart(frame_of(scene, 256), frame_of(kept, 256)) < TARGET / 3


@pytest.mark.slow
def test_shadow_rays_and_their_table_are_kept_under_the_sun(frame_of: Frames) -> None:
    scene = in_bowl(lights=[SUN], rotating=False)
    assert scene.lighting.environment.table.rows.size
    best = frame_of(scene, 1024)
    assert (
        apart(frame_of(scene, 256), best) < TARGET < apart(frame_of(aimed(scene, False), 256), best)
    )


def read_by(scene: Scene, isovalue: float, azimuth: float) -> np.ndarray:
    """Which texels of the lattice a view reads; bool."""
    prepared = PreparedScene(scene)
    tiles = Tiles()
    gbuffer = trace(view_of(scene, azimuth, isovalue=isovalue), prepared.surface(isovalue), tiles)
    marks = np.zeros(prepared.shape, np.bool_)
    texels = find_texels(gbuffer, prepared, tiles)
    for index, offsets in zip(texels.chunks, texels.offsets, strict=True):
        inside = np.unravel_index(offsets, (DEFAULT_CHUNK_SIDE,) * 3)
        marks[
            tuple(at + DEFAULT_CHUNK_SIDE * chunk for at, chunk in zip(inside, index, strict=True))
        ] = True
    return marks


def test_texels_are_kept_that_some_allowed_isovalue_shows() -> None:
    one = scene_of(bowl(), (0.0, 0.0))
    more = scene_of(bowl(), (0.0, 3.0))
    at_zero = surface_cells(one.volume.voxels, *[one.volume.normalise_isovalue(0.0)] * 2)
    assert (read_by(more, 3.0, 40.0) & ~shown_texels(at_zero, one.lattice_shape)).any()
    assert more.texels.shown > one.texels.shown


def test_texels_without_a_gradient_are_left_out_and_not_missed(frame_of: Frames) -> None:
    """A ball lit from all sides is R everywhere; texels counted as black would show."""
    scene = scene_of(plated_ball(), (-0.4, 0.4), lattice=0.5, bounces=0)
    assert scene.texels.void > scene.texels.shown / 4
    frame = frame_of(scene)
    assert frame.coverage["provisional"] == 0.0
    assert (
        apart(
            frame, replace(frame, radiance=np.full_like(frame.radiance, scene.surfaces.albedo[0]))
        )
        < TARGET
    )
