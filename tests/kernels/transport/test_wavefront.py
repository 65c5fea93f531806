"""Paths in waves against paths one at a time: the same bits, however they are put together."""

import numpy as np
import pytest
from numba import njit

from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.noise import Goal
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import Light
from isogi_core.kernels.tracing.vec import column
from isogi_core.kernels.tracing.walls import NO_WALL
from isogi_core.kernels.transport.harmonics import accumulate
from isogi_core.kernels.transport.paths import PathTree, SampleRange, TransferRules
from isogi_core.kernels.transport.transfer import bake_texels
from isogi_core.model.volume import make_volume
from isogi_core.prepared.prepared_scene import PreparedScene, make_field
from tests.kernels.fields import cells_of
from tests.kernels.transport.lighting import halves_of
from tests.loaded import load_scene
from tests.oracles.paths import DARK, NO_GLOWS, Start, one_surface, trace
from tests.scale import PYTHON

Z, Y, X = np.indices((30, 34, 38)) - 16.0
BUMPS = 10.0 - np.sqrt(X**2 + Y**2 + Z**2) + 1.5 * np.sin(X) * np.sin(Y) * np.sin(Z)
BOUNCES = 4


WEIGHTS = np.array([[0.3, 1.0, 0.8, 0.6, 0.5, 0.2]])
"""What paths count: no two alike, so that sums tell after how many bounces each has left."""


@njit
def one_by_one(world, starts, samples, tree, sums):
    """``bake_texels`` by paths one by one, to ``sums`` (g, n²); returns how many left after a
    bounce.
    """
    bounced = 0
    weight = np.ones(3)
    for i in range(len(starts.isovalues)):
        p = column(starts.points, i)
        n = column(starts.normals, i)
        level = starts.isovalues[i]
        seed = starts.seeds[i]
        for sample in range(samples.first, samples.first + samples.count):
            for branch in range(tree.branches):
                start = Start(p, n, level, NO_WALL, seed, sample)
                path = trace(world, (DARK, NO_GLOWS), start, tree, branch, weight)
                alone = path.bounces == 0
                (x, y, z) = path.way
                share = WEIGHTS[0, path.bounces + 1] / (1 if alone else tree.branches)
                accumulate(2, x, y, z, share, sums[i])
                bounced += path.bounces > 0
                if alone:
                    break
    return bounced


def plateaus(values):
    """The same surface between two plains, where no gradient tells a normal."""
    return np.clip(values, -0.4, 0.4)


@pytest.mark.parametrize(
    ("survival", "branches", "smooth", "offset"),
    [
        (1.0, 1, True, 0.3),
        (0.6, 1, True, 0.6),
        (0.6, 4, True, 0.3),
        (1.0, 2, False, 0.0),
        (0.6, 1, False, 0.0),
    ],
)
@pytest.mark.parametrize("texels, count", [(1, 1), (2, 20), (9, 3), (350, 5), (10, 600), (2500, 2)])
@pytest.mark.parametrize(
    "body",
    [BUMPS, plateaus(BUMPS), BUMPS[:, :, 16:19], np.repeat(BUMPS[16:17], len(BUMPS), axis=0)],
    ids=["bumps", "plateaus", "thin", "a column, whose normals have no z"],
)
def test_waves_are_the_paths_one_by_one(texels, count, body, survival, branches, smooth, offset):
    if PYTHON and texels * count > 50:
        pytest.skip("so many paths need compiled kernels")
    volume = make_volume(body, (0.5, 1.0, 2.0))
    field = make_field(volume, smooth, offset)
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(3, texels))
    normals /= np.linalg.norm(normals, axis=0)
    points = np.clip(16.0 + 9.5 * normals, 0.0, np.array(volume.size)[:, None] - 1.0)
    isovalues = volume.normalise_isovalue(0.0) + rng.uniform(-0.002, 0.002, texels)
    place = rng.integers(0, 2**31, (texels, 3)).astype(np.int32), points, normals, isovalues
    cells = cells_of(field, isovalues.min(), isovalues.max())
    samples = SampleRange(3, count)
    one, other = np.zeros((2, texels, 2, 1, 4))
    starts = halves_of(place)
    tree = PathTree(BOUNCES, survival, branches)
    bounced = one_by_one(one_surface(field), starts, samples, tree, one.reshape(2 * texels, 4))
    rules = TransferRules(WEIGHTS, survival, branches)
    rows = np.arange(texels)
    bake_texels(field, cells, place, rows, samples, rules, np.full(1, 2), other)
    assert one.any() and np.array_equal(one, other)
    assert texels * count < 500 or bounced > 0.01 * 2 * texels * count


@pytest.mark.parametrize("pieces", [2, 7])
def test_texels_are_the_same_bits_in_any_company(pieces):
    spec = spec_for(PreparedScene(load_scene("demo:orbital", bounces=3)), "gi")
    rng = np.random.default_rng(2)
    texels = np.stack([rng.integers(0, n, 60) for n in spec.prepared.shape], axis=-1).astype(
        np.int32
    )
    together = Light.dark(spec.plan, len(texels))
    refine(together, texels, spec, 64, Goal(0.0))
    for piece in np.array_split(rng.permutation(len(texels)), pieces):
        apart = Light.dark(spec.plan, len(piece))
        refine(apart, texels[piece], spec, 32, Goal(0.0))
        refine(apart, texels[piece], spec, 64, Goal(0.0))
        for part, whole in zip(apart.parts, together.parts, strict=True):
            for name in ("samples", "noise", "coefficients"):
                assert np.array_equal(getattr(part, name), getattr(whole, name)[piece])
