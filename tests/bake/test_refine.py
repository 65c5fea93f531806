"""Refinement: the same texel after so many samples has the same bits, however it got there."""

from dataclasses import replace

import numpy as np
import pytest

from isogi_core.bake.light import Light
from isogi_core.bake.look import Look
from isogi_core.bake.noise import DECAYS, blend_noise, finished, most_samples, noise_of_halves, relative_error
from isogi_core.bake.precision import VOID, noise_codes, noise_of, round_light
from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import add_to_mean, climb, next_samples, refine
from isogi_core.kernels.transfer import bake_texels, locate_texels
from isogi_core.model.plan import FEWEST
from tests.bake.texels import COLUMNS, NEVER, baked, climbed, orbital, same, surface_texels
from tests.scale import COMPILED

LOOKS = {
    "transfer": {},
    "coloured": {"albedo": (0.3, 0.5, 0.9)},
    "single floats": {"precision": "single"},
    "constant": {"sky": False},
    "vicinity": {"shading": "vicinity"},
}
EVERY_LOOK = pytest.mark.parametrize("settings", LOOKS.values(), ids=LOOKS)


# --- the same bits ------------------------------------------------------------------------------------------------


@COMPILED
@EVERY_LOOK
def test_in_one_go_or_in_many_small_ones_is_the_same(settings: dict[str, object]) -> None:
    look = orbital(**settings)  # type: ignore[arg-type]
    texels = surface_texels(look, 60)
    target = 0.02
    once = baked(look, texels, most_samples(target), target=target)
    assert finished(once, look, target).all() and len(set(once.samples.tolist())) > 1
    rungs = [16 << step for step in range(12)]
    assert same(baked(look, texels, *rungs, target=target), once)
    assert same(baked(look, texels, 32, 32, 1024, 16, most_samples(target), target=target), once)
    assert not same(baked(look, texels, 32, target=target), once)


@COMPILED
def test_a_part_has_the_bits_of_its_samples_whatever_the_others_have() -> None:
    look = orbital()
    texels = surface_texels(look, 60)
    light = Light.dark(look.plan, 60)
    light.put(np.arange(30), climbed(look, texels[:30], 128))
    climb(light.parts[:1], np.arange(30), texels, look)
    refine(light, texels, look, 128, 0.001)
    assert {*zip(*(part.samples.tolist() for part in light.parts), strict=True)} == {(256, 128), (128, 128)}
    for samples in {int(own) for part in light.parts for own in part.samples}:
        expected = climbed(look, texels, samples)
        for part, own in zip(light.parts, expected.parts, strict=True):
            rows = np.flatnonzero(part.samples == samples)
            for name in COLUMNS:
                assert np.array_equal(getattr(part, name)[rows], getattr(own, name)[rows])


@COMPILED
def test_order_and_company_of_texels_change_no_bit() -> None:
    look = orbital()
    texels = surface_texels(look, 30)
    together = baked(look, texels, 64)
    order = np.random.default_rng(2).permutation(30)
    assert same(baked(look, texels[order], 64), together.rows(order))
    for rows in np.array_split(np.arange(30), [1, 8, 9]):
        assert same(baked(look, texels[rows], 64), together.rows(rows))


def test_texels_on_different_rungs_meet() -> None:
    look = orbital()
    texels = surface_texels(look, 12)
    light = Light.dark(look.plan, 12)
    for share, until in ((np.arange(4), 64), (np.arange(2, 8), 32)):
        part = light.rows(share)
        refine(part, texels[share], look, until, NEVER)
        light.put(share, part)
    assert len(set(light.samples.tolist())) > 2
    refine(light, texels, look, 128, NEVER)
    assert same(light, baked(look, texels, 128))


@COMPILED
@EVERY_LOOK
def test_what_is_kept_in_memory_is_what_the_store_keeps(settings: dict[str, object]) -> None:
    look = orbital(**settings)  # type: ignore[arg-type]
    for part in baked(look, surface_texels(look, 40), 64).parts:
        assert np.array_equal(round_light(part.coefficients, part.layer), part.coefficients)
        assert np.array_equal(noise_of(noise_codes(part.noise, part.layer.scale), part.layer.scale), part.noise)


# --- who climbs ----------------------------------------------------------------------------------------------------


@COMPILED
def test_what_has_reached_the_target_is_left_alone() -> None:
    look = orbital()
    texels = surface_texels(look, 60)
    start = climbed(look, texels, FEWEST)
    target = float(np.median(relative_error(start, look)))
    done = finished(start, look, target)
    light = start.rows(np.arange(60))
    refine(light, texels, look, 8 * FEWEST, target)
    assert 0 < done.sum() < 60
    assert same(light.rows(np.flatnonzero(done)), start.rows(np.flatnonzero(done)))
    climbing = sum(part.samples for part in light.parts) > 2 * FEWEST
    assert np.array_equal(climbing, ~done)


@COMPILED
def test_parts_with_fewer_samples_catch_up_and_then_climb_together() -> None:
    look, target = orbital(), 0.001
    texels = surface_texels(look, 60)
    far, near = climbed(look, texels, 128), climbed(look, texels, 16)
    light = Light((far.parts[0].rows(np.arange(60)), near.parts[1]))
    assert (next_samples(light, look, target) == 16).all()
    refine(light, texels, look, 64, target)
    assert same(Light(light.parts[:1]), Light(far.parts[:1])) and (light.parts[1].samples == 64).all()
    refine(light, texels, look, 512, target)
    assert (light.parts[0].samples == 512).all() and same(light, climbed(look, texels, 512))


@COMPILED
def test_texels_wait_that_have_the_samples_asked_for() -> None:
    look, target, until = orbital(), 0.005, 128
    light = baked(look, surface_texels(look, 60), until, target=target)
    waiting, done = next_samples(light, look, target), finished(light, look, target)
    assert (waiting[done] == -1).all() and (waiting[~done] == until).all() and not done.all()


@COMPILED
def test_a_layer_that_was_lost_is_baked_again_and_the_other_kept() -> None:
    look, target = orbital(), 0.02
    texels = surface_texels(look, 60)
    whole = baked(look, texels, most_samples(target), target=target)
    light = Light((whole.parts[0].rows(np.arange(60)), Light.dark(look.plan, 60).parts[1]))
    assert not next_samples(light, look, target).any()
    refine(light, texels, look, most_samples(target), target)
    assert finished(light, look, target).all() and same(light, whole)


@COMPILED
def test_a_layer_far_ahead_is_followed_as_far_as_the_target_is_worth() -> None:
    look, loose = orbital(), 0.2
    texels = surface_texels(look, 30)
    light = Light((climbed(look, texels, 1024).parts[0], Light.dark(look.plan, 30).parts[1]))
    refine(light, texels, look, 1024, loose)
    assert (light.parts[0].samples == 1024).all() and (light.parts[1].samples == most_samples(loose)).all()


# --- what the light is ---------------------------------------------------------------------------------------------


def kernels_sums(look: Look, texels: np.ndarray, number: int, first: int, count: int) -> np.ndarray:
    """Sums of the kernel for one layer of the look; (m, 2, channels, n²)."""
    recipe, layer, m = look.recipe, look.plan.layers[number], len(texels)
    sums = np.zeros((m, 2, layer.channels, layer.order**2))
    isovalues, void = np.empty(m), np.empty(m, np.bool_)
    place = (texels, np.empty((3, m)), np.empty((3, m)), isovalues)
    locate_texels(recipe.field, recipe.step, *place, void)
    bricks = recipe.bricks(float(isovalues.min()), float(isovalues.max()))
    bake_texels(
        recipe.field,
        bricks,
        place,
        np.arange(m),
        first,
        count,
        look.shares([layer]),
        look.plan.survival,
        np.full(layer.channels, layer.order),
        sums,
    )
    return sums


@pytest.mark.parametrize("number", [0, 1])
def test_means_and_noise_are_those_of_the_kernels_sums(number: int) -> None:
    look = orbital((0.3, 0.5, 0.9), precision="single")
    texels = surface_texels(look, 20)
    part = climbed(look, texels, 64).parts[number]
    rungs = [kernels_sums(look, texels, number, first, count) for first, count in ((0, 8), (8, 8), (16, 16))]
    np.testing.assert_allclose(part.coefficients, sum(rungs).sum(axis=1) / 64, atol=1e-6)
    decay, seen = DECAYS[part.layer.kind], [look.judged(sums, part.layer) for sums in rungs]
    noises = [noise_of_halves(sums, count, part.layer.order) for sums, count in zip(seen, (16, 16, 32), strict=True)]
    blended = blend_noise(blend_noise(noises[0], 16, noises[1], decay), 32, noises[2], decay)
    codes = (noise_codes(noise, part.layer.scale).astype(int) for noise in (part.noise, blended))
    assert np.abs(np.subtract(*codes)).max() <= 1, "each rung is rounded to the next step"


@COMPILED
def test_direct_and_indirect_light_are_the_whole() -> None:
    """Three layers of the same paths, under constant light."""
    apart, whole = orbital(precision="single"), orbital(sky=False, precision="single")
    texels = surface_texels(apart, 40)
    sum_of = climbed(apart, texels, 64).transfer[:, 0, 0]
    np.testing.assert_allclose(climbed(whole, texels, 64).transfer[:, 0, 0], sum_of, atol=1e-6)


@COMPILED
@pytest.mark.parametrize("settings", [{"sky": False}, {"indirect_order": 1}])
def test_white_furnace(settings: dict[str, object]) -> None:
    """Albedo 1 and no end of bounces: every path gets out, and each texel sees all of a constant light."""
    look = orbital(1.0, **{"bounces": 1000, **settings})  # type: ignore[arg-type]
    light = climbed(look, surface_texels(look, 200), 64)
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
        alone = climbed(Look(grey.recipe, plan), texels, 64).parts
        assert np.array_equal(alone[0].coefficients, direct.coefficients)
        assert np.array_equal(alone[1].coefficients[:, 0], indirect.coefficients[:, channel])


@COMPILED
def test_brighter_albedo_reflects_more_and_black_nothing() -> None:
    look = orbital((0.0, 0.5, 0.9))
    _, indirect = climbed(look, surface_texels(look, 60), 64).parts
    black, grey, bright = indirect.coefficients[:, :, 0].mean(axis=0)
    assert black == 0.0 < grey < bright


@EVERY_LOOK
def test_void_texels_are_marked_once_and_hold_nothing(settings: dict[str, object]) -> None:
    look = orbital(**settings)  # type: ignore[arg-type]
    scene = look.recipe.scene
    z, y, x = np.argwhere(scene.volume.voxels == 0.0)[0]
    voxels = scene.volume.voxels.copy()
    voxels[max(z - 2, 0) : z + 4, max(y - 2, 0) : y + 4, max(x - 2, 0) : x + 4] = 0.0
    hollow = Look(Recipe(scene), look.plan)
    hollow.recipe.__dict__["field"] = look.recipe.field._replace(voxels=voxels)
    light = baked(hollow, np.array([[z, y, x], *surface_texels(look, 3)], np.int32), 16, 128)
    assert light.void.tolist() == [True, False, False, False]
    assert light.samples[0] == VOID and (light.samples[1:] >= FEWEST).all()
    assert not light.transfer[0].any() and all(np.isfinite(part.coefficients).all() for part in light.parts)


def test_add_to_mean_is_the_mean_of_all() -> None:
    values = np.random.default_rng(3).random((48, 5))
    old = values[:16].mean(axis=0).astype(np.float32)
    np.testing.assert_allclose(add_to_mean(old, 16, values[16:].sum(axis=0), 48), values.mean(axis=0), rtol=1e-6)
