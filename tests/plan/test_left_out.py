"""What plans leave out of a texel makes less difference than the target error; where it made more, it is kept."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from isogi_core.frame.frame import Frame
from isogi_core.model.scene_plan import Layer
from isogi_core.plan.scene import Scene
from tests.plan.conftest import SUN, TARGET, TURN, WIDE, Frames, Lobe, apart, in_bowl, make_frame, with_layers

SOFT = 0.3
"""Projection of a light that is nearly the same from all sides."""


@pytest.fixture(scope="module")
def frame_of(tmp_path_factory: pytest.TempPathFactory) -> Frames:
    """Makes frames, one for each scene, plan and view: the frame of what a plan keeps serves several tests."""
    made: dict[Any, Frame] = {}

    def make(scene: Scene, samples: int = 64, **settings: Any) -> Frame:
        key = scene.digest, scene.bounces, repr(scene.plan), samples, repr(settings)
        if key not in made:
            made[key] = make_frame(tmp_path_factory.mktemp("light"), scene, samples, **settings)
        return made[key]

    return make


VICINITY = {"representation": "vicinity", "bounces": 0}


def test_harmonics_are_left_out_under_constant_light(frame_of: Frames) -> None:
    scene = in_bowl()
    assert scene.plan.representation == "constant"
    kept = in_bowl(representation="transfer", order=3, indirect_order=3)
    assert apart(frame_of(scene), frame_of(kept)) < TARGET / 10


def test_harmonics_are_kept_under_a_probe(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(1.0)])
    assert scene.plan.representation == "transfer"
    assert apart(frame_of(with_layers(scene, Layer("whole"), representation="constant")), frame_of(scene)) > TARGET


@pytest.mark.slow
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


def test_soft_light_leaves_out_bands_of_direct_light(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    assert direct.order < 5
    kept = with_layers(scene, replace(direct, order=8), indirect)
    assert apart(frame_of(scene), frame_of(kept)) < TARGET


def test_bands_of_direct_light_are_kept_where_the_light_is_sharp(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[SUN], lobes=0)
    soft = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    cut = with_layers(scene, replace(direct, order=soft.plan.layers[0].order), indirect)
    assert direct.order > cut.plan.layers[0].order
    assert apart(frame_of(cut), frame_of(scene)) > TARGET


def test_reflected_light_keeps_few_bands(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    direct, indirect = scene.plan.layers
    assert indirect.order < direct.order
    assert apart(frame_of(scene), frame_of(with_layers(scene, direct, replace(indirect, order=8)))) < TARGET


def test_bands_of_reflected_light_turn_with_the_sun(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[SUN])
    direct, indirect = scene.plan.layers
    assert indirect.order > 1 == in_bowl(lights=[lobe(SOFT)]).plan.indirect_order
    cut = with_layers(scene, direct, replace(indirect, order=1, coarse=None))
    assert apart(frame_of(cut), frame_of(scene)) > TARGET


def test_lobes_are_left_out_where_the_light_is_soft(frame_of: Frames, lobe: Lobe) -> None:
    scene = in_bowl(lights=[lobe(WIDE)])
    assert scene.plan.lobes == 0 and not scene.inputs.lobes
    assert apart(frame_of(scene, 256), frame_of(scene, 256, shading="path_traced")) < 2 * TARGET


@pytest.mark.slow
def test_lobes_are_kept_where_a_sun_throws_shadows(frame_of: Frames) -> None:
    scene = in_bowl(lights=[SUN])
    assert scene.plan.lobes == 1
    truth = frame_of(scene, 256, shading="path_traced")
    assert apart(frame_of(in_bowl(lights=[SUN], lobes=0), 256), truth) > 2 * apart(frame_of(scene, 256), truth)


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


def test_paths_end_by_chance_where_that_adds_little_noise(frame_of: Frames) -> None:
    scene = in_bowl(albedo=0.9)
    assert scene.plan.survival < 1.0
    kept = replace(scene, plan=replace(scene.plan, survival=1.0))
    assert apart(frame_of(scene), frame_of(kept)) < TARGET


def test_paths_are_kept_as_often_as_the_albedo_asks(frame_of: Frames) -> None:
    scene = in_bowl(albedo=0.9)
    hasty = replace(scene, plan=replace(scene.plan, survival=in_bowl(albedo=0.5).plan.survival))
    assert hasty.plan.survival < scene.plan.survival
    assert apart(frame_of(hasty), frame_of(scene, 256)) > TARGET


def test_black_surfaces_leave_out_reflected_light(frame_of: Frames) -> None:
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


@pytest.mark.slow
def test_vicinity_shading_is_the_path_tracer_without_bounces(frame_of: Frames) -> None:
    """S1, figure 10: by the same paths from texels, and by others from pixels, which do not interpolate."""
    scene = in_bowl(bounces=0, lattice=2.0)
    assert scene.plan.representation == "vicinity"
    frame = frame_of(scene)
    general = with_layers(scene, Layer("irradiance"), representation="irradiance")
    assert apart(frame, frame_of(general)) < TARGET / 50
    assert apart(frame, frame_of(scene, 1024, shading="path_traced")) < TARGET / 2
    assert apart(frame_of(in_bowl(lattice=2.0), shading="vicinity"), frame) == 0.0
