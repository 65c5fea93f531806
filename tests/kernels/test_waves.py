"""Paths in waves against paths one at a time: the same bits, however they are put together."""

import numpy as np
import pytest
from numba import njit

from isogi_core.bake.light import Light
from isogi_core.bake.look import look_for
from isogi_core.bake.recipe import Recipe, make_field
from isogi_core.bake.refine import refine
from isogi_core.kernels.bricks import brick_ranges, make_bricks
from isogi_core.kernels.field import OFFSET
from isogi_core.kernels.integrator import trace_path
from isogi_core.kernels.intersect import OUTSIDE
from isogi_core.kernels.vec import column, put_column
from isogi_core.kernels.waves import walk_paths
from isogi_core.model.scene import load_scene
from isogi_core.model.volume import make_volume
from tests.scale import PYTHON

Z, Y, X = np.indices((30, 34, 38)) - 16.0
BUMPS = 10.0 - np.sqrt(X**2 + Y**2 + Z**2) + 1.5 * np.sin(X) * np.sin(Y) * np.sin(Z)
BOUNCES = 4


@njit
def one_by_one(field, isovalues, points, normals, seeds, first, count, survival, left, ways):
    starts = len(isovalues)
    for m in range(starts * count):
        i, sample = m % starts, first + m // starts
        p, n = column(points, i), column(normals, i)
        left[m], w = trace_path(field, isovalues[i], p, n, OUTSIDE, seeds[i], sample, BOUNCES, survival)
        put_column(ways, m, w)


@njit
def in_waves(field, bricks, isovalues, points, normals, seeds, first, count, survival, left, ways):
    walk_paths(field, bricks, isovalues, points, normals, seeds, first, count, BOUNCES, survival, left, ways)


def plateaus(values):
    """The same surface between two plains, where no gradient tells a normal."""
    return np.clip(values, -0.4, 0.4)


@pytest.mark.parametrize(("survival", "smooth", "offset"), [(1.0, True, OFFSET), (0.6, True, 0.6), (0.6, False, 0.0)])
@pytest.mark.parametrize("starts, count", [(1, 1), (2, 40), (17, 3), (700, 5), (10, 1200), (5000, 2)])
@pytest.mark.parametrize(
    "body",
    [BUMPS, plateaus(BUMPS), BUMPS[:, :, 16:19], np.repeat(BUMPS[16:17], len(BUMPS), axis=0)],
    ids=["bumps", "plateaus", "thin", "a column, whose normals have no z"],
)
def test_waves_are_the_paths_one_by_one(starts, count, body, survival, smooth, offset):
    if PYTHON and starts * count > 100:
        pytest.skip("so many paths need compiled kernels")
    volume = make_volume(body, (0.5, 1.0, 2.0))
    field = make_field(volume, smooth, offset)
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(3, starts))
    normals /= np.linalg.norm(normals, axis=0)
    points = np.clip(16.0 + 9.5 * normals, 0.0, np.array(volume.size)[:, None] - 1.0)
    isovalues = volume.normalise_isovalue(0.0) + rng.uniform(-0.002, 0.002, starts)
    seeds = rng.integers(0, 2**63, starts).astype(np.uint64)
    bricks = make_bricks(volume.voxels, brick_ranges(volume.voxels), isovalues.min(), isovalues.max())
    total = starts * count
    left, ways = np.empty((2, total), np.int64), np.empty((2, 3, total))
    one_by_one(field, isovalues, points, normals, seeds, 3, count, survival, left[0], ways[0])
    in_waves(field, bricks, isovalues, points, normals, seeds, 3, count, survival, left[1], ways[1])
    assert np.array_equal(left[0], left[1])
    assert np.array_equal(ways[0], ways[1])
    assert total < 1000 or (left[0] > 0).mean() > 0.01


@pytest.mark.parametrize("pieces", [2, 7])
def test_texels_are_the_same_bits_in_any_company(pieces):
    look = look_for(Recipe(load_scene("demo:orbital", bounces=3)), "gi")
    rng = np.random.default_rng(2)
    texels = np.stack([rng.integers(0, n, 60) for n in look.recipe.shape], axis=-1).astype(np.int32)
    together = Light.dark(look.plan, len(texels))
    refine(together, texels, look, 64, 0.0)
    for piece in np.array_split(rng.permutation(len(texels)), pieces):
        apart = Light.dark(look.plan, len(piece))
        refine(apart, texels[piece], look, 32, 0.0)
        refine(apart, texels[piece], look, 64, 0.0)
        for part, whole in zip(apart.parts, together.parts, strict=True):
            for name in ("samples", "noise", "coefficients"):
                assert np.array_equal(getattr(part, name), getattr(whole, name)[piece])
