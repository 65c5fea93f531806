"""Paths in waves against paths one at a time: the same bits, however they are put together."""

import numpy as np
import pytest
from numba import njit

from isogi_core.bake.light import Light
from isogi_core.bake.recipe import Recipe, make_field
from isogi_core.bake.refine import refine
from isogi_core.kernels.bricks import brick_ranges, make_bricks
from isogi_core.kernels.integrator import trace_path, walk_paths
from isogi_core.kernels.intersect import OUTSIDE
from isogi_core.kernels.vec import row
from isogi_core.model.scene import load_scene
from isogi_core.model.volume import make_volume

Z, Y, X = np.indices((30, 34, 38)) - 16.0
BUMPS = 10.0 - np.sqrt(X**2 + Y**2 + Z**2) + 1.5 * np.sin(X) * np.sin(Y) * np.sin(Z)
BOUNCES = 4


@njit
def one_by_one(field, isovalues, points, normals, seeds, samples, left, ways):
    for m in range(len(points)):
        p, n = row(points, m), row(normals, m)
        k, w = trace_path(field, isovalues[m], p, n, OUTSIDE, seeds[m], samples[m], BOUNCES)
        left[m] = k
        ways[m, 0], ways[m, 1], ways[m, 2] = w


@njit
def in_waves(field, bricks, isovalues, points, normals, seeds, samples, left, ways):
    walk_paths(field, bricks, isovalues, points, normals, seeds, samples, BOUNCES, left, ways)


def test_waves_are_the_paths_one_by_one():
    volume = make_volume(BUMPS)
    field, count = make_field(volume), 3000
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = 16.0 + 9.5 * normals
    isovalues = volume.normalise_isovalue(0.0) + rng.uniform(-0.02, 0.02, count)
    seeds, samples = rng.integers(0, 2**63, count).astype(np.uint64), np.arange(count)
    bricks = make_bricks(volume.voxels, brick_ranges(volume.voxels), isovalues.min(), isovalues.max())
    left, ways = np.empty((2, count), np.int64), np.empty((2, count, 3))
    one_by_one(field, isovalues, points, normals, seeds, samples, left[0], ways[0])
    in_waves(field, bricks, isovalues, points.copy(), normals.copy(), seeds, samples, left[1], ways[1])
    assert np.array_equal(left[0], left[1])
    out = left[0] >= 0
    assert np.array_equal(ways[0, out], ways[1, out])
    assert (left[0] > 0).mean() > 0.02


@pytest.mark.parametrize("pieces", [2, 7])
def test_texels_are_the_same_bits_in_any_company(pieces):
    recipe = Recipe(load_scene("demo:orbital"))
    rng = np.random.default_rng(2)
    texels = np.stack([rng.integers(0, n, 60) for n in recipe.shape], axis=-1).astype(np.int32)
    together = Light.dark(recipe.scene.plan, len(texels))
    refine(together, texels, recipe, 64, 0.0)
    for piece in np.array_split(rng.permutation(len(texels)), pieces):
        apart = Light.dark(recipe.scene.plan, len(piece))
        refine(apart, texels[piece], recipe, 32, 0.0)
        refine(apart, texels[piece], recipe, 64, 0.0)
        assert np.array_equal(apart.planes, together.planes[piece])
