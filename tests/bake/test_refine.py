"""Refinement: the same texel after so many samples has the same bits, however it got there."""

import math
from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.bake_spec import BakeSpec
from isogi_core.bake.noise import (
    Goal,
    finished,
    most_samples,
    noise_of_halves,
    relative_error,
)
from isogi_core.bake.refine import add_to_mean, climb, locate, next_samples, refine
from isogi_core.bake.texel_light import VOID, Light, noise_codes, noise_of, round_light
from isogi_core.kernels.transport.paths import SampleRange, TransferRules
from isogi_core.kernels.transport.transfer import bake_texels, locate_texels
from isogi_core.model.scene_plan import texel_target
from isogi_core.prepared.prepared_scene import PreparedScene
from tests.bake.texels import COLUMNS, baked, climbed, orbital, same, surface_texels
from tests.scale import COMPILED

LOOKS = {
    "transfer": {},
    "coloured": {"albedo": (0.3, 0.5, 0.9)},
    "single floats": {"precision": "single"},
    "constant": {"sky": False},
    "vicinity": {"shading": "vicinity"},
}
EVERY_LOOK = pytest.mark.parametrize("settings", LOOKS.values(), ids=LOOKS)


# --- the same bits
# ------------------------------------------------------------------------------------------------


@COMPILED
@EVERY_LOOK
def test_one_bake_and_many_small_ones_are_the_same(settings: dict[str, object]) -> None:
    spec = orbital(**settings)  # type: ignore[arg-type]
    texels = surface_texels(spec, 60)
    target = 0.02
    once = baked(spec, texels, most_samples(target), target=target)
    assert finished(once, spec, Goal(target)).all() and len(set(once.samples.tolist())) > 1
    levels = [16 << step for step in range(12)]
    assert same(baked(spec, texels, *levels, target=target), once)
    assert same(baked(spec, texels, 32, 32, 1024, 16, most_samples(target), target=target), once)
    assert not same(baked(spec, texels, 32, target=target), once)


@COMPILED
def test_the_bits_of_a_part_depend_on_its_samples_alone() -> None:
    spec = orbital()
    texels = surface_texels(spec, 60)
    light = Light.dark(spec.plan, 60)
    light.put(np.arange(30), climbed(spec, texels[:30], 128))
    climb(light.parts[:1], np.arange(30), locate(texels, spec.prepared, spec.shown), spec)
    refine(light, texels, spec, 128, Goal(0.001))
    assert {*zip(*(part.samples.tolist() for part in light.parts), strict=True)} == {
        (256, 128),
        (128, 128),
    }
    for samples in {int(own) for part in light.parts for own in part.samples}:
        expected = climbed(spec, texels, samples)
        for part, own in zip(light.parts, expected.parts, strict=True):
            rows = np.flatnonzero(part.samples == samples)
            for name in COLUMNS:
                assert np.array_equal(getattr(part, name)[rows], getattr(own, name)[rows])


@COMPILED
def test_order_and_company_of_texels_change_no_bit() -> None:
    spec = orbital()
    texels = surface_texels(spec, 30)
    together = baked(spec, texels, 64)
    order = np.random.default_rng(2).permutation(30)
    assert same(baked(spec, texels[order], 64), together.rows(order))
    for rows in np.array_split(np.arange(30), [1, 8, 9]):
        assert same(baked(spec, texels[rows], 64), together.rows(rows))


@COMPILED
@EVERY_LOOK
def test_light_in_memory_is_rounded_as_in_the_store(settings: dict[str, object]) -> None:
    spec = orbital(**settings)  # type: ignore[arg-type]
    for part in baked(spec, surface_texels(spec, 40), 64).parts:
        assert np.array_equal(round_light(part.coefficients, part.layer), part.coefficients)
        assert np.array_equal(
            noise_of(noise_codes(part.noise, part.layer.scale), part.layer.scale), part.noise
        )


# --- what climbs
# --------------------------------------------------------------------------------------------------


@COMPILED
def test_texels_at_the_target_are_left_alone() -> None:
    spec = orbital()
    texels = surface_texels(spec, 60)
    start = climbed(spec, texels, 64)
    goal = Goal(float(np.median(relative_error(start, spec))) / texel_target(1.0))
    done = finished(start, spec, goal)
    light = start.rows(np.arange(60))
    refine(light, texels, spec, 512, goal)
    assert 0 < done.sum() < 60
    assert same(light.rows(np.flatnonzero(done)), start.rows(np.flatnonzero(done)))
    climbing = sum(part.samples for part in light.parts) > 128
    assert np.array_equal(climbing, ~done)


@COMPILED
def test_parts_catch_up_and_then_climb_together() -> None:
    spec = orbital()
    goal = Goal(0.001)
    texels = surface_texels(spec, 60)
    far, near = climbed(spec, texels, 128), climbed(spec, texels, 16)
    light = Light((far.parts[0].rows(np.arange(60)), near.parts[1]))
    assert (next_samples(light, spec, goal) == 16).all()
    refine(light, texels, spec, 64, goal)
    assert (
        same(Light(light.parts[:1]), Light(far.parts[:1])) and (light.parts[1].samples == 64).all()
    )
    refine(light, texels, spec, 512, goal)
    assert (light.parts[0].samples == 512).all() and same(light, climbed(spec, texels, 512))


@COMPILED
def test_texels_with_enough_samples_wait() -> None:
    spec = orbital()
    goal = Goal(0.005)
    until = 128
    light = baked(spec, surface_texels(spec, 60), until, target=goal.error)
    waiting = next_samples(light, spec, goal)
    done = finished(light, spec, goal)
    assert (waiting[done] == -1).all() and (waiting[~done] == until).all() and not done.all()


@COMPILED
def test_a_layer_far_ahead_is_followed_up_to_the_target() -> None:
    spec = orbital()
    loose = Goal(0.2)
    texels = surface_texels(spec, 30)
    light = Light((climbed(spec, texels, 1024).parts[0], Light.dark(spec.plan, 30).parts[1]))
    refine(light, texels, spec, 1024, loose)
    assert (light.parts[0].samples == 1024).all() and (
        light.parts[1].samples == loose.most_samples
    ).all()


# --- what the light is
# ---------------------------------------------------------------------------------------------


def kernels_sums(
    spec: BakeSpec, texels: np.ndarray, number: int, first: int, count: int
) -> np.ndarray:
    """Sums of the kernel for one layer of the spec; (m, 2, channels, n²)."""
    prepared = spec.prepared
    layer = spec.plan.layers[number]
    m = len(texels)
    sums = np.zeros((m, 2, layer.channels, layer.order**2))
    isovalues = np.empty(m)
    void = np.empty(m, np.bool_)
    place = (texels, np.empty((3, m)), np.empty((3, m)), isovalues)
    locate_texels(prepared.field, prepared.step, *place, void)
    bricks = prepared.maps.covering(isovalues)
    samples = SampleRange(first, count)
    rules = TransferRules(spec.shares([layer]), spec.plan.survival, spec.plan.branches)
    orders = np.full(layer.channels, layer.order)
    bake_texels(prepared.field, bricks, place, np.arange(m), samples, rules, orders, sums)
    return sums


@pytest.mark.parametrize(("number", "least"), [(0, 0.2), (1, 0.4)], ids=["direct", "indirect"])
def test_means_and_noise_are_those_of_the_kernels_sums(number: int, least: float) -> None:
    """Of the variance twice the samples leave at most half, as random points do, and at
    ``least`` a share: more of light that comes by long paths.
    """
    spec = orbital((0.3, 0.5, 0.9), precision="single")
    texels = surface_texels(spec, 20)
    parts = [climbed(spec, texels, samples).parts[number] for samples in (16, 32, 64)]
    layer = parts[0].layer
    levels = [
        kernels_sums(spec, texels, number, first, count)
        for first, count in ((0, 8), (8, 8), (16, 16))
    ]
    np.testing.assert_allclose(parts[2].coefficients, sum(levels).sum(axis=1) / 64, atol=1e-6)
    first, second, third = (
        noise_of_halves(spec.luminance_sums(sums, layer), count, layer.order)
        for sums, count in zip(levels, (16, 16, 32), strict=True)
    )
    # Codes are 9 % apart, and each level is rounded to the next one.
    np.testing.assert_allclose(parts[0].noise, first, rtol=0.045)
    for former, latest, after in ((parts[0], second, parts[1]), (parts[1], third, parts[2])):
        both = np.sqrt((former.noise**2 + latest**2) / 2.0)
        lit = both > 0.0
        fallen = after.noise[lit] / both[lit]
        assert math.sqrt(least) / 1.045 < fallen.min() <= fallen.max() <= math.sqrt(0.5) * 1.045


@COMPILED
def test_direct_and_indirect_light_are_the_whole() -> None:
    """Three layers of the same paths, under constant light."""
    apart = orbital(precision="single")
    whole = orbital(sky=False, precision="single")
    whole = replace(whole, plan=replace(whole.plan, branches=apart.plan.branches))
    texels = surface_texels(apart, 40)
    sum_of = climbed(apart, texels, 64).transfer[:, 0, 0]
    np.testing.assert_allclose(climbed(whole, texels, 64).transfer[:, 0, 0], sum_of, atol=1e-6)


@COMPILED
@pytest.mark.parametrize("settings", [{"sky": False}, {"indirect_order": 1}])
def test_white_furnace(settings: dict[str, object]) -> None:
    """Albedo 1 and no end of bounces: every path gets out, and each texel sees all of a constant
    light.
    """
    spec = orbital(1.0, **{"bounces": 1000, **settings})  # type: ignore[arg-type]
    light = climbed(spec, surface_texels(spec, 200), 64)
    whole = np.sqrt(4.0 * np.pi) * light.transfer[:, 0, 0]
    assert all(part.coefficients.any() for part in light.parts)
    assert np.abs(whole - 1.0).max() < 0.002, "but for half floats"


@COMPILED
def test_coloured_albedo_is_three_grey_bakes() -> None:
    """Where paths end by the same chance, which follows from the brightest."""
    albedos = (0.25, 0.5, 0.75)
    coloured = orbital(albedos)
    texels = surface_texels(coloured, 30)
    direct, indirect = climbed(coloured, texels, 64).parts
    assert indirect.coefficients.shape[1] == 3
    for channel, albedo in enumerate(albedos):
        grey = orbital(albedo)
        plan = replace(grey.plan, survival=coloured.plan.survival)
        alone = climbed(BakeSpec(grey.prepared, plan), texels, 64).parts
        assert np.array_equal(alone[0].coefficients, direct.coefficients)
        assert np.array_equal(alone[1].coefficients[:, 0], indirect.coefficients[:, channel])


@EVERY_LOOK
def test_void_texels_are_marked_once_and_hold_nothing(settings: dict[str, object]) -> None:
    spec = orbital(**settings)  # type: ignore[arg-type]
    scene = spec.prepared.scene
    z, y, x = np.argwhere(scene.volume.voxels == 0.0)[0]
    voxels = scene.volume.voxels.copy()
    voxels[max(z - 2, 0) : z + 4, max(y - 2, 0) : y + 4, max(x - 2, 0) : x + 4] = 0.0
    hollow = BakeSpec(PreparedScene(scene), spec.plan)
    hollow.prepared.__dict__["field"] = spec.prepared.field._replace(voxels=voxels)
    light = baked(hollow, np.array([[z, y, x], *surface_texels(spec, 3)], np.int32), 16, 128)
    assert light.void.tolist() == [True, False, False, False]
    assert light.samples[0] == VOID and (light.samples[1:] >= 64).all()
    assert not light.transfer[0].any() and all(
        np.isfinite(part.coefficients).all() for part in light.parts
    )


def test_add_to_mean_is_the_mean_of_all() -> None:
    values = np.random.default_rng(3).random((48, 5))
    old = values[:16].mean(axis=0).astype(np.float32)
    np.testing.assert_allclose(
        add_to_mean(old, 16, values[16:].sum(axis=0), 48), values.mean(axis=0), rtol=1e-6
    )
