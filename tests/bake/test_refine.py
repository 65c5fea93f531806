"""Refinement: the same texel after so many samples has the same bits, however it got there."""

from functools import cache

import numpy as np
import pytest
from numba import config

from isogi_core.bake.light import ERROR, VOID, Light
from isogi_core.bake.noise import FEWEST, most_samples, relative_error
from isogi_core.bake.recipe import Recipe
from isogi_core.bake.refine import add_to_mean, next_rung, refine
from isogi_core.kernels.transfer import bake_texels, locate_texels
from isogi_core.model.scene import load_scene

NEVER = -1.0
"""A target that no texel reaches."""

COMPILED = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="so many paths need compiled kernels")
SKY = {"type": "sky", "sun_azimuth": 20.0, "sun_elevation": 35.0}


@cache
def orbital_recipe(albedo: float | tuple[float, ...] = 0.7, lattice: float = 1.0) -> Recipe:
    """The orbital under a sky; three albedos make it coloured."""
    given = list(albedo) if isinstance(albedo, tuple) else albedo
    return Recipe(load_scene("demo:orbital", lights=[SKY], albedo=given, lattice=lattice, bounces=3))


def surface_texels(recipe: Recipe, count: int, seed: int = 1) -> np.ndarray:
    """Random texels (count, 3; z, y, x) within a voxel or so of the scene's own isosurface; lattice 1."""
    voxels = recipe.scene.volume.voxels
    iso = recipe.scene.volume.normalise_isovalue(recipe.scene.isovalue)
    steep = np.sqrt(sum(g * g for g in np.gradient(voxels)))
    near = np.argwhere(np.abs(voxels - iso) < steep)
    return np.random.default_rng(seed).permutation(near)[:count].astype(np.int32)


def baked(recipe: Recipe, texels: np.ndarray, *rungs: int, target: float = NEVER) -> np.ndarray:
    """Planes (m, planes) of the texels after one call of `refine` for each of the `rungs`."""
    light = Light.dark(recipe.scene.plan, len(texels))
    for until in rungs:
        refine(light, texels, recipe, until, target)
    return light.planes


def test_the_ladder_doubles_from_its_first_rung() -> None:
    rungs = [0]
    while rungs[-1] < 1000:
        rungs.append(next_rung(rungs[-1]))
    assert rungs == [0, 16, 32, 64, 128, 256, 512, 1024]


@COMPILED
def test_rungs_continue_the_sequence_bit_for_bit() -> None:
    recipe = orbital_recipe()
    texels = surface_texels(recipe, 40)
    once = baked(recipe, texels, 64)
    assert (once[:, 0] == 64).all()
    assert np.array_equal(baked(recipe, texels, 16, 32, 64), once)
    assert np.array_equal(baked(recipe, texels, 16, 64), once)
    assert not np.array_equal(baked(recipe, texels, 32), once)


@COMPILED
def test_order_and_company_of_texels_change_no_bit() -> None:
    recipe = orbital_recipe()
    texels = surface_texels(recipe, 30)
    together = baked(recipe, texels, 32)
    order = np.random.default_rng(2).permutation(30)
    assert np.array_equal(baked(recipe, texels[order], 32), together[order])
    apart = [baked(recipe, part, 32) for part in np.array_split(texels, [1, 8, 9])]
    assert np.array_equal(np.concatenate(apart), together)


def test_texels_on_different_rungs_meet() -> None:
    recipe = orbital_recipe()
    texels = surface_texels(recipe, 12)
    light = Light.dark(recipe.scene.plan, 12)
    for share, until in ((slice(0, 4), 32), (slice(2, 8), 16)):
        part = Light(recipe.scene.plan, light.planes[share].copy())
        refine(part, texels[share], recipe, until, NEVER)
        light.planes[share] = part.planes
    assert sorted(set(light.samples)) == [0, 16, 32]
    refine(light, texels, recipe, 64, NEVER)
    assert np.array_equal(light.planes, baked(recipe, texels, 64))


@COMPILED
def test_what_has_reached_the_target_is_left_alone() -> None:
    recipe = orbital_recipe()
    texels = surface_texels(recipe, 60)
    start = Light(recipe.scene.plan, baked(recipe, texels, FEWEST))
    target = float(np.median(relative_error(start, recipe)))
    done = relative_error(start, recipe) <= target
    planes = baked(recipe, texels, FEWEST, 8 * FEWEST, target=target)
    assert np.array_equal(planes[done], start.planes[done])
    assert (planes[~done, 0] > FEWEST).all()
    better = relative_error(Light(recipe.scene.plan, planes), recipe) <= target
    assert (better | (planes[:, 0] >= min(8 * FEWEST, most_samples(target)))).all()


def test_means_are_those_of_the_kernels_sums() -> None:
    recipe = orbital_recipe((0.3, 0.5, 0.9))
    plan, texels, half = recipe.scene.plan, surface_texels(recipe, 20), 32
    direct, indirect = np.zeros((20, 2, 25)), np.zeros((20, 2, 3, 25))
    isovalues, void = np.empty(20), np.empty(20, np.bool_)
    place = (texels, np.empty((3, 20)), np.empty((3, 20)), isovalues)
    locate_texels(recipe.field, recipe.step, *place, void)
    bricks = recipe.bricks(float(isovalues.min()), float(isovalues.max()))
    path = (0, half, recipe.weights, plan.order)
    bake_texels(recipe.field, bricks, place, np.arange(20), *path, direct, indirect)
    light = Light(plan, baked(recipe, texels, 2 * half))
    np.testing.assert_allclose(light.direct, direct.mean(axis=1) / half, atol=1e-6)
    np.testing.assert_allclose(light.indirect, indirect.mean(axis=1) / half, atol=1e-6)
    whole = (direct[:, :, None] + indirect) / half
    np.testing.assert_allclose(light.transfer, whole.mean(axis=1), atol=1e-6)
    np.testing.assert_allclose(light.spread, (whole[:, 0] - whole[:, 1]) / 2, atol=1e-6)
    np.testing.assert_allclose(light.planes[:, ERROR], np.sqrt((light.spread**2).sum(axis=(1, 2))), rtol=1e-5)
    assert np.array_equal(light.isovalue, isovalues.astype(np.float32))
    z, y, x = texels.T
    assert np.array_equal(light.isovalue, recipe.scene.volume.voxels[z, y, x])


@COMPILED
def test_coloured_albedo_is_three_grey_bakes() -> None:
    albedos = (0.25, 0.5, 0.75)
    coloured = orbital_recipe(albedos)
    texels = surface_texels(coloured, 30)
    light = Light(coloured.scene.plan, baked(coloured, texels, 64))
    assert coloured.scene.plan.channels == 3 and light.indirect.shape == (30, 3, 25)
    for c, albedo in enumerate(albedos):
        grey = orbital_recipe(albedo)
        alone = Light(grey.scene.plan, baked(grey, texels, 64))
        assert grey.scene.plan.channels == 1
        assert np.array_equal(alone.direct, light.direct)
        assert np.array_equal(alone.indirect[:, 0], light.indirect[:, c])
        assert np.array_equal(alone.spread[:, 0], light.spread[:, c])


@COMPILED
def test_brighter_albedo_reflects_more_and_black_nothing() -> None:
    recipe = orbital_recipe((0.0, 0.5, 0.9))
    light = Light(recipe.scene.plan, baked(recipe, surface_texels(recipe, 60), 64))
    black, grey, bright = light.indirect[:, :, 0].mean(axis=0)
    assert black == 0.0 < grey < bright


@pytest.mark.parametrize("albedo", [0.7, (0.2, 0.4, 0.6)])
def test_void_texels_are_marked_once_and_hold_nothing(albedo: float | tuple[float, ...]) -> None:
    recipe = orbital_recipe(albedo)
    z, y, x = np.argwhere(recipe.scene.volume.voxels == 0.0)[0]
    texels = np.array([[z, y, x], *surface_texels(recipe, 3)], np.int32)
    hollow = Recipe(recipe.scene)
    voxels = recipe.scene.volume.voxels.copy()
    voxels[max(z - 2, 0) : z + 4, max(y - 2, 0) : y + 4, max(x - 2, 0) : x + 4] = 0.0
    hollow.__dict__["field"] = recipe.field._replace(voxels=voxels)
    planes = baked(hollow, texels, 16, 64)
    light = Light(recipe.scene.plan, planes)
    assert light.samples.tolist() == [VOID, 64, 64, 64]
    assert not planes[0, 2:].any() and np.isfinite(planes).all()


def test_add_to_mean_is_the_mean_of_all() -> None:
    values = np.random.default_rng(3).random((48, 5))
    old = values[:16].mean(axis=0).astype(np.float32)
    np.testing.assert_allclose(add_to_mean(old, 16, values[16:].sum(axis=0), 48), values.mean(axis=0), rtol=1e-6)
