"""Paths in waves against paths one at a time: the same bits, however they are put together."""

import numpy as np
import pytest
from numba import njit

from isogi_core.bake.bake_spec import spec_for
from isogi_core.bake.refine import refine
from isogi_core.bake.texel_light import Light
from isogi_core.kernels.tracing.field import OFFSET
from isogi_core.kernels.tracing.intersect import OUTSIDE
from isogi_core.kernels.tracing.vec import column, put_column
from isogi_core.kernels.transport.integrator import trace_path
from isogi_core.kernels.transport.paths import PathEnds, PathStarts, SampleRange
from isogi_core.kernels.transport.wavefront import walk_paths
from isogi_core.model.volume import make_volume
from isogi_core.plan.assembly import load_scene
from isogi_core.prepared.prepared_scene import PreparedScene, make_field
from tests.kernels.fields import cells_of
from tests.scale import PYTHON

Z, Y, X = np.indices((30, 34, 38)) - 16.0
BUMPS = 10.0 - np.sqrt(X**2 + Y**2 + Z**2) + 1.5 * np.sin(X) * np.sin(Y) * np.sin(Z)
BOUNCES = 4


@njit
def one_by_one(field, starts, samples, survival, ends):
    g = len(starts.isovalues)
    for m in range(g * samples.count):
        i, sample = m % g, samples.first + m // g
        start = column(starts.points, i), column(starts.normals, i), OUTSIDE
        ends.bounces[m], w = trace_path(field, starts.isovalues[i], start, starts.seeds[i], sample, BOUNCES, survival)
        put_column(ends.directions, m, w)


@njit
def in_waves(field, cells, starts, samples, survival, ends):
    walk_paths(field, cells, starts, samples, BOUNCES, survival, ends)


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
    cells, total = cells_of(field, isovalues.min(), isovalues.max()), starts * count
    one, other = (PathEnds(np.empty(total, np.int64), np.empty((3, total))) for _ in range(2))
    begin, samples = PathStarts(points, normals, isovalues, seeds), SampleRange(3, count)
    one_by_one(field, begin, samples, survival, one)
    in_waves(field, cells, begin, samples, survival, other)
    assert np.array_equal(one.bounces, other.bounces)
    assert np.array_equal(one.directions, other.directions)
    assert total < 1000 or (one.bounces > 0).mean() > 0.01


@pytest.mark.parametrize("pieces", [2, 7])
def test_texels_are_the_same_bits_in_any_company(pieces):
    spec = spec_for(PreparedScene(load_scene("demo:orbital", bounces=3)), "gi")
    rng = np.random.default_rng(2)
    texels = np.stack([rng.integers(0, n, 60) for n in spec.prepared.shape], axis=-1).astype(np.int32)
    together = Light.dark(spec.plan, len(texels))
    refine(together, texels, spec, 64, 0.0)
    for piece in np.array_split(rng.permutation(len(texels)), pieces):
        apart = Light.dark(spec.plan, len(piece))
        refine(apart, texels[piece], spec, 32, 0.0)
        refine(apart, texels[piece], spec, 64, 0.0)
        for part, whole in zip(apart.parts, together.parts, strict=True):
            for name in ("samples", "noise", "coefficients"):
                assert np.array_equal(getattr(part, name), getattr(whole, name)[piece])
